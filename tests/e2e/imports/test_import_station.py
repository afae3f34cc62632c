"""Files that say where they were measured and what they are: --station, --latitude, --time-zone, --procedure."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from gyrofleet import main

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
def ask(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Result]:
    """A store with a unit of a station that is known, one without a latitude, and one whose station is stated later."""
    here = tmp_path_factory.mktemp("stations")

    def ask(*words: object, code: int = 0) -> Result:
        paths = [str(here / str(word)) if str(word).endswith((".csv", ".toml")) else str(word) for word in words]
        done = CliRunner().invoke(main, [*paths, "--store", str(here / "S")])
        assert done.exit_code == code, (done.output, done.exception)
        return done

    (here / "bench.toml").write_text(STATION)
    for name, bias in (("known", 1.0), ("unknown", 2.0), ("later", 3.0)):
        still(here / f"{name}.csv", bias + EARTH_DEG_PER_H, seed=len(name))
    ask("import", "known.csv", "--unit", "U-KNOWN", "--start", START, "--station", "bench.toml", *UP)
    ask("import", "unknown.csv", "--unit", "U-UNKNOWN", "--start", START, *UP)
    ask("import", "later.csv", "--unit", "U-LATER", "--start", START)
    return ask


def biases(ask: Callable[..., Result], unit: str) -> dict[str, dict[str, Any]]:
    rows = json.loads(ask("metrics", "--metric", "bias", "--unit", unit, "--json").stdout)
    return {row["parameters"]["earth_rate"]: row for row in rows}


def test_the_earth_rate_is_removed_where_the_station_is_known(ask: Callable[..., Result]) -> None:
    found = biases(ask, "U-KNOWN")
    assert found["none"]["value"] == pytest.approx(1.0 + EARTH_DEG_PER_H, abs=0.01)
    assert found["removed"]["value"] == pytest.approx(1.0, abs=0.01)
    assert found["removed"]["standard"] == "JJF2014"


def test_without_a_latitude_the_corrected_value_of_that_unit_is_missing(ask: Callable[..., Result]) -> None:
    found = biases(ask, "U-UNKNOWN")
    assert found["none"]["value"] == pytest.approx(2.0 + EARTH_DEG_PER_H, abs=0.01)
    assert found["removed"]["value"] is None
    assert "--latitude" in found["removed"]["reason"]
    assert biases(ask, "U-KNOWN")["removed"]["value"] is not None


def test_days_are_those_of_the_station(ask: Callable[..., Result]) -> None:
    rows = json.loads(ask("sql", "select unit, day::varchar as day from bias_by_day order by unit", "--json").stdout)
    days = {row["unit"]: row["day"] for row in rows}
    assert (days["U-KNOWN"], days["U-UNKNOWN"]) == ("2026-01-06", "2026-01-05")
    (run,) = json.loads(ask("sql", "select site, station from runs where run = 'known'", "--json").stdout)
    assert (run["site"], run["station"]) == ("plant", "bench-7")
    (gravity,) = json.loads(
        ask("sql", "select any_value(gravity_m_per_s2) as g from step_means where run = 'known'", "--json").stdout
    )
    assert gravity["g"] == pytest.approx(9.8015, abs=1e-4)


@pytest.mark.long
def test_what_was_left_out_is_stated_by_the_same_command(ask: Callable[..., Result]) -> None:
    reported = ask("metrics", "--unit", "U-LATER", code=1)
    assert "has samples, but no completed step says what was measured: import its files again" in reported.output
    later = ("import", "later.csv", "--unit", "U-LATER", "--start", START)
    assert "No step says what was measured" in ask(*later).output
    assert "stored already; 1 step in the store says what was measured." in ask(*later, *UP).output
    assert "No step says what was measured" not in ask(*later).output
    assert biases(ask, "U-LATER")["removed"]["value"] is None
    reported = ask(*later, "--procedure", "static_bias", "--position", "IRA_east", code=1)
    assert "has a step there already, with position IRA_up; what is recorded stays" in reported.output
    ask(*later, *UP, "--latitude", "39.9", "--time-zone", "Asia/Shanghai")
    assert biases(ask, "U-LATER")["removed"]["value"] == pytest.approx(3.0, abs=0.01)
    (day,) = json.loads(
        ask("sql", "select day::varchar as day from bias_by_day where unit = 'U-LATER'", "--json").stdout
    )
    assert day["day"] == "2026-01-06"
    # what was said stays, unless it is corrected on purpose
    reported = ask(*later, *UP, "--latitude", "0", code=1)
    assert "stored with latitude_deg 39.9, now it is 0; what is stored stays" in " ".join(reported.output.split())
    assert biases(ask, "U-LATER")["removed"]["value"] == pytest.approx(3.0, abs=0.01)
    ask(*later, *UP, "--latitude", "0", "--restate")
    assert biases(ask, "U-LATER")["removed"]["value"] == pytest.approx(3.0 + EARTH_DEG_PER_H, abs=0.01)
    stated = "select count(*) as n from events where kind = 'StationStated'"
    (before,) = json.loads(ask("sql", stated, "--json").stdout)
    ask(*later, *UP, "--latitude", "0")
    assert json.loads(ask("sql", stated, "--json").stdout) == [before] == [{"n": 2}]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--latitude", "95"), "--latitude is 95; it lies between -90 and 90"),
        (("--time-zone", "Mars/Olympus"), "which is not known"),
        (("--station", "none.toml"), "none.toml cannot be read"),
        (("--station", "bench.toml", "--site", "other"), "says 'plant'; leave out --site"),
    ],
)
def test_a_place_that_is_none_is_refused(ask: Callable[..., Result], words: tuple[str, ...], said: str) -> None:
    done = ask("import", "known.csv", "--unit", "U9", *words, code=1)
    assert said in done.output


def test_words_that_a_column_says_too_are_refused(ask: Callable[..., Result], tmp_path: Path) -> None:
    path = tmp_path / "both.csv"
    path.write_text("time[s],rate[deg/h],procedure\n0,1,allan_variance\n1,1,allan_variance\n")
    done = ask("import", path, "--unit", "U9", "--procedure", "static_bias", code=1)
    assert "--procedure is given, but a column 'procedure' says it too" in done.output


def test_words_that_no_procedure_has_are_told(ask: Callable[..., Result]) -> None:
    known = ("import", "known.csv", "--unit", "U-WORDS", "--start", START)
    assert "warning" not in ask(*known, "--run", "w1", *UP).output
    reported = ask(*known, "--run", "w2", "--procedure", "static_bais", "--position", "IRA_sideways").output
    assert "warning: --procedure static_bais is none of gyrofleet's" in reported
    assert ", did you mean static_bias? the step is judged by its position alone" in reported
    assert "warning: --position IRA_sideways is none of" in reported
    assert "IRA_up" in reported.partition("IRA_sideways is none of")[2]
