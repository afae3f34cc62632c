"""The values of a metric in order of time, with the unit, station, lot and fixture of each."""

import json
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from itertools import pairwise
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np

from analytics.evaluation.selection import evaluated
from analytics.metric_registry.registry import MetricHeader, check_metrics, metrics
from analytics.specifications.verdicts import UNGIVEN, rows_of
from analytics.trends.values_sql import METRIC_VALUES
from storage.sql.catalog import Catalog
from stream.batch import FloatArray, IntArray
from stream.errors import NotFound

NS_PER_DAY = 86_400 * 10**9
GROUPS = ("station", "fixture", "lot")

# Results beside the value, no settings: values that differ in these are of one kind.
_RESULTS = {
    "duration_s", "whole_seconds", "n_effective", "repeat", "repeats", "scale_factor", "scale_source", "epochs", "days",
    "power_ons", "n", "remark",
}  # fmt: skip
_TEMPERATURE = "temperature"
_TEMPERATURE_GAP_DEG_C = 5.0
_FEW = 12


class Variant(NamedTuple):
    """A kind of values of a metric: its standard and its settings."""

    standard: str
    parameters: tuple[tuple[str, str], ...]

    def __str__(self) -> str:
        return ", ".join([f"standard={self.standard}", *(f"{name}={value}" for name, value in self.parameters)])


@dataclass(frozen=True)
class MetricSeries:
    """Values of a metric in order of time."""

    metric: str
    unit_of_measure: str
    value: FloatArray
    uncertainty: FloatArray  # standard uncertainty, NaN where unknown
    t_ns: IntArray  # shape (n,); when each was measured; where the date of a run is unknown, when it was recorded
    unit: list[str]  # unit of each value; with the signal where units have several
    run: list[str]
    groups: dict[str, list[str]]  # levels of each value, for `GROUPS`, `product`, `signal` and `serial`
    variant: Variant
    others: tuple[Variant, ...]  # the other kinds in the store
    without_value: int  # rows of this kind that have a reason instead of a value
    dated: bool  # whether the dates of all runs are known
    bounds: FloatArray | None = None  # shape (2, n); 95 % bounds of each value, NaN where there are none
    undated_runs: tuple[str, ...] = ()  # runs without a date, whose values are left out
    undated: int = 0  # how many values that are
    remarks: list[str] | None = None  # of each value, empty where it has none
    other_measures: Mapping[str, int] = field(default_factory=dict)  # values of this kind by another unit of measure
    excluded: tuple[str, ...] = ()  # runs of these units that people have excluded, each with its unit and why

    @property
    def header(self) -> MetricHeader | None:
        """The header of the metric; None where there is no such metric now."""
        return metrics()[self.metric].header if self.metric in metrics() else None

    @property
    def is_magnitude(self) -> bool:
        """Whether no value is negative, as of deviations and sizes of effects."""
        is_size = self.header is not None and self.header.better in {"lower", "nearer_zero"}
        return is_size and bool((self.value >= 0).all())

    @property
    def serial(self) -> list[str]:
        """Unit of each value: several signals, as the axes of one unit, are of one."""
        return self.groups.get("serial", self.unit)

    @property
    def without_interval(self) -> list[int]:
        """Indices of the values that have no interval."""
        return [] if self.bounds is None else np.flatnonzero(np.isnan(self.bounds).any(axis=0)).tolist()

    def where(self, chosen: Iterable[int]) -> "MetricSeries":
        """Some of the values, by their indices."""
        at = np.array(list(chosen), np.int64)
        return replace(
            self, value=self.value[at], uncertainty=self.uncertainty[at], t_ns=self.t_ns[at],
            unit=[self.unit[index] for index in at], run=[self.run[index] for index in at],
            groups={name: [levels[index] for index in at] for name, levels in self.groups.items()},
            bounds=None if self.bounds is None else self.bounds[:, at],
            remarks=None if self.remarks is None else [self.remarks[index] for index in at],
        )  # fmt: skip

    def within_products(self) -> "MetricSeries":
        """The values less the mean of their product, plus that of all; the same where there is one product."""
        products, code = np.unique(np.array(self.groups.get("product", self.unit)), return_inverse=True)
        if products.size < 2 or "product" not in self.groups:
            return self
        means = np.bincount(code, self.value) / np.bincount(code)
        return replace(self, value=self.value - means[code] + self.value.mean())

    def first_of_units(self) -> "MetricSeries":
        """The first value of each unit: a repeated measurement is no new unit."""
        return self.where(self.first_places())

    def first_places(self) -> IntArray:
        """Indices of the first value of each unit."""
        first = {unit: index for index, unit in reversed(list(enumerate(self.unit)))}
        return np.array(sorted(first.values()), np.int64)

    def places(self, by: str) -> dict[str, IntArray]:
        """Indices of the values of each unit, or level of a group, by name."""
        levels = np.array(self.unit if by == "unit" else self.groups[by])
        return {str(level): np.flatnonzero(levels == level) for level in np.unique(levels)}


