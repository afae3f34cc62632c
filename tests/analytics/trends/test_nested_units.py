"""Levels whose units were measured at no other level: no effect of units alone, no interval without their scatter."""

import numpy as np
import pytest
from scipy.stats import binom, ttest_ind

from analytics.trends.report import sentences
from analytics.trends.series import MetricSeries
from analytics.trends.trend import trend_of
from tests.analytics.trends.test_trends_groups import compared, series_of

OWN = np.array([0.3, 0.1, -0.2, 0.25, -0.05])


def nested(
    rng: np.random.Generator, own: np.ndarray, runs: int, group: str = "fixture", *, per: int = 1
) -> MetricSeries:
    """So many runs of each unit, `per` units to each level of the group."""
    unit = np.tile(np.arange(own.size), runs)
    return series_of(own[unit] + rng.normal(0, 0.03, unit.size), unit, **{group: unit // per})


@pytest.mark.parametrize(("group", "zh"), [("fixture", "夹具"), ("station", "试验台"), ("lot", "批次")])
def test_levels_of_one_unit_each_are_not_compared(group: str, zh: str) -> None:
    trend = trend_of(nested(np.random.default_rng(3), OWN, 9, group), by=group)
    said = sentences(trend)
    english, chinese = "\n".join(each.en for each in said), "\n".join(each.zh for each in said)
    why = f"each {group} holds one unit: its effect cannot be separated from that of the units"
    assert f"Not compared: {why}." in english
    assert f"未比较：每个{zh}只有一个产品：{zh}的影响无法与产品本身的差别区分。" in chinese
    assert "gives values" not in english
    assert f"from unit to unit, {group} included 0.2" in english
    assert f"产品间（含{zh}） 0.2" in chinese
    assert trend.components["unit"].lo > 0.1


def test_a_level_with_one_unit_among_others_is_named_and_the_others_are_compared() -> None:
    unit = np.tile(np.arange(9), 3)
    value = np.linspace(-0.2, 0.2, 9)[unit] + np.random.default_rng(4).normal(0, 0.01, 27)
    found = compared(series_of(value, unit, fixture=unit // 4))
    assert [(each.level, each.against) for each in found.differences] == [("F1", "F0")]
    (why,) = found.left_out
    assert why.en.startswith("fixture F2: holds one unit, measured at no other fixture")


def test_repeats_of_units_of_two_levels_give_the_t_test_of_their_means() -> None:
    rng = np.random.default_rng(5)
    series = nested(rng, rng.normal(0, 0.001, 6), 9, per=3)  # the components of variance see no scatter of units
    trend = trend_of(series, by="fixture")
    (found,) = compared(series).differences
    means = series.value.reshape(9, 6).mean(axis=0)
    expected = ttest_ind(means[3:], means[:3])
    assert found.effect.chance == pytest.approx(expected.pvalue, rel=1e-6)
    assert (found.effect.lo, found.effect.hi) == pytest.approx(tuple(expected.confidence_interval(0.95)), rel=1e-6)
    assert (found.units, found.elsewhere, found.on_both) == (3, 3, 0)
    assert trend.components["unit"].hi > 0


def test_a_difference_of_lots_says_how_many_units_it_rests_on() -> None:
    rng = np.random.default_rng(6)
    own = rng.normal(0, 0.05, 20) + (np.arange(20) >= 10)
    text = "\n".join(each.en for each in sentences(trend_of(nested(rng, own, 2, "lot", per=10))))
    assert "; 10 units there, 10 elsewhere, none on both: the interval counts how units scatter." in text


@pytest.mark.parametrize("trials", [20, pytest.param(200, marks=pytest.mark.long)])
def test_units_alone_make_no_difference_of_fixtures(trials: int) -> None:
    """Intervals of nested levels cover nothing, and seldom name a fixture."""
    named = covered = count = 0
    for seed in range(trials):
        rng = np.random.default_rng(seed)
        found = compared(nested(rng, rng.normal(0, 0.2, 9), 9, per=3)).differences
        named += any(each.adjusted <= 0.05 for each in found)
        covered += sum(each.effect.lo <= 0 <= each.effect.hi for each in found)
        count += len(found)
    assert named <= binom.isf(1e-4, trials, 0.05)
    # two differences of three are independent: as of fewer trials
    assert count - covered <= 1.5 * binom.isf(1e-4, 2 * trials, 0.05)


def test_scatter_of_a_fleet_with_a_frozen_lot_and_one_far_away_stays_that_of_its_values() -> None:
    """Beside a variance of lots of 1e18 times that of measurements rounding made the squares negative: 683 deg/h."""
    unit = np.repeat(np.arange(22), 2)
    lot, station = (np.repeat(levels, (6, 6, 1, 8, 1)) for levels in ((0, 1, 2, 3, 4), (0, 0, 1, 1, 2)))
    rng, is_frozen = np.random.default_rng(5), lot == 3
    own = np.array([1.0, 1.0, 9.0, 2.0, 1.0])[lot] + 0.1 * rng.standard_normal(22) * ~is_frozen
    value = own[unit] + 0.002 * rng.standard_normal(44) * ~is_frozen[unit]
    found = trend_of(series_of(value, unit, lot=lot[unit], station=station[unit])).components
    assert np.log(found["residual"].value / 0.002) ** 2 < 0.25
    assert 0.0 < found["unit"].lo < 0.1 < found["unit"].hi < 0.2
    assert 1.0 < found["lot"].value < 10.0 > found["station"].value
