"""The worked case of CN 102680005: nine changes of dv', and the errors of three gyros by every way."""

from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest

from analytics.system_level.calibration import Result, Way, results
from analytics.system_level.procedure_positions import start_of
from analytics.system_level.rotation_record import ImuSeries, Rotation, evaluated
from analytics.system_level.velocity_filter import kalman_derivatives, quadratic_fit
from tests.analytics.system_level.rotation_kinematics import (
    ASYMMETRIC,
    DEG_PER_H,
    GRAVITY,
    LATITUDE_DEG,
    STARTS,
    SYMMETRIC,
    Planted,
    axes_of,
    calibration,
    turned,
)

CHANGES_MM_PER_S2 = (-3.41587, -4.59283, 3.97801, 1.66694, 3.62816, -3.26240, -2.64410, -0.682674, 0.436839)
U_HEADING_RAD = np.radians(0.1)
TOLERANCE_PPM = 0.005


def rotations(records: Sequence[tuple[int, ImuSeries]]) -> list[Rotation]:
    found = []
    for number, series in records:
        start = start_of(f"rotation_{number}")
        assert start is not None
        found.append(evaluated(series, LATITUDE_DEG, (start, U_HEADING_RAD), f"rotation_{number}"))
    return found


@cache
def of_bias(bias_deg_per_h: float, heading_error_deg: float = 0.0) -> tuple[Rotation, ...]:
    planted = Planted(gyro_bias_deg_per_h=bias_deg_per_h, heading_error_deg=heading_error_deg)
    return tuple(rotations(calibration(planted)))


def of_axis(found: Sequence[Rotation], axis: int) -> dict[Way, list[Result]]:
    ways: dict[Way, list[Result]] = {}
    for result in results([each for each in found if each.axis == axis], LATITUDE_DEG):
        ways.setdefault(result.way, []).append(result)
    return ways


def ppm(result: Result, letter: str = "A") -> float:
    return result.budgets[letter].value * 1e6


def test_the_nine_changes_come_out_to_the_digits_given() -> None:
    found = of_bias(0.0)[:9]
    assert [each.change * 1e3 for each in found] == pytest.approx(CHANGES_MM_PER_S2, abs=1.01e-5)
    assert [each.axis for each in found] == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    assert [each.sign for each in found] == [1, 1, -1, 1, 1, -1, 1, 1, -1]
    # positions in the text: north is observed for X and Z, east for Y
    observed = [np.cross([0, 0, 1], each.towards_enu).round(9).tolist() for each in found]
    assert observed == [[0, 1, 0]] * 3 + [[1, 0, 0]] * 3 + [[0, 1, 0]] * 3


def test_without_a_gyro_bias_the_errors_come_back() -> None:
    found = of_bias(0.0)[:9]
    for axis, (expected, symmetric) in enumerate(zip((9.978, -5.936, 3.990), SYMMETRIC, strict=True)):
        (one,) = of_axis(found, axis)[Way.SPEED]
        assert ppm(one) == pytest.approx(expected, abs=TOLERANCE_PPM)
        assert ppm(one, "S") == pytest.approx(symmetric * 1e6, abs=0.02)
        across, bias_ug = ((1, -30.0), (0, 50.0), (0, 50.0))[axis]
        assert {each.across for each in found if each.axis == axis} == {across}
        assert one.budgets["B"].value / GRAVITY * 1e6 == pytest.approx(bias_ug, abs=0.02)


def test_a_gyro_bias_shows_in_the_speeds_and_the_joint_fit_knows_it() -> None:
    found = of_bias(0.02)
    x, y, z = (of_axis(found, axis) for axis in range(3))
    assert [ppm(each) for each in x[Way.SPEED]] == pytest.approx([10.998, 10.726, 10.636], abs=TOLERANCE_PPM)
    assert ppm(x[Way.AVERAGE][0]) == pytest.approx(10.786, abs=TOLERANCE_PPM)
    for ways, expected in ((x, 10.002), (y, -5.997), (z, 3.999)):
        assert ppm(ways[Way.JOINT][0]) == pytest.approx(expected, abs=TOLERANCE_PPM)
        assert ppm(ways[Way.JOINT_REST][0]) == pytest.approx(expected, abs=TOLERANCE_PPM)
    assert x[Way.JOINT][0].budgets["b"].value / DEG_PER_H == pytest.approx(0.0196, abs=1e-4)
    assert x[Way.REST][0].budgets["b"].value / DEG_PER_H == pytest.approx(0.0196, abs=1e-4)
    average, planted = x[Way.AVERAGE][0].budgets["A"], ASYMMETRIC[0]
    assert abs(average.value - planted) < average.standard_uncertainty(), "its budget has the bias that it keeps"


