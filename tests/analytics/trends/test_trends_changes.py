"""Changes of level and drifts: found, sized and dated with intervals that cover, and seldom seen in noise."""

import itertools

import numpy as np
import pytest
from scipy.stats import binom

from analytics.trends.levels.change_points import (
    LEAST_SEGMENT,
    Changes,
    Drift,
    _divisions,
    change_points,
    clipped,
    drift,
    penalty,
)
from analytics.trends.words import NotComputed

TRIALS = 1500


def gain(values: np.ndarray) -> float:
    """n*ln(S_0/S_k)/k, the largest over k: a change is found where it exceeds the penalty."""
    squares, _ = _divisions(clipped(values))
    return float((values.size * np.log(squares[0] / squares[1:]) / np.arange(1, squares.size)).max())


def _found(values: np.ndarray, false_alarm: float = 0.01) -> Changes:
    found = change_points(values, false_alarm=false_alarm)
    assert isinstance(found, Changes)
    return found


@pytest.mark.in_gate("12")
@pytest.mark.parametrize("n", [12, 20, 60, 200])
def test_noise_shows_a_change_in_at_most_one_of_a_hundred_series(n: int) -> None:
    rng = np.random.default_rng([20260711, n])
    trials = TRIALS if n < 200 else 500
    alarms = sum(gain(rng.normal(5.0, 0.3, n)) > penalty(n, 0.01) for _ in range(trials))
    assert alarms <= binom.isf(0.001 / 4, trials, 0.01)


def test_a_dearer_price_makes_alarms_rarer() -> None:
    rng = np.random.default_rng(20260712)
    gains = np.array([gain(rng.standard_normal(30)) for _ in range(TRIALS)])
    assert (gains > penalty(30, 0.1)).sum() <= binom.isf(0.001, TRIALS, 0.1)
    assert (gains > penalty(30, 0.1)).sum() >= binom.ppf(0.001, TRIALS, 0.02)  # it is not idle either


def test_the_best_division_is_found() -> None:
    """Against all divisions there are."""
    rng = np.random.default_rng(20260713)
    for _ in range(20):
        values = rng.standard_normal(18) + np.repeat([0.0, 4.0, -2.0], 6)
        best = min(
            (sum(((part - part.mean()) ** 2).sum() for part in np.split(values, cut)), cut)
            for cut in itertools.combinations(range(1, 18), 2)
            if min(np.diff([0, *cut, 18])) >= LEAST_SEGMENT
        )
        found = _found(values)
        if len(found.points) == 2:
            assert tuple(each.at for each in found.points) == best[1]


def test_moment_and_size_of_a_change_are_covered() -> None:
    rng = np.random.default_rng(20260714)
    seen = moments = sizes = 0
    for _ in range(TRIALS):
        values = rng.standard_normal(60)
        values[35:] += 2.0
        found = _found(values)
        if len(found.points) == 1:
            (point,) = found.points
            seen += 1
            moments += point.first <= 35 <= point.last
            sizes += point.lo <= 2.0 <= point.hi
    assert seen >= 0.95 * TRIALS
    for covered in (moments, sizes):
        assert covered >= binom.ppf(0.001 / 2, seen, 0.93)


def test_wild_points_are_no_change() -> None:
    rng = np.random.default_rng(20260715)
    alarms = 0
    for _ in range(300):
        values = rng.standard_normal(80)
        values[[17, 55]] += 25.0
        alarms += bool(_found(values).points)
    assert alarms <= binom.isf(0.001, 300, 0.02)


def test_a_drift_is_no_staircase() -> None:
    values = 0.05 * np.arange(100) + np.random.default_rng(20260716).standard_normal(100)
    found = _found(values)
    assert found.is_drift
    assert not found.points


def test_constant_and_short_series() -> None:
    assert not _found(np.full(40, 3.5)).points
    short = change_points(np.zeros(11))
    assert isinstance(short, NotComputed)
    assert "11 points" in short.why.en


def test_units_of_measure_do_not_matter() -> None:
    rng = np.random.default_rng(20260717)
    values = rng.standard_normal(50) + np.repeat([0.0, 3.0], 25)
    plain, large = _found(values), _found(values * 1e6 + 1e9)
    assert [each.at for each in plain.points] == [each.at for each in large.points]
    assert large.points[0].size == pytest.approx(plain.points[0].size * 1e6, rel=1e-6)


@pytest.mark.in_gate("0.9-0.91")
@pytest.mark.parametrize(("correlation", "least"), [(0.0, 0.95), (0.6, 0.94), (0.9, 0.91)])
def test_slope_is_covered_though_neighbours_resemble_each_other(correlation: float, least: float) -> None:
    rng = np.random.default_rng([20260718, round(10 * correlation)])
    trials, n = 700, 30
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
