"""Noise coefficients come back from exact and simulated Allan curves, with limits that are honest about the rest."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stream.errors import EstimatorError
from stream.estimators.base import NoEstimate
from stream.estimators.noise.noise_fit import NoiseFit, fit_noise
from stream.estimators.noise.noise_model import TERMS
from tests.stream.allan_curves import (
    DAY,
    INTERVAL_S,
    POSITIVE,
    a_day,
    coefficients,
    exact_curve,
    point,
    simulated_curve,
)
from tests.stream.examples import examples


@examples(6, 25, factors=st.tuples(*[POSITIVE] * 5), per_octave=st.sampled_from([1, 2, 4]), derandomize=True)
def test_an_exact_curve_gives_its_coefficients_back(factors: tuple[float, ...], per_octave: int) -> None:
    truth = tuple(a * b for a, b in zip(DAY, factors, strict=True))
    fit = fit_noise(exact_curve(truth, per_octave=per_octave))
    for found, true in zip(coefficients(fit), truth, strict=True):
        assert found.value == pytest.approx(true, rel=1e-4)
        assert found.lo <= true * (1 + 1e-4)
        assert true <= found.hi * (1 + 1e-4)
    assert isinstance(fit, NoiseFit)
    assert fit.markov is None


@pytest.mark.long
@settings(max_examples=20, deadline=None, derandomize=True)
@given(
    logarithms=st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=20),
    edfs=st.lists(st.floats(1.0, 1e5), min_size=20, max_size=20),
    confidence=st.sampled_from([0.5, 0.95, 0.999]),
)
def test_whatever_the_curve_the_limits_are_ordered_finite_and_never_negative(
    logarithms: list[float], edfs: list[float], confidence: float
) -> None:
    points = [point(0.1 * 2.0**i, 10.0**x, edfs[i]) for i, x in enumerate(logarithms)]
    for found in coefficients(fit_noise(points, confidence=confidence)):
        assert all(math.isfinite(x) for x in (found.lo, found.value, found.hi))
        assert 0.0 <= found.lo <= found.value <= found.hi
        assert found.hi > 0.0
        assert found.observable == (found.reason == "") == (found.lo > 0.0)


@pytest.mark.parametrize("factor", [1e-100, 1e-3, 1e6, 1e100])
def test_coefficients_scale_with_the_curve(factor: float) -> None:
    curve = exact_curve(DAY)
    scaled = [point(p.tau_s, p.value * factor, p.edf) for p in curve]
    for one, other in zip(coefficients(fit_noise(curve)), coefficients(fit_noise(scaled)), strict=True):
        expected = (factor * one.value, factor * one.lo, factor * one.hi)
        assert (other.value, other.lo, other.hi) == pytest.approx(expected, rel=1e-4)


def test_coefficients_scale_with_time() -> None:
    """The same curve at taus 4 times longer: Q by 4, N by 2, K by 1/2, R by 1/4."""
    curve = exact_curve(DAY)
    slower = [point(4.0 * p.tau_s, p.value, p.edf) for p in curve]
    powers = (4.0, 2.0, 1.0, 0.5, 0.25)
    for one, other, power in zip(coefficients(fit_noise(curve)), coefficients(fit_noise(slower)), powers, strict=True):
        assert (other.value, other.hi) == pytest.approx((power * one.value, power * one.hi), rel=1e-4)


def test_the_order_of_points_does_not_matter_and_more_confidence_is_wider() -> None:
    curve = simulated_curve(a_day(np.random.default_rng(5)))
    assert fit_noise(curve) == fit_noise(curve[::-1])
    for narrow, wide in zip(
        coefficients(fit_noise(curve, confidence=0.5)), coefficients(fit_noise(curve, confidence=0.99)), strict=True
    ):
        assert wide.lo <= narrow.lo
        assert narrow.hi < wide.hi


def test_units_are_those_of_ieee_952() -> None:
    """1 deg/sqrt(h) is 60 (deg/h) sqrt(s): a deviation of 60 deg/h at 1 s."""
    assert [found.unit_of_measure for found in coefficients(fit_noise(exact_curve(DAY)))] == [
        "arcsec",
        "deg/sqrt(h)",
        "deg/h",
        "deg/h/sqrt(h)",
        "deg/h/h",
    ]
    white = [point(2.0**i, 60.0 / math.sqrt(2.0**i), 1e4) for i in range(12)]
    assert coefficients(fit_noise(white))[1].value == pytest.approx(1.0, rel=1e-6)
    ramp_per_h = 3.0
    ramp = [point(2.0**i, ramp_per_h * 2.0**i / 3600.0 / math.sqrt(2.0), 1e4) for i in range(12)]
    assert coefficients(fit_noise(ramp))[4].value == pytest.approx(ramp_per_h, rel=1e-6)
    for term in TERMS:
        assert all(term.names[language].strip() for language in ("en", "zh"))


def test_too_little_or_constant_data_is_a_reason() -> None:
    for points in ([], exact_curve(DAY)[:5], [exact_curve(DAY)[0]] * 9):
        fit = fit_noise(points)
        assert isinstance(fit, NoEstimate)
        assert "6 averaging times" in fit.reason
    fit = fit_noise([point(2.0**i, 0.0, 10.0) for i in range(9)])
    assert isinstance(fit, NoEstimate)
    assert "constant" in fit.reason
    with pytest.raises(EstimatorError, match="between 0 and 1"):
        fit_noise(exact_curve(DAY), confidence=95.0)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_white_noise_shows_nothing_but_angle_random_walk(seed: int) -> None:
    """N to four standard deviations: its square is known to sqrt(2/edf) at the shortest tau, edf > n/2."""
    samples = 200_000
    values = np.random.default_rng(seed).standard_normal(samples) * 0.01 * 60.0 / math.sqrt(INTERVAL_S)
    q, n, b, k, r = coefficients(fit_noise(simulated_curve(values)))
    assert n.value == pytest.approx(0.01, rel=4.0 * math.sqrt(1.0 / samples))
    assert n.lo <= n.value <= n.hi
    assert n.observable
    for other in (q, b, k, r):
        assert other.lo == 0.0
        assert not other.observable
        assert other.reason.startswith("not observable in this record: at most")


@pytest.mark.parametrize("step", [5e-3, pytest.param(2e-2, marks=pytest.mark.long)])
def test_a_walk_that_only_the_longest_averages_show_is_below_its_upper_bound(step: float) -> None:
    """80 records of white noise and a walk, of 4096 s: at 95 % 12 misses have a probability below 1e-3."""
    rng = np.random.default_rng([20261130, round(1e3 * step)])
    missed = 0
    for _ in range(80):
        values = rng.standard_normal(4096) + step * np.cumsum(rng.standard_normal(4096))
        _, _, _, k, _ = coefficients(fit_noise(simulated_curve(values, 1.0, per_octave=2)))
        missed += not k.lo <= 60.0 * step <= k.hi
    assert missed < 12


@pytest.mark.long
def test_a_day_with_all_five_terms() -> None:
    """Ten days: bounds are those of the bench (N 0.3 %, B 7 %, K 35 % RMS) with room for ten runs."""
    rng = np.random.default_rng(20)
    runs = [coefficients(fit_noise(simulated_curve(a_day(rng)))) for _ in range(10)]
    values = np.array([[found.value for found in run] for run in runs])
    errors = np.sqrt(np.mean((values / np.array(DAY) - 1.0) ** 2, axis=0))
    assert errors[0] < 0.005
    assert errors[1] < 0.01
    assert errors[2] < 0.15
    assert errors[3] < 0.7
    held = [[found.lo <= true <= found.hi for found, true in zip(run, DAY, strict=True)] for run in runs]
    # 50 intervals at 95 %: 9 or more misses have a probability below 1e-3
    assert np.sum(held) >= 42
    assert all(run[i].observable for run in runs for i in (0, 1, 2))
