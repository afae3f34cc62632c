"""Trends of several products: their limits, charts and capabilities, and the groups that are compared within them."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analytics.plots.trend_plot import plot_trend
from analytics.specifications.entering import add_specification
from analytics.trends.charts.capability import Capability, SpecifiedLimits, specified_limits
from analytics.trends.document import document
from analytics.trends.groups.between_stations import GroupComparison
from analytics.trends.report import sentences
from analytics.trends.series import Choice, read_series
from analytics.trends.trend import trend_of
from storage.store import Store
from tests.analytics.trends.reported_values import Reported, english, one_each


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
