"""The worked cases of JJF 1536-2015, from a file through the command to the answer, and the functions beside them."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analytics.methods.attitude_compensation import compensated_angles, misalignment_matrix
from analytics.methods.attitude_frames import attitude_angles, attitude_matrix
from tests.attitude_unit_files import Sheet, four_positions, turns

ANGLES = {axis: f"angle_{axis.lower()}[deg]" for axis in "XYZ"}
BIASES = {"X": 6.0, "Y": -3.0, "Z": 1.5}
MATRIX = {"XY": 0.002, "XZ": -0.001, "YX": 0.003, "YZ": -0.002, "ZX": 0.0015, "ZY": -0.0025}
REST = ("procedure", "axis", "position")
TURNING = (*REST, "rate_command[deg/s]")
Row = dict[str, Any]


@pytest.fixture
def measured_rows(gyrofleet: Callable[..., Any], tmp_path: Path) -> Callable[..., list[Row]]:
    """Rows of `gyrofleet metrics --standard "JJF 1536"` of files that are imported as one run."""

    def rows(*paths: Path, latitude: float | None = 39.9) -> list[Row]:
        place = () if latitude is None else ("--latitude", latitude, "--altitude", 50, "--time-zone", "Asia/Shanghai")
        begun = gyrofleet(
            "import", *paths, "--unit", "AHRS-1", "--run", "r1", "--start", "2026-03-02T09:00:00+08:00", *place,
            "--store", "S",
        )  # fmt: skip
        assert begun.code == 0, begun.err
        found = gyrofleet("metrics", "--standard", "JJF 1536", "--store", "S", "--json")
        assert found.code == 0, found.err
        listed: list[Row] = found.json
        return listed

    return rows


def biases(rows: list[Row]) -> dict[str, Row]:
    return {row["parameters"]["axis"]: row for row in rows if row["metric"] == "attitude_unit_bias"}


def elements(rows: list[Row]) -> dict[str, Row]:
    return {row["parameters"]["element"]: row for row in rows if row["metric"] == "attitude_unit_misalignment"}


def test_four_times_three_degrees_are_six_degrees_per_hour(measured_rows: Any, tmp_path: Path) -> None:
    sheet = Sheet(ANGLES, REST)
    four_positions(sheet, BIASES)
    found = biases(measured_rows(sheet.write(tmp_path / "bias.csv")))
    assert {axis: row["value"] for axis, row in found.items()} == pytest.approx(BIASES, abs=1e-6)
    names = [found[axis]["parameters"]["zero_of"] for axis in "XYZ"]
    assert names == ["heading", "pitch", "roll"]
    assert {row["unit_of_measure"] for row in found.values()} == {"deg/h"}


def test_a_heading_error_cancels_in_four_positions_and_not_in_two(measured_rows: Any, tmp_path: Path) -> None:
    sheet = Sheet(ANGLES, REST)
    four_positions(sheet, BIASES, heading_error_deg=0.5)
    found = biases(measured_rows(sheet.write(tmp_path / "bias.csv")))
    assert found["X"]["value"] == pytest.approx(6.0, abs=1e-6)
    assert found["X"]["parameters"]["heading_error_deg"] == pytest.approx(0.5, abs=1e-3)
    # N = 3.050348 deg with the axis to the east: alone 6.1007 deg/h
    assert 6.0 + found["X"]["parameters"]["level_rate_deg_per_h"] == pytest.approx(6.1007, abs=5e-5)


def test_six_misalignments(measured_rows: Any, tmp_path: Path) -> None:
    sheet = Sheet(ANGLES, TURNING, dt_s=0.1)
    turns(sheet, MATRIX, BIASES)
    found = elements(measured_rows(sheet.write(tmp_path / "turns.csv")))
    assert len(found) == 6
    for name, expected in MATRIX.items():
        row = found[f"L_{name.lower()}"]
        assert row["parameters"]["radians"] == pytest.approx(expected, abs=1e-8)
        assert row["value"] == pytest.approx(expected * 180 / math.pi * 60, abs=1e-4)
    # N = 10.77 and -10.83 deg: the printed pi in place of n would give 0.0095493
    assert found["L_yx"]["value"] == pytest.approx(10.3132, abs=1e-4)
    assert (found["L_yx"]["signal"], found["L_yx"]["clause"]) == ("angle_y", "5.6 (7), 7.3.2 (17)")
    assert found["L_yx"]["parameters"]["turns"] == 10


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
