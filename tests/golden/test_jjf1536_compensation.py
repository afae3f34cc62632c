"""Compensation of an attitude unit and the errors of its attitude, from files through `gyrofleet attitude`."""

import csv
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from tests.attitude_unit_files import EARTH_DEG_PER_H, Sheet, four_positions, ramp, turns

ANGLES = {axis: f"angle_{axis.lower()}[deg]" for axis in "XYZ"}
BIASES = {"X": 6.0, "Y": -3.0, "Z": 1.5}
MATRIX = {"XY": 0.002, "XZ": -0.001, "YX": 0.003, "YZ": -0.002, "ZX": 0.0015, "ZY": -0.0025}
WORDS = ("procedure", "axis", "position", "step", "rate_command[deg/s]")
LATITUDE_DEG = 39.9
UNIT = "AHRS-7"
# X east, Y north, Z up for 60 s: what the Earth turns the axes, and what they give by (3), deg
EARTH = {
    "X": 0.0,
    "Y": EARTH_DEG_PER_H / 60 * math.cos(math.radians(LATITUDE_DEG)),
    "Z": EARTH_DEG_PER_H / 60 * math.sin(math.radians(LATITUDE_DEG)),
}
GIVEN = {
    own: EARTH[own] + sum(MATRIX[own + other] * EARTH[other] for other in "XYZ" if other != own) + BIASES[own] / 60
    for own in "XYZ"
}


