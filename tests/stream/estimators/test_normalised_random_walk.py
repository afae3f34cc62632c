"""Angle random walk by normalised bias stability: white noise comes back, drift stays out (GJB 2426A 5.12.5.4.1)."""

import math

import numpy as np
import pytest

from stream.batch import FloatArray
from stream.errors import EstimatorError
from stream.estimators.base import NoEstimate
from stream.estimators.noise.normalised_random_walk import angle_random_walk_normalised, median_efficiency


@pytest.mark.parametrize("interval_s", [0.001, 0.003, 0.005])
def test_normalised_random_walk_of_white_noise(interval_s: float) -> None:
    """20 pieces of 30 means: the median's relative error is 1/sqrt(2 * 20 * 29 * 2/pi), 4 %."""
    n = round(600.0 / interval_s)
    values = np.random.default_rng(6).standard_normal(n) * 0.01 * 60.0 / math.sqrt(interval_s) + 15.0
    values[5:8] = np.nan
    found = angle_random_walk_normalised(values, interval_s, confidence=0.999)
    assert not isinstance(found, NoEstimate)
    assert found.pieces == 20
    assert found.coefficient.value == pytest.approx(0.01, rel=0.16)
    assert found.coefficient.lo < 0.01 < found.coefficient.hi
    assert 1.0 in found.taus_s
    assert found.taus_s[:3] == pytest.approx((interval_s, 2 * interval_s, 4 * interval_s))
    white = np.array(found.bias_stability_deg_per_h) * np.sqrt(found.taus_s)
    np.testing.assert_allclose(white, 0.6, rtol=0.25)


def test_the_median_over_pieces_does_not_take_drift_for_random_walk() -> None:
    n = 200 * 1200
    rng = np.random.default_rng(7)
    values = rng.standard_normal(n) * 0.6 * math.sqrt(200.0) + 1e-3 * np.arange(n) / 200.0
    pieces = angle_random_walk_normalised(values, 0.005)
    whole = angle_random_walk_normalised(values, 0.005, piece_s=1200.0)
    assert not isinstance(pieces, NoEstimate)
    assert not isinstance(whole, NoEstimate)
    assert pieces.coefficient.value == pytest.approx(0.01, rel=0.12)
    assert whole.coefficient.value > pieces.coefficient.value
    doubled = angle_random_walk_normalised(2.0 * values, 0.005)
    assert not isinstance(doubled, NoEstimate)
    assert doubled.coefficient.value == pytest.approx(2.0 * pieces.coefficient.value)


@pytest.mark.parametrize(
    ("values", "interval_s", "words"),
    [
        (np.zeros(6000), 0.005, "constant"),
        (np.ones(100), 0.005, "10 means of 1 s needed"),
        (np.array([]), 0.005, "10 means of 1 s needed"),
        (np.full(6000, np.nan), 0.005, "10 means of 1 s needed"),
        (np.arange(6000.0), 0.01, "less than 0.01 s"),
    ],
)
def test_no_normalised_random_walk_without_its_conditions(values: FloatArray, interval_s: float, words: str) -> None:
    found = angle_random_walk_normalised(values, interval_s)
    assert isinstance(found, NoEstimate)
    assert words in found.reason


def test_a_normalised_random_walk_of_senseless_arguments_is_refused() -> None:
    with pytest.raises(EstimatorError, match="pieces from 10 s"):
        angle_random_walk_normalised(np.zeros(10), 0.005, piece_s=1.0)


def test_a_second_piece_does_not_widen_the_limits() -> None:
    """Two pieces of 30 s have the freedom of one of 60 s: the median of two is their mean."""
    values = np.random.default_rng(5).standard_normal(12_200)

    def width(seconds: float) -> float:
        found = angle_random_walk_normalised(values[: round(seconds * 200)], 0.005)
        assert not isinstance(found, NoEstimate)
        return found.coefficient.hi / found.coefficient.lo

    # 58 degrees of freedom each: 59 means less one, and twice 30 less one
    assert width(60.0) == pytest.approx(width(59.0), rel=1e-9)


def test_the_efficiency_of_a_median_is_that_of_simulated_ones() -> None:
    values = np.random.default_rng(6).standard_normal((20_000, 9))
    for n in (2, 3, 4, 6, 9):
        simulated = values[:, :n].mean(axis=1).var() / np.median(values[:, :n], axis=1).var()
        # a ratio of two variances of 20,000 values that correlate: known to 1 %
        assert median_efficiency(n) == pytest.approx(simulated, rel=0.04)