def test_filter_and_least_squares_agree() -> None:
    for each in of_bias(0.02):
        difference = (each.change - each.change_least_squares) / (2 * np.pi * each.gravity_m_per_s2)
        assert abs(difference) * 1e6 < 0.0002


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e6])
def test_the_filter_is_the_fit_at_any_size(scale: float) -> None:
    rng = np.random.default_rng(5)
    velocity = scale * (np.cumsum(rng.standard_normal(1500)) + 3.0)
    fit = quadratic_fit(len(velocity), 0.01)
    _, slope, curvature = kalman_derivatives(velocity, 0.01)
    assert slope == pytest.approx(float(fit.slope @ velocity), rel=1e-6)
    assert curvature == pytest.approx(float(fit.curvature @ velocity), rel=1e-6)
    assert kalman_derivatives(np.full(100, 2.5 * scale), 0.01).tolist() == [2.5 * scale, 0.0, 0.0]


def test_an_error_of_the_heading_acts_like_a_gyro_bias_on_axes_that_point_east() -> None:
    right, wrong = of_bias(0.0), of_bias(0.0, 0.1)
    changes = []
    for axis in range(3):
        of = [ppm(of_axis(found[:9], axis)[Way.SPEED][0]) for found in (right, wrong)]
        changes.append(abs(of[1] - of[0]))
    assert changes == pytest.approx([1.03, 0.0, 1.03], abs=0.01)
    heading = of_axis(right, 0)[Way.AVERAGE][0].budgets["A"].components
    share = {each.en: each.u * abs(each.sensitivity) * 1e6 for each in heading}["heading"]
    assert share == pytest.approx(np.mean([33, 24, 21]) / 33 * 1.03, abs=0.02)
    assert ppm(of_axis(wrong, 0)[Way.JOINT][0]) == pytest.approx(10.0, abs=0.02)


def test_the_fourth_rotation_goes_on_from_the_end_of_the_third() -> None:
    """Taken as east, north, up again, Y points the other way, and its asymmetry has the other sign."""
    series = calibration(Planted(), (10.0,))[3][1]
    with_words = rotations([(4, series)])[0]
    wrong_words = evaluated(series, LATITUDE_DEG, (axes_of("ENU"), U_HEADING_RAD), "r4")
    assert wrong_words.attitude.heading_source == "earth_rate", "gravity contradicts the word"
    assert wrong_words.change == pytest.approx(with_words.change, abs=2e-5)
    reset = turned("ENU", 1, 1, 10.0, Planted())  # a laboratory that really begins at east, north, up
    begun_again = evaluated(reset, LATITUDE_DEG, (axes_of("ESD"), U_HEADING_RAD), "r4")
    assert begun_again.towards_enu.round(3).tolist() == [0.0, 1.0, 0.0]
    assert np.sign(begun_again.change) == np.sign(with_words.change), "c stays -1 in the observed direction"


def test_without_words_the_earth_tells_the_positions() -> None:
    records = calibration(Planted(), (10.0, 20.0))
    found = [evaluated(series, LATITUDE_DEG, None, f"r{number}") for number, series in records]
    for each, (number, _) in zip(found, records, strict=True):
        towards = axes_of(STARTS[number - 1])[each.axis]
        assert np.degrees(np.arccos(towards @ each.towards_enu)) < 0.1
    for axis in range(3):
        result = of_axis(found, axis)[Way.JOINT_REST][0]
        budget = result.budgets["A"]
        assert abs(budget.value - ASYMMETRIC[axis]) < 2 * budget.standard_uncertainty()
