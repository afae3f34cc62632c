"""A drift that is not significant among many charts, and that noise seldom shows: it is not passed over."""

import numpy as np
import pytest

from analytics.trends.report import sentences, stands_out
from analytics.trends.series import read_series
from analytics.trends.trend import FALSE_ALARM, trend_of
from tests.analytics.trends.reported_values import Reported

UNITS, DAYS = 12, 10
NOISE = np.random.default_rng(20261129).normal(0, 0.1, (UNITS, DAYS))


@pytest.mark.parametrize(("per_day", "expected"), [(0.0, ""), (0.12, "may drift"), (0.4, "it drifts")])
def test_what_is_said_of_a_drift_follows_its_chance(reported: Reported, per_day: float, expected: str) -> None:
    """The same noise with a drift of one unit: none, one that is possible, one that is plain."""
    rows = [
        {"unit": f"U{unit:02}", "hour": 24 * day + unit, "station": "A",
         "value": unit + NOISE[unit, day] + (per_day * day if unit == 7 else 0)}
        for day in range(DAYS) for unit in range(UNITS)
    ]  # fmt: skip
    trend = trend_of(read_series(reported(rows), "bias"), by="unit")
    chart = next(each for each in trend.charts if each.name == "U07")
    assert chart.drift_chance is not None
    bounds = {"": (0.05, 1.0), "may drift": (FALSE_ALARM, 0.05), "it drifts": (0.0, FALSE_ALARM)}[expected]
    assert bounds[0] < chart.drift_chance <= bounds[1]
    assert chart.drift_is_by_chance == (expected != "it drifts")
    english, chinese = ("\n".join(each[at] for each in sentences(trend)) for at in (0, 1))
    assert ("Unit U07: it may drift, by" in english) == (expected == "may drift")
    assert ("Unit U07: it drifts by" in english) == (expected == "it drifts")
    assert ("U07" in chinese) == bool(expected)
    if expected == "may drift":
        assert f"on one of {UNITS} charts in {chart.drift_chance:.1%} of trends" in english
        assert "12 张图中至少一张" in chinese
        assert not stands_out(trend), "what may be is no signal"
