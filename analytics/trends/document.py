"""A trend as JSON."""

from typing import Any

from analytics.trends.chart_sentences import beyond, moment, state_of
from analytics.trends.charts.capability import Capability, SpecifiedLimits
from analytics.trends.charts.nelson_rules import RULES
from analytics.trends.groups.between_stations import Difference, GroupComparison, Pairs
from analytics.trends.groups.level_drifts import LevelDrift
from analytics.trends.levels.change_points import Changes
from analytics.trends.levels.drift import Drift
from analytics.trends.levels.level_shifts import LevelShift, LevelShifts
from analytics.trends.report import sentences, stands_out
from analytics.trends.series import MetricSeries, Variant
from analytics.trends.trend import Chart, Trend
from analytics.trends.words import NotComputed


def document(trend: Trend) -> dict[str, Any]:
    """All results of a trend; one that was not computed has a `reason`."""
    series, header = trend.series, trend.series.header
    charts = zip(trend.charts, trend.capabilities, trend.specifications, strict=True)
    return {
        "metric": series.metric,
        "names": None if header is None else {"en": header.en, "zh": header.zh},
        "unit_of_measure": series.unit_of_measure,
        "kind": _kind(series.variant),
        "other_kinds": [_kind(each) for each in series.others],
        "values": series.value.size,
        "units": len(set(series.serial)),
        "without_value": series.without_value,
        "other_measures": dict(series.other_measures),
        "without_interval": without_interval(series),
        "undated_left_out": series.undated,
        "undated_runs": list(series.undated_runs),
        "excluded": list(series.excluded),
        "dated": series.dated,
        "by": trend.by,
        "charts": [
            _chart(chart) | {"capability": _capability(found, chart), "specification": _specification(limits)}
            for chart, found, limits in charts
        ],
        "specification": _specification(trend.specification),
        **_shifts(trend.shifts, series),
        "drifts": [_flat(each) for each in trend.drifts],
        "drifting_units": list(trend.found.drifting),
        "wild_left_out": [
            {"unit": series.unit[at], "run": series.run[at], "time": moment(series, at)} for at in trend.found.wild
        ],
        **_comparison(trend.comparison),
        "scatters": [each._asdict() for each in trend.scatters.differences],
        "scatters_not_compared": [each._asdict() for each in trend.scatters.left_out],
        "components": {name: _plain(each) for name, each in trend.components.items()},
        "stands_out": stands_out(trend),
        "report": [each._asdict() for each in sentences(trend)],
    }


def _specification(limits: SpecifiedLimits) -> dict[str, Any]:
    return {
        "lower": limits.lower,
        "upper": limits.upper,
        "source": limits.source or None,
        "decision_rule": limits.rule or None,
        "stretches": [each._asdict() for each in limits.stretches],
    }


def _plain(value: Any) -> Any:
    """A result with its parts as mappings; of one that was not computed the reason."""
    if isinstance(value, NotComputed):
        return {"reason": value.why._asdict()}
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return {name: _plain(each) for name, each in value._asdict().items()}
    return value


def _kind(variant: Variant) -> dict[str, Any]:
    return {"standard": variant.standard, "parameters": dict(variant.parameters)}


def _chart(chart: Chart) -> dict[str, Any]:
    per = {"per": "day" if chart.series.dated else "point"} if isinstance(chart.drift, Drift) else {}
    return {
        "name": chart.name,
        "in_control": chart.in_control,
        "state": state_of(chart)._asdict(),
        "limits": _plain(chart.limits),
        "points": _points(chart),
        "signals": [
            {
                "rule": rule,
                **RULES[rule - 1]._asdict(),
                "count": chart.counts[rule - 1],
                "expected_by_chance": None if chart.chance is None else chart.chance.expected[rule - 1],
                "points": points,
            }
            for rule, points in chart.signals.items()
        ],
        "beyond_3_sigma": beyond(chart),
        "chance": _plain(chart.chance),
        "wild_point": chart.wild_point,
        "rule_met_too_often": chart.too_many,
        "changes": _changes(chart),
        "drift": _plain(chart.drift) | per,
        "drifts": chart.drifts,
        "drift_chance": chart.drift_chance,
        "drift_is_by_chance": chart.drift_is_by_chance,
        "is_adjusted": chart.is_adjusted,
    }


def _points(chart: Chart) -> list[dict[str, Any]]:
    series, averages = chart.series, chart.averages
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
            "rules": [rule for rule, points in chart.signals.items() if at in points],
            "ewma": None if averages is None else float(averages.averages[at]),
            "ewma_outside": at in outside,
        }
        for at in range(series.value.size)
    ]


def _changes(chart: Chart) -> dict[str, Any]:
    if not isinstance(chart.changes, Changes):
        return {"reason": chart.changes.why._asdict()}
    of = chart.series
    points = [each._asdict() | _times(of, each.at, each.first - 1, each.last) for each in chart.changes.points]
    return {"points": points, "levels": list(chart.changes.levels), "false_alarm": chart.changes.false_alarm}


def _shifts(found: LevelShifts | NotComputed, series: MetricSeries) -> dict[str, Any]:
    """Level shifts of stations; their indices are those of all values in order of time."""
    if isinstance(found, NotComputed):
        return {"shifts": [], "unsteady": None, "shifts_not_searched": found.why._asdict()}
    unsteady = None if found.unsteady is None else found.unsteady._asdict()
    if unsteady and unsteady["largest"]:
        unsteady["largest"] = _shift(unsteady["largest"], series)
    shifts = [_shift(each, series) for each in found.shifts]
    return {"shifts": shifts, "unsteady": unsteady, "shifts_not_searched": None}


def _shift(shift: LevelShift, series: MetricSeries) -> dict[str, Any]:
    station = {"station": shift.station or None, "is_plain": shift.is_plain}
    return shift._asdict() | _times(series, shift.at, shift.first, shift.last) | station


def _times(series: MetricSeries, at: int, first: int, last: int) -> dict[str, str]:
    return {"time": moment(series, at), "from": moment(series, first), "to": moment(series, last)}


def _capability(found: Capability | NotComputed, chart: Chart) -> dict[str, Any]:
    if not isinstance(found, Capability):
        return {**_plain(found)}
    lacking = without_interval(chart.series.first_of_units())
    return {**_plain(found), "is_normal": found.is_normal, "without_interval": lacking}


def without_interval(series: MetricSeries) -> list[dict[str, Any]]:
    """The values that have no interval, with what is remarked on them."""
    return [
        {
            "unit": series.unit[at], "run": series.run[at], "time": moment(series, at),
            "remark": (series.remarks[at] if series.remarks else "") or None,
        }
        for at in series.without_interval
    ]  # fmt: skip


def _comparison(found: GroupComparison | NotComputed) -> dict[str, Any]:
    if isinstance(found, NotComputed):
        return {"differences": [], "pairs": [], "not_compared": [found.why._asdict()]}
    return {
        "differences": [_flat(each) for each in found.differences],
        "pairs": [_flat(each) for each in found.pairs],
        "not_compared": [each._asdict() for each in found.left_out],
    }


def _flat(each: Difference | Pairs | LevelDrift) -> dict[str, Any]:
    return {name: value for name, value in each._asdict().items() if name != "effect"} | each.effect._asdict()
