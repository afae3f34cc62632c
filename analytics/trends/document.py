"""A trend as JSON."""

from typing import Any

from analytics.metric_registry.registry import metrics
from analytics.trends.between_stations import Comparison
from analytics.trends.capability import Capability
from analytics.trends.change_points import Changes
from analytics.trends.control_chart import IndividualsChart
from analytics.trends.drift import Drift
from analytics.trends.level_shifts import LevelShift, LevelShifts
from analytics.trends.nelson_rules import RULES
from analytics.trends.report import sentences, stands_out
from analytics.trends.series import Series, Variant
from analytics.trends.shift_sentences import moment
from analytics.trends.trend import Chart, Trend
from analytics.trends.words import Refused, Words


def document(trend: Trend) -> dict[str, Any]:
    """All that is known of a trend; what could not be had says why, in `reason`."""
    series = trend.series
    header = metrics()[series.metric].header if series.metric in metrics() else None
    return {
        "metric": series.metric,
        "names": None if header is None else {"en": header.en, "zh": header.zh},
        "unit_of_measure": series.unit_of_measure,
        "kind": _kind(series.variant),
        "other_kinds": [_kind(each) for each in series.others],
        "values": series.value.size,
        "units": len(set(series.unit)),
        "without_value": series.without_value,
        "dated": series.dated,
        "by": trend.by,
        "charts": [
            _chart(chart) | {"capability": _capability(found)}
            for chart, found in zip(trend.charts, trend.capabilities, strict=True)
        ],
        "specification": {
            "lower": trend.specification.lower,
            "upper": trend.specification.upper,
            "source": trend.specification.source or None,
        },
        **_shifts(trend.shifts, series),
        **_comparison(trend.comparison),
        "components": {name: each._asdict() for name, each in trend.components.items()},
        "stands_out": stands_out(trend),
        "report": [_words(each) for each in sentences(trend)],
    }


def _words(words: Words) -> dict[str, str]:
    return words._asdict()


def _reason(refused: Refused) -> dict[str, dict[str, str]]:
    return {"reason": _words(refused.why)}


def _kind(variant: Variant) -> dict[str, Any]:
    return {"standard": variant.standard, "parameters": dict(variant.parameters)}


def _chart(chart: Chart) -> dict[str, Any]:
    return {
        "name": chart.name,
        "in_control": chart.in_control,
        "limits": chart.limits._asdict() if isinstance(chart.limits, IndividualsChart) else _reason(chart.limits),
        "points": _points(chart),
        "signals": _signals(chart),
        "chance": None if chart.chance is None else chart.chance._asdict(),
        "wild_point": chart.wild_point,
        "rule_met_too_often": chart.too_many,
        "changes": _changes(chart),
        "drift": chart.drift._asdict() | {"per": "day" if chart.series.dated else "point"}
        if isinstance(chart.drift, Drift)
        else _reason(chart.drift),
        "drifts": chart.drifts,
        "is_adjusted": chart.is_adjusted,
    }


def _points(chart: Chart) -> list[dict[str, Any]]:
    series = chart.series
    rules: list[list[int]] = [[] for _ in range(series.value.size)]
    for rule, points in chart.signals.items():
        for point in points:
            rules[point].append(rule)
    averages = chart.averages
    outside = set() if averages is None else set(averages.outside)
    return [
        {
            "time": moment(series, at) if series.dated else None,
            "t_ns": int(series.t_ns[at]) if series.dated else None,
            "unit": series.unit[at],
            "run": series.run[at],
            **{name: levels[at] for name, levels in series.groups.items()},
            "value": float(series.value[at]),
            "charted": float(chart.charted[at]),
            "standard_uncertainty": float(series.uncertainty[at]),
            "rules": rules[at],
            "ewma": None if averages is None else float(averages.averages[at]),
            "ewma_outside": at in outside,
        }
        for at in range(series.value.size)
    ]


def _signals(chart: Chart) -> list[dict[str, Any]]:
    return [
        {
            "rule": rule,
            **_words(RULES[rule - 1]),
            "count": chart.counts[rule - 1],
            "expected_by_chance": None if chart.chance is None else chart.chance.expected[rule - 1],
            "points": points,
        }
        for rule, points in chart.signals.items()
    ]


def _changes(chart: Chart) -> dict[str, Any]:
    if not isinstance(chart.changes, Changes):
        return _reason(chart.changes)
    series = chart.series
    return {
        "points": [
            each._asdict()
            | {"time": moment(series, each.at), "from": moment(series, each.first - 1), "to": moment(series, each.last)}
            for each in chart.changes.points
        ],
        "levels": list(chart.changes.levels),
        "false_alarm": chart.changes.false_alarm,
    }


def _shifts(found: LevelShifts | Refused, series: Series) -> dict[str, Any]:
    """Changes of stations; their numbers are those of all values in order of time."""
    if isinstance(found, Refused):
        return {"shifts": [], "unsteady": None, "shifts_not_searched": _words(found.why)}
    unsteady = found.unsteady
    told = None
    if unsteady is not None:
        largest = unsteady.largest
        told = unsteady._asdict() | {"largest": None if largest is None else _shift(largest, series)}
    return {"shifts": [_shift(each, series) for each in found.shifts], "unsteady": told, "shifts_not_searched": None}


def _shift(shift: LevelShift, series: Series) -> dict[str, Any]:
    times = {name: moment(series, at) for name, at in (("time", shift.at), ("from", shift.first), ("to", shift.last))}
    return shift._asdict() | times | {"station": shift.station or None, "is_plain": shift.is_plain}


def _capability(found: Capability | Refused) -> dict[str, Any]:
    if isinstance(found, Refused):
        return _reason(found)
    told = found._asdict()
    indices = {name: None if told[name] is None else told[name]._asdict() for name in ("cp", "cpk")}
    return told | indices | {"is_normal": found.is_normal}


def _comparison(found: Comparison | Refused) -> dict[str, Any]:
    if isinstance(found, Refused):
        return {"differences": [], "pairs": [], "not_compared": [_words(found.why)]}
    return {
        "differences": [
            {name: value for name, value in each._asdict().items() if name != "effect"} | each.effect._asdict()
            for each in found.differences
        ],
        "pairs": [
            {name: value for name, value in each._asdict().items() if name != "effect"} | each.effect._asdict()
            for each in found.pairs
        ],
        "not_compared": [_words(each) for each in found.left_out],
    }
