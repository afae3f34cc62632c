"""The header contract."""

from dataclasses import replace
from pathlib import Path

import pytest

from ingest.tables.columns import TableOptions, read_header
from stream.errors import BadInput, UnknownUnit

G1 = TableOptions(unit="G1")


def test_every_kind_of_column_is_recognised() -> None:
    titles = ["time[ms]", "rate_x[deg/s]", "gain[1]", "unit", "run", "step", "rate_command[rpm]", "amplitude"]
    columns = read_header(Path("a.csv"), titles, TableOptions())
    assert columns.time is not None
    assert columns.time.ns_per_unit == 10**6
    assert [(signal.name, signal.unit_of_measure) for signal in columns.signals] == [("rate_x", "deg/s"), ("gain", "1")]
    assert (columns.unit, columns.run) == ("unit", "run")
    assert [word.word for word in columns.words] == ["step", "rate_command_deg_per_s", "amplitude"]


@pytest.mark.parametrize(
    ("titles", "message"),
    [
        (["time[s]", "rate"], "name it like 'rate[deg/s]', or 'rate[1]'"),
        (["clock", "temperature[degC]"], "if it is the time, give it in seconds and name it 'time[s]'"),
        (["time", "rate[deg/s]"], "name it 'time[s]' or 'time[ns]'"),
        (["time[s]", "time[ns]", "rate[deg/s]"], "both times"),
        (["time[deg]", "rate[deg/s]"], "column 'time[deg]'"),
        (["time[ps]", "rate[deg/s]"], "no whole number of nanoseconds"),
        (["time[s]"], "no column holds a signal"),
        (["rate[deg/s]"], "no column 'time[s]'"),
        (["Time[s]", "clock[s]", "rate[deg/s]"], "'Time[s]' is not it: rename it"),
        (["time[s]", "rate[deg/s]", "rate[deg/s]"], "more than once"),
        (["time[s]", "rate[deg/s]", "rate[rad/s]"], "signal 'rate' stands in the header more than once"),
        (
            ["time[s]", "Temperature[degC]", "temperature[degC]", "rate[deg/s]"],
            "as 'Temperature[degC]' and 'temperature[degC]'; give one another name: --rename 'temperature[degC]=NAME'",
        ),
        (["time[s]", "rate[deg/s]", ""], "column 3 has no title"),
        (["time[s]", "rate[deg/s", "x[1]"], "cannot be read"),
        (["time[s]", "[deg/s]"], "cannot be read"),
        (["time[s]", "rate/x[deg/s]"], "cannot be used as a name"),
        (["0.0", "1.25"], "the first line must be the header"),
        (["time[s]", "rate[deg/s]", "stp"], "did you mean 'step'?"),
        (["time[s]", "rate[deg/s]", "step[1]"], "written without a unit"),
        (["time[s]", "rate[deg/s]", "rate_command"], "name it 'rate_command[deg/s]'"),
        (["time[s]", "rate[deg/s]", "rate_command[Hz]"], "cannot be turned into 'deg/s'"),
        (["time[s]", "rate[deg/s]", "frequency[rad/s]"], "cannot be turned into 'Hz'"),
        (["time[s]", "rate[deg/s]", "settle[m]"], "different quantities"),
        (["time[s]", "rate[deg/s]", "settle[s]", "settle[ms]"], "more than once"),
        (["time[s]", "rate[deg/s]", "run[1]"], "takes no unit"),
    ],
)
def test_a_header_that_breaks_the_contract_is_refused(titles: list[str], message: str) -> None:
    with pytest.raises(BadInput) as caught:
        read_header(Path("a.csv"), titles, G1)
    assert message in str(caught.value)
    assert str(caught.value).startswith("a.csv: ")


def test_a_standard_name_in_another_case_is_that_name_unless_renamed() -> None:
    titles = ["time[s]", "rate[deg/s]", "Temperature[degC]", "Humidity (%)", "SUPPLY_VOLTAGE[V]"]
    columns = read_header(Path("a.csv"), titles, G1)
    assert [each.name for each in columns.signals] == ["rate", "temperature", "humidity", "supply_voltage"]
    assert "column 'Temperature[degC]' is signal temperature" in columns.remarks
    renamed = replace(G1, renames=(("Temperature[degC]", "Temperature"),))
    assert "Temperature" in [each.name for each in read_header(Path("a.csv"), titles, renamed).signals]


@pytest.mark.parametrize(
    "titles", [["Time [s]", "Gyro X [deg/s]"], ["Time (s)", "Gyro X (deg/s)"], ["T[s]", "Gyro X[deg/s]"]]
)
def test_titles_of_other_programs_are_understood(titles: list[str]) -> None:
    found = read_header(Path("a.csv"), titles, G1)
    assert found.time is not None
    assert found.time.title == titles[0]
    assert [(each.name, each.unit_of_measure) for each in found.signals] == [("gyro_x", "deg/s")]
    assert found.remarks == [f"column {titles[1]!r} is signal gyro_x"]


def test_all_columns_that_cannot_be_read_are_named_at_once() -> None:
    with pytest.raises(BadInput) as caught:
        read_header(Path("a.csv"), ["time[s]", "rate", "temp", "Note"], G1)
    assert all(f"--rename '{name}=" in str(caught.value) for name in ("rate", "temp", "Note"))


def test_time_stamps_named_in_seconds_are_read_as_stamps_and_reported() -> None:
    columns = read_header(Path("a.csv"), ["time[s]", "rate[deg/s]"], G1, stamps=["time[s]"])
    assert columns.time is not None
    assert columns.time.is_stamp
    assert columns.remarks == ["column 'time[s]' holds time stamps; its unit [s] is ignored"]


def test_an_unknown_unit_of_measure_names_column_and_likely_unit() -> None:
    with pytest.raises(UnknownUnit, match=r"column 'rate\[dge/s\]'.*did you mean deg/s"):
        read_header(Path("a.csv"), ["time[s]", "rate[dge/s]"], G1)


@pytest.mark.parametrize(
    ("titles", "options", "message"),
    [
        (["time[s]", "rate[deg/s]"], TableOptions(), "which unit? give --unit U or a column 'unit'"),
        (["time[s]", "rate[deg/s]", "unit"], G1, "--unit is given"),
        (["time[s]", "rate[deg/s]", "run"], TableOptions(unit="G1", run="r"), "--run is given"),
        (["time[s]", "rate[deg/s]"], TableOptions(unit="G1", sample_rate_hz=10), "leave out one"),
    ],
)
def test_options_and_columns_say_a_thing_once(titles: list[str], options: TableOptions, message: str) -> None:
    with pytest.raises(BadInput) as caught:
        read_header(Path("a.csv"), titles, options)
    assert message in str(caught.value)


@pytest.mark.parametrize("rate_hz", [0.0, -1.0, float("nan"), float("inf")])
def test_a_sample_rate_is_a_positive_number(rate_hz: float) -> None:
    with pytest.raises(BadInput, match="sample rate"):
        TableOptions(sample_rate_hz=rate_hz)


def test_other_options_keep_their_ranges() -> None:
    with pytest.raises(BadInput, match="to 2116"):
        TableOptions(start_ns=2**63)
    with pytest.raises(BadInput, match="at least 1"):
        TableOptions(batch_samples=0)
