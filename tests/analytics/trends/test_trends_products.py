"""Trends of several products: their limits, charts and capabilities, and the groups that are compared within them."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analytics.plots.trend_plot import plot_trend
from analytics.specifications.entering import add_specification
from analytics.specifications.verdicts import UNGIVEN
from analytics.trends.charts.capability import Capability, SpecifiedLimits, specified_limits
from analytics.trends.document import document
from analytics.trends.groups.between_stations import GroupComparison, compare_groups
from analytics.trends.groups.components import components
from analytics.trends.report import sentences
from analytics.trends.series import Choice, MetricSeries, read_series
from analytics.trends.trend import trend_of
from analytics.trends.words import NotComputed
from storage.store import Store
from tests.analytics.trends.reported_values import Reported, english, one_each
from tests.analytics.trends.test_trends_groups import series_of


@pytest.mark.long
def test_products_with_different_limits_have_none_in_common(reported: Reported, store: Store, tmp_path: Path) -> None:
    rows = one_each(np.random.default_rng(1).normal(size=30))
    for at, row in enumerate(rows):
        row["product"] = ("P", "Q")[at % 2]
    series = read_series(reported(rows), "bias")
    assert specified_limits(store, series) == SpecifiedLimits()
    path = tmp_path / "two.toml"
    text = '[[limit]]\nmetric = "bias"\nupper = {}\nunit_of_measure = "deg/h"\nproduct = "{}"\n'
    path.write_text('revision = "A"\n' + text.format(1.0, "P") + text.format(2.0, "Q"))
    add_specification(store, path)
    limits = specified_limits(store, series)
    assert limits.why_not is not None
    assert "--product" in limits.why_not.en
    one = read_series(reported(rows), "bias", Choice(product="Q"))
    assert specified_limits(store, one).upper == 2.0


def test_products_in_one_chart_are_named_and_each_has_a_chart_of_its_own(reported: Reported) -> None:
    rng = np.random.default_rng(5)
    rows = [
        {"unit": f"U{i:02}", "product": "AB"[i % 3 == 0], "value": rng.normal(10.0 * (i % 3 == 0), 1.0)}
        for i in range(60)
    ]
    series = read_series(reported(rows), "bias")
    mixed = sentences(trend_of(series))
    assert "of 2 products (A: 40, B: 20)" in mixed[1].en
    assert "2 种产品型号（A: 40、B: 20）" in mixed[1].zh
    by_product = trend_of(series, by="product")
    assert [(chart.name, chart.series.value.size) for chart in by_product.charts] == [("A", 40), ("B", 20)]
    assert not any("products" in each.en for each in sentences(by_product))
    of_one = read_series(reported(rows), "bias", Choice(product="A"))
    assert not any("products" in each.en for each in sentences(trend_of(of_one)))


@pytest.mark.parametrize(
    "groups",
    [("fixture",), pytest.param((None, "product", "lot", "fixture"), marks=pytest.mark.long)],
    ids=["one", "all"],
)
def test_a_product_is_no_fixture_and_each_has_the_capability_by_its_own_limits(
    reported: Reported, store: Store, tmp_path: Path, groups: tuple[Any, ...]
) -> None:
    path = tmp_path / "two.toml"
    entry = '[[limit]]\nmetric = "bias"\nproduct = "{}"\nlower = {}\nupper = {}\nunit_of_measure = "deg/h"\n'
    path.write_text('revision = "A"\n' + entry.format("X", -6, 10) + entry.format("Y", 4, 20))
    add_specification(store, path)
    rng = np.random.default_rng(11)
    # as in production: each product has lots and a fixture of its own
    rows = [
        {
            "unit": f"U{i:02}", "product": "XY"[i % 2], "lot": f"L{i % 4}", "fixture": f"F{i % 2}", "station": "A",
            "value": rng.normal(2.0 + 10.0 * (i % 2), 1.0),
        }
        for i in range(80)
    ]  # fmt: skip
    series = read_series(reported(rows), "bias")
    for by in groups:
        limits_of = partial(specified_limits, store)
        trend = trend_of(series, by=by, specification=specified_limits(store, series), limits_of=limits_of)
        text = english(trend)
        assert "than fixture" not in text, (by, text)
        assert "than the other" not in text, (by, text)
        assert not any(each.value > 2.0 for each in trend.components.values()), (by, trend.components)
    by_product = trend_of(series, by="product", specification=specified_limits(store, series), limits_of=limits_of)
    for found, (lower, upper) in zip(by_product.capabilities, ((-6.0, 10.0), (4.0, 20.0)), strict=True):
        assert isinstance(found, Capability)
        assert (found.lower, found.upper) == (lower, upper)
    assert "Product X: Cp" in english(by_product)
    assert "各取该处每个产品的首个值" in sentences(by_product)[0].zh
    assert document(by_product)["charts"][1]["specification"]["lower"] == 4.0
    plot_trend(by_product, tmp_path / "both.svg")


def test_a_fixture_that_both_products_share_is_compared_within_each(reported: Reported) -> None:
    rng = np.random.default_rng(12)
    rows = [
        {
            "unit": f"U{i:02}", "product": "XY"[i % 2], "fixture": f"F{i // 2 % 2}", "station": "A",
            "value": rng.normal(2.0 + 10.0 * (i % 2) + 3.0 * (i // 2 % 2), 1.0),
        }
        for i in range(80)
    ]  # fmt: skip
    comparison = trend_of(read_series(reported(rows), "bias")).comparison
    assert isinstance(comparison, GroupComparison)
    (fixture,) = comparison.differences
    assert fixture.group == "fixture"
    assert fixture.effect.lo < 3.0 < fixture.effect.hi
    assert fixture.adjusted < 1e-6


def test_products_that_are_measured_at_one_time_are_no_change_of_level(reported: Reported) -> None:
    """Two sessions; in each all units are measured at once, those of one product before the others by their serials."""
    rng = np.random.default_rng(20261131)
    rows = [
        {"unit": f"U{session}{at:02}", "value": (1.0 if at < 12 else 0.4) + rng.normal(0, 0.02),
         "product": "PQ"[at >= 12], "station": "A", "hour": 24 * session}
        for session in range(2) for at in range(20)
    ]  # fmt: skip
    series = read_series(reported(rows), "bias")
    assert sorted(series.unit[:20]) == [f"U0{at:02}" for at in range(20)]
    assert "changes by" not in english(trend_of(series))


def with_another(series: MetricSeries, *, values: int, offset: float = 0.0) -> MetricSeries:
    """The values and those of one more unit, of another product and with no fixture."""
    more = series.where([*range(series.value.size), *[0] * values])
    last = ["U9999"] * values
    more.value[-values:] = 1.0 + offset
    groups = {name: levels[:-values] + [UNGIVEN] * values for name, levels in more.groups.items()}
    groups["station"] = more.groups["station"]
    return replace(more, unit=more.unit[:-values] + last, groups=groups)


def three_fixtures(seed: int, offset: float) -> MetricSeries:
    """24 units, each on both stations and all of three fixtures; F2 differs."""
    rng = np.random.default_rng([20261201, seed])
    unit, times = np.tile(np.arange(24), 4), np.repeat(np.arange(4), 24)
    fixture = (unit + times) % 3
    value = rng.normal(1, 0.1, 24)[unit] + offset * (fixture == 2) + rng.normal(0, 0.045, 96)
    return series_of(value, unit, station=times % 2, fixture=fixture)


@pytest.mark.parametrize("values", [1, 5])
def test_a_unit_of_another_product_hides_no_fixture_that_differs(values: int) -> None:
    plain = three_fixtures(1, 0.2)
    trend = trend_of(with_another(plain, values=values, offset=3.0), by="fixture")
    assert not isinstance(trend.comparison, NotComputed)
    found = {each.level: each for each in trend.comparison.differences if each.group == "fixture"}
    assert set(found) == {"F0", "F1", "F2"}
    assert found["F2"].effect.lo < 0.2 < found["F2"].effect.hi
    assert found["F2"].confounded == ()
    alone = trend_of(plain).comparison
    assert not isinstance(alone, NotComputed)
    (same,) = [each for each in alone.differences if each.level == "F2"]
    assert found["F2"].effect.hi - found["F2"].effect.lo == pytest.approx(same.effect.hi - same.effect.lo, rel=0.05)
    text = english(trend)
    (sentence,) = [each for each in text.splitlines() if each.startswith("Fixture F2 gives values ")]
    assert "higher than the other fixtures on average" in sentence
    assert "Not compared: fixture (not given): no name" in text


def test_a_level_with_few_units_weighs_little_in_the_mean_of_the_others() -> None:
    """Two units on a fourth fixture alone, at a level of their own."""
    plain = three_fixtures(2, 0.2)
    few = with_another(plain, values=2)
    few = replace(
        few,
        unit=[*few.unit[:-1], "U9998"],
        groups=few.groups | {"product": ["FOG-70"] * 98, "fixture": [*few.groups["fixture"][:-2], *"ZZ"]},
    )
    comparison, alone = compare_groups(few), compare_groups(plain)
    assert not isinstance(comparison, NotComputed)
    assert not isinstance(alone, NotComputed)
    width, before = (
        next(each.effect.hi - each.effect.lo for each in of.differences if each.level == "F2")
        for of in (comparison, alone)
    )
    assert width < 1.1 * before
    assert "Z" in {each.level for each in comparison.differences}


def test_levels_of_different_products_are_not_compared() -> None:
    """Lots are of one product each: of two products with two lots each there are two differences."""
    rng = np.random.default_rng(20261202)
    lot = np.arange(80) // 20
    value = rng.normal(0, 0.1, 80) + 0.5 * (lot == 1) + 4.0 * (lot > 1)
    series = series_of(value, np.arange(80), lot=lot)
    products = np.where(lot > 1, "Q", "P").tolist()
    found = compare_groups(replace(series, groups=series.groups | {"product": products}))
    assert not isinstance(found, NotComputed)
    assert [(each.level, each.against) for each in found.differences] == [("L1", "L0"), ("L3", "L2")]
    assert found.differences[0].effect.lo < 0.5 < found.differences[0].effect.hi
    assert [each.adjusted < 0.01 for each in found.differences] == [True, False]
    apart = compare_groups(replace(series, groups=series.groups | {"product": [f"P{each}" for each in lot]}))
    assert not isinstance(apart, NotComputed)
    assert apart.differences == ()
    assert "lot" in apart.left_out[0].en


def test_values_that_do_not_scatter_are_not_compared_and_the_report_gives_the_reason() -> None:
    """As of a coarse resolution: nothing says how sure a difference is, and nobody takes it for none."""
    unit = np.repeat(np.arange(12), 4)
    station = np.arange(48) % 2
    for value in (np.full(48, 3.3), np.round(np.arange(12) * 0.1, 1)[unit] + 0.5 * station):
        trend = trend_of(series_of(value, unit, station=station), by="station")
        assert isinstance(trend.comparison, NotComputed)
        assert trend.components == {}
        (reason,) = [each for each in sentences(trend) if "Not compared: station: " in each.en]
        assert "measurements of one unit do not scatter" in reason.en
        assert "各次测量无分散" in reason.zh


def test_groups_that_products_determine_have_no_component_and_are_named() -> None:
    unit = np.repeat(np.arange(24), 3)
    rng = np.random.default_rng(8)
    series = series_of(rng.normal(0, 1, 24)[unit] + rng.normal(0, 0.1, 72), unit, station=unit % 2)
    series = replace(series, groups=series.groups | {"product": [f"P{each % 2}" for each in unit]})
    trend = trend_of(series)
    assert set(trend.components) == {"unit", "residual"}
    text = "\n".join(each.en for each in sentences(trend))
    assert "from station to station: not separable from products or other groups" in text
    json.dumps(document(trend), allow_nan=False)


def test_more_levels_than_are_compared_are_named_by_their_number() -> None:
    unit = np.repeat(np.arange(250), 2)
    value = np.random.default_rng(3).standard_normal(500)
    found = compare_groups(series_of(value, unit, lot=unit))
    assert isinstance(found, GroupComparison)
    assert [each.en for each in found.left_out] == ["lot: 250 levels, at most 200 are compared"]


def test_a_group_of_many_levels_is_in_no_other_component() -> None:
    """61 fixtures that differ by ten times the scatter of measurements, crossed with the units."""
    rng = np.random.default_rng(5)
    unit, fixture = np.repeat(np.arange(60), 6), rng.integers(0, 61, 360)
    value = rng.normal(0, 1, 60)[unit] + rng.normal(0, 0.2, 61)[fixture] + rng.normal(0, 0.02, 360)
    found = components(series_of(value, unit, fixture=fixture), ("station", "fixture", "lot"))
    assert set(found) == {"unit", "residual"}
    assert found["residual"].lo < 0.02 < found["residual"].hi < 0.03


@pytest.mark.parametrize("noise", [0.0, 1e-9, 1e-5, 1e-3])
def test_components_beside_large_offsets_are_right_or_none(noise: float) -> None:
    rng = np.random.default_rng(1)
    unit, station = np.repeat(np.arange(30), 3), np.tile([0, 1, 2], 30)
    value = rng.normal(0, 0.1, 30)[unit] + np.array([0, 0.1, 0.25])[station] + noise * rng.normal(size=90)
    found = components(series_of(value, unit, station=station, lot=unit % 4), ("station", "fixture", "lot"))
    if noise < 1e-3:
        assert found == {}
        return
    assert found["residual"].lo < noise < found["residual"].hi
    assert found["station"].lo < np.std([0, 0.1, 0.25], ddof=1) < found["station"].hi


@pytest.mark.parametrize("seed", range(6))
def test_values_of_a_coarse_grid_with_an_exact_offset_end_no_report(seed: int) -> None:
    rng = np.random.default_rng([4, seed])
    unit, station = np.repeat(np.arange(20), 2), np.tile([0, 1], 20)
    value = np.round(5 + rng.normal(0, 0.3, 20), 1)[unit] + 0.1 * station
    assert sentences(trend_of(series_of(value, unit, station=station), by="station"))
