"""Stations, fixtures and lots: offsets found, sized with intervals that cover, attributed, and not invented."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import binom, f_oneway, ttest_ind, ttest_rel

from analytics.trends.groups.between_stations import GroupComparison, compare_groups
from analytics.trends.groups.components import components
from analytics.trends.groups.contrasts import holm
from analytics.trends.groups.mixed_model import MixedModel
from analytics.trends.series import MetricSeries, Variant
from analytics.trends.words import NotComputed

START_NS = 1_763_683_200 * 10**9


def series_of(value: np.ndarray, unit: np.ndarray, **groups: np.ndarray) -> MetricSeries:
    """Values an hour apart; units and levels by number."""
    n = len(value)
    levels = {name: [f"{name[0].upper()}{each}" for each in groups.get(name, np.zeros(n, int))] for name in GROUPS}
    return MetricSeries(
        metric="bias",
        unit_of_measure="deg/h",
        value=np.asarray(value, np.float64),
        uncertainty=np.full(n, 0.01),
        t_ns=START_NS + np.arange(n, dtype=np.int64) * 3600 * 10**9,
        unit=[f"U{each:04}" for each in unit],
        run=[f"r{at}" for at in range(n)],
        groups=levels | {"product": ["FOG-70"] * n, "signal": ["rate"] * n},
        variant=Variant("JJF2014", ()),
        others=(),
        without_value=0,
        dated=True,
    )


GROUPS = ("station", "fixture", "lot")


def two_stations(rng: np.random.Generator, offset: float) -> MetricSeries:
    """300 units, 150 of them on both stations: scatter of units 0.1, of measurements 0.02 deg/h."""
    unit = np.r_[np.arange(300), np.arange(150)]
    first = np.arange(300) % 2
    station = np.r_[first, 1 - first[:150]]
    value = 5 + rng.normal(0, 0.1, 300)[unit] + offset * station + rng.normal(0, 0.02, 450)
    return series_of(value, unit, station=station, lot=unit % 6 // 2)


def compared(series: MetricSeries) -> GroupComparison:
    found = compare_groups(series)
    assert isinstance(found, GroupComparison)
    return found


@pytest.mark.in_gate("10")
@pytest.mark.parametrize("trials", [10, 30, 100])
def test_station_offset_is_found_and_covered(trials: int) -> None:
    rng = np.random.default_rng(20260721)
    covered = found = pairs = 0
    for _ in range(trials):
        comparison = compared(two_stations(rng, 0.05))
        (station,) = (each for each in comparison.differences if each.group == "station")
        assert (station.level, station.against, station.confounded) == ("S1", "S0", ())
        covered += station.effect.lo <= 0.05 <= station.effect.hi
        found += station.adjusted < 0.01
        (pair,) = comparison.pairs
        assert pair.units == 150
        pairs += pair.effect.lo <= 0.05 <= pair.effect.hi
    assert found == trials
    for count in (covered, pairs):
        assert binom.ppf(0.001 / 2, trials, 0.95) <= count


@pytest.mark.long
@pytest.mark.parametrize("trials", [15, pytest.param(40, marks=pytest.mark.long)])
def test_scatter_of_units_is_covered(trials: int) -> None:
    rng = np.random.default_rng(20260731)
    covered = 0
    for _ in range(trials):
        unit = np.repeat(np.arange(40), 3)
        value = rng.normal(0, 0.1, 40)[unit] + rng.normal(0, 0.05, 120)
        found = components(series_of(value, unit), GROUPS)
        covered += (found["unit"].lo <= 0.1 <= found["unit"].hi) + (
            found["residual"].lo <= 0.05 <= found["residual"].hi
        )
    assert covered >= binom.ppf(0.001, 2 * trials, 0.94)


@pytest.mark.long
def test_scatter_of_stations() -> None:
    found = components(two_stations(np.random.default_rng(20260732), 0.05), GROUPS)
    assert set(found) == {"station", "unit", "residual", "lot"}
    assert found["unit"].lo <= 0.1 <= found["unit"].hi
    assert found["residual"].lo <= 0.02 <= found["residual"].hi
    # of two stations little can be said: 0.05/sqrt(2), with wide limits
    assert found["station"].value == pytest.approx(0.05 / np.sqrt(2), rel=0.2)
    assert found["station"].hi > 0.2
    assert components(series_of(np.ones(20), np.arange(20)), GROUPS) == {}


@pytest.mark.long
@pytest.mark.parametrize("trials", [25, pytest.param(80, marks=pytest.mark.long)])
def test_no_station_is_named_where_there_is_no_offset(trials: int) -> None:
    rng = np.random.default_rng(20260722)
    named = 0
    for _ in range(trials):
        unit = np.r_[np.arange(40), np.arange(20)]
        station = np.r_[np.arange(40) % 2, 1 - np.arange(20) % 2]
        value = rng.normal(0, 0.1, 40)[unit] + rng.normal(0, 0.02, 60)
        comparison = compared(series_of(value, unit, station=station, lot=unit % 5, fixture=np.arange(60) % 3))
        named += any(each.adjusted <= 0.05 for each in comparison.differences)
    assert named <= binom.isf(0.001, trials, 0.05)


def test_units_measured_once_give_the_t_test() -> None:
    rng = np.random.default_rng(20260723)
    station = np.arange(60) % 2
    value = rng.normal(3, 0.5, 60) + 0.4 * station
    (found,) = compared(series_of(value, np.arange(60), station=station)).differences
    expected = ttest_ind(value[station == 1], value[station == 0])
    low, high = expected.confidence_interval(0.95)
    assert found.effect.chance == pytest.approx(expected.pvalue, rel=1e-6)
    assert (found.effect.lo, found.effect.hi) == pytest.approx((low, high), rel=1e-6)


def test_all_units_on_both_give_the_paired_t_test() -> None:
    """Balanced: the mixed model, too, holds each unit against itself."""
    rng = np.random.default_rng(20260724)
    own = rng.normal(0, 1.0, 8)
    one, two = own + rng.normal(0, 0.1, 8), own + 0.15 + rng.normal(0, 0.1, 8)
    series = series_of(np.r_[one, two], np.r_[np.arange(8), np.arange(8)], station=np.repeat([0, 1], 8))
    comparison = compared(series)
    expected = ttest_rel(two, one)
    assert comparison.pairs[0].effect.chance == pytest.approx(expected.pvalue, rel=1e-9)
    (found,) = comparison.differences
    assert found.effect.value == pytest.approx((two - one).mean(), rel=1e-9)
    assert found.effect.chance == pytest.approx(expected.pvalue, rel=1e-3)
    assert found.effect.freedom == pytest.approx(7, rel=1e-3)


def test_lot_and_station_that_go_together_cannot_be_told_apart() -> None:
    rng = np.random.default_rng(20260725)
    station = np.arange(80) % 2
    value = rng.normal(0, 0.1, 80) + 0.3 * station
    comparison = compared(series_of(value, np.arange(80), station=station, lot=station))
    assert {each.group: each.confounded for each in comparison.differences} == {
        "station": ("lot",),
        "lot": ("station",),
    }
    parts = components(series_of(value, np.arange(80), station=station, lot=station), GROUPS)
    assert parts["station"].lo == parts["lot"].lo == 0.0
    assert min(parts["station"].hi, parts["lot"].hi) > 0.2
    # some units of both lots on both stations: now it is known which it is
    unit = np.r_[np.arange(80), np.arange(20)]
    both = np.r_[station, 1 - station[:20]]
    value = np.r_[value, value[:20] + 0.3 * (both[80:] - station[:20])] + rng.normal(0, 0.01, 100)
    comparison = compared(series_of(value, unit, station=both, lot=station[unit]))
    found = {each.group: each for each in comparison.differences}
    assert found["station"].confounded == found["lot"].confounded == ()
    assert found["station"].effect.lo <= 0.3 <= found["station"].effect.hi
    assert found["station"].adjusted < 1e-6
    assert found["lot"].adjusted > 0.01


def test_a_third_group_is_not_drawn_into_the_confusion_of_two() -> None:
    rng = np.random.default_rng(20260726)
    station = np.arange(90) % 2
    fixture = np.arange(90) // 2 % 3
    value = rng.normal(0, 0.1, 90) + 0.2 * (fixture == 2)
    comparison = compared(series_of(value, np.arange(90), station=station, lot=station, fixture=fixture))
    found = {(each.group, each.level): each for each in comparison.differences}
    assert found["fixture", "F2"].confounded == ()
    assert found["fixture", "F2"].adjusted < 0.01
    assert found["fixture", "F2"].effect.lo <= 0.2 <= found["fixture", "F2"].effect.hi
    assert found["station", "S1"].confounded == ("lot",)
    assert found["station", "S1"].adjusted > 0.01


def test_a_fixture_that_stands_on_one_station_only() -> None:
    rng = np.random.default_rng(20260727)
    fixture = np.arange(90) % 3
    station = (fixture == 2).astype(int)
    comparison = compared(series_of(rng.normal(0, 1, 90), np.arange(90), station=station, fixture=fixture))
    assert {each.group: each.confounded for each in comparison.differences} == {
        "station": ("fixture",),
        "fixture": ("station",),
    }


def test_too_little_is_refused_or_left_out() -> None:
    few = compare_groups(series_of(np.arange(7.0), np.arange(7), station=np.arange(7) % 2))
    assert isinstance(few, NotComputed)
    assert "7 values" in few.why.en
    single = compared(series_of(np.arange(9.0), np.arange(9), station=np.r_[np.zeros(8, int), 1]))
    assert not single.differences
    assert "station" in single.left_out[0].en
    same = compared(series_of(np.arange(9.0), np.arange(9)))
    assert (same.differences, same.pairs, same.left_out) == ((), (), ())


def _dense_deviance(y: np.ndarray, x: np.ndarray, parts: list[np.ndarray], logs: np.ndarray) -> float:
    """-2 ln of the restricted likelihood by its definition, with the whole covariance matrix."""
    v = sum(np.exp(log) * part for log, part in zip(logs, parts, strict=True))
    inverse = np.linalg.inv(v)
    normal = x.T @ inverse @ x
    beta = np.linalg.solve(normal, x.T @ inverse @ y)
    rest = y - x @ beta
    return float(np.linalg.slogdet(v)[1] + np.linalg.slogdet(normal)[1] + rest @ inverse @ rest)


@pytest.mark.long
def test_components_are_those_of_the_dense_likelihood() -> None:
    rng = np.random.default_rng(20260728)
    unit = rng.integers(0, 15, 70)
    unit[:15] = np.arange(15)
    station = rng.integers(0, 4, 70)
    y = 2 + rng.normal(0, 1.0, 15)[unit] + rng.normal(0, 0.7, 4)[station] + rng.normal(0, 0.5, 70)
    indicator = np.eye(4)[station]
    found = MixedModel(y, np.ones((70, 1)), unit, {"station": indicator}).deviations()
    parts = [np.eye(70), np.eye(15)[unit] @ np.eye(15)[unit].T, indicator @ indicator.T]
    best = minimize(
        lambda logs: _dense_deviance(y, np.ones((70, 1)), parts, logs),
        np.zeros(3),
        method="Nelder-Mead",
        options={"xatol": 1e-8, "fatol": 1e-10, "maxiter": 4000},
    )
    values = [found[name].value for name in ("residual", "unit", "station")]
    assert values == pytest.approx(list(np.exp(best.x / 2)), rel=1e-5)


def test_components_of_a_balanced_layout_are_those_of_analysis_of_variance() -> None:
    rng = np.random.default_rng(20260729)
    table = 7 + rng.normal(0, 2.0, (30, 1)) + rng.normal(0, 1.0, (30, 6))
    within = table.var(axis=1, ddof=1).mean()
    between = 6 * table.mean(axis=1).var(ddof=1)
    assert f_oneway(*table).statistic == pytest.approx(between / within)
    found = MixedModel(table.ravel(), np.ones((180, 1)), np.repeat(np.arange(30), 6)).deviations()
    assert found["residual"].value == pytest.approx(np.sqrt(within), rel=1e-6)
    assert found["unit"].value == pytest.approx(np.sqrt((between - within) / 6), rel=1e-6)


def test_a_component_that_is_none_is_zero() -> None:
    rng = np.random.default_rng(20260730)
    # groups more alike than chance: analysis of variance gives a negative component
    table = rng.normal(0, 1, (10, 5))
    table -= 0.95 * table.mean(axis=1, keepdims=True)
    model = MixedModel(table.ravel(), np.ones((50, 1)), np.repeat(np.arange(10), 5))
    found = model.deviations()
    assert found["unit"].value == found["unit"].lo == 0.0
    assert found["unit"].hi > 0
    (mean,) = model.effects(np.ones((1, 1)))
    assert mean.freedom == pytest.approx(49)


def test_probabilities_are_adjusted_as_holm_does() -> None:
    assert holm([]) == []
    assert holm([0.2]) == [0.2]
    assert holm([0.5, 0.001, 0.02]) == pytest.approx([0.5, 0.003, 0.04])


@pytest.mark.parametrize(("offset", "fixture_offset"), [(0.15, 0.2), (0.4, 0.3)])
def test_groups_that_differ_at_once_are_in_no_scatter_of_measurements(offset: float, fixture_offset: float) -> None:
    """Each unit on both stations, and on another fixture each time."""
    rng = np.random.default_rng(20260734)
    unit, round_of = np.tile(np.arange(24), 4), np.repeat(np.arange(4), 24)
    station, fixture = round_of % 2, (unit + round_of) % 3
    value = rng.normal(1, 0.1, 24)[unit] + rng.normal(0, 0.045, 96)
    plain = components(series_of(value, unit, station=station, fixture=fixture), GROUPS)
    value = value + offset * station + fixture_offset * (fixture == 2)
    found = components(series_of(value, unit, station=station, fixture=fixture), GROUPS)
    assert set(found) == {"residual", "unit", "station", "fixture"}
    assert found["residual"].lo < 0.045 < found["residual"].hi
    assert found["unit"].lo < 0.1 < found["unit"].hi
    assert plain["station"].hi < 1.0 > plain["fixture"].hi  # also where there is none
    for part in ("residual", "unit"):
        assert found[part].value == pytest.approx(plain[part].value, rel=0.05)


@pytest.mark.long
@pytest.mark.parametrize("levels", [2, 4])
def test_bounds_of_few_levels_hold_their_scatter(levels: int) -> None:
    rng = np.random.default_rng(20260735)
    level, many = np.repeat(np.arange(levels), 20), 400
    covered = 0
    for _ in range(many):
        value = rng.normal(0, 1.0, levels)[level] + rng.normal(0, 0.01, level.size)
        model = MixedModel(value, np.ones((level.size, 1)), np.arange(level.size), {"station": np.eye(levels)[level]})
        found = model.deviation("station")
        covered += found.lo <= 1.0 <= found.hi
    assert binom.ppf(0.0005, many, 0.95) <= covered <= binom.isf(0.0005, many, 0.95)


def test_units_that_differ_by_far_more_than_they_scatter_have_components() -> None:
    """As values in another unit of measure among others: the residual is a hundred-thousandth of the rest."""
    unit = np.r_[np.arange(5), 5 + np.arange(23) % 3]
    own = np.r_[np.full(5, 3528.0), 1.0, 2.0, 3.0]
    noise = np.random.default_rng(20260733).normal(0, 0.04, unit.size)
    found = components(series_of(own[unit] + noise, unit), GROUPS)
    assert found["residual"].lo <= 0.04 <= found["residual"].hi
