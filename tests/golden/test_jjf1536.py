"""The worked cases of JJF 1536-2015, from a file through the command to the answer, and the functions beside them."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from analytics.methods.attitude.compensation import compensated_angles, misalignment_matrix
from analytics.methods.attitude.frames import attitude_angles, attitude_matrix
from tests.attitude_unit_files import Sheet, four_positions, ramp, turns

ANGLES = {axis: f"angle_{axis.lower()}[deg]" for axis in "XYZ"}
BIASES = {"X": 6.0, "Y": -3.0, "Z": 1.5}
MATRIX = {"XY": 0.002, "XZ": -0.001, "YX": 0.003, "YZ": -0.002, "ZX": 0.0015, "ZY": -0.0025}
SCALES = {"X": 1.0002, "Y": 0.9997, "Z": 1.0}
WORDS = ("procedure", "axis", "position", "step", "rate_command[deg/s]")
RATES = (0.0, 10.0, -10.0, 25.0, -25.0, 63.0, -63.0, 100.0, -100.0, 0.0)
Row = dict[str, Any]


def rates(sheet: Sheet) -> None:
    """Angles of each axis while the table turns it at nine rates, at rest before and after."""
    for axis in "XYZ":
        for rate in RATES:
            samples = {each: ramp((rate * SCALES[axis] if each == axis else 0.0) * 20.0, 20) for each in ANGLES}
            words = {"axis": axis, "position": f"{axis}_up", "rate_command": rate, "step": "rate" if rate else "rest"}
            sheet.step(samples, procedure="attitude_unit_scale_factor", **words)


@pytest.fixture(scope="module")
def rows(run_command: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> list[Row]:
    """Rows of `gyrofleet metrics --standard "JJF 1536"` of two units.

    The second one was tested in four positions only, and misses east by 0.5 deg.
    """
    folder = tmp_path_factory.mktemp("jjf1536")
    for unit, error_deg in (("AHRS-1", 0.0), ("AHRS-2", 0.5)):
        turning, standing, rating = (Sheet(ANGLES, WORDS, dt_s=dt_s) for dt_s in (0.1, 10.0, 1.0))
        turns(turning, MATRIX, BIASES)
        four_positions(standing, BIASES, heading_error_deg=error_deg)
        rates(rating)
        sheets = {"L": turning, "B": standing, "K": rating}
        for day, (name, sheet) in enumerate(sheets.items(), start=2):
            if error_deg and name != "B":
                continue
            begun = run_command(
                "import", sheet.write(folder / f"{name}-{unit}.csv"), "--unit", unit, "--run", f"{name}-{unit}",
                "--start", f"2026-03-0{day}T09:00:00+08:00", "--latitude", 39.9, "--altitude", 50,
                "--time-zone", "Asia/Shanghai", "--store", "S", cwd=folder,
            )  # fmt: skip
            assert begun.code == 0, begun.err
    found = run_command("metrics", "--standard", "JJF 1536", "--store", "S", "--json", cwd=folder)
    assert found.code == 0, found.err
    listed: list[Row] = found.json
    return listed


def by_parameter(rows: list[Row], unit: str, metric: str, name: str) -> dict[str, Row]:
    return {row["parameters"][name]: row for row in rows if (row["unit"], row["metric"]) == (unit, metric)}


def test_four_times_three_degrees_are_six_degrees_per_hour(rows: list[Row]) -> None:
    """T = 1800 s: N = 3.0 deg four times."""
    found = by_parameter(rows, "AHRS-1", "attitude_unit_bias", "axis")
    assert {axis: row["value"] for axis, row in found.items()} == pytest.approx(BIASES, abs=1e-6)
    assert [found[axis]["parameters"]["zero_of"] for axis in "XYZ"] == ["heading", "pitch", "roll"]
    assert {row["unit_of_measure"] for row in found.values()} == {"deg/h"}


def test_a_heading_error_cancels_in_four_positions_and_not_in_two(rows: list[Row]) -> None:
    found = by_parameter(rows, "AHRS-2", "attitude_unit_bias", "axis")
    assert {axis: row["value"] for axis, row in found.items()} == pytest.approx(BIASES, abs=1e-6)
    assert found["X"]["parameters"]["heading_error_deg"] == pytest.approx(0.5, abs=1e-3)
    # N = 3.050348 deg with the axis to the east: these two alone give 6.1007 deg/h
    assert 6.0 + found["X"]["parameters"]["level_rate_deg_per_h"] == pytest.approx(6.1007, abs=5e-5)


def test_six_misalignments(rows: list[Row]) -> None:
    """10 turns at 100 deg/s: N = 10.77 and -10.83 deg for L_yx; the printed pi in place of n would give 0.0095493."""
    found = by_parameter(rows, "AHRS-1", "attitude_unit_misalignment", "element")
    assert len(found) == 6
    for name, expected in MATRIX.items():
        row = found[f"L_{name.lower()}"]
        assert row["parameters"]["radians"] == pytest.approx(expected, abs=1e-8)
        assert row["value"] == pytest.approx(expected * 180 / math.pi * 60, abs=1e-4)
    assert found["L_yx"]["value"] == pytest.approx(10.3132, abs=1e-4)
    assert (found["L_yx"]["signal"], found["L_yx"]["clause"]) == ("angle_y", "5.6 (7), 7.3.2 (17)")
    assert found["L_yx"]["parameters"]["turns"] == 10


def test_three_scale_factors(rows: list[Row]) -> None:
    found = [row for row in rows if (row["unit"], row["metric"]) == ("AHRS-1", "scale_factor")]
    assert {row["signal"][-1].upper(): row["value"] for row in found} == pytest.approx(SCALES, abs=1e-9)
    assert {(row["standard"], row["unit_of_measure"]) for row in found} == {("JJF1536", "1")}


def test_compensation_goes_back_to_what_was_turned() -> None:
    matrix = misalignment_matrix({f"L_{name.lower()}": value for name, value in MATRIX.items()})
    bias_deg_per_s = np.array([6.0, -3.0, 1.5]) / 3600
    turned = np.array([10.0, -20.0, 30.0])
    by_hand = [
        turned[0] + 0.002 * turned[1] - 0.001 * turned[2] + 0.1,
        turned[1] + 0.003 * turned[0] - 0.002 * turned[2] - 0.05,
        turned[2] + 0.0015 * turned[0] - 0.0025 * turned[1] + 0.025,
    ]
    assert [round(each, 2) for each in by_hand] == [10.03, -20.08, 30.09]
    np.testing.assert_allclose(compensated_angles(by_hand, matrix, bias_deg_per_s, 60.0), turned, atol=1e-12)
    rounded = compensated_angles([10.03, -20.08, 30.09], matrix, bias_deg_per_s, 60.0)
    np.testing.assert_allclose(rounded, turned, atol=0.006)
    # as (2) is printed, the inverse matrix and the column added, every row would hold three numbers
    assert np.linalg.inv(matrix).shape != rounded.shape


def printed(matrix: np.ndarray) -> list[float]:
    """(B.4) as it is printed."""
    heading = math.atan(matrix[0, 1] / matrix[1, 1])
    roll = math.atan(matrix[2, 0] / matrix[2, 2])
    return [math.degrees(each) for each in (heading, math.asin(matrix[2, 1]), roll)]


def of_b1(heading_deg: float, pitch_deg: float, roll_deg: float) -> np.ndarray:
    """The matrix (B.1), element by element."""
    p, t, g = (math.radians(each) for each in (heading_deg, pitch_deg, roll_deg))
    s, c = math.sin, math.cos
    return np.array([
        [c(p) * c(g) - s(p) * s(t) * s(g), -s(p) * c(t), c(p) * s(g) + s(p) * s(t) * c(g)],
        [s(p) * c(g) + c(p) * s(t) * s(g), c(p) * c(t), s(p) * s(g) - c(p) * s(t) * c(g)],
        [-c(t) * s(g), s(t), c(t) * c(g)],
    ])  # fmt: skip


def test_angles_go_round_and_the_printed_arctangents_do_not() -> None:
    np.testing.assert_allclose(attitude_matrix(130.0, -25.0, 160.0), of_b1(130.0, -25.0, 160.0), atol=1e-12)
    found = attitude_angles(of_b1(130.0, -25.0, 160.0))
    assert list(found) == pytest.approx([130.0, -25.0, 160.0], abs=1e-9)
    # erratum: (B.4) has neither the minus nor the quadrant
    assert printed(of_b1(130.0, -25.0, 160.0)) == pytest.approx([50.0, -25.0, 20.0], abs=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_every_attitude_goes_both_ways(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for heading, pitch, roll in rng.uniform((-180, -89, -180), (180, 89, 180), (200, 3)):
        matrix = of_b1(heading, pitch, roll)
        np.testing.assert_allclose(attitude_matrix(heading, pitch, roll), matrix, atol=1e-12)
        assert list(attitude_angles(matrix)) == pytest.approx([heading, pitch, roll], abs=1e-6)
