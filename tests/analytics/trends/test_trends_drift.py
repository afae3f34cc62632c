"""Drifts: slopes covered by their intervals though neighbouring points resemble each other."""

import numpy as np
import pytest
from scipy.stats import binom

from analytics.trends.levels.drift import Drift, drift
from analytics.trends.wander import Noise, simulated
from analytics.trends.words import NotComputed


@pytest.mark.in_gate("0.9-0.91-150")
@pytest.mark.parametrize("trials", [150, 700])
@pytest.mark.parametrize(("correlation", "least"), [(0.0, 0.95), (0.6, 0.94), (0.9, 0.91)])
def test_slope_is_covered_though_neighbours_resemble_each_other(correlation: float, least: float, trials: int) -> None:
    rng = np.random.default_rng([20260718, round(10 * correlation)])
    n = 30
    noise = rng.standard_normal((trials, n))
    noise[:, 0] /= np.sqrt(1 - correlation**2)
    for at in range(1, n):
        noise[:, at] += correlation * noise[:, at - 1]
    time = np.sort(rng.uniform(0, 90, n))
    covered = alarms = 0
    for each in noise:
        found = drift(time, each + 0.02 * time)
        assert isinstance(found, Drift)
        covered += found.lo <= 0.02 <= found.hi
        still = drift(time, each)
        assert isinstance(still, Drift)
        alarms += still.chance <= 0.01
    assert covered >= binom.ppf(0.001 / 3, trials, least)
    assert alarms <= binom.isf(0.001 / 3, trials, 0.01 if correlation < 0.9 else 0.02)


@pytest.mark.long
def test_slope_is_covered_where_a_slow_wander_hides_in_scatter() -> None:
    """A model without scatter takes such noise as fast, and holds the slope of 0.77 of these series."""
    rng = np.random.default_rng(20261127)
    time = np.arange(90.0)
    noise = simulated(Noise(0.9, 0.7), 400, 90, rng)
    found = [drift(time, each + 0.02 * time) for each in noise]
    covered = sum(isinstance(each, Drift) and each.lo <= 0.02 <= each.hi for each in found)
    assert covered >= binom.ppf(0.001, 400, 0.91)


def test_slope_of_white_noise_is_that_of_least_squares() -> None:
    rng = np.random.default_rng(20260719)
    time = np.arange(2000.0)
    values = 0.01 * time + rng.standard_normal(2000)
    found = drift(time, values)
    assert isinstance(found, Drift)
    slope, _ = np.polyfit(time, values, 1)
    spread = np.sqrt(1.0 / ((time - time.mean()) ** 2).sum())
    assert abs(found.slope - slope) < 0.1 * spread
    assert (found.hi - found.lo) / (2 * 1.96 * spread) == pytest.approx(1.0, abs=0.1)


def test_a_drift_needs_points_at_different_times() -> None:
    assert isinstance(drift(np.zeros(20), np.arange(20.0)), NotComputed)
    assert isinstance(drift(np.arange(7.0), np.arange(7.0)), NotComputed)
    flat = drift(np.arange(10.0), np.full(10, 2.0))
    assert isinstance(flat, Drift)
    assert (flat.slope, flat.chance) == (0.0, 1.0)
