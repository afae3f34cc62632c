"""Sentences on a control chart: what is significant on it, and its points beyond 3 sigma."""

from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from typing import Any

from analytics.trends.charts.control_chart import IndividualsChart
from analytics.trends.charts.nelson_rules import RULES, wild_point_chance
from analytics.trends.levels.change_points import Changes
from analytics.trends.levels.drift import Drift
from analytics.trends.series import NS_PER_DAY, MetricSeries
from analytics.trends.trend import Chart
from analytics.trends.words import NotComputed, Words, behind, figures, interval, listed, words

_BRIEF_DAYS = 10
_MOST_NAMED = 8


def moment(series: MetricSeries, index: int) -> str:
    """When a point was measured (UTC); its number where dates are unknown.

    >>> import numpy as np
    >>> from analytics.trends.series import Variant
    >>> one = MetricSeries("bias", "deg/h", np.zeros(1), np.zeros(1), np.array([1_763_683_200 * 10**9]), ["U"], ["r"],
    ...                    {}, Variant("", ()), (), 0, True)
    >>> moment(one, 0)
    '2025-11-21 00:00'
    """
    if not series.dated:
        return f"#{index + 1}"
    is_brief = int(series.t_ns[-1] - series.t_ns[0]) < _BRIEF_DAYS * NS_PER_DAY
    at = datetime.fromtimestamp(int(series.t_ns[index]) // 10**9, UTC)
    return at.strftime("%Y-%m-%d %H:%M" if is_brief else "%Y-%m-%d")


def state_of(chart: Chart) -> Words:
    """Whether a chart is in control; where points of one that nothing is significant on are outside, how many."""
    if chart.in_control is None:
        return words("state_few")
    if not chart.in_control:
        return words("state_out")
    outside = len(chart.signals.get(1, []))
    return words("state_outside", n=outside, s="s" * (outside > 1)) if outside else words("state_in")


def of_chart(chart: Chart) -> Iterator[Words]:
    """Sentences on what is significant on a chart."""
    series, unit = chart.series, chart.series.unit_of_measure
    if isinstance(chart.changes, Changes) and not (chart.is_adjusted and chart.shifts):
        for change in chart.changes.points:
            yield words(
                "change" if change.is_certain else "change_possible",
                size=interval(change.size, change.lo, change.hi, unit),
                before=moment(series, change.first - 1), after=moment(series, change.last),
                here=f"{series.unit[change.at]}, {moment(series, change.at)}",
            )  # fmt: skip
    if chart.drifts:
        yield words("drift", **drift_parts(chart))
    if isinstance(chart.limits, NotComputed):
        return
    if chart.wild_point is not None:
        yield _outlier(chart, chart.limits, chart.wild_point)
        yield from _beyond(chart)
    if chart.too_many is not None and not _moves(chart):
        yield words(
            "rule_met", rule=chart.too_many, text=RULES[chart.too_many - 1], count=chart.counts[chart.too_many - 1],
            first=moment(series, chart.signals[chart.too_many][0]),
            expected=0.0 if chart.chance is None else chart.chance.expected[chart.too_many - 1],
        )  # fmt: skip
        if chart.too_many == 1 and chart.wild_point is None:
            yield from _beyond(chart)


def drift_parts(chart: Chart) -> dict[str, Words]:
    """The slope of a chart and what it is per."""
    assert isinstance(chart.drift, Drift)
    return {
        "size": interval(chart.drift.slope, chart.drift.lo, chart.drift.hi, chart.series.unit_of_measure),
        "per": words("per_day" if chart.series.dated else "per_point"),
    }


def _outlier(chart: Chart, limits: IndividualsChart, point: int) -> Words:
    series = chart.series
    return words(
        "outlier", where=f"{series.unit[point]}, {moment(series, point)}",
        value=figures(float(chart.charted[point]), limits.sigma), unit=behind(series.unit_of_measure),
        z=float(chart.z[point]),
        centre=figures(limits.centre, limits.sigma), n=chart.charted.size, chance=wild_point_chance(chart.charted),
    )  # fmt: skip


def unremarkable(charts: Iterable[Chart]) -> Iterator[Words]:
    """The points beyond 3 sigma of charts on which neither they nor a moving level are reported."""
    points = [
        (chart, at)
        for chart in charts
        if not (_moves(chart) or chart.wild_point is not None or chart.too_many == 1)
        for at in chart.signals.get(1, [])
    ]
    yield from _named("beyond_by_chance", points)


def beyond(chart: Chart) -> list[dict[str, Any]]:
    """The points of a chart beyond 3 sigma, the farthest first."""
    series = chart.series
    return [
        {
            "unit": series.unit[at], "run": series.run[at], "time": moment(series, at),
            "value": float(chart.charted[at]), "sigmas": float(chart.z[at]),
        }
        for at in sorted(chart.signals.get(1, []), key=lambda at: -abs(chart.z[at]))
    ]  # fmt: skip


def _moves(chart: Chart) -> bool:
    """Whether its level moves, so that it meets the rules by itself."""
    return bool(chart.has_changed or chart.drifts or chart.shifts or chart.is_unsteady)


def _beyond(chart: Chart) -> Iterator[Words]:
    """The points beyond 3 sigma, without the one that is named already."""
    points = [(chart, each) for each in chart.signals.get(1, []) if each != chart.wild_point]
    yield from _named("beyond" if chart.wild_point is None else "beyond_too", points)


def _named(sentence: str, points: list[tuple[Chart, int]]) -> Iterator[Words]:
    """Points with unit, run, time and value, the farthest first."""
    named = []
    for chart, at in sorted(points, key=lambda point: -abs(point[0].z[point[1]])):
        series = chart.series
        assert isinstance(chart.limits, IndividualsChart)
        where = dict.fromkeys([chart.name, series.unit[at], series.run[at], moment(series, at)])
        value = f"{figures(float(chart.charted[at]), chart.limits.sigma)}{behind(series.unit_of_measure)}"
        named.append(words("point", where=", ".join(filter(None, where)), value=value, z=float(chart.z[at])))
    if named:
        en, zh = (listed(list(each), _MOST_NAMED, apart=Words("; ", "；")) for each in zip(*named, strict=True))
        yield words(sentence, points=Words(en.en, zh.zh))