class Choice(NamedTuple):
    """Selection of values; None and empty select all."""

    units: tuple[str, ...] = ()
    signal: str | None = None
    standard: str | None = None
    parameters: Mapping[str, str] = {}
    lot: str | None = None
    station: str | None = None
    fixture: str | None = None
    product: str | None = None
    since_ns: int | None = None


_EXCLUDED = "select run, unit, reason from exclusions order by run, unit"
_LIMITED = "select distinct parameters from specification_limits where metric = $metric"


def read_series(catalog: Catalog, metric: str, choice: Choice = Choice()) -> MetricSeries:
    """Read the values of one metric from the store; only this metric is computed.

    Where a metric has several kinds of values (averaging times, axes, with and without the Earth's rate) and the choice
    leaves more than one, the kind with the most values is used, of several one that a specification limits; the others
    are named in the result.
    """
    return every_series(catalog, metric, choice)[0]


def every_series(catalog: Catalog, metric: str, choice: Choice = Choice()) -> list[MetricSeries]:
    """The values of each kind and unit of measure that has any, in the order of `read_series`; NotFound if none has."""
    check_metrics([metric])
    with evaluated(catalog, [metric]):
        found = rows_of(catalog, METRIC_VALUES, {"metric": metric, "unit": ""})
        limits = rows_of(catalog, _LIMITED, {"metric": metric})
        excluded = rows_of(catalog, _EXCLUDED)
    rows = [row | {"parameters": json.loads(row["parameters"] or "{}")} for row in found]
    kept = [row for row in rows if _is_selected(row, choice)]
    if not kept:
        raise NotFound(_nothing(metric, rows, choice, excluded))
    kinds = _ordered_kinds(kept, [json.loads(each["parameters"] or "{}") for each in limits])
    of_units = [row for row in excluded if row["unit"] in (choice.units or {each["unit"] for each in rows})]
    named = tuple(f"{row['run']} ({row['unit']}: {row['reason']})" for row in of_units)
    every = []
    for variant, own in kinds.items():
        others = tuple(each for each in kinds if each != variant)
        valued = [row for row in own if row["value"] is not None]
        # scale factors of outputs in volts and in deg/s cannot share a chart
        counts = Counter(row["unit_of_measure"] for row in valued)
        for measure, _ in counts.most_common():
            alike = [row for row in valued if row["unit_of_measure"] == measure]
            series = _series(metric, alike, variant, others, len(own) - len(valued))
            measures = {each: count for each, count in counts.items() if each != measure}
            every.append(replace(series, excluded=named, other_measures=measures))
    if not every:
        own = next(iter(kinds.values()))
        reasons = Counter(row["reason"] for row in own)
        raise NotFound(f"{metric}: no unit has a value; of {len(own)} most say: {reasons.most_common(1)[0][0]}")
    return every


def _is_selected(row: Mapping[str, Any], choice: Choice) -> bool:
    own = row["parameters"]
    asked = (
        (not choice.units or row["unit"] in choice.units),
        choice.signal in {None, row["signal"]},
        choice.standard is None or choice.standard in (row["standard"] or "").split(", "),
        choice.since_ns is None or (row["date_known"] and _moment(row) >= choice.since_ns),
        *(
            wanted in {None, row[name] or UNGIVEN}
            for name, wanted in choice._asdict().items()
            if name in (*GROUPS, "product")
        ),
        *(parameter_text(own.get(name)) == parameter_text(value) for name, value in choice.parameters.items()),
    )
    return all(asked)


def _moment(row: Mapping[str, Any]) -> int:
    return int((row["t_ns"] if row["date_known"] and row["t_ns"] is not None else row["recorded_ns"]) or 0)


def parameter_text(value: object) -> str:
    """A parameter so that 100, 100.0 and '100' are the same.

    >>> parameter_text(100.0), parameter_text("100"), parameter_text("X")
    ('100', '100', 'X')
    """
    try:
        return f"{float(str(value)):g}"
    except ValueError:
        return str(value)


def _nothing(
    metric: str, rows: list[dict[str, Any]], choice: Choice, excluded: Sequence[Mapping[str, Any]]
) -> str:  # fmt: skip
    if not rows and excluded:
        runs = sorted({f"{row['run']} ({row['reason']})" for row in excluded})
        listed = ", ".join(runs[:4]) + (f" and {len(runs) - 4} more" if len(runs) > 4 else "")
        return f"{metric}: no unit of this store has a value; excluded from evaluation are {listed}"
    if not rows:
        return f"{metric}: no unit of this store has been in such a test; `gyrofleet metrics` lists what there is"
    chosen = [(name, value) for name, value in choice._asdict().items() if value not in (None, (), {})]
    asked = ", ".join(_in_words(name, value) for name, value in chosen)
    kinds = sorted(str(each) for each in _kinds(rows))
    return f"{metric}: none of {len(rows)} values is of {asked}; kinds of values: {'; '.join(kinds[:12])}"


