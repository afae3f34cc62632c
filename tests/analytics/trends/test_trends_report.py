"""From values in a store to charts, sentences and pictures."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom
from scipy.stats import t as student

from analytics.plots.trend_plot import plot_trend
from analytics.specifications.entering import add_specification
from analytics.trends.charts.capability import Capability, SpecifiedLimits, specified_limits
from analytics.trends.charts.control_chart import IndividualsChart
from analytics.trends.document import document
from analytics.trends.report import sentences, stands_out
from analytics.trends.series import Choice, MetricSeries, Variant, read_series
from analytics.trends.trend import trend_of
from analytics.trends.words import NotComputed
from storage.store import Store
from stream.errors import BadInput
from stream.terminal.console import json_text
from tests.analytics.trends.reported_values import HOUR_NS, START_NS, Reported, english, one_each


# the interval of 75 pairs alone is 4 * 0.02 sqrt(2 / 75) = 0.013 wide
@pytest.mark.parametrize("units", [150, pytest.param(300, marks=pytest.mark.long)])
def test_a_station_with_an_offset_is_named_and_sized(reported: Reported, units: int) -> None:
    rng = np.random.default_rng(20260741)
    own = rng.normal(0, 0.1, units)
    rows = [
        {"unit": f"U{unit:03}", "station": "AB"[station], "lot": f"L{unit % 6 // 2}",
         "value": 5 + own[unit] + 0.05 * station + rng.normal(0, 0.02)}
        for unit, station in [(u, u % 2) for u in range(units)] + [(u, 1 - u % 2) for u in range(units // 2)]
    ]  # fmt: skip
    trend = trend_of(read_series(reported(rows), "bias"))
    said = english(trend)
    assert "Station B gives values 0.0" in said
    assert "higher than station A" in said
    assert f"the {units // 2} units measured on both show 0.0" in said
    assert "it is the station, not its units" in said
    assert "Lot " not in said
    (station,) = (each for each in document(trend)["differences"] if each["group"] == "station")
    assert station["lo"] < 0.05 < station["hi"]
    assert station["hi"] - station["lo"] < 0.02
    chinese = "\n".join(each.zh for each in sentences(trend))
    assert "试验台 B 的值比试验台 A 高" in chinese
    assert "差异来自试验台" in chinese


@pytest.mark.parametrize("hours", [0, 1])
def test_values_of_one_time_have_no_order(reported: Reported, hours: int) -> None:
    rows = one_each(np.random.default_rng(5).normal(0, 1, 20))
    for at, row in enumerate(rows):
        row["hour"] = at * hours
    said = english(trend_of(read_series(reported(rows), "bias")))
    assert ("20 of 20 values have the time of another one: their order has no meaning" in said) == (hours == 0)


@pytest.mark.long
def test_lot_and_station_together_are_said_to_be_inseparable(reported: Reported) -> None:
    rng = np.random.default_rng(20260742)
    rows = [
        {"unit": f"U{at:03}", "station": "AB"[at % 2], "lot": "KL"[at % 2], "value": rng.normal(0.5 * (at % 2), 0.1)}
        for at in range(80)
    ]
    said = english(trend_of(read_series(reported(rows), "bias")))
    assert "cannot be distinguished from lot" in said
    assert said.count("cannot be distinguished") == 1


@pytest.mark.long
def test_a_change_is_dated_and_the_process_has_no_capability(reported: Reported) -> None:
    values = np.random.default_rng(20260743).normal(0, 1, 100)
    values[60:] += 3
    trend = trend_of(read_series(reported(one_each(values)), "bias"), specification=SpecifiedLimits(-8, 8, "fog-A"))
    said = english(trend)
    assert "The level changes by" in said
    assert "2026-01-03 12:00" in said
    assert "no capability: the process is not in control (its level changes" in said.replace("No cap", "no cap")
    assert isinstance(trend.capabilities[0], NotComputed)


@pytest.mark.long
def test_of_several_stations_the_one_out_of_control_says_why_it_has_no_capability(reported: Reported) -> None:
    rng = np.random.default_rng(20260751)
    rows = [
        {"unit": f"U{at:03}{station}", "hour": at, "station": station,
         "value": rng.normal(0, 1) + (4 if station == "B" and at >= 30 else 0)}
        for at in range(60) for station in "AB"
    ]  # fmt: skip
    trend = trend_of(read_series(reported(rows), "bias"), by="station", specification=SpecifiedLimits(-8, 8, "fog-A"))
    said = english(trend)
    assert "Station A: Cp " in said
    assert "Station B: no capability: the process is not in control (its level changes" in said
    chinese = "\n".join(each.zh for each in sentences(trend))
    assert "试验台 B：无过程能力指数" in chinese
    assert " to " not in chinese


@pytest.mark.long
def test_a_unit_that_drifts_is_named_among_others(reported: Reported) -> None:
    rng = np.random.default_rng(20260744)
    rows = [
        {"unit": f"U{unit:02}", "hour": 24 * day + unit, "station": "A",
         "value": rng.normal(unit, 0.1) + (0.02 * day if unit == 7 else 0)}
        for day in range(40) for unit in range(12)
    ]  # fmt: skip
    trend = trend_of(read_series(reported(rows), "bias"), by="unit")
    said = english(trend)
    assert "Unit U07: it drifts by 0.0" in said
    assert "per day" in said
    assert [chart.name for chart in trend.charts if chart.in_control is False] == ["U07"]
    assert "of one unit" not in said  # capability is of a process; of many charts it is passed over


def test_a_wild_point_stands_with_its_chance_and_a_deviation_has_no_limit_below_zero(reported: Reported) -> None:
    values = np.abs(np.random.default_rng(20260747).normal(0.05, 0.02, 40))
    values[20] = 0.6
    catalog = reported(one_each(values, metric="bias_stability"))
    trend = trend_of(read_series(catalog, "bias_stability", Choice()))
    rest = np.delete(values, 20)
    t = (values[20] - rest.mean()) / (rest.std(ddof=1) * np.sqrt(40 / 39))  # Grubbs by the studentized deleted residual
    assert f"with a probability of {min(1.0, 80 * student.sf(t, 38)):.2g} at most (Grubbs)" in english(trend)
    (chart,) = trend.charts
    assert not isinstance(chart.limits, NotComputed)
    assert chart.limits.centre < 3 * chart.limits.sigma
    assert chart.limits.lower == 0.0


@pytest.mark.long
@pytest.mark.parametrize("trials", [30, pytest.param(100, marks=pytest.mark.long)])
def test_nothing_stands_out_in_noise(trials: int) -> None:
    """Of trends of noise alone at most 5 in a hundred say anything."""
    rng = np.random.default_rng(20260745)
    loud = 0
    for _ in range(trials):
        n = 60
        units = np.r_[np.arange(40), np.arange(20)]
        value = rng.normal(0, 0.1, 40)[units] + rng.normal(0, 0.03, n)
        series = MetricSeries(
            metric="bias", unit_of_measure="deg/h", value=value, uncertainty=np.full(n, 0.03),
            t_ns=START_NS + np.arange(n) * HOUR_NS, unit=[f"U{each:02}" for each in units], run=["r"] * n,
            groups={name: [f"{name}{each}" for each in rng.integers(0, 2, n)] for name in ("station", "fixture")}
            | {"lot": [f"L{each % 4}" for each in units], "product": ["P"] * n, "signal": ["rate"] * n},
            variant=Variant("JJF2014", ()), others=(), without_value=0, dated=True,
        )  # fmt: skip
        loud += stands_out(trend_of(series))
    assert loud <= binom.isf(0.001, trials, 0.05)


@pytest.mark.long
def test_nothing_is_said_so_and_capability_follows(reported: Reported, store: Store, tmp_path: Path) -> None:
    values = np.random.default_rng(20260746).normal(0.2, 0.1, 120)
    series = read_series(reported(one_each(values, product="FOG-70", lot="L1")), "bias")
    path = tmp_path / "fog.toml"
    path.write_text(
        'revision = "A"\n[[limit]]\nmetric = "bias"\nupper = 1e-4\nlower = -1e-4\nunit_of_measure = "deg/s"\n'
    )
    add_specification(store, path)
    limits = specified_limits(store, series)
    assert limits.source == "fog-A"
    assert [limits.lower, limits.upper] == pytest.approx([-0.36, 0.36])
    trend = trend_of(series, specification=limits)
    said = english(trend)
    assert "Nothing stands out" in said
    assert "Cpk" in said
    assert "fog-A" in said
    (found,) = trend.capabilities
    assert isinstance(found, Capability)
    assert found.cpk.value == pytest.approx((0.36 - values.mean()) / 3 / values.std(ddof=1))


def test_a_point_beyond_three_sigma_is_counted_where_nothing_stands_out(reported: Reported) -> None:
    values = np.random.default_rng(0).normal(size=400)
    trend = trend_of(read_series(reported([{"unit": f"U{i:03}", "value": x} for i, x in enumerate(values)]), "bias"))
    (chart,) = trend.charts
    assert isinstance(chart.limits, IndividualsChart)
    n = int((np.abs(values - chart.limits.centre) > 3 * chart.limits.sigma).sum())
    assert n > 0
    assert chart.in_control
    assert f"({n} point" in sentences(trend)[1].en


def test_few_values_without_a_date(reported: Reported) -> None:
    trend = trend_of(read_series(reported(one_each(np.arange(4.0), dated=False)), "bias"))
    said = english(trend)
    assert "too little to judge" in said
    assert "4 points, a chart's limits need 8" in said
    assert "dates of some runs are not known" in said
    assert not stands_out(trend)


def test_the_document_is_json_and_complete(reported: Reported) -> None:
    values = np.random.default_rng(20260747).normal(0, 1, 50)
    values[30] = 30.0
    found = json.loads(json_text(document(trend_of(read_series(reported(one_each(values)), "bias")))))
    (chart,) = found["charts"]
    assert len(chart["points"]) == 50
    assert chart["points"][30]["rules"][0] == 1
    assert chart["points"][30]["unit"] == "U030"
    assert chart["wild_point"] == 30
    assert chart["in_control"] is False
    assert chart["points"][0]["standard_uncertainty"] == 0.01
    assert not any(math.isnan(point["ewma"]) for point in chart["points"])
    assert found["stands_out"] is True
    assert any("U030" in each["en"] for each in found["report"])
    assert found["names"] == {"en": "Bias", "zh": "零偏"}


@pytest.mark.long
@pytest.mark.parametrize("suffix", [".png", ".svg"])
@pytest.mark.parametrize("by", [None, "station", "unit"])
def test_pictures(reported: Reported, tmp_path: Path, by: str | None, suffix: str) -> None:
    values = np.random.default_rng(20260748).normal(0, 1, 40)
    values[25:] += 4
    rows = one_each(values)
    for at, row in enumerate(rows):
        row |= {"unit": f"U{at % 10}", "station": f"S{at % 2}"}
    trend = trend_of(read_series(reported(rows), "bias"), by=by, specification=SpecifiedLimits(-5, 9, "fog-A"))
    path = tmp_path / f"trend{suffix}"
    plot_trend(trend, path)
    first = path.read_bytes()
    assert len(first) > 10_000
    plot_trend(trend, path)
    assert path.read_bytes() == first


def test_a_picture_has_its_suffix(reported: Reported, tmp_path: Path) -> None:
    trend = trend_of(read_series(reported(one_each(np.arange(9.0))), "bias"))
    with pytest.raises(BadInput, match=r"\.png or \.svg"):
        plot_trend(trend, tmp_path / "trend.pdf")
