"""Files that say where they were measured and what they are: --station, --latitude, --time-zone, --procedure."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.conftest import Outcome

EARTH_DEG_PER_H = 15.041067 * math.sin(math.radians(39.9))
STATION = """
[station]
site = "plant"
name = "bench-7"
latitude_deg = 39.9
altitude_m = 50
time_zone = "Asia/Shanghai"
"""
START = "2026-01-05T17:00:00Z"  # the 6th in Shanghai
UP = ("--procedure", "static_bias", "--position", "IRA_up")

Rows = list[dict[str, Any]]


def still(path: Path, bias_deg_per_h: float, seconds: int = 3600, seed: int = 1) -> Path:
    """A plain file of a gyro at rest: times and rates, and nothing else."""
    values = bias_deg_per_h + np.random.default_rng(seed).normal(0, 0.1, seconds)
    lines = ["time[s],rate[deg/h]", *(f"{i},{value:.6f}" for i, value in enumerate(values))]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture(scope="module")
def ask(tmp_path_factory: pytest.TempPathFactory, run_command: Callable[..., Outcome]) -> Callable[..., Outcome]:
    """A store with a unit of a station that is known, one without a latitude, and one whose station is stated later."""
    here = tmp_path_factory.mktemp("stations")

    def ask(*words: object, code: int = 0) -> Outcome:
        done = run_command(*words, "--store", "S", cwd=here)
        assert done.code == code, (done.out, done.err)
        return done

    (here / "bench.toml").write_text(STATION)
    for name, bias in (("known", 1.0), ("unknown", 2.0), ("later", 3.0)):
        still(here / f"{name}.csv", bias + EARTH_DEG_PER_H, seed=len(name))
    ask("import", "known.csv", "--unit", "U-KNOWN", "--start", START, "--station", "bench.toml", *UP)
    ask("import", "unknown.csv", "--unit", "U-UNKNOWN", "--start", START, *UP)
    ask("import", "later.csv", "--unit", "U-LATER", "--start", START)
    return ask


def both(done: Outcome) -> str:
    """All that a command says."""
    return done.out + done.err


def biases(ask: Callable[..., Outcome], unit: str) -> dict[str, dict[str, Any]]:
    rows = ask("metrics", "--metric", "bias", "--unit", unit, "--json").json
    return {row["parameters"]["earth_rate"]: row for row in rows}


def test_the_earth_rate_is_removed_where_the_station_is_known(ask: Callable[..., Outcome]) -> None:
    found = biases(ask, "U-KNOWN")
    assert found["none"]["value"] == pytest.approx(1.0 + EARTH_DEG_PER_H, abs=0.01)
    assert found["removed"]["value"] == pytest.approx(1.0, abs=0.01)
    assert found["removed"]["standard"] == "JJF2014"


@pytest.mark.long
def test_without_a_latitude_the_corrected_value_of_that_unit_is_missing(ask: Callable[..., Outcome]) -> None:
    found = biases(ask, "U-UNKNOWN")
    assert found["none"]["value"] == pytest.approx(2.0 + EARTH_DEG_PER_H, abs=0.01)
    assert found["removed"]["value"] is None
    assert "--latitude" in found["removed"]["reason"]
    assert biases(ask, "U-KNOWN")["removed"]["value"] is not None


@pytest.mark.long
def test_days_are_those_of_the_station(ask: Callable[..., Outcome]) -> None:
    rows = ask("sql", "select unit, day::varchar as day from bias_by_day order by unit", "--json").json
    days = {row["unit"]: row["day"] for row in rows}
    assert (days["U-KNOWN"], days["U-UNKNOWN"]) == ("2026-01-06", "2026-01-05")
    (run,) = ask("sql", "select site, station from runs where run = 'known'", "--json").json
    assert (run["site"], run["station"]) == ("plant", "bench-7")
    (gravity,) = ask(
        "sql", "select any_value(gravity_m_per_s2) as g from step_means where run = 'known'", "--json"
    ).json
    assert gravity["g"] == pytest.approx(9.8015, abs=1e-4)


@pytest.mark.long
def test_what_was_left_out_is_stated_by_the_same_command(ask: Callable[..., Outcome]) -> None:
    reported = ask("metrics", "--unit", "U-LATER", code=1)
    assert "has samples, but no completed step says what was measured: import its files again" in reported.err
    later = ("import", "later.csv", "--unit", "U-LATER", "--start", START)
    assert "No step says what was measured" in both(ask(*later))
    assert "stored already; 1 step in the store says what was measured, 1 new or longer with this import." in both(
        ask(*later, *UP)
    )
    assert "No step says what was measured" not in both(ask(*later))
    assert biases(ask, "U-LATER")["removed"]["value"] is None
    reported = ask(*later, "--procedure", "static_bias", "--position", "IRA_east", code=1)
    assert "has a step there already, with position IRA_up; what is recorded stays" in reported.err
    ask(*later, *UP, "--latitude", "39.9", "--time-zone", "Asia/Shanghai")
    assert biases(ask, "U-LATER")["removed"]["value"] == pytest.approx(3.0, abs=0.01)
    (day,) = ask("sql", "select day::varchar as day from bias_by_day where unit = 'U-LATER'", "--json").json
    assert day["day"] == "2026-01-06"
    # what was said stays, unless it is corrected on purpose
    reported = ask(*later, *UP, "--latitude", "0", code=1)
    assert "stored with latitude_deg 39.9, now it is 0; what is stored stays" in " ".join(reported.err.split())
    assert biases(ask, "U-LATER")["removed"]["value"] == pytest.approx(3.0, abs=0.01)
    ask(*later, *UP, "--latitude", "0", "--restate")
    assert biases(ask, "U-LATER")["removed"]["value"] == pytest.approx(3.0 + EARTH_DEG_PER_H, abs=0.01)
    stated = "select count(*) as n from events where kind = 'StationStated'"
    (before,) = ask("sql", stated, "--json").json
    ask(*later, *UP, "--latitude", "0")
    assert ask("sql", stated, "--json").json == [before] == [{"n": 2}]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--latitude", "95"), "--latitude is 95; it lies between -90 and 90"),
        (("--time-zone", "Mars/Olympus"), "which is not known"),
        (("--station", "none.toml"), "none.toml cannot be read"),
        (("--station", "bench.toml", "--site", "other"), "says 'plant'; leave out --site"),
    ],
)
def test_a_place_that_is_none_is_refused(ask: Callable[..., Outcome], words: tuple[str, ...], said: str) -> None:
    done = ask("import", "known.csv", "--unit", "U9", *words, code=1)
    assert said in done.err


def test_words_that_a_column_says_too_are_refused(ask: Callable[..., Outcome], tmp_path: Path) -> None:
    path = tmp_path / "both.csv"
    path.write_text("time[s],rate[deg/h],procedure\n0,1,allan_variance\n1,1,allan_variance\n")
    done = ask("import", path, "--unit", "U9", "--procedure", "static_bias", code=1)
    assert "--procedure is given, but a column 'procedure' says it too" in done.err


@pytest.mark.long
def test_words_that_no_procedure_has_are_told(ask: Callable[..., Outcome]) -> None:
    known = ("import", "known.csv", "--unit", "U-WORDS", "--start", START)
    assert "warning: --" not in both(ask(*known, "--run", "w1", *UP))
    reported = ask(*known, "--run", "w2", "--procedure", "static_bais", "--position", "IRA_sideways").err
    assert "warning: --procedure static_bais is none of gyrofleet's" in reported
    assert ", did you mean static_bias? the step is judged by its position alone" in reported
    assert "warning: --position IRA_sideways is none of" in reported
    assert "IRA_up" in reported.partition("IRA_sideways is none of")[2]


@pytest.mark.long
def test_a_station_that_is_stated_later_is_that_of_the_run(ask: Callable[..., Outcome]) -> None:
    again = ("import", "unknown.csv", "--unit", "U-UNKNOWN", "--start", START, *UP)
    found = "select distinct site, station from {} where run = 'unknown'"
    tables = ("runs", "units", "unit_runs")
    assert [ask("sql", found.format(each), "--json").json for each in tables] == [
        [{"site": "local", "station": "files"}]
    ] * 3
    ask(*again, "--station", "bench.toml")
    assert [ask("sql", found.format(each), "--json").json for each in tables] == [
        [{"site": "plant", "station": "bench-7"}]
    ] * 3
    refused = ask(*again, "--station", "pier-2", code=1)
    assert "run unknown is stored with station bench-7, now it is pier-2" in " ".join(refused.err.split())
    again_stated = ask(*again, "--station", "pier-2", "--restate")
    assert "What is stated of the station is recorded for 1 run." in both(again_stated)
    assert "stated of the station" not in both(ask(*again, "--station", "pier-2"))
    assert ask("sql", found.format("runs"), "--json").json == [{"site": "plant", "station": "pier-2"}]
    # one that was stated when the run began is refused likewise
    known = ("import", "known.csv", "--unit", "U-KNOWN", "--start", START, *UP, "--station", "pier-2")
    assert "stored with station bench-7, now it is pier-2" in " ".join(ask(*known, code=1).err.split())
