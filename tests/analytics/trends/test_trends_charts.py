"""Rules of charts against a plain reading of their words, and how often charts of noise alone say something."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import binom

from analytics.trends.chart_sentences import state_of
from analytics.trends.charts.capability import Capability, capability
from analytics.trends.charts.control_chart import D2, IndividualsChart, Spread, ewma_chart, individuals_chart
from analytics.trends.charts.nelson_rules import chart_chance, points_of, rule_flags, wild_point_chance
from analytics.trends.levels.change_points import Changes, change_points
from analytics.trends.trend import trend_of
from analytics.trends.words import NotComputed, Words
from tests.analytics.trends.test_trends_groups import series_of


def _plain_flags(z: list[float]) -> set[tuple[int, int]]:
    """Rules and the points that complete them, word for word."""
    found = set()
    for at in range(len(z)):
        last = [z[at - back] for back in range(at + 1)]  # the newest first
        nine, six, fourteen, fifteen, eight = last[:9], last[:6], last[:14], last[:15], last[:8]
        steps = [a - b for a, b in pairwise(last)]
        if abs(last[0]) > 3:
            found.add((1, at))
        if len(nine) == 9 and (min(nine) > 0 or max(nine) < 0):
            found.add((2, at))
        if len(six) == 6 and (min(steps[:5]) > 0 or max(steps[:5]) < 0):
            found.add((3, at))
        if len(fourteen) == 14 and all(a * b < 0 for a, b in pairwise(steps[:13])):
            found.add((4, at))
        for side in (1, -1):
            outside = [side * each for each in last]
            if outside[0] > 2 and sum(each > 2 for each in outside[:3]) >= 2:
                found.add((5, at))
            if outside[0] > 1 and sum(each > 1 for each in outside[:5]) >= 4:
                found.add((6, at))
        if len(fifteen) == 15 and max(map(abs, fifteen)) < 1:
            found.add((7, at))
        if len(eight) == 8 and min(map(abs, eight)) > 1:
            found.add((8, at))
    return found


@pytest.mark.long
@pytest.mark.parametrize("scale", [0.5, 1.0, 1.6, 2.5])
def test_rules_are_what_their_words_say(scale: float) -> None:
    rng = np.random.default_rng(20260701)
    for series in range(40):
        z = scale * rng.standard_normal(80) + (0.8 if series % 3 == 0 else 0.0)
        if series % 4 == 1:
            z = np.cumsum(z) / 4
        if series % 4 == 2:
            z = z + np.tile([1.5, -1.5], 40)
        flags = rule_flags(z)
        assert {(rule + 1, int(at)) for rule, at in np.argwhere(flags)} == _plain_flags(list(z))


def test_rules_of_short_series() -> None:
    assert not rule_flags(np.array([0.5])).any()
    assert not rule_flags(np.array([])).any()
    assert points_of(rule_flags(np.array([2.5, 2.5])), np.array([2.5, 2.5])) == {5: [0, 1]}


def test_rules_name_the_points_that_take_part() -> None:
    z = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, -0.1, 4.0])
    assert points_of(rule_flags(z), z) == {1: [7], 3: [0, 1, 2, 3, 4, 5]}


@pytest.mark.long
def test_a_chart_of_noise_seldom_has_too_many_signals_or_a_wild_point() -> None:
    rng = np.random.default_rng(20260702)
    series = 1500
    for n in (12, 60):
        signals = wild = 0
        for _ in range(series):
            values = rng.normal(100.0, 3.0, n)
            chart = individuals_chart(values, spread=Spread.MEDIAN_MOVING_RANGE)
            assert isinstance(chart, IndividualsChart)
            counts = rule_flags((values - chart.centre) / chart.sigma).sum(axis=-1)
            chance = chart_chance(values, counts, baseline=n, spread=Spread.MEDIAN_MOVING_RANGE)
            signals += chance.signals <= 0.01
            wild += chance.wild_point <= 0.01
        # both are bounds, four checks are made; the simulated null has an error of its own, of a tenth
        bound = binom.isf(0.001 / 4, series, 0.011)
        assert signals <= bound
        assert wild <= bound


def test_signals_are_counted_as_noise_gives_them() -> None:
    """The expected number of signals is what charts of known limits give: about one point in 370 beyond 3 sigma."""
    chance = chart_chance(np.arange(400.0), np.zeros(8, np.int64), baseline=400, spread=Spread.DEVIATION)
    assert chance.expected[0] == pytest.approx(400 / 370.4, rel=0.12)
    assert chance.rule is None


def test_a_moved_level_has_too_many_signals() -> None:
    rng = np.random.default_rng(20260703)
    values = rng.standard_normal(60)
    values[30:] += 2.0
    chart = individuals_chart(values, spread=Spread.MEDIAN_MOVING_RANGE)
    assert isinstance(chart, IndividualsChart)
    counts = rule_flags((values - chart.centre) / chart.sigma).sum(axis=-1)
    assert chart_chance(values, counts, baseline=60, spread=Spread.MEDIAN_MOVING_RANGE).signals <= 0.001


def test_a_wild_point_is_seen_among_few() -> None:
    values = np.array([5.0, 5.1, 4.9, 5.05, 4.95, 5.1, 4.9, 9.0])
    assert wild_point_chance(values) < 1e-6
    assert wild_point_chance(np.delete(values, 7)) > 0.5
    assert wild_point_chance(np.full(9, 2.0)) == 1.0


def test_too_few_or_equal_points_have_no_limits() -> None:
    few = individuals_chart(np.arange(7.0))
    assert isinstance(few, NotComputed)
    assert "7 points" in few.why.en
    equal = individuals_chart(np.full(20, 1.25))
    assert isinstance(equal, NotComputed)
    assert "do not vary" in equal.why.en


def test_coarse_values_have_limits_and_a_change_of_level() -> None:
    # more than half of successive values are alike, so that the median moving range is 0
    coarse = np.where(np.random.default_rng(2).random(60) < 0.8, 1.0, 1.2)
    assert np.median(np.abs(np.diff(coarse))) == 0.0
    chart = individuals_chart(coarse, spread=Spread.MEDIAN_MOVING_RANGE)
    assert isinstance(chart, IndividualsChart)
    assert chart.sigma == pytest.approx(np.abs(np.diff(coarse)).mean() / D2)
    coarse[30:] += 0.6
    found = change_points(coarse)
    assert isinstance(found, Changes)
    (change,) = found.points
    assert change.at == 30
    assert change.lo < 0.6 < change.hi


def test_limits_from_a_baseline_are_blind_to_what_follows() -> None:
    rng = np.random.default_rng(20260704)
    values = rng.standard_normal(60)
    before = individuals_chart(values, baseline=20)
    values[20:] += 50
    assert individuals_chart(values, baseline=20) == before


def test_moving_averages_see_a_small_shift_that_single_points_do_not() -> None:
    values = np.concatenate([np.zeros(20), np.full(20, 1.2)])
    chart = ewma_chart(values, 0.0, 1.0)
    # 1.2*(1 - 0.8**k) is beyond 2.86*sqrt(0.2/1.8) = 0.953 for the first time after 8 points
    assert min(chart.outside) == 27
    assert np.abs(values).max() < 3


@pytest.mark.long
def test_capability_intervals_cover() -> None:
    rng = np.random.default_rng(20260705)
    trials = 2000
    for n in (20, 100):
        values = rng.normal(1.0, 1.0, (trials, n))
        found = [capability(each, -4.0, 5.0) for each in values]
        assert all(isinstance(each, Capability) for each in found)
        cp = sum(each.cp.lo <= 1.5 <= each.cp.hi for each in found if isinstance(each, Capability) and each.cp)
        one = [capability(each, None, 5.0) for each in values]
        cpk = sum(each.cpk.lo <= 4 / 3 <= each.cpk.hi for each in one if isinstance(each, Capability))
        # exact for Cp; Bissell's is an approximation that is held to 93 %
        assert abs(cp - 0.95 * trials) <= binom.isf(0.001 / 4, trials, 0.95) - 0.95 * trials + 3
        assert cpk >= binom.ppf(0.001 / 4, trials, 0.93)


def test_capability_is_refused_with_a_reason() -> None:
    values = np.random.default_rng(1).normal(size=40)
    drifting = Words("it drifts", "存在漂移")
    for found, word in (
        (capability(values[:19], -3, 3), "19 units"),
        (capability(values, None, None), "no specification"),
        (capability(values, -3, 3, out_of_control=drifting), "it drifts"),
        (capability(np.ones(30), -3, 3), "do not vary"),
    ):
        assert isinstance(found, NotComputed)
        assert word in found.why.en
        assert found.why.zh


def test_capability_tells_what_the_measurement_adds_and_whether_values_are_normal() -> None:
    rng = np.random.default_rng(6)
    found = capability(rng.normal(0, 2.0, 400), -9, 9, uncertainty=np.full(400, 1.0))
    assert isinstance(found, Capability)
    assert found.measurement_share == pytest.approx(0.25, rel=0.2)
    assert found.is_normal
    skewed = capability(rng.exponential(1.0, 400), None, 9)
    assert isinstance(skewed, Capability)
    assert not skewed.is_normal
    unknown = capability(rng.normal(0, 2.0, 40), -9, 9, uncertainty=np.full(40, np.nan))
    assert isinstance(unknown, Capability)
    assert unknown.measurement_share is None


def test_a_point_outside_the_limits_is_in_the_state_of_the_chart() -> None:
    """Nine values with one beyond 3 sigma, as noise gives: the chart does not call itself in control beside it."""
    value = np.array([0.09, 0.1, 0.095, 0.105, 0.1, 0.11, 0.1, 0.06, 0.09])
    (chart,) = trend_of(series_of(value, np.zeros(9, int)), by="unit").charts
    assert (chart.in_control, len(chart.signals[1])) == (True, 1)
    assert state_of(chart).en == "1 point outside, not significantly more than chance"
    assert state_of(chart).zh == "1 点超出控制限，未显著多于随机预期"
    (plain,) = trend_of(series_of(np.r_[value[:7], 0.1, 0.09], np.zeros(9, int)), by="unit").charts
    assert state_of(plain) == ("in control", "受控")
