"""Which values of a store a trend is of: their order, their kinds, and the choices among them."""

import numpy as np
import pytest

from analytics.trends.report import sentences
from analytics.trends.series import Choice, every_series, read_series
from analytics.trends.trend import trend_of
from stream.errors import BadInput, NotFound
from tests.analytics.trends.reported_values import HOUR_NS, START_NS, Reported


def test_values_come_in_order_of_time_with_their_groups(reported: Reported) -> None:
    rows = [
        {"unit": "U2", "value": 2.0, "hour": 5, "station": "B", "lot": "L1"},
        {"unit": "U1", "value": 1.0, "hour": 3, "station": "A", "lot": "L1", "fixture": "F9"},
        {"unit": "U1", "value": 1.5, "hour": 9, "station": "B"},
        {"unit": "U3", "reason": "the record is 600 s long", "hour": 1},
    ]
    series = read_series(reported(rows), "bias")
    assert list(series.value) == [1.0, 2.0, 1.5]
    assert series.groups["station"] == ["A", "B", "B"]
    assert series.groups["fixture"] == ["F9", "(not given)", "(not given)"]
    assert list(series.t_ns) == [START_NS + hour * HOUR_NS for hour in (3, 5, 9)]
    assert series.without_value == 1
    assert series.first_of_units().unit == ["U1", "U2"]
    assert {name: series.where(at).unit for name, at in series.places("station").items()} == {
        "A": ["U1"],
        "B": ["U2", "U1"],
    }


@pytest.mark.parametrize(("dated", "left_out"), [(12, 2), (2, 0)])
def test_a_few_values_without_a_date_are_left_out_and_named(reported: Reported, dated: int, left_out: int) -> None:
    rows = [{"unit": f"U{at}", "run": f"r{at:02}", "value": at / 7, "dated": at < dated} for at in range(14)]
    catalog = reported(rows)
    series = read_series(catalog, "bias")
    assert (series.value.size, series.undated, series.dated) == (14 - left_out, left_out, left_out > 0)
    assert series.undated_runs == (("r12", "r13") if left_out else ())
    said = " ".join(str(each) for each in sentences(trend_of(series)))
    assert ("Values of runs without a date are left out: 2, of r12, r13." in said) == (left_out > 0)
    assert ("The dates of some runs are not known" in said) == (left_out == 0)


def test_charts_that_are_too_short_take_nothing_from_the_others(reported: Reported) -> None:
    noise = np.random.default_rng(3).normal(0, 0.02, 10)
    rows = [
        {"unit": "U-drifts", "run": f"d{at}", "value": 0.8 + 0.1 * at + noise[at], "hour": 24 * at} for at in range(10)
    ]
    alone = trend_of(read_series(reported(rows), "bias"), by="unit").charts[0]
    others = [
        {"unit": f"U{unit}", "run": f"o{unit}-{again}", "value": 1.0 + unit / 50, "hour": 24 * again + unit / 9}
        for unit in range(60) for again in (0, 5)
    ]  # fmt: skip
    beside = trend_of(read_series(reported([*rows, *others]), "bias"), by="unit")
    (found,) = [chart for chart in beside.charts if chart.name == "U-drifts"]
    assert (alone.in_control, found.in_control) == (False, False)
    assert (found.drifts, found.too_many) == (alone.drifts, alone.too_many)
    assert len(beside.charts) == 61


def test_kinds_of_values_are_told_apart(reported: Reported) -> None:
    rows = [
        {"unit": f"U{at}", "run": f"r{at}", "value": at + average / 1000, "metric": "bias_stability_averaged",
         "parameters": {"average_s": average, "duration_s": 3600 + at, "n_effective": 7.1 * at, "repeat": at}}
        for at in range(5) for average in (1.0, 10.0, 100.0)
    ]  # fmt: skip
    catalog = reported(rows[:-1])
    series = read_series(catalog, "bias_stability_averaged")
    # of two kinds with as many values the first; the third lacks one
    assert dict(series.variant.parameters) == {"average_s": "1"}
    assert series.value.size == 5
    assert [dict(each.parameters)["average_s"] for each in series.others] == ["10", "100"]
    chosen = read_series(catalog, "bias_stability_averaged", Choice(parameters={"average_s": "100"}))
    assert list(chosen.value) == pytest.approx([0.1, 1.1, 2.1, 3.1])
    with pytest.raises(NotFound, match="average_s=100"):
        read_series(catalog, "bias_stability_averaged", Choice(parameters={"average_s": "7"}))


def test_temperatures_are_kinds_but_their_scatter_is_not(reported: Reported) -> None:
    rng = np.random.default_rng(5)
    rows = [
        {"unit": f"U{at}", "run": f"r{at}", "step": step, "value": 1.0, "metric": "scale_factor",
         "parameters": {"temperature": round(command + rng.normal(0, 0.3), 2), "room": command == 25}}
        for at in range(20) for step, command in enumerate((-40, 25, 60), 1)
    ]  # fmt: skip
    series = read_series(reported(rows), "scale_factor")
    assert dict(series.variant.parameters) == {"room": "True", "temperature": "25"}
    assert len(series.others) == 2
    assert series.value.size == 20


def test_values_of_another_unit_of_measure_are_a_series_of_their_own_and_named(reported: Reported) -> None:
    measures = ["V/(deg/s)"] * 9 + ["1"] * 4
    rows = [{"unit": f"U{at}", "value": 1.0 + at % 3, "measure": measure} for at, measure in enumerate(measures)]
    catalog = reported([*rows, {"unit": "N", "value": None, "reason": "why"}])
    shown, other = every_series(catalog, "bias")
    assert (shown.unit_of_measure, shown.value.size, shown.without_value) == ("V/(deg/s)", 9, 1)
    assert (other.unit_of_measure, other.value.size) == ("1", 4)
    (said,) = [each for each in sentences(trend_of(shown)) if "left out" in each.en]
    assert said.en.startswith("Values in 1 are left out, 4 of them")
    assert said.zh.startswith("单位为 1 的 4 个值未计入")


def test_choices(reported: Reported) -> None:
    rows = [
        {"unit": f"U{at % 4}", "value": float(at), "station": "AB"[at % 2], "lot": f"L{at // 6}", "signal": "rate_x"}
        for at in range(12)
    ]
    catalog = reported(rows)
    assert list(read_series(catalog, "bias", Choice(units=("U1", "U3"))).value) == [1, 3, 5, 7, 9, 11]
    assert list(read_series(catalog, "bias", Choice(station="A", lot="L1")).value) == [6, 8, 10]
    assert list(read_series(catalog, "bias", Choice(since_ns=START_NS + 10 * HOUR_NS)).value) == [10, 11]
    for choice, word in ((Choice(signal="rate_z"), "rate_z"), (Choice(standard="GJB2426A"), "GJB2426A")):
        with pytest.raises(NotFound, match=word):
            read_series(catalog, "bias", choice)


def test_what_is_not_there_is_said(reported: Reported) -> None:
    catalog = reported([{"unit": "U1", "reason": "the record is 600 s long"}])
    with pytest.raises(BadInput, match="did you mean bias"):
        read_series(catalog, "biass")
    with pytest.raises(NotFound, match="no unit of this store"):
        read_series(catalog, "polarity")
    with pytest.raises(NotFound, match="600 s long"):
        read_series(catalog, "bias")