def _in_words(name: str, value: Any) -> str:
    """What a choice asks for.

    >>> _in_words("units", ("A", "B")), _in_words("since_ns", 1_795_255_200 * 10**9), _in_words("lot", "L1")
    ('unit A or B', 'since 2026-11-21 10:00 UTC', 'lot L1')
    """
    match name:
        case "units":
            return f"unit {' or '.join(value)}"
        case "since_ns":
            return f"since {datetime.fromtimestamp(value / 1e9, UTC):%Y-%m-%d %H:%M} UTC"
        case "parameters":
            return ", ".join(f"{each} = {of}" for each, of in value.items())
    return f"{name} {value}"


def _order(row: Mapping[str, Any]) -> tuple[Any, ...]:
    """The order in time; units of one moment, as of one session, in an order that means nothing.

    By their serials, products or lots would follow each other, and look like a change of level in time.
    """
    unit = row["unit"]
    return _moment(row), crc32(unit.encode()), unit, row["run"] or "", row["signal"], row["steps"] or []


def _settings(rows: list[dict[str, Any]]) -> set[str]:
    """Parameters that distinguish kinds of values: words, averaging times, those by which values of one step differ."""
    named: set[str] = set()
    same: defaultdict[tuple[object, ...], list[dict[str, Any]]] = defaultdict(list)
    for row in rows:
        own = row["parameters"]
        named |= {name for name, value in own.items() if isinstance(value, str | bool) or name == "average_s"}
        same[row["unit"], row["signal"], row["run"], row["standard"], tuple(row["steps"] or ())].append(own)
    for group in same.values():
        if len(group) > 1:
            names = {name for each in group for name in each}
            named |= {name for name in names if len({parameter_text(each.get(name)) for each in group}) > 1}
    most = max(_FEW, len(rows) // 20)
    few = {name for name in named if len({parameter_text(row["parameters"].get(name)) for row in rows}) <= most}
    return (few - _RESULTS) | {_TEMPERATURE}


def _temperature_classes(rows: list[dict[str, Any]]) -> dict[float, str]:
    """Measured temperatures by the median of their class: classes are separated by gaps of more than 5 degC."""
    measured = {row["parameters"].get(_TEMPERATURE) for row in rows}
    found = sorted({float(each) for each in measured if isinstance(each, int | float)})
    gaps = [at for at in range(1, len(found)) if found[at] - found[at - 1] > _TEMPERATURE_GAP_DEG_C]
    return {
        each: f"{np.median(found[first:last]):.0f}"
        for first, last in pairwise([0, *gaps, len(found)])
        for each in found[first:last]
    }


def _kinds(rows: list[dict[str, Any]]) -> dict[Variant, list[dict[str, Any]]]:
    settings, classes = _settings(rows), _temperature_classes(rows)
    kinds: defaultdict[Variant, list[dict[str, Any]]] = defaultdict(list)
    for row in rows:
        own = row["parameters"].items()
        kind = {name: parameter_text(value) for name, value in own if name in settings and value is not None}
        if (temperature := row["parameters"].get(_TEMPERATURE)) in classes:
            kind[_TEMPERATURE] = classes[temperature]
        kinds[Variant(row["standard"] or "", tuple(sorted(kind.items())))].append(row)
    return kinds


def _ordered_kinds(
    rows: list[dict[str, Any]], limited: Sequence[Mapping[str, object]]
) -> dict[Variant, list[dict[str, Any]]]:
    kinds = _kinds(rows)
    asked = [{(name, parameter_text(value)) for name, value in each.items()} for each in limited]

    def rank(kind: Variant) -> tuple[int, bool, bool, Variant]:
        """Most values first; of two with as many the one with a limit, and that at room temperature."""
        own, values = set(kind.parameters), sum(row["value"] is not None for row in kinds[kind])
        return -values, not any(each <= own for each in asked), ("room", "False") in own, kind

    return {kind: kinds[kind] for kind in sorted(kinds, key=rank)}


def _series(
    metric: str, rows: list[dict[str, Any]], variant: Variant, others: tuple[Variant, ...], without_value: int
) -> MetricSeries:
    undated = [row for row in rows if not row["date_known"]]
    if len(undated) > len(rows) / 2:  # the order in which they were recorded is all that is known of most
        undated = []
    rows = [row for row in rows if row["date_known"] or not undated]
    rows.sort(key=_order)
    several = len({row["signal"] for row in rows}) > 1
    groups = {name: [row[name] or UNGIVEN for row in rows] for name in (*GROUPS, "product", "signal")}
    return MetricSeries(
        metric=metric, unit_of_measure=rows[0]["unit_of_measure"],
        value=np.array([row["value"] for row in rows], np.float64),
        uncertainty=np.array([row["standard_uncertainty"] for row in rows], np.float64),
        t_ns=np.array([_moment(row) for row in rows], np.int64),
        unit=[f"{row['unit']} {row['signal']}" if several else row["unit"] for row in rows],
        run=[row["run"] or "" for row in rows],
        groups=groups | {"serial": [row["unit"] for row in rows]},
        variant=variant, others=others, without_value=without_value, dated=all(row["date_known"] for row in rows),
        bounds=np.array([[row[side] for row in rows] for side in ("lo", "hi")], np.float64),
        undated_runs=tuple(sorted({row["run"] or "" for row in undated})), undated=len(undated),
        remarks=[row["parameters"].get("remark") or "" for row in rows],
    )  # fmt: skip
