"""Fixtures that drift against each other: found beside lots that differ, named, and not invented."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from analytics.trends.groups.level_drifts import level_drifts
from analytics.trends.report import sentences
from analytics.trends.series import MetricSeries
from analytics.trends.trend import FALSE_ALARM, trend_of
from tests.analytics.trends.test_trends_groups import START_NS, series_of

WEEK_NS = 7 * 86_400 * 10**9
LOTS, PER_LOT, FIXTURES = 12, 10, 3


def weekly_lots(rng: np.random.Generator, slope: float, *, heavy: bool = False) -> MetricSeries:
    """A lot a week, each of another level, in three fixtures; one drifts by `slope` a week from the fourth week on."""
    n = LOTS * PER_LOT
    lot, fixture = np.arange(n) // PER_LOT, np.arange(n) % FIXTURES
    noise = rng.standard_t(3, n) if heavy else rng.normal(size=n)
    levels = rng.normal(size=LOTS) + 1.5 * (np.arange(LOTS) >= LOTS // 2)
    value = levels[lot] + noise + slope * (fixture == 1) * np.maximum(lot - 3, 0)
    series = series_of(value, np.arange(n), lot=lot, fixture=fixture)
    return replace(series, t_ns=START_NS + lot.astype(np.int64) * WEEK_NS + (np.arange(n) % PER_LOT) * 10**9)


@pytest.mark.in_gate("200-True")
@pytest.mark.parametrize("heavy", [False, True])
@pytest.mark.parametrize("trials", [200, 2000])
def test_noise_shows_no_drift_more_often_than_is_promised(trials: int, *, heavy: bool) -> None:
    rng = np.random.default_rng(20261129)
    found = sum(bool(level_drifts(weekly_lots(rng, 0.0, heavy=heavy))) for _ in range(trials))
    assert found <= binom.ppf(0.999, trials, FALSE_ALARM)


def test_a_fixture_that_drifts_is_named_with_its_slope_and_its_lots_are_not_blamed_for_it() -> None:
    rng = np.random.default_rng(20261129)
    series = weekly_lots(rng, 1.0)
    trend = trend_of(series)
    (drift,) = trend.drifts
    assert (drift.group, drift.level, drift.blocks) == ("fixture", "F1", LOTS)
    slope = np.polyfit(np.arange(LOTS), np.maximum(np.arange(LOTS) - 3, 0), 1)[0]  # of the line nearest to the drift
    assert drift.effect.lo < slope / 7 < drift.effect.hi
    report = [each.en for each in sentences(trend)]
    assert any(each.startswith("Fixture F1 drifts against the other fixtures by") for each in report)
    assert not any("Fixture F0" in each or "Fixture F2" in each for each in report)


def test_levels_that_are_never_there_together_are_not_compared() -> None:
    rng = np.random.default_rng(2)
    series = weekly_lots(rng, 3.0)
    alone = replace(series, groups=series.groups | {"fixture": [f"F{each[1:]}" for each in series.groups["lot"]]})
    assert level_drifts(alone) == ()
    assert level_drifts(replace(series, dated=False)) == ()
    assert level_drifts(series.where(range(12))) == ()
