"""The demonstration, and asking its store: SQL, Allan curves, plots; and what is refused."""

import csv
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mcap.reader
import polars as pl
import pytest

from ingest.simulator.demo_fleet import ODD_UNIT

UNITS = [f"FOG-02{n}" for n in range(31, 39)]


LENGTHS = pytest.mark.parametrize("demo", [0.1, 0.5], indirect=True)  # hours


@pytest.fixture(scope="module")
def demo(
    tmp_path_factory: pytest.TempPathFactory, run_command: Callable[..., Any], request: pytest.FixtureRequest
) -> tuple[Path, dict[str, Any]]:
    """A short demonstration: its store and its result."""
    folder = tmp_path_factory.mktemp("demo")
    hours = getattr(request, "param", 0.5)
    done = run_command("demo", "--hours", hours, "--store", folder / "store", "--json", cwd=folder, timeout_s=300)
    assert done.code == 0, done.err
    return folder / "store", done.json


@LENGTHS
@pytest.mark.in_gate("0.1")
def test_every_simulated_sample_is_in_the_lake_and_judged(
    gyrofleet: Callable[..., Any], demo: tuple[Path, Any], request: pytest.FixtureRequest
) -> None:
    store, result = demo
    seconds = round(3600 * request.node.callspec.params["demo"])
    assert result["simulated"]
    assert [unit["unit"] for unit in result["units"]] == UNITS
    # white noise twice the limit shows in minutes; the others need hours
    assert next(unit["verdict"] for unit in result["units"] if unit["unit"] == "FOG-0234") == "FAIL"
    rows = gyrofleet(
        "sql", "select unit, signal, count(*) as n, count(distinct t_ns) as moments from samples "
        f"where run = '{result['run']}' group by all order by all",
        "--store", store, "--json",
    ).json  # fmt: skip
    assert [(row["unit"], row["signal"], row["n"], row["moments"]) for row in rows] == [
        (unit, signal, n, n) for unit in UNITS for signal, n in (("rate", 200 * seconds), ("temperature", seconds))
    ]
    assert sum(row["n"] for row in rows) == result["samples"]
    stored = gyrofleet(
        "sql", "select unit, document->>'$.verdict' as verdict from events where kind = 'VerdictGiven' order by unit",
        "--store", store, "--json",
    ).json  # fmt: skip
    assert stored == [{"unit": unit["unit"], "verdict": unit["verdict"]} for unit in result["units"]]
    rows = gyrofleet("metrics", "--metric", "bias", "--run", result["run"], "--store", store, "--json").json
    assert {row["unit"] for row in rows if row["value"] is not None} == set(UNITS)
    (run,) = gyrofleet("sql", f"select * from runs where run = '{result['run']}'", "--store", store, "--json").json
    assert (run["simulated"], run["date_known"], run["outcome"]) == (True, True, "completed")
    assert Path(result["plot"]).read_bytes().startswith(b"\x89PNG")


@LENGTHS
@pytest.mark.in_gate("0.1")
def test_the_effect_that_nobody_declared_is_found_in_its_unit_and_in_no_other(demo: tuple[Path, Any]) -> None:
    units = demo[1]["found"]["units"]
    assert sorted(units) == UNITS
    assert {unit for unit, found in units.items() if found["effects"]} == {ODD_UNIT}
    found = units[ODD_UNIT]
    (effect,) = found["effects"]
    # planted as 0.25 deg/h per degC/min; a clock offset of the thermometer looks the same, and that is said
    assert effect["name"] == "temperature_rate"
    assert effect["lo"] <= 0.25 * 60 <= effect["hi"]
    assert found["verdict"] == "confounded"
    assert [each["name"] for each in found["confounded"]] == ["temperature_time_offset"]
    assert found["holdout"]["accepted"]
    assert len(found["holdout"]["runs"]) == 3
    assert found["error"]["after"]["rms_300s"] < found["error"]["before"]["rms_300s"]


@pytest.mark.long
def test_counts_are_kept_and_values_made_from_them(gyrofleet: Callable[..., Any], demo: tuple[Path, Any]) -> None:
    (row,) = gyrofleet(
        "sql",
        "select max(abs(value - counts * scale)) as worst, any_value(scale) as scale from samples "
        "join signals using (unit, signal, run) where signal = 'rate'", "--store", demo[0], "--json",
    ).json  # fmt: skip
    assert row == {"worst": 0.0, "scale": 5e-5}


