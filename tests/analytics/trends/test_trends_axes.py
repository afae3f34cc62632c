"""Trends of units with several axes, of few units on two stations, against limits of their time."""

from dataclasses import replace

import numpy as np
import pytest

from analytics.plots.picture import Label
from analytics.serve.api.trend.trend_pictures import chart_picture
from analytics.trends.charts.capability import Capability, LimitStretch, SpecifiedLimits, cpk_index
from analytics.trends.document import document
from analytics.trends.report import sentences
from analytics.trends.series import MetricSeries
from analytics.trends.trend import Trend, trend_of
from analytics.trends.words import NotComputed
from tests.analytics.trends.test_trends_groups import compared, series_of

LIMITS = SpecifiedLimits(lower=0.0, upper=10.0, source="P-A", rule="interval")


def of_axes(units: int, seed: int) -> MetricSeries:
    """One value of each of three axes of units, whose axes share what is their unit's."""
    rng = np.random.default_rng(seed)
    number = np.tile(np.arange(units), 3)
    plain = series_of(5.0 + rng.normal(0, 1.0, units)[number] + rng.normal(0, 0.1, 3 * units), number)
    axes = [f"{unit} rate_{'xyz'[at // units]}" for at, unit in enumerate(plain.unit)]
    return replace(plain, unit=axes, groups=plain.groups | {"serial": plain.unit})


def english(trend: Trend) -> str:
    return " ".join(each.en for each in sentences(trend))


def test_axes_of_a_unit_are_no_units() -> None:
    few = trend_of(of_axes(8, 1), specification=LIMITS)
    (refused,) = few.capabilities
    assert isinstance(refused, NotComputed)
    assert refused.why.en == "8 units, capability is given from 20 on"
    assert "24 values of 8 units" in english(few)
    assert document(few)["units"] == 8
    enough = trend_of(of_axes(24, 2), specification=LIMITS)
    (found,) = enough.capabilities
    assert isinstance(found, Capability)
    assert (found.n, found.units) == (72, 24)
    assert "of 72 values of 24 units, with bounds as of 24 values" in english(enough)
    assert found.cpk == cpk_index(found.cpk.value, 24)


@pytest.mark.parametrize(
    ("common", "counted"),
    [
        pytest.param(1, "only 1 unit there was", marks=pytest.mark.long),
        (2, "only 2 units there were"),
        (4, "4 units measured on both"),
    ],
)
def test_units_on_both_stations_are_counted_by_unit(common: int, counted: str) -> None:
    rng = np.random.default_rng([3, common])
    number = np.r_[np.repeat(np.arange(10), 6), np.repeat(np.arange(common), 6)]
    station = np.r_[np.zeros(60, int), np.ones(6 * common, int)]
    value = 5.0 + rng.normal(0, 0.02, number.size) + rng.normal(0, 0.05, 10)[number] + 0.3 * station
    assert counted in english(trend_of(series_of(value, number, station=station), by="station"))


def test_three_axes_of_one_unit_are_no_three_units_on_both() -> None:
    rng = np.random.default_rng(4)
    axis, station = np.tile(np.arange(3), 8), np.repeat([0, 1], 12)
    plain = series_of(5.0 + axis + 0.3 * station + rng.normal(0, 0.02, 24), axis, station=station)
    one = replace(plain, groups=plain.groups | {"serial": ["U0"] * 24})
    assert compared(one).pairs == ()
    assert len(compared(plain).pairs) == 1


def test_a_chart_is_not_out_of_control_for_a_change_that_it_does_not_show() -> None:
    """All units are measured on the first day; their station changes later."""
    rng = np.random.default_rng(5)
    number, day = np.tile(np.arange(12), 20), np.repeat(np.arange(20), 12)
    value = 5.0 + rng.normal(0, 0.3, 12)[number] + rng.normal(0, 0.02, 240) + 0.1 * (day >= 10)
    moments = 1_763_683_200 * 10**9 + day * 86_400 * 10**9 + number * 10**9
    series = replace(series_of(value, number), t_ns=moments, run=[f"r{each}" for each in day])
    whole, of_station = trend_of(series), trend_of(series, by="station")
    assert "The level of station S0 changes by 0.1" in english(whole)
    assert (whole.charts[0].in_control, of_station.charts[0].in_control) == (True, False)


def test_an_adjusted_chart_draws_what_it_charts_and_no_limits() -> None:
    rng = np.random.default_rng(6)
    number = np.tile(np.arange(12), 4)
    value = 5.0 + 2.0 * rng.normal(0, 1.0, 12)[number] + rng.normal(0, 0.02, 48)
    stretches = (LimitStretch(0.0, 10.0, "P-A", 0, 2**62),)
    found = document(
        trend_of(series_of(value, number), by="station", specification=LIMITS._replace(stretches=stretches))
    )
    (chart,) = found["charts"]
    assert chart["is_adjusted"]
    for point in chart["points"]:
        point["serial"] = point["unit"]
    picture = chart_picture(chart, found, Label.same("bias"))
    drawn = np.array(picture.curves[0].y, np.float64)
    assert np.all((drawn > chart["limits"]["lower"]) & (drawn < chart["limits"]["upper"]))
    assert not [curve for curve in picture.curves if curve.style == "limit"]
    assert picture.note is not None


def test_limits_are_drawn_while_they_are_valid() -> None:
    series = series_of(5.0 + np.random.default_rng(7).normal(0, 0.1, 40), np.arange(40))
    change = int(series.t_ns[20])
    stretches = (LimitStretch(0.0, 10.0, "P-A", 0, change), LimitStretch(None, 8.0, "P-B", change, 2**62))
    found = document(trend_of(series, specification=LIMITS._replace(stretches=stretches)))
    (chart,) = found["charts"]
    for point in chart["points"]:
        point["serial"] = point["unit"]
    limits = {
        curve.name.en: (list(curve.x), list(curve.y))
        for curve in chart_picture(chart, found, Label.same("bias")).curves
        if curve.style == "limit"
    }
    t_s = (series.t_ns / 1e9).tolist()
    assert limits == {
        "lower limit P-A": ([t_s[0], t_s[19]], [0.0, 0.0]), "upper limit P-A": ([t_s[0], t_s[19]], [10.0, 10.0]),
        "upper limit P-B": ([t_s[20], t_s[39]], [8.0, 8.0]),
    }  # fmt: skip
