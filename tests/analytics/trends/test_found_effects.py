"""What a report finds is taken off before the rest is compared: steps and stations, wild values, units that drift."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from analytics.trends.document import document
from analytics.trends.levels.found_effects import FoundEffects, found_effects
from analytics.trends.levels.level_shifts import level_shifts
from analytics.trends.report import sentences
from analytics.trends.series import NS_PER_DAY, MetricSeries
from analytics.trends.trend import trend_of
from analytics.trends.words import NotComputed
from tests.analytics.trends.test_trends_groups import series_of

UNITS, WEEKS = 20, 13
NOISE, STEP, OFFSET = 0.02, 0.12, -0.06


def weekly(seed: int, *, slope: float = 0.0, wander: float = 0.0) -> MetricSeries:
    """Units that are measured each week at one of two stations; all step after six weeks, U0003 drifts per day."""
    rng = np.random.default_rng([20261130, seed])
    unit, week = np.tile(np.arange(UNITS), WEEKS), np.repeat(np.arange(WEEKS), UNITS)
    station = (unit + week + rng.integers(0, 2, unit.size)) % 2
    noise = rng.standard_normal((WEEKS, UNITS))
    for at in range(1, WEEKS):
        noise[at] = wander * noise[at - 1] + np.sqrt(1 - wander**2) * noise[at]
    value = 1.0 + rng.normal(0, 0.1, UNITS)[unit] + NOISE * noise[week, unit]
    value += STEP * (week >= 6) + OFFSET * station + slope * 7 * week * (unit == 3)
    series = series_of(value, unit, station=station)
    days = 7 * week + station
    moments = series.t_ns[0] + days * NS_PER_DAY + unit * 600 * 10**9
    series = replace(series, t_ns=moments, run=[f"r{day}" for day in days])
    return series.where(np.argsort(moments, kind="stable"))


def found_of(series: MetricSeries) -> FoundEffects:
    return found_effects(series, level_shifts(series.within_products()), ())


def with_wild(series: MetricSeries, at: int) -> MetricSeries:
    value = series.value.copy()
    value[at] += 1.5
    return replace(series, value=value)


def test_a_unit_that_drifts_is_named_beside_a_step_and_an_offset_of_stations() -> None:
    series = weekly(1, slope=0.004)
    trend = trend_of(series, by="unit")
    assert [chart.name for chart in trend.charts if chart.drifts] == ["U0003"]
    (chart,) = [chart for chart in trend.charts if chart.drifts]
    assert not isinstance(chart.drift, NotComputed)
    assert chart.drift.lo < 0.004 < chart.drift.hi
    english = [each.en for each in sentences(trend)]
    assert "what this report finds of stations and fixtures taken off" in english[0]
    assert any(each.startswith("Unit U0003: it drifts by 0.00") for each in english)
    assert document(trend)["drifting_units"] == ["U0003"]
    # what is charted is one measurement's scatter wide, not that of step and station
    widths = [chart.charted.std(ddof=1) for chart in trend.charts if chart.name != "U0003"]
    assert np.mean(widths) < 1.3 * NOISE


@pytest.mark.in_gate("0.0-12")
@pytest.mark.parametrize("trials", [12, pytest.param(400, marks=pytest.mark.long)])
@pytest.mark.parametrize("wander", [0.0, 0.6, 0.9])
def test_of_units_that_stay_none_drifts(wander: float, trials: int) -> None:
    """One per cent of reports of stationary units name any of the twenty."""
    alarms = sum(bool(found_of(weekly(seed, wander=wander)).drifting) for seed in range(trials))
    assert alarms <= binom.isf(0.001 / 3, trials, 0.01)


def test_a_wild_value_accuses_no_station_and_is_in_no_component() -> None:
    series = with_wild(weekly(2), 37)
    trend = trend_of(series, by="station")
    assert trend.found.wild == (37,)
    assert all(each.chance > 0.01 for each in trend.scatters.differences)
    residual = trend.components["residual"]
    assert residual.lo < NOISE < residual.hi
    assert residual.hi < 1.3 * NOISE
    english = "\n".join(each.en for each in sentences(trend))
    assert "times" not in english
    assert "Wild among the measurements of their units, and left out" in english
    assert series.unit[37] in english.split("Wild among")[1]
    assert "Standard deviations without the changes of level above" in english
    (left_out,) = document(trend)["wild_left_out"]
    assert left_out["unit"] == series.unit[37]


def test_a_station_that_scatters_more_has_no_wild_values_and_is_named() -> None:
    plain = weekly(3)
    rng = np.random.default_rng(8)
    is_loud = np.array(plain.groups["station"]) == "S1"
    series = replace(plain, value=plain.value + 3 * NOISE * rng.standard_normal(is_loud.size) * is_loud)
    trend = trend_of(series, by="station")
    assert trend.found.wild == ()
    (loud,) = [each for each in trend.scatters.differences if each.level == "S1"]
    assert loud.chance <= 0.01
    assert loud.lo < np.sqrt(10) < loud.hi


def test_a_unit_that_drifts_has_no_wild_values() -> None:
    assert found_of(weekly(4, slope=0.01)).wild == ()


def test_of_two_values_of_a_unit_both_are_left_out() -> None:
    """Which of the two is wild, they do not tell."""
    rng = np.random.default_rng(9)
    unit = np.tile(np.arange(30), 2)
    value = 1.0 + rng.normal(0, 0.1, 30)[unit] + rng.normal(0, NOISE, 60)
    value[12] += 1.5
    assert found_of(series_of(value, unit)).wild == (12, 42)
    assert found_of(series_of(value[:30], unit[:30])).wild == ()


def test_difference_of_stations_is_as_narrow_as_the_measurements_allow() -> None:
    trend = trend_of(with_wild(weekly(5, slope=0.004), 100), by="station")
    assert not isinstance(trend.comparison, NotComputed)
    (station,) = trend.comparison.differences
    assert station.effect.lo < OFFSET < station.effect.hi
    # two standard errors on either side of a difference of two halves of 260 values
    assert station.effect.hi - station.effect.lo < 1.3 * 4 * NOISE * 2 / np.sqrt(260)


def test_a_difference_of_stations_is_that_since_one_of_them_changed() -> None:
    """About the mean of the station that steps both cancel: no difference had been stated."""
    rng = np.random.default_rng(20261131)
    unit, week = np.tile(np.arange(16), WEEKS), np.repeat(np.arange(WEEKS), 16)
    station = (unit + week) % 2
    value = 1.0 + rng.normal(0, 0.1, 16)[unit] + rng.normal(0, NOISE, unit.size)
    value += 0.15 * (station == 1) + 0.30 * ((station == 0) & (week >= 6))
    series = series_of(value, unit, station=station)
    series = replace(series, t_ns=series.t_ns[0] + 7 * week * NS_PER_DAY, run=[f"r{each}" for each in week])
    trend = trend_of(series, by="station")
    assert not isinstance(trend.comparison, NotComputed)
    (found,) = [each for each in trend.comparison.differences if each.group == "station"]
    truth = 0.15 if found.effect.value > 0 else -0.15  # 0.15 - 0.30 of the other
    assert found.effect.lo < truth < found.effect.hi
    assert found.effect.hi - found.effect.lo < 0.05
    # the change of the one is fitted beside the difference: no rest of either is in the scatter of measurements
    (pair,) = trend.comparison.pairs
    assert pair.effect.lo < abs(truth) * np.sign(pair.effect.value) < pair.effect.hi
    assert trend.components["residual"].lo < NOISE < trend.components["residual"].hi < 1.3 * NOISE
    (sentence,) = [each for each in sentences(trend) if "since the level of " in each.en]
    assert "水平变化以后" in sentence.zh