@LENGTHS
@pytest.mark.in_gate("0.1")
def test_any_mcap_tool_reads_the_log(demo: tuple[Path, Any]) -> None:
    segment = next(iter(sorted((demo[0] / "log").glob("*.mcap"))))
    with segment.open("rb") as file:
        summary = mcap.reader.make_reader(file).get_summary()
    assert summary is not None
    topics = {channel.topic for channel in summary.channels.values()}
    assert "gyrofleet/simulated/demo-station/FOG-0231/rate" in topics
    assert "gyrofleet/simulated/demo-station/FOG-0231/rate/preview" in topics
    assert {schema.encoding for schema in summary.schemas.values()} == {"protobuf", "jsonschema"}


@pytest.mark.long
def test_csv_and_parquet_carry_the_same_result(
    gyrofleet: Callable[..., Any], demo: tuple[Path, Any], tmp_path: Path
) -> None:
    question = (
        "select unit, time, value, counts from samples where signal = 'temperature' order by unit, time limit 300"
    )
    as_csv = gyrofleet("sql", question, "--store", demo[0], "--csv").out
    rows = list(csv.DictReader(io.StringIO(as_csv)))
    written = gyrofleet("sql", question, "--store", demo[0], "--parquet", "out.parquet")
    assert written.code == 0
    frame = pl.read_parquet(tmp_path / "out.parquet")
    assert [float(row["value"]) for row in rows] == frame["value"].to_list()
    assert len(frame) == 300
    assert rows[1]["time"].endswith("000000")  # nanoseconds are there


@pytest.mark.long
@pytest.mark.parametrize(
    ("statement", "word"),
    [
        ("insert into samples values (1)", "INSERT is refused"),
        ("create table mine as select 1", "CREATE is refused"),
        ("drop view samples", "DROP is refused"),
        ("copy (select 1) to 'x.csv'", "COPY is refused"),
        ("attach 'x.db'", "ATTACH is refused"),
        ("install httpfs", "LOAD is refused"),
        ("set threads = 1", "SET is refused"),
        ("select 1; select 2", "2 statements"),
        ("", "0 statements"),
        ("select * from nothing", "nothing"),
        ("select * from '/etc/passwd'", "/etc/passwd"),
        ("select", "views: samples"),
    ],
)
def test_what_would_write_or_fails_is_refused_in_one_line(
    gyrofleet: Callable[..., Any], demo: tuple[Path, Any], tmp_path: Path, statement: str, word: str
) -> None:
    refused = gyrofleet("sql", statement, "--store", demo[0])
    assert refused.code == 2
    assert word in refused.err
    assert refused.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--unit", "FOG-9999", "--signal", "rate"], ["unit 'FOG-9999'", "it holds FOG-0231, FOG-0232"]),
        (["--unit", "FOG-0231", "--signal", "yaw"], ["signal 'yaw' of unit FOG-0231", "rate, temperature"]),
        (["--unit", "FOG-0231", "--signal", "rate", "--run", "x"], ["run 'x'", "demo-"]),
        (["--unit", "FOG-0231", "--signal", "rate", "--plot", "x.gif"], [".png", ".svg"]),
        (["--unit", "FOG-0231", "--signal", "rate", "--resample", "0"], ["positive"]),
        (["--unit", "FOG-0231", "--signal", "rate", "--resample", "0.001"], ["shorter than the sample interval"]),
        (["--unit", "FOG-0231", "--signal", "temperature", "--resample", "1500"], ["no Allan deviation"]),
    ],
)
def test_allan_says_what_is_missing(
    gyrofleet: Callable[..., Any], demo: tuple[Path, Any], arguments: list[str], words: list[str]
) -> None:
    refused = gyrofleet("allan", *arguments, "--store", demo[0])
    assert refused.code == 1
    assert all(word in refused.err for word in words), refused.err


