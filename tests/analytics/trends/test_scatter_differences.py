"""Fixtures whose values scatter more are found, with a ratio that covers; noise alone, steps and drifts are not."""

import numpy as np
from scipy.stats import binom

from analytics.trends.groups.scatter_differences import ScatterDifference, scatter_differences
from analytics.trends.series import MetricSeries
from tests.analytics.trends.test_trends_groups import series_of

TRIALS = 200


def rotated(rng: np.random.Generator, deviations: tuple[float, ...], step: float = 0.0) -> MetricSeries:
    """30 units, measured nine times, each time on the next fixture; from the fifth time on all read `step` more."""
    unit, turn = np.tile(np.arange(30), 9), np.repeat(np.arange(9), 30)
    fixture = (unit + turn) % 3
    value = (
        rng.normal(1.0, 0.2, 30)[unit] + step * (turn >= 4) + np.array(deviations)[fixture] * rng.standard_normal(270)
    )
    return series_of(value, unit, fixture=fixture)


def of_third(series: MetricSeries) -> ScatterDifference:
    (found,) = [each for each in scatter_differences(series).differences if each.level == "F2"]
    return found


def test_a_fixture_that_scatters_three_times_as_much_is_found_and_covered() -> None:
    found = [of_third(rotated(np.random.default_rng(seed), (0.1, 0.1, 0.3))) for seed in range(TRIALS)]
    assert all(each.is_within_units for each in found)
    assert sum(each.chance <= 0.01 for each in found) >= 0.9 * TRIALS
    # 95 % bounds: so few as these cover with a probability of 1e-4
    assert sum(each.lo <= 3.0 <= each.hi for each in found) >= binom.ppf(1e-4, TRIALS, 0.95)


def test_equal_scatter_is_seldom_called_different_whatever_the_level_does() -> None:
    for step in (0.0, 0.5):
        alarms = 0
        for seed in range(TRIALS):
            series = rotated(np.random.default_rng(seed), (0.1, 0.1, 0.1), step)
            alarms += any(each.chance <= 0.01 for each in scatter_differences(series).differences)
        assert alarms <= binom.ppf(1 - 1e-4, TRIALS, 0.01)


def test_values_of_different_units_are_compared_where_none_was_measured_again() -> None:
    rng = np.random.default_rng(4)
    lot = np.repeat([0, 1], 100)
    value = np.where(lot == 1, 0.3, 0.1) * rng.standard_normal(200)
    (first, second) = scatter_differences(series_of(value, np.arange(200), lot=lot)).differences
    assert not second.is_within_units
    assert second.lo < 3.0 < second.hi
    assert np.isclose(first.ratio * second.ratio, 1.0)
    few = scatter_differences(series_of(value[90:110], np.arange(20), lot=lot[90:110]))
    assert few.differences == ()
    (why,) = few.left_out
    assert "fewer than 8 pairs" in why.en
    assert "L0, L1" in why.en


def test_a_second_station_takes_no_spread_of_a_lot_away() -> None:
    """The same units measured once more elsewhere: the lots are compared by the first value of each, as before."""
    rng = np.random.default_rng(5)
    unit, lot = np.arange(90), np.repeat([0, 1, 2], 30)
    own = rng.normal(0, np.array([0.03, 0.15, 0.03])[lot])
    first, again = (own + rng.normal(0, 0.01, 90) for _ in range(2))
    once = scatter_differences(series_of(first, unit, lot=lot))
    station = np.repeat([0, 1], 90)
    twice = scatter_differences(series_of(np.r_[first, again], np.tile(unit, 2), lot=np.tile(lot, 2), station=station))
    of_lots = [each for each in twice.differences if not each.is_within_units]
    assert {each.level: each.ratio for each in of_lots} == {each.level: each.ratio for each in once.differences}
    (wide,) = [each for each in of_lots if each.level == "L1"]
    assert wide.chance <= 0.01
    assert wide.lo < 5.0 < wide.hi
    # each unit only once at each station: the repeatability is not compared, and the report says so
    assert any("measurements of one unit by station" in each.en for each in twice.left_out)
