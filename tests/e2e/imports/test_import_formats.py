"""Tables as other programs write them: imported by the command, and asked in SQL."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

Run = Callable[..., Any]
SHANGHAI = timezone(timedelta(hours=8))
START = datetime(2026, 11, 21, 10, 0, tzinfo=UTC)
START_NS = 1_795_255_200 * 10**9


def signals(gyrofleet: Run) -> dict[str, tuple[str, int]]:
    rows = gyrofleet("sql", "select signal, unit_of_measure, samples from signals order by all", "--json").json
    return {row["signal"]: (row["unit_of_measure"], row["samples"]) for row in rows}


def values(gyrofleet: Run, signal: str) -> list[tuple[int, float]]:
    rows = gyrofleet("sql", f"select t_ns, value from samples where signal = '{signal}' order by t_ns", "--json").json
    return [(row["t_ns"], row["value"]) for row in rows]


def imported(gyrofleet: Run, path: Path, *more: object) -> Any:
    done = gyrofleet("import", path, "--unit", "U1", "--run", "r", *more, "--json")
    assert done.code == 0, done.err + done.out
    return done.json["files"][0]


def test_titles_with_units_in_round_brackets(gyrofleet: Run, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("Time (s),Gyro X (deg/s),Gyro Y (deg/s),Rate (dps)\n0.00,1.5,2,3\n0.01,1.6,2,3\n0.02,1.7,2,3\n")
    found = imported(gyrofleet, path, "--rename", "Gyro Y=gyro_lateral")
    assert signals(gyrofleet) == {"Rate": ("dps", 3), "gyro_lateral": ("deg/s", 3), "gyro_x": ("deg/s", 3)}
    assert values(gyrofleet, "gyro_x") == [(0, 1.5), (10**7, 1.6), (2 * 10**7, 1.7)]
    assert found["remarks"] == ["column 'Gyro X (deg/s)' is signal gyro_x"]


@pytest.mark.long
def test_rename_gives_names_and_units_and_is_never_in_vain(gyrofleet: Run, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("Elapsed,rate x[deg/s],Status,Serial\n0,1,7,FOG-1\n0.5,2,8,FOG-1\n")
    refused = gyrofleet("import", path, "--run", "r")
    assert refused.code == 1
    assert "column 'Elapsed' has no unit" in refused.err
    renames = [("Elapsed", "time[s]"), ("rate x", "rate"), ("Status", "status[1]"), ("Serial", "unit")]
    options = [word for old, new in renames for word in ("--rename", f"{old}={new}")]
    assert gyrofleet("import", path, "--run", "r", *options).code == 0
    assert signals(gyrofleet) == {"rate": ("deg/s", 2), "status": ("1", 2)}
    assert gyrofleet("sql", "select distinct unit from samples", "--json").json == [{"unit": "FOG-1"}]
    left_out = [*options[:4], "--rename", "Status=", *options[6:]]
    assert "column 'Status' is left out" in gyrofleet("import", path, "--run", "s", *left_out).err
    for wrong, text in (("Speed=rate", "--rename 'Speed': the columns are Elapsed"), ("rate", "write it like")):
        refused = gyrofleet("import", path, "--run", "r", *options, "--rename", wrong)
        assert refused.code == 1
        assert text in refused.err


STAMPS: dict[str, tuple[Callable[[datetime], str], str]] = {
    "zone": (lambda t: t.astimezone(SHANGHAI).isoformat(), "2026-11-21T18:00:00.500000+08:00"),
    "utc": (lambda t: t.strftime("%Y-%m-%dT%H:%M:%S.%f") + "000Z", "2026-11-21T10:00:00.500000000Z"),
    "blank": (lambda t: str(t.replace(tzinfo=None)), "2026-11-21 10:00:00.500000"),
    "apart": (lambda t: f"{t:%Y-%m-%d %H:%M:%S.%f} +0000", "2026-11-21 10:00:00.500000 +0000"),
}


@pytest.mark.long
@pytest.mark.parametrize(
    ("title", "kind"),
    [("time", "zone"), ("Time (s)", "utc"), ("Timestamp", "blank"), ("Date Time", "apart"), ("Time (UTC)", "blank")],
)
def test_iso_time_stamps(gyrofleet: Run, tmp_path: Path, title: str, kind: str) -> None:
    form, example = STAMPS[kind]
    moments = [START + timedelta(seconds=0.5 * i) for i in range(6)]
    assert form(moments[1]) == example
    path = tmp_path / "a.csv"
    path.write_text(f"{title},Gyro X (deg/s)\n" + "".join(f"{form(t)},{i}\n" for i, t in enumerate(moments)))
    found = imported(gyrofleet, path)
    assert found["date_known"]
    assert values(gyrofleet, "gyro_x") == [(START_NS + i * 500_000_000, float(i)) for i in range(6)]
    without_zone = "time stamps without a zone are taken as UTC"
    assert (without_zone in found["remarks"]) == (kind == "blank")


@pytest.mark.long
def test_time_stamps_without_a_zone_are_of_the_stations(gyrofleet: Run, tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("Timestamp\tRate (deg/s)\n2026-11-21 18:00:00,5\t1\n2026-11-21 18:00:01,0\t2\n")
    found = imported(gyrofleet, path, "--time-zone", "Asia/Shanghai")
    assert values(gyrofleet, "Rate") == [(START_NS + 500_000_000, 1.0), (START_NS + 10**9, 2.0)]
    assert "time stamps without a zone are taken as Asia/Shanghai" in found["remarks"]


def test_a_wrong_time_stamp_is_a_bad_row(gyrofleet: Run, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(
        "time,rate[deg/s]\n2026-11-21T10:00:00Z,1\n2026-11-21T25:00:01Z,2\nnoon,3\n2026-11-21T10:00:02Z,4\n"
    )
    refused = gyrofleet("import", path, "--unit", "U1")
    assert refused.code == 1
    assert "line 3, column time: found '2026-11-21T25:00:01Z', expected a moment that exists" in refused.err
    assert "line 4, column time: found 'noon', expected a time stamp, like 2026-11-21T18:00:00.5Z" in refused.err
    assert imported(gyrofleet, path, "--skip-bad")["bad_row_count"] == 2


@pytest.mark.long
def test_time_stamps_of_a_parquet_file(gyrofleet: Run, tmp_path: Path) -> None:
    moments = [START + timedelta(milliseconds=10 * i) for i in range(5)]
    pl.DataFrame({"timestamp": moments, "rate[deg/h]": np.arange(5.0)}).write_parquet(tmp_path / "a.pq")
    assert imported(gyrofleet, tmp_path / "a.pq")["date_known"]
    assert values(gyrofleet, "rate") == [(START_NS + i * 10**7, float(i)) for i in range(5)]


@pytest.mark.long
def test_comments_before_and_between_rows_are_skipped_and_counted(gyrofleet: Run, tmp_path: Path) -> None:
    rows = "".join(f"# block {i}\n{i / 100},{i}\n" for i in range(300))
    (tmp_path / "a.csv").write_text(f"# bench 3\n#operator: Li, Wang\n\ntime[s],rate[deg/s]\n{rows}#end\n4,x\n")
    refused = gyrofleet("import", tmp_path / "a.csv", "--unit", "U1")
    assert "line 606, column rate[deg/s]: found 'x'" in refused.err
    found = imported(gyrofleet, tmp_path / "a.csv", "--skip-bad")
    assert (found["rows"], found["bad_row_count"]) == (301, 1)
    assert "303 comment lines (beginning with #) skipped" in found["remarks"]
    assert values(gyrofleet, "rate") == [(i * 10**7, float(i)) for i in range(300)]
    (event,) = gyrofleet("sql", "select * from events where kind = 'NoteAdded'", "--json").json
    assert "303 comment lines" in str(event)


@pytest.mark.long
@pytest.mark.parametrize("delimiter", [" ", ",", ";", "\t"])
def test_a_header_in_a_comment_as_numpy_writes_it(gyrofleet: Run, tmp_path: Path, delimiter: str) -> None:
    table = np.column_stack([np.arange(5) * 0.25, np.arange(5) - 2.5])
    np.savetxt(tmp_path / "a.txt", table, delimiter=delimiter, header=f"bench\ntime[s]{delimiter}rate[deg/s]")
    found = imported(gyrofleet, tmp_path / "a.txt")
    assert values(gyrofleet, "rate") == [(i * 250_000_000, i - 2.5) for i in range(5)]
    assert "the header is the last comment before the rows" in found["remarks"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("unit", "stored"),
    [("dps", "dps"), ("deg/sec", "deg/sec"), ("°/s", "°/s"), ("rad/s", "rad/s"), ("dph", "deg/h"), ("º/h", "deg/h")],
)
def test_spellings_of_angular_rates(gyrofleet: Run, tmp_path: Path, unit: str, stored: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"time[s],rate[{unit}]\n" + "".join(f"{i / 10},{i % 3}\n" for i in range(50)), encoding="utf-8")
    assert imported(gyrofleet, path)["remarks"] == []
    assert signals(gyrofleet) == {"rate": (stored, 50)}
    curve = gyrofleet("allan", "--unit", "U1", "--signal", "rate", "--json")
    assert (curve.json["unit_of_measure"], curve.json["samples"]) == ("deg/h", 50)


@pytest.mark.long
def test_g_is_standard_gravity_for_an_acceleration_and_asked_back_else(gyrofleet: Run, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time[s],acceleration_x[g],Acc Y (mg)\n0,1,1\n1,1,1\n2,1,1\n")
    found = imported(gyrofleet, path)
    assert signals(gyrofleet) == {"acc_y": ("mg_0", 3), "acceleration_x": ("g_0", 3)}
    assert any("g is taken as standard gravity (g_0)" in remark for remark in found["remarks"])
    path.write_text("time[s],x[g]\n0,1\n1,1\n")
    refused = gyrofleet("import", path, "--unit", "U1", "--run", "other")
    assert refused.code == 1
    assert "column 'x[g]': unit 'g' may be standard gravity or a mass; write 'g_0'" in refused.err


def test_a_unit_that_does_not_suit_the_signal_is_a_warning(gyrofleet: Run, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time[s],rate[furlong],temperature[degC],flow_rate[l/h]\n0,1,20,1\n1,1,20,1\n2,1,20,1\n")
    done = gyrofleet("import", path, "--unit", "U1")
    assert done.code == 0
    warnings = [line for line in done.err.splitlines() if "warning" in line]
    assert len(warnings) == 1
    assert "warning: column 'rate[furlong]': 'rate' is expected to be an angular rate, in deg/s" in warnings[0]


@pytest.mark.in_gate("csv-;-,", "txt-  -.")
@pytest.mark.parametrize(
    ("suffix", "delimiter", "mark"),
    [
        ("csv", ";", "."), ("csv", ";", ","), ("tsv", "\t", "."), ("tsv", "\t", ","),
        ("txt", ",", "."), ("txt", "  ", "."), ("txt", " ", ","), ("txt", ";", ","),
    ],
)  # fmt: skip
def test_suffixes_separators_and_decimal_marks(
    gyrofleet: Run, tmp_path: Path, suffix: str, delimiter: str, mark: str
) -> None:
    lines = ["time[ms]", "rate[deg/s]", "settle[s]"], *([f"{i * 2.5}", f"{i - 0.5:e}", "1.5"] for i in range(40))
    text = "\n".join(delimiter.join(each.replace(".", mark) for each in cells) for cells in lines)
    path = tmp_path / f"a.{suffix}"
    path.write_text(text + "\n")
    found = imported(gyrofleet, path)
    assert values(gyrofleet, "rate") == [(i * 2_500_000, i - 0.5) for i in range(40)]
    assert gyrofleet("sql", "select settle from steps", "--json").json == [{"settle": 1.5}]
    assert ("numbers are read with a decimal comma" in found["remarks"]) == (mark == ",")


@pytest.mark.long
def test_a_decimal_mark_that_changes_is_a_bad_row(gyrofleet: Run, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time[s];rate[deg/s]\n0;1\n0,1;1,5\n0,2;1.5\n0,3;1.000,5\n0,4;2\n")
    refused = gyrofleet("import", path, "--unit", "U1")
    assert "line 4, column rate[deg/s]: found '1.5', expected a value with a decimal comma" in refused.err
    assert "line 5, column rate[deg/s]: found '1.000,5', expected a value, as a number" in refused.err
    assert imported(gyrofleet, path, "--skip-bad")["bad_row_count"] == 2
    assert values(gyrofleet, "rate") == [(0, 1.0), (10**8, 1.5), (4 * 10**8, 2.0)]