@LENGTHS
@pytest.mark.in_gate("0.1")
def test_allan_draws_and_tells(gyrofleet: Callable[..., Any], demo: tuple[Path, Any], tmp_path: Path) -> None:
    for name, magic in (("a.png", b"\x89PNG"), ("a.svg", b"<?xml")):
        done = gyrofleet("allan", "--unit", "FOG-0231", "--signal", "rate", "--store", demo[0], "--plot", name)
        assert done.code == 0, done.err
        assert (tmp_path / name).read_bytes().startswith(magic)
        assert "deg/h" in done.out
    fine = gyrofleet(
        "allan", "--unit", "FOG-0231", "--signal", "rate", "--store", demo[0], "--points-per-octave", "4", "--json"
    ).json
    coarse = gyrofleet("allan", "--unit", "FOG-0231", "--signal", "rate", "--store", demo[0], "--json").json
    common = dict(zip(fine["tau_s"], fine["value"], strict=True))
    assert [common[tau] for tau in coarse["tau_s"]] == pytest.approx(coarse["value"], rel=1e-12)
    assert list(coarse) == [
        "unit", "signal", "run", "unit_of_measure", "sample_interval_s", "samples", "missing",
        "tau_s", "value", "lo", "hi", "edf", "deviation", "overlap", "plausible", "longest_still",
        "left_out_tau_s", "longest_tau_s", "rate_changes",
    ]  # fmt: skip


@pytest.mark.long
def test_curves_are_of_the_run_measured_last_and_not_of_a_short_run_recorded_after_it(
    gyrofleet: Callable[..., Any], demo: tuple[Path, Any]
) -> None:
    ask = ("--unit", "FOG-0231", "--signal", "rate", "--store", demo[0], "--json")
    for command in (("allan",), ("allan", "--rolling", "0.25", "--step", "0.125"), ("spectrum",)):
        done = gyrofleet(*command, *ask)
        assert done.code == 0, done.err
        assert done.json["run"] == demo[1]["run"]


@pytest.mark.long
def test_results_of_every_type_can_be_printed(
    gyrofleet: Callable[..., Any], demo: tuple[Path, Any], tmp_path: Path
) -> None:
    question = (
        "select 1 as a, 2 as a, 'nan'::double as x, interval 1 day as i, 'ab'::blob as b, {'k': [1, 2]} as s, "
        "1.5::decimal(10,2) as d, [make_timestamp_ns(7)] as l, 'p'::enum('p', 'q') as e, null as n, uuid() as u"
    )
    (row,) = gyrofleet("sql", question, "--store", demo[0], "--json").json
    del row["u"]
    assert row == {
        "a": 1, "a_2": 2, "x": None, "i": "0 months 1 days 0 s", "b": "YWI=", "s": {"k": [1, 2]}, "d": 1.5,
        "l": ["1970-01-01 00:00:00.000000007"], "e": "p", "n": None,
    }  # fmt: skip
    as_csv = gyrofleet("sql", question, "--store", demo[0], "--csv")
    assert as_csv.code == 0
    assert '"{""k"":[1,2]}"' in as_csv.out
    assert gyrofleet("sql", question, "--store", demo[0]).code == 0
    refused = gyrofleet("sql", question, "--store", demo[0], "--parquet", "out.parquet")
    assert refused.code == 2
    assert "::varchar" in refused.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
def test_the_fleet_and_its_limits_are_drawn_behind_a_unit(
    gyrofleet: Callable[..., Any], demo: tuple[Path, Any], tmp_path: Path
) -> None:
    ask = ("allan", "--unit", "FOG-0234", "--signal", "rate", "--store", demo[0])
    (tmp_path / "limits.toml").write_text(
        'revision = "A"\n[[limit]]\ncharacteristic = "allan_deviation"\nsignal = "rate"\ntau_s = 10.0\n'
        'upper = 0.5\nunit_of_measure = "deg/h"\n'
    )
    done = gyrofleet(*ask, "--compare", "all", "--limits", "limits.toml", "--plot", "fleet.svg")
    assert done.code == 0, done.err
    alone = gyrofleet(*ask, "--plot", "alone.svg")
    assert alone.code == 0
    lines = {name: (tmp_path / name).read_text().count('id="line2d_') for name in ("fleet.svg", "alone.svg")}
    assert lines["fleet.svg"] >= lines["alone.svg"] + 7
    for wrong, words in (
        (["--compare", "FOG-9", "--plot", "x.svg"], ["unit 'FOG-9'", "FOG-0231"]),
        (["--compare", "all"], ["--plot"]),
        (["--limits", "none.toml", "--plot", "x.svg"], ["none.toml", "cannot be read"]),
    ):
        refused = gyrofleet(*ask, *wrong)
        assert refused.code == 1
        assert all(word in refused.err for word in words), refused.err