@pytest.fixture(scope="module")
def lab(run_command: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a store S: a calibrated unit, the angles of methods.md I, and a rest."""
    folder = tmp_path_factory.mktemp("compensation")
    turning, standing, rating, given, resting = (Sheet(ANGLES, WORDS, dt_s=dt_s) for dt_s in (0.1, 10.0, 1.0, 1.0, 1.0))
    turns(turning, MATRIX, BIASES)
    four_positions(standing, BIASES)
    for axis in "XYZ":
        for rate in (0.0, 10.0, -10.0, 25.0, -25.0, 63.0, -63.0, 100.0, -100.0, 0.0):
            samples = {each: ramp(rate * 20.0 if each == axis else 0.0, 20) for each in ANGLES}
            words = {"axis": axis, "position": f"{axis}_up", "rate_command": rate, "step": "rate" if rate else "rest"}
            rating.step(samples, procedure="attitude_unit_scale_factor", **words)
    given.step(
        {axis: ramp(angle, 60) for axis, angle in zip("XYZ", (10.03, -20.08, 30.09), strict=True)},
        procedure="attitude", step="turned",
    )  # fmt: skip
    resting.step(
        {axis: ramp(GIVEN[axis], 60) for axis in "XYZ"}, procedure="attitude", step="rest", position="X_east_Y_north"
    )
    sheets = {"K": rating, "L": turning, "B": standing, "turned": given, "rest": resting}
    for day, (name, sheet) in enumerate(sheets.items(), start=2):
        sheet.write(folder / f"{name}.csv")
        imported(run_command, folder, name, UNIT, day)
    return folder


def imported(run_command: Callable[..., Any], folder: Path, name: str, unit: str, day: int) -> None:
    begun = run_command(
        "import", f"{name}.csv", "--unit", unit, "--run", f"{name}-{unit}",
        "--start", f"2026-03-0{day}T09:00:00+08:00", "--latitude", LATITUDE_DEG, "--altitude", 50,
        "--time-zone", "Asia/Shanghai", "--store", "S", cwd=folder,
    )  # fmt: skip
    assert begun.code == 0, begun.err


def asked(run_command: Callable[..., Any], lab: Path, *words: object) -> Any:
    return run_command("attitude", "--unit", UNIT, "--store", "S", "--json", *words, cwd=lab)


def test_the_worked_case_comes_back_to_what_was_turned(lab: Path, run_command: Callable[..., Any]) -> None:
    """N = 10.03, -20.08, 30.09 deg after 60 s: A = 10, -20, 30 deg to the rounding of N."""
    done = asked(run_command, lab, "--run", f"turned-{UNIT}")
    assert done.code == 0, done.err
    (step,) = done.json["steps"]
    assert step["raw_deg"] == pytest.approx([10.03, -20.08, 30.09], abs=1e-6)
    assert step["compensated_deg"] == pytest.approx([10.0, -20.0, 30.0], abs=0.006)
    # exactly, by hand: each of the three equations (3) gives the output
    turned = step["compensated_deg"]
    for i, own in enumerate("XYZ"):
        output = turned[i] + sum(MATRIX[own + "XYZ"[j]] * turned[j] for j in range(3) if j != i) + BIASES[own] / 60
        assert output == pytest.approx(step["raw_deg"][i], abs=1e-6)
    assert "the position names no directions" in step["reason"]
    assert done.json["calibration"]["misalignment_rad"]["L_yx"]["value"] == pytest.approx(0.003, abs=1e-8)


@pytest.mark.long
def test_at_rest_the_errors_of_heading_pitch_and_roll_go(lab: Path, run_command: Callable[..., Any]) -> None:
    """As given, pitch (about east), roll (about north), heading (about up) are off by N - A of X, Y, Z."""
    done = asked(run_command, lab, "--run", f"rest-{UNIT}", "--out", "rest.parquet")
    (step,) = done.json["steps"]
    assert step["reference_deg"] == pytest.approx([EARTH[axis] for axis in "XYZ"], abs=1e-9)
    off = [GIVEN[axis] - EARTH[axis] for axis in "XYZ"]
    raw = [step["raw_error"][name] for name in ("pitch_deg", "roll_deg", "heading_deg")]
    # turns do not commute: half the product of the Earth's 0.25 deg and the error of 0.11 deg
    assert raw == pytest.approx(off, abs=2.4e-4)
    assert max(map(abs, raw)) > 0.02
    left = [step["compensated_error"][name] for name in ("pitch_deg", "roll_deg", "heading_deg")]
    assert left == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    assert step["attitude"] == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    assert all(step["expanded_deg"][name] >= 0 for name in ("pitch_deg", "roll_deg", "heading_deg"))
    table = pq.read_table(lab / "rest.parquet")
    assert table.num_rows == 60
    angles = [table[f"angle_{axis}_compensated_deg"][-1].as_py() for axis in "xyz"]
    assert angles == pytest.approx(step["compensated_deg"], abs=1e-9)
    assert np.diff(table["t_ns"].to_numpy()).tolist() == [10**9] * 59


def test_turning_only_the_heading_is_known(lab: Path, run_command: Callable[..., Any]) -> None:
    done = asked(run_command, lab, "--run", f"L-{UNIT}", "--out", "turns.csv")
    assert len(done.json["steps"]) == 6
    for step in done.json["steps"]:
        # the file has no Earth's rate, which the axis that is up would see for 36 s
        assert step["compensated_error"]["heading_deg"] == pytest.approx(-EARTH["Z"] * 36 / 60, abs=1e-3)
        assert step["compensated_error"]["pitch_deg"] is None
    with (lab / "turns.csv").open(newline="") as file:
        assert next(csv.reader(file))[:3] == ["step", "t_ns", "rate_x_deg_per_s"]


def test_while_the_table_turns_the_level_axes_sweep_the_earths_rate(lab: Path, run_command: Callable[..., Any]) -> None:
    """The truth is the sum of the body's rates over 20,000 short intervals, X east and Y north at the start."""
    cases, n = {"whole": (360.0, 12), "third": (120.0, 4), "back": (-200.0, 4)}, 20_000
    latitude = math.radians(LATITUDE_DEG)
    sheet, truth = Sheet(ANGLES, WORDS), []
    for name, (turn_deg, lasts_s) in cases.items():
        samples = {"X": ramp(0.0, lasts_s), "Y": ramp(0.0, lasts_s), "Z": ramp(turn_deg, lasts_s)}
        words = {"procedure": "attitude", "axis": "Z", "position": "X_east_Y_north", "rate_command": turn_deg / lasts_s}
        sheet.step(samples, step=name, **words)
        angle = np.radians(turn_deg) * (np.arange(n) + 0.5) / n
        earth_deg = EARTH_DEG_PER_H / 3600 * lasts_s
        swept = [
            np.sin(angle).mean() * math.cos(latitude),
            np.cos(angle).mean() * math.cos(latitude),
            math.sin(latitude),
        ]
        truth.append([earth_deg * each for each in swept])
        truth[-1][2] += turn_deg
    sheet.write(lab / "sweeps.csv")
    imported(run_command, lab, "sweeps", UNIT, 9)
    steps = asked(run_command, lab, "--run", f"sweeps-{UNIT}").json["steps"]
    assert len(steps) == len(cases)
    for step, expected in zip(steps, truth, strict=True):
        assert step["reference_deg"] == pytest.approx(expected, abs=1e-7)
    assert truth[0][:2] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert truth[1][:2] == pytest.approx([0.0092, 0.0053], abs=5e-5)  # X, Y, as a metrologist integrated them


def test_without_the_run_of_the_biases_each_is_named(lab: Path, run_command: Callable[..., Any]) -> None:
    one = asked(run_command, lab, "--run", f"rest-{UNIT}", "--calibration", f"K-{UNIT}")
    assert one.code == 1
    assert "the bias of X, the bias of Y, the bias of Z" in one.json["error"]["message"]


@pytest.mark.long
def test_what_is_not_calibrated_is_refused_with_all_that_lacks(lab: Path, run_command: Callable[..., Any]) -> None:
    for day, name in enumerate("KB", start=2):
        imported(run_command, lab, name, "AHRS-8", day)
    lacking = run_command("attitude", "--unit", "AHRS-8", "--run", "B-AHRS-8", "--store", "S", cwd=lab)
    assert lacking.code == 1
    assert "L_xy, L_xz, L_yx, L_yz, L_zx, L_zy not measured" in lacking.err
    wrong = asked(run_command, lab, "--run", f"rest-{UNIT}", "--out", "rest.txt")
    assert "ends with .parquet or .csv" in wrong.json["error"]["message"]
