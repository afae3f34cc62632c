"""Importing as a user does: counted to the last sample, repeated without harm, refused without a trace."""

import hashlib
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest


def fingerprint(folder: Path) -> dict[str, str]:
    """Content of every file below a folder, but for what a role last said of itself, which every command renews."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file() and path.parent.name != "status"
    }


def table(path: Path, n: int = 2000, start: int = 0, shift: float = 0.0) -> Path:
    i = np.arange(start, start + n)
    frame = pl.DataFrame(
        {"time[s]": i * 0.01, "rate[deg/s]": np.sin(i * 0.1) + shift, "temperature[degC]": 25 + i * 1e-3}
    )
    (frame.write_csv if path.suffix == ".csv" else frame.write_parquet)(path)
    return path


def samples(gyrofleet: Callable[..., Any], where: str = "true") -> int:
    return int(gyrofleet("sql", f"select count(*) as n from samples where {where}", "--json").json[0]["n"])


@pytest.mark.long
def test_the_same_file_again_adds_nothing_and_says_so(gyrofleet: Callable[..., Any], tmp_path: Path) -> None:
    path = table(tmp_path / "a.csv")
    first = gyrofleet("import", path, "--unit", "U1", "--json").json["files"][0]
    assert [signal["in_lake"] for signal in first["signals"]] == [2000, 2000]
    log = fingerprint(tmp_path / "gyrofleet-data")
    again = gyrofleet("import", path, "--unit", "U1")
    assert again.code == 0
    assert "Nothing to add: all 4,000 samples are stored already" in again.out
    assert fingerprint(tmp_path / "gyrofleet-data") == log
    assert samples(gyrofleet) == 4000


@pytest.mark.long
def test_csv_and_parquet_of_the_same_samples_are_the_same_samples(
    gyrofleet: Callable[..., Any], tmp_path: Path
) -> None:
    table(tmp_path / "a.csv")
    table(tmp_path / "a.parquet")
    gyrofleet("import", "a.csv", "--unit", "U1")
    assert "Nothing to add" in gyrofleet("import", "a.parquet", "--unit", "U1").out


@pytest.mark.long
def test_other_values_at_the_same_time_are_refused_and_the_store_stays(
    gyrofleet: Callable[..., Any], tmp_path: Path
) -> None:
    gyrofleet("import", table(tmp_path / "a.csv"), "--unit", "U1", "--run", "r")
    before = fingerprint(tmp_path / "gyrofleet-data")
    refused = gyrofleet("import", table(tmp_path / "b.csv", shift=0.5), "--unit", "U1", "--run", "r")
    assert refused.code == 1
    assert "unit U1, signal rate, run r" in refused.err
    assert "--run" in refused.err
    assert refused.err.count("\n") == 1
    assert fingerprint(tmp_path / "gyrofleet-data") == before


@pytest.mark.long
def test_samples_between_stored_ones_are_another_recording(gyrofleet: Callable[..., Any], tmp_path: Path) -> None:
    gyrofleet("import", table(tmp_path / "a.csv"), "--unit", "U1", "--run", "r")
    shifted = pl.read_csv(tmp_path / "a.csv").with_columns(pl.col("time[s]") + 0.005)
    shifted.write_csv(tmp_path / "b.csv")
    assert "other values" in gyrofleet("import", "b.csv", "--unit", "U1", "--run", "r").err
    assert samples(gyrofleet) == 4000


@pytest.mark.long
def test_a_file_may_add_signals_and_time_ranges_to_a_run(gyrofleet: Callable[..., Any], tmp_path: Path) -> None:
    gyrofleet("import", table(tmp_path / "a.csv"), "--unit", "U1", "--run", "r")
    later = gyrofleet("import", table(tmp_path / "b.csv", start=1500), "--unit", "U1", "--run", "r", "--json")
    assert [s["added"] for s in later.json["files"][0]["signals"]] == [1500, 1500]
    assert [s["already_stored"] for s in later.json["files"][0]["signals"]] == [500, 500]
    other = pl.DataFrame({"time[s]": [0.0, 1.0, 2.0], "supply_voltage[V]": [5.0, 5.1, 5.0]})
    other.write_parquet(tmp_path / "c.parquet")
    assert gyrofleet("import", "c.parquet", "--unit", "U1", "--run", "r").code == 0
    assert samples(gyrofleet, "signal = 'rate'") == 3500
    assert samples(gyrofleet, "signal = 'supply_voltage'") == 3
    curve = gyrofleet("allan", "--unit", "U1", "--signal", "rate", "--json").json
    assert (curve["samples"], curve["missing"]) == (3500, 0)
    (run,) = gyrofleet("sql", "select run, samples, signals, date_known, started, outcome from runs", "--json").json
    assert run == {
        "run": "r", "samples": 7003, "signals": 3, "date_known": False, "started": None, "outcome": "completed",
    }  # fmt: skip


@pytest.mark.long
def test_start_gives_the_date_and_no_start_leaves_it_open(gyrofleet: Callable[..., Any], tmp_path: Path) -> None:
    path = table(tmp_path / "a.csv", n=10)
    gyrofleet("import", path, "--unit", "U1", "--run", "dated", "--start", "2026-03-01T20:00:00+08:00")
    (row,) = gyrofleet("sql", "select date_known, started from runs", "--json").json
    assert row == {"date_known": True, "started": "2026-03-01 12:00:00.000000000"}
    refused = gyrofleet("import", path, "--unit", "U2", "--run", "dated")
    assert refused.code == 1
    assert "--start" in refused.err


def test_three_bad_rows_of_ten_thousand(gyrofleet: Callable[..., Any], tmp_path: Path) -> None:
    lines = ["time[s],rate[deg/s]"] + [f"{i / 100},{i % 7}" for i in range(10_000)]
    lines[5], lines[5000], lines[9999] = "0.04,fast", "49.99,nan", "99.98"
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    refused = gyrofleet("import", "a.csv", "--unit", "U1")
    assert refused.code == 1
    for line in (6, 5001, 10_000):
        assert f"line {line}" in refused.err
    assert not (tmp_path / "gyrofleet-data").exists()
    done = gyrofleet("import", "a.csv", "--unit", "U1", "--skip-bad")
    assert done.code == 0
    assert "3 of 10,000 rows of a.csv left out as bad" in done.err
    assert samples(gyrofleet) == 9997


@pytest.mark.long
def test_several_units_in_one_file(gyrofleet: Callable[..., Any], tmp_path: Path) -> None:
    lines = ["unit,time[s],rate[deg/s],temperature[degC]"]
    for i in range(500):
        lines += [f"A,{i / 10},{i},{25 if i % 10 == 0 else ''}", f"B,{i / 10},{-i},"]
    (tmp_path / "two.csv").write_text("\n".join(lines))
    gyrofleet("import", "two.csv")
    rows = gyrofleet("sql", "select unit, signal, samples from signals order by all", "--json").json
    assert [tuple(row.values()) for row in rows] == [("A", "rate", 500), ("A", "temperature", 50), ("B", "rate", 500)]


@pytest.mark.long
def test_the_same_file_at_another_start_is_refused(gyrofleet: Callable[..., Any], tmp_path: Path) -> None:
    """Its rows would be there twice."""
    path = table(tmp_path / "a.csv")
    words = ("import", path, "--unit", "U1", "--run", "r", "--start")
    done = gyrofleet(*words, "2026-03-01T20:00:00Z", "--json")
    assert [each["added"] for each in done.json["files"][0]["signals"]] == [2000, 2000]
    for start in ("2026-03-01T20:30:00Z", "2026-03-01T19:30:00Z"):
        refused = gyrofleet(*words, start)
        assert refused.code == 1
        assert "a.csv" in refused.err
    assert "Nothing to add" in gyrofleet(*words, "2026-03-01T20:00:00Z").out
    (row,) = gyrofleet("sql", "select count(*) as n, count(distinct (signal, t_ns)) as m from samples", "--json").json
    assert row == {"n": 4000, "m": 4000}


@pytest.mark.long
def test_the_interval_of_rounded_times_is_not_that_of_the_rounding(
    gyrofleet: Callable[..., Any], tmp_path: Path
) -> None:
    i = np.arange(20_000)
    times_s = np.round(i / 102.4, 3)
    pl.DataFrame({"time[s]": times_s, "rate[deg/s]": np.sin(i * 0.7)}).write_csv(tmp_path / "rounded.csv")
    (signal,) = gyrofleet("import", "rounded.csv", "--unit", "U1", "--json").json["files"][0]["signals"]
    assert not signal["irregular"]
    assert signal["sample_interval_s"] == pytest.approx(1 / 102.4, rel=1e-5)
    curve = gyrofleet("allan", "--unit", "U1", "--signal", "rate", "--json").json
    assert (curve["samples"], curve["missing"]) == (20_000, 0)
    assert curve["tau_s"][0] == pytest.approx(1 / 102.4, rel=1e-5)


@pytest.mark.long
def test_it_ends_with_what_to_ask_next(gyrofleet: Callable[..., Any], tmp_path: Path) -> None:
    path = tmp_path / "a(day).csv"
    path.write_text("time[s],temperature[degC],rate[deg/s]\n" + "".join(f"{i / 10},20,{i % 7}\n" for i in range(200)))
    done = gyrofleet("import", path, "--unit", "FOG-1", "--store", "s")
    assert done.code == 0
    asked = done.err.splitlines()[-1]
    assert asked == "Ask it: gyrofleet allan --unit FOG-1 --signal rate --run 'a(day)' --fit --store s"
    assert gyrofleet(*shlex.split(asked)[3:]).code == 0


@pytest.mark.in_gate("1-None", "64---fit --store s")
@pytest.mark.parametrize(
    ("samples", "asked"), [(1, None), (3, "--store s"), (63, "--store s"), (64, "--fit --store s")]
)
def test_what_to_ask_can_be_answered(
    gyrofleet: Callable[..., Any], tmp_path: Path, samples: int, asked: str | None
) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time[s],rate[deg/s]\n" + "".join(f"{i / 10},{i % 7}\n" for i in range(samples)))
    reported = gyrofleet("import", path, "--unit", "U", "--store", "s").err
    if asked is None:
        assert "Ask it" not in reported
        return
    line = reported.splitlines()[-1]
    assert line == f"Ask it: gyrofleet allan --unit U --signal rate --run a {asked}"
    assert gyrofleet(*shlex.split(line)[3:]).code == 0


@pytest.mark.long
def test_product_lot_and_fixture_of_imported_units_are_said_then_or_later(
    gyrofleet: Callable[..., Any], tmp_path: Path
) -> None:
    path = table(tmp_path / "a.csv")
    units = tmp_path / "units.csv"
    gyrofleet("import", path, "--unit", "U1")
    query = ("sql", "select unit, product, lot, fixture from units order by unit", "--json")
    unlisted = {"unit": "U1", "product": None, "lot": None, "fixture": None}
    assert gyrofleet(*query).json == [unlisted], "its run names it"

    units.write_text("serial,product,lot,fixture\nU1,FOG-70,L7,plate 2\nU9,FOG-80,L9,\n")
    again = gyrofleet("import", path, "--unit", "U1", "--units", units)
    assert again.code == 0
    assert "Nothing to add: all 4,000 samples" in again.out
    assert f"no sample of 1 of the 2 units of {units}: U9" in " ".join(again.err.split())
    assert gyrofleet(*query).json == [{"unit": "U1", "product": "FOG-70", "lot": "L7", "fixture": "plate 2"}]
    log = fingerprint(tmp_path / "gyrofleet-data" / "log")
    gyrofleet("import", path, "--unit", "U1", "--units", units)
    assert fingerprint(tmp_path / "gyrofleet-data" / "log") == log

    units.write_text("serial,product,lot,fixture\nU1,FOG-70,L8,plate 2\n")
    gyrofleet("import", path, "--unit", "U1", "--units", units)
    other = gyrofleet("import", path, "--unit", "U2", "--units", units, "--json").json
    assert (other["units_not_listed"], other["units_without_samples"]) == (["U2"], ["U1"])
    assert [(row["unit"], row["lot"]) for row in gyrofleet(*query).json] == [("U1", "L8"), ("U2", None)]
    assert samples(gyrofleet) == 8000

    units.write_text("serial,product,lot,fixture\nU1,FOG-70,L7,plate 2\n")
    gyrofleet("import", path, "--unit", "U1", "--units", units)
    assert [row["lot"] for row in gyrofleet(*query).json] == ["L7", None], "the first lot is entered again"
    log = fingerprint(tmp_path / "gyrofleet-data" / "log")
    gyrofleet("import", path, "--unit", "U1", "--units", units)
    assert fingerprint(tmp_path / "gyrofleet-data" / "log") == log


def test_a_bad_list_of_units_is_refused_before_anything_is_imported(
    gyrofleet: Callable[..., Any], tmp_path: Path
) -> None:
    units = tmp_path / "units.csv"
    units.write_text("serial,product\nU1,FOG-70\nU1,FOG-80\n")
    refused = gyrofleet("import", table(tmp_path / "a.csv"), "--unit", "U1", "--units", units)
    assert refused.code == 1
    assert "U1" in refused.err
    assert "line" in refused.err
    assert not (tmp_path / "gyrofleet-data").exists()
