"""From files of two chambers to the sentence that dates the shift of one of them, and the picture that shows it."""

import csv
import json
import os
from collections.abc import Callable
from datetime import date
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from gyrofleet import main

UNITS, WEEKS, SHIFT, AFTER_WEEK = 30, 16, 0.12, 7
START_S = 1_767_600_000  # Monday 2026-01-05 08:00 UTC
WEEK_S = 7 * 86_400
Ask = Callable[..., Result]


def _write(path: Path, chamber: int, biases: np.ndarray, rng: np.random.Generator) -> None:
    """Each unit four times in the chamber, once in each quarter of the time; an hour each, a sample a minute."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["unit", "run", "time[s]", "rate[deg/h]", "procedure", "step"])
        for unit, bias in enumerate(biases):
            for quarter in range(4):
                week = quarter * WEEKS // 4 + int(rng.integers(WEEKS // 4))
                start_s = START_S + week * WEEK_S + chamber * 86_400 + unit * 600
                mean = bias + 0.05 * chamber + rng.normal(0, 0.1) + SHIFT * (chamber and week >= AFTER_WEEK)
                noise = rng.normal(0, 0.1, 61)
                for minute in range(61):
                    value = f"{mean + noise[minute]:.6f}"
                    run = f"c{chamber}-w{week:02}"
                    writer.writerow([f"FOG-{unit:03}", run, start_s + 60 * minute, value, "static_bias", "static"])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    here = tmp_path_factory.mktemp("shift")
    rng = np.random.default_rng(20260782)
    biases = rng.normal(2.0, 0.5, UNITS)
    for chamber in (0, 1):
        _write(here / f"{chamber}.csv", chamber, biases, rng)
        words = [
            "import",
            here / f"{chamber}.csv",
            "--station",
            f"chamber-{chamber + 1}",
            "--store",
            here / "S",
            "--json",
        ]
        done = CliRunner().invoke(main, [str(each) for each in words])
        assert done.exit_code == 0, done.output
    return here


@pytest.fixture
def ask(folder: Path) -> Ask:
    def run(*words: object) -> Result:
        arguments = [*(str(word) for word in words), "--store", str(folder / "S")]
        done = CliRunner(env={**os.environ, "COLUMNS": "200"}).invoke(main, arguments)
        assert done.exit_code == 0, done.output
        return done

    return run


@pytest.mark.long
def test_a_shift_of_one_chamber_is_dated_and_sized(ask: Ask) -> None:
    found = json.loads(ask("trend", "bias", "--json").stdout)
    assert (found["values"], found["units"]) == (4 * 2 * UNITS, UNITS)
    assert found["stands_out"]
    (shift,) = found["shifts"]
    assert shift["station"] == "chamber-2"
    assert shift["lo"] <= SHIFT <= shift["hi"]
    assert shift["hi"] - shift["lo"] < 0.15
    # the first session of the new level is that of week 7, counted from 0
    truth = date.fromordinal(date(2026, 1, 6).toordinal() + 7 * AFTER_WEEK)
    assert date.fromisoformat(shift["from"]) < truth <= date.fromisoformat(shift["to"])
    assert shift["units"] >= 20
    # the chart has the first value of each unit, and these lie before the shift
    (chart,) = found["charts"]
    assert len(chart["points"]) == UNITS
    assert max(each["time"] for each in chart["points"]) < shift["from"]
    assert chart["in_control"]


@pytest.mark.long
def test_every_measurement_stands_on_the_charts_of_the_chambers(ask: Ask, folder: Path) -> None:
    found = json.loads(ask("trend", "bias", "--by", "station", "--json").stdout)
    charts = {each["name"]: each for each in found["charts"]}
    assert {name: len(each["points"]) for name, each in charts.items()} == {
        "chamber-1": 4 * UNITS,
        "chamber-2": 4 * UNITS,
    }
    assert {name: each["in_control"] for name, each in charts.items()} == {"chamber-1": True, "chamber-2": False}
    # units scatter by 0.5, measurements of one by 0.1
    assert 0.05 < charts["chamber-1"]["limits"]["sigma"] < 0.2
    reported = ask("trend", "bias", "--by", "station", "--plot", folder / "bias.svg").stdout
    assert "The level of station chamber-2 changes by 0." in reported
    assert "were measured there before and after" in reported
    assert "in control" in reported
    assert (folder / "bias.svg").stat().st_size > 20_000
    chinese = ask("trend", "bias", "--lang", "zh").stdout
    assert "试验台 chamber-2 的水平在" in chinese
