"""Lots, stations and units in lists and yields: units without limits, tests without a list of units, two stations."""

import datetime as dt
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from gyrofleet import main
from tests.e2e.judging.test_doubtful_records import parameters

Ask = Callable[..., Any]
LIMITS = """
revision = "A"
[product.FOG]
[[limit]]
metric = "bias"
product = "FOG"
upper = 10.0
unit_of_measure = "deg/h"
"""
STATION = """
[station]
site = "plant"
name = "{name}"
latitude_deg = 40.0
time_zone = "UTC"
"""


def record(path: Path, unit: str, bias: float, seed: int, day: int = 1) -> Path:
    """Ten minutes at rest on a day of October 2026."""
    noise = np.random.default_rng(seed).standard_normal(600)
    begin = int(dt.datetime(2026, 10, day, 8, tzinfo=dt.UTC).timestamp())
    rows = [f"{begin + at},{bias + 0.5 * each:.6f},{unit},static_bias,IRA_east_west" for at, each in enumerate(noise)]
    path.write_text("\n".join(["time[s],rate[deg/h],unit,procedure,position", *rows]) + "\n")
    return path


def rows_of(answer: Any) -> list[dict[str, Any]]:
    return list(answer["rows"] if isinstance(answer, dict) and "rows" in answer else answer)


def test_every_unit_is_in_its_lot(ask: Ask, tmp_path: Path) -> None:
    """Five units, one of a product without limits; one is tested again, without the list of units."""
    serials = [f"G{at}" for at in range(5)]
    listed = [f"{serial},{'MEMS' if serial == 'G4' else 'FOG'},L1" for serial in serials]
    (tmp_path / "units.csv").write_text("\n".join(["serial,product,lot", *listed]) + "\n")
    paths = [record(tmp_path / f"{serial}.csv", serial, 2.0, at) for at, serial in enumerate(serials)]
    ask("import", *paths, "--units", tmp_path / "units.csv")
    again = record(tmp_path / "again.csv", "G0", 20.0, 9, day=2)
    ask("import", again, record(tmp_path / "new.csv", "NEW", 2.0, 10, day=2))
    bare = ask("verdicts", "--by", "lot")
    groups = {row["name"]: row for row in bare["yield"]}
    assert {name: (row["units"], row["no_data"]) for name, row in groups.items()} == {"L1": (5, 5), None: (1, 1)}
    plain = CliRunner().invoke(main, ["verdicts", "--by", "lot", "--store", str(tmp_path / "S")]).output
    (without,) = ask("verdicts", "--by", "all", "--lot", "(not given)")["yield"]
    assert "(not given)" in plain
    assert without["units"] == 1
    refused = CliRunner().invoke(main, ["verdicts", "--by", "all", "--lot", "", "--store", str(tmp_path / "S")])
    assert refused.exit_code == 2
    assert "it is empty: leave it out for all" in refused.output
    (tmp_path / "limits.toml").write_text(LIMITS)
    ask("limits", "add", tmp_path / "limits.toml")
    by_lot = {row["name"]: row for row in ask("verdicts", "--by", "lot")["yield"]}
    counts = ("units", "passed", "failed", "no_data")
    assert [by_lot["L1"][name] for name in counts] == [5, 3, 1, 1]
    assert by_lot["L1"]["yield"] == pytest.approx(0.75)
    found = {row["unit"]: row for row in ask("verdicts")["units"]}
    assert (found["G0"]["lot"], found["G0"]["verdict"], found["G4"]["verdict"]) == ("L1", "FAIL", "NO_DATA")
    listed_runs = rows_of(ask("sql", "select unit, run, product, lot, mountings from units order by run, unit"))
    assert {row["unit"] for row in listed_runs if row["mountings"] == 0} == {"G0", "NEW"}
    assert len(listed_runs) == 7
    (run,) = rows_of(ask("sql", "select procedure, lot from runs where run = 'G1'"))
    assert (run["procedure"], run["lot"]) == ("static_bias", "L1")


@pytest.mark.long
def test_a_unit_without_a_verdict_is_in_each_group_that_measured_it(ask: Ask, tmp_path: Path) -> None:
    (tmp_path / "units.csv").write_text("serial,product,lot\nG1,FOG,L1\n")
    for day, name in enumerate("AB", start=1):
        (tmp_path / f"{name}.toml").write_text(STATION.format(name=name))
        files = [record(tmp_path / f"{unit}-{name}.csv", unit, 2.0, day, day) for unit in ("G1", "STRANGER")]
        ask("import", *files, "--station", tmp_path / f"{name}.toml", "--units", tmp_path / "units.csv")
    (tmp_path / "limits.toml").write_text(LIMITS)
    ask("limits", "add", tmp_path / "limits.toml")
    rows = rows_of(
        ask("sql", "select kind, units, passed, no_data from yield_by where kind in ('station', 'day', 'all')")
    )
    found = sorted((row["kind"], row["units"], row["passed"], row["no_data"]) for row in rows)
    assert found == [("all", 2, 1, 1), ("day", 2, 1, 1), ("day", 2, 1, 1), ("station", 2, 1, 1), ("station", 2, 1, 1)]


def test_a_record_under_two_names_is_warned_of(ask: Ask, tmp_path: Path) -> None:
    one = record(tmp_path / "one.csv", "G1", 2.0, 1)
    copy = tmp_path / "copy.csv"
    copy.write_text(one.read_text().replace(",G1,", ",G2,"))
    ask("import", one, copy, record(tmp_path / "other.csv", "G3", 2.0, 3))
    warnings = {row["unit"]: row for row in ask("verdicts")["warnings"]}
    assert {unit: row["others"] for unit, row in warnings.items()} == {"G1": ["G2"], "G2": ["G1"]}
    assert "has 1 run with the samples of another one (run one is run copy of G2)" in warnings["G1"]["reason"]


def test_a_repeatability_over_two_stations_says_so(ask: Ask, tmp_path: Path) -> None:
    for name in ("A", "B"):
        (tmp_path / f"{name}.toml").write_text(STATION.format(name=name))
    paths: dict[str, list[Path]] = {"A": [], "B": []}
    for at in range(6):
        for unit, station in (("TWO", "AB"[at % 2]), ("ONE", "A")):
            bias, seed = 2.0 + 0.5 * (station == "B"), 10 * at + (unit == "ONE")
            paths[station].append(record(tmp_path / f"{unit}{at}.csv", unit, bias, seed, day=at + 1))
    for station, files in paths.items():
        ask("import", *files, "--station", tmp_path / f"{station}.toml")
    answer = ask("metrics", "--metric", "bias_repeatability")
    found = [row for row in (answer["metrics"] if isinstance(answer, dict) else answer) if row["value"] is not None]
    said = "measured at 2 stations (A, B): what differs between these is in the scatter"
    assert {row["unit"]: said in (parameters(row)["remark"] or "") for row in found} == {"TWO": True, "ONE": False}


def test_a_word_that_no_value_has_is_no_limit(ask: Ask, tmp_path: Path) -> None:
    ask("import", record(tmp_path / "one.csv", "G1", 2.0, 1))
    (tmp_path / "limits.toml").write_text(LIMITS + 'parameters = { earth_rate = "nonne" }\n')
    done = CliRunner().invoke(main, ["limits", "add", str(tmp_path / "limits.toml"), "--store", str(tmp_path / "S")])
    assert done.exit_code == 1
    assert "no value of bias has earth_rate = 'nonne'; did you mean none?" in " ".join(done.output.split())
