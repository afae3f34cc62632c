"""A watch over a growing series: asked after each point, seldom wrong ever, and not blind."""

import numpy as np
import pytest
from scipy.stats import binom

from analytics.trends.levels.level_watch import LEAST_POINTS, LevelWatch, level_watch
from analytics.trends.wander import Noise, simulated
from analytics.trends.words import NotComputed


def _alarm(values: np.ndarray, start: int = LEAST_POINTS) -> int | None:
    """Number of points after which the watch alarms."""
    for n in range(start, values.size + 1):
        found = level_watch(values[:n])
        if isinstance(found, LevelWatch) and found.alarms(0.01):
            return n
    return None


@pytest.mark.in_gate("0.8-0.7-12")
@pytest.mark.parametrize("series", [12, 40, 120])
@pytest.mark.parametrize(("correlation", "share"), [(0.0, 1.0), (0.4, 1.0), (0.8, 1.0), (0.8, 0.7)])
def test_a_steady_series_is_seldom_ever_alarmed(correlation: float, share: float, series: int) -> None:
    rng = np.random.default_rng([20261204, round(10 * correlation), round(10 * share)])
    noise = simulated(Noise(correlation, share), series, 100, rng)
    assert sum(_alarm(each) is not None for each in noise) <= binom.isf(0.001 / 4, series, 0.01)


@pytest.mark.long
def test_a_step_is_seen_and_dated() -> None:
    rng = np.random.default_rng(20261205)
    series = rng.standard_normal((40, 110)) + 4.0 * (np.arange(110) >= 60)
    alarms = [_alarm(each, 60) for each in series]
    seen = [(n, each) for n, each in zip(alarms, series, strict=True) if n is not None]
    assert len(seen) == 40
    assert np.median([n for n, _ in seen]) <= 75
    dated = [level_watch(each[:n]) for n, each in seen]
    assert sum(isinstance(each, LevelWatch) and abs(each.at - 60) <= 2 for each in dated) >= 36


def test_one_wild_point_is_no_change_of_level() -> None:
    values = np.random.default_rng(20261206).standard_normal(60)
    values[40] += 30.0
    assert _alarm(values) is None


def test_few_and_constant_points() -> None:
    few = level_watch(np.zeros(LEAST_POINTS - 1))
    assert isinstance(few, NotComputed)
    assert "7 points" in few.why.en
    still = level_watch(np.full(20, 3.0))
    assert isinstance(still, LevelWatch)
    assert not still.alarms(0.01)
