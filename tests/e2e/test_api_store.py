"""`gyrofleet.open_store`: what commands have recorded, as frames and typed results."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

import gyrofleet as gf
from stream.errors import BadInput, NotFound, QueryError, StoreError

START = "2026-11-01T00:00:00+08:00"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, run_command: Callable[..., Any]) -> Path:
    """A store of one unit: an hour at rest, and six runs of two hours with a temperature of its own."""
    folder = tmp_path_factory.mktemp("api")
    rng = np.random.default_rng(11)
    rate = 5.0 + rng.normal(0.0, 1.0, 3700)
    lines = ["time[s],rate[deg/h],temperature[degC]", *(f"{i},{x:.6f},20" for i, x in enumerate(rate))]
    (folder / "still.csv").write_text("\n".join(lines))
    words = ("--unit", "G-1", "--start", START, "--procedure", "static_bias", "--position", "IRA_up", "--store", "S")
    done = run_command("import", "still.csv", *words, cwd=folder)
    assert done.code == 0, done.err
    for run in range(6):
        t = np.arange(720) * 10.0
        temperature = 20 + 15 * np.sin(2 * np.pi * t / 3600 + run)
        values = 1.0 + 0.5 * (temperature - 20) + rng.normal(0.0, 0.3, t.size)
        rows = [f"{a:g},{b:.6f},{c:.4f}" for a, b, c in zip(t, values, temperature, strict=True)]
        (folder / f"t{run}.csv").write_text("\n".join(["time[s],rate[deg/h],temperature[degC]", *rows]))
    done = run_command("import", *(f"t{run}.csv" for run in range(6)), "--unit", "G-2", "--store", "S", cwd=folder)
    assert done.code == 0, done.err
    return folder


@pytest.fixture(scope="module")
def store(folder: Path) -> Iterator[gf.FleetStore]:
    with gf.open_store(folder / "S") as store:
        yield store


def test_what_there_is(store: gf.FleetStore) -> None:
    assert set(store.runs()["run"]) == {"still", *(f"t{run}" for run in range(6))}
    assert set(store.units()["unit"]) == {"G-1", "G-2"}
    assert store.signals().filter(unit="G-1")["samples"].to_list() == [3700, 3700]
    assert store.sql("select count(*) as n from samples where unit = $unit", {"unit": "G-1"}).rows() == [{"n": 7400}]


def test_times_of_nanoseconds_are_datetimes_in_rows(store: gf.FleetStore) -> None:
    """Without pandas, which pyarrow would take for them."""
    found = store.sql("select make_timestamp_ns(1796000000123456789) as at, null::timestamp_ns as none").rows()
    assert found == [{"at": datetime(2026, 11, 30, 0, 53, 20, 123456), "none": None}]


def test_samples_between_two_moments(store: gf.FleetStore) -> None:
    assert store.samples("G-1", "rate").height == 3700
    found = store.samples("G-1", "rate", start="2026-11-01T00:00:10+08:00", stop="2026-11-01T00:00:20+08:00")
    assert found.height == 10
    assert found["time"][0].isoformat() == "2026-10-31T16:00:10+00:00"
    for begin in (found["time"][3], found["t_ns"][3], found["t_ns"].to_numpy()[3], found["time"].to_numpy()[3]):
        assert store.samples("G-1", "rate", start=begin, stop=found["t_ns"][5]).height == 2
    with pytest.raises(BadInput, match="whole nanoseconds"):
        store.samples("G-1", "rate", start=1.5)  # type: ignore[arg-type]
    assert found["t_ns"].diff().drop_nulls().unique().to_list() == [10**9]
    assert found["unit_of_measure"].unique().to_list() == ["deg/h"]
    with pytest.raises(BadInput, match="start"):
        store.samples("G-1", "rate", start="2026-11-01T00:00:10")
    with pytest.raises(BadInput, match="not before stop"):
        store.samples("G-1", "rate", start=20, stop=10)
    with pytest.raises(NotFound, match="G-9"):
        store.samples("G-9", "rate")


def test_a_moment_in_sql_is_that_of_samples(store: gf.FleetStore) -> None:
    at, count = "2026-11-01T00:00:10+08:00", "select count(*) as n from samples where unit = 'G-1' and signal = 'rate'"
    expected = [{"n": store.samples("G-1", "rate", start=at).height}]
    assert store.sql(f"{count} and time >= '{at}'").rows() == expected
    for moment in (at, datetime.fromisoformat(at)):
        assert store.sql(f"{count} and time >= $at", {"at": moment}).rows() == expected
    with pytest.raises(QueryError, match=r"now\(\)::timestamp"):
        store.sql(f"{count} and time >= now()")


class _OfTheCaller:
    """What the process of statements cannot read, as of a module that only the caller has."""

    def __reduce__(self) -> tuple[Any, ...]:
        return int, ("none",)


@pytest.mark.parametrize("value", [_OfTheCaller(), lambda: 1])
def test_a_parameter_that_sql_has_not_is_refused(store: gf.FleetStore, value: object) -> None:
    with pytest.raises(QueryError, match="of a kind that SQL has not"):
        store.sql("select $p", {"p": value})
    assert store.sql("select 1 as a").rows() == [{"a": 1}]


def test_arguments_of_another_type_are_named(store: gf.FleetStore, folder: Path) -> None:
    ask: Any = store
    calls: dict[str, Callable[[], Any]] = {
        "unit": lambda: ask.samples(["G-1"], "rate"),
        "signal": lambda: ask.allan("G-1", 3),
        "run": lambda: ask.samples("G-1", "rate", 3),
        "no deviation": lambda: ask.allan("G-1", "rate", deviation=["oadev"]),
        "points_per_octave": lambda: ask.allan("G-1", "rate", points_per_octave=3),
        "unit is None": lambda: ask.metrics(unit=None),
        "one lot is 7": lambda: ask.metrics(lot=["L", 7]),
        "model": lambda: ask.diagnose("G-1", None),
        "progress": lambda: ask.diagnose("G-1", "rate = bias", progress=3),
        "statement is 3": lambda: ask.sql(3),
        "statement is .* surrogate pair": lambda: ask.sql("select '\ud800'"),
        "parameters is 'a'": lambda: ask.sql("select ?", "a"),
        "folder is None": lambda: gf.open_store(cast("Any", None)),
        "folder is .* null character": lambda: gf.open_store("a\0b"),
        "limits is 3": lambda: gf.open_store(folder / "S", cast("Any", 3)),
        "path is None": lambda: store.allan("G-1", "rate").plot(cast("Any", None)),
    }
    for name, call in calls.items():
        with pytest.raises(BadInput, match=f"^{name}"):
            call()


def test_a_frame_has_durations_and_names_of_their_own(store: gf.FleetStore) -> None:
    found = store.sql("select 1 as a, 2 as a, max(time) - min(time) as length from samples where unit = 'G-1'").polars()
    assert found.row(0) == (1, 2, timedelta(seconds=3699))
    assert found.columns == ["a", "a_2", "length"]
    for column in ("interval '1 month'", "[interval '1 day']", "union_value(k := 1)"):
        with pytest.raises(QueryError, match=r"intervals|Polars has no type"):
            store.sql(f"select {column} as c").polars()


@pytest.mark.parametrize("moment", [np.datetime64("3000-01-01"), np.datetime64("NaT"), True])
def test_what_is_no_moment_of_a_record_is_refused(store: gf.FleetStore, moment: Any) -> None:
    with pytest.raises(BadInput, match="a moment"):
        store.samples("G-1", "rate", stop=moment)


def test_without_a_run_the_longest_record_is_taken(store: gf.FleetStore) -> None:
    assert store.samples("G-2", "rate")["run"].unique().to_list() == [store.allan("G-2", "rate").curve.run]
    assert store.samples("G-2", "rate", "t3")["run"].unique().to_list() == ["t3"]


@pytest.mark.long
def test_a_curve_is_that_of_the_array_and_of_the_command(
    store: gf.FleetStore, folder: Path, run_command: Callable[..., Any]
) -> None:
    found = store.allan("G-1", "rate")
    plain = gf.allan_deviation(store.samples("G-1", "rate")["value"].to_numpy(), 1.0, unit_of_measure="deg/h")
    for name in ("tau_s", "deviation", "lo", "hi", "edf", "n"):
        np.testing.assert_allclose(getattr(found, name), getattr(plain, name), rtol=1e-12)
    reported = json.loads(
        run_command("allan", "--unit", "G-1", "--signal", "rate", "--store", "S", "--json", cwd=folder).out
    )
    np.testing.assert_allclose(reported["value"], found.deviation, rtol=1e-12)
    with pytest.raises(BadInput, match="choose one of"):
        store.allan("G-1", "rate", deviation="tdev")


def test_metrics_are_a_frame(store: gf.FleetStore) -> None:
    (row,) = store.metrics(unit="G-1", metric="bias_stability", standard="GJB 2426A").rows(named=True)
    assert row["lo"] < 1.0 < row["hi"]
    with pytest.raises(NotFound, match="G-9"):
        store.metrics(unit="G-9")
    with pytest.raises(BadInput, match="no metric"):
        store.metrics(metric="no_such_metric")
    none = store.metrics(unit="G-1", metric="bandwidth")
    assert none.height == 0
    assert {"value", "lo", "hi", "reason", "parameters"} <= set(none.columns)
    biases = store.metrics(unit="G-1", metric="bias")
    assert "none" in {json.loads(each)["earth_rate"] for each in biases["parameters"]}


@pytest.mark.long
def test_an_effect_that_was_not_declared_is_found(store: gf.FleetStore) -> None:
    found = store.diagnose("G-2", "rate = bias").diagnosis
    assert store.diagnose("G-2", "rate = bias", runs=["t0", "t1"], holdout="t1").diagnosis.training_runs == ("t0",)
    assert "temperature" in {name for each in found.effects for name in (each.name, *(c.name for c in each.confounded))}


def test_a_store_that_is_closed_is_told(folder: Path) -> None:
    store = gf.open_store(folder / "S")
    store.close()
    for ask in (store.runs, store.metrics):
        with pytest.raises(StoreError, match="is closed"):
            ask()


def test_what_is_no_store_is_told(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="no store"):
        gf.open_store(tmp_path)


@pytest.mark.long
@pytest.mark.parametrize(
    ("words", "names"),
    [
        ("metrics --store S --unit G-", ["G-1", "G-2"]),
        ("replay --store S t", [f"t{run}" for run in range(6)]),
        ("allan --store S --signal te", ["temperature"]),
    ],
)
def test_the_shell_completes_names_of_the_store(folder: Path, words: str, names: list[str]) -> None:
    line = f"gyrofleet {words}"
    variables = {"_GYROFLEET_COMPLETE": "bash_complete", "COMP_WORDS": line, "COMP_CWORD": str(line.count(" "))}
    command = [sys.executable, "-c", "import gyrofleet; gyrofleet.main(prog_name='gyrofleet')"]
    done = subprocess.run(
        command, env={**os.environ, **variables}, cwd=folder, capture_output=True, text=True, timeout=60
    )
    assert done.stderr == ""
    assert sorted(done.stdout.split()) == [f"plain,{name}" for name in names]
