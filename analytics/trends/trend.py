"""The trend of a metric: control charts, changes, drift, differences between groups, capability."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from analytics.trends.charts.capability import Capability, SpecifiedLimits, capability
from analytics.trends.charts.control_chart import (
    LEAST_POINTS,
    EwmaChart,
    IndividualsChart,
    Spread,
    ewma_chart,
    individuals_chart,
)
from analytics.trends.charts.nelson_rules import ChartChance, chart_chance, points_of, rule_flags, wild_point_chance
from analytics.trends.groups.between_stations import GroupComparison
from analytics.trends.groups.components import components
from analytics.trends.groups.level_drifts import LevelDrift, level_drifts
from analytics.trends.groups.mixed_model import ComponentDeviation
from analytics.trends.groups.scatter_differences import ScatterComparison, scatter_differences
from analytics.trends.levels.change_points import ChangePoint, Changes, change_points
from analytics.trends.levels.drift import Drift, drift, shared_noises
from analytics.trends.levels.found_effects import FoundEffects, found_effects
from analytics.trends.levels.level_shifts import LevelShift, LevelShifts, level_shifts
from analytics.trends.series import GROUPS, NS_PER_DAY, MetricSeries
from analytics.trends.wander import NOISES
from analytics.trends.words import NotComputed, Words, joined, not_computed, words
from stream.batch import FloatArray, IntArray

# probability that noise alone shows an outlier; the same for a change, a drift, and too many signals
FALSE_ALARM = 0.01
_MOST_SIMULATED = 40


class Chart(NamedTuple):
    """One series with its control limits, signals, changes and drift."""

    name: str  # unit, or level of the group; empty where all units share one chart
    series: MetricSeries
    # shape (points,); the values; for a station or fixture that measured units more than once, the level there plus the
    # deviation of each value from that expected of its unit (`LevelShifts.points`); for a unit, the values without what
    # stations and fixtures do (`FoundEffects.of_units`)
    charted: FloatArray
    is_adjusted: bool  # whether these differ
    limits: IndividualsChart | NotComputed  # centre and control limits; none below zero where values cannot be negative
    changes: Changes | NotComputed  # changes of level; for an adjusted chart, those of `shifts`
    drift: Drift | NotComputed  # per day; per point where dates are unknown
    drifts: bool  # whether the drift is significant
    # level shifts of stations with values of this chart on both sides, from all measurements there
    shifts: tuple[LevelShift, ...]
    is_unsteady: bool  # whether the stations wander between the sessions that it has values of
    z: FloatArray = np.empty(0)  # shape (points,); distances from the centre in sigma; empty without limits
    # points in the patterns of each of Nelson's rules that is met, by its number
    signals: Mapping[int, list[int]] = MappingProxyType({})
    counts: tuple[int, ...] = (0,) * 8  # how often each of the eight is met
    averages: EwmaChart | None = None
    # significance; None where there are so many charts that no number of signals would be significant
    chance: ChartChance | None = None
    tested: int = 1  # charts of the trend that are long enough to show anything
    wild_point: int | None = None  # the most distant point, where it is a significant outlier
    too_many: int | None = None  # the rule that is met significantly more often than by chance

    @property
    def has_changed(self) -> bool:
        """Whether the level of the chart has changed; not where the bounds of the change include none."""
        points: list[ChangePoint | LevelShift] = [*self.shifts]
        if isinstance(self.changes, Changes):
            points += self.changes.points
        return any(each.is_certain for each in points)

    @property
    def drift_chance(self) -> float | None:
        """Chance that noise alone shows so strong a drift on any of the charts; None where there is no drift."""
        return min(1.0, self.drift.chance * self.tested) if isinstance(self.drift, Drift) else None

    @property
    def drift_is_by_chance(self) -> bool:
        """Whether noise alone shows so strong a drift too often for it to be significant."""
        return self.drift_chance is not None and self.drift_chance > FALSE_ALARM

    @property
    def in_control(self) -> bool | None:
        """Whether nothing is significant; None where there are too few points."""
        if isinstance(self.limits, NotComputed):
            return None
        is_outside = self.wild_point is not None or self.too_many is not None
        return not any((is_outside, self.has_changed, self.drifts, self.is_unsteady))


@dataclass(frozen=True)
class Trend:
    """The trend of a metric."""

    series: MetricSeries  # all values
    # the grouping of the charts: ``unit``, ``product``, ``lot``, ``station``, ``fixture``; None for one chart of all
    by: str | None
    charts: tuple[Chart, ...]  # in order of the groups' names
    shifts: LevelShifts | NotComputed  # level shifts of single stations, from all values
    drifts: tuple[LevelDrift, ...]  # stations and fixtures that drift against the others
    found: (
        FoundEffects  # what is taken off before groups are compared, and the comparison of stations, fixtures and lots
    )
    scatters: ScatterComparison  # stations, fixtures and lots, by the scatter of their values
    specification: SpecifiedLimits  # of all values
    specifications: tuple[SpecifiedLimits, ...]  # of each chart, in the order of the charts, as the capabilities
    capabilities: tuple[Capability | NotComputed, ...]

    @property
    def comparison(self) -> GroupComparison | NotComputed:
        """Between stations, fixtures and lots."""
        return self.found.comparison

    @cached_property
    def components(self) -> dict[str, ComponentDeviation]:
        """Scatter of units, of measurements, and of groups, without what is found of all or of single units."""
        return components(self.found.rest, GROUPS)


def trend_of(
    series: MetricSeries, *, by: str | None = None, baseline: int | None = None,
    spread: Spread = Spread.MEDIAN_MOVING_RANGE, specification: SpecifiedLimits = SpecifiedLimits(),
    limits_of: Callable[[MetricSeries], SpecifiedLimits] | None = None,
) -> Trend:  # fmt: skip
    """Make the control charts of a series and compare its groups.

    One chart for each unit, product, lot, station or fixture. A chart of a unit has all its values, without what the
    report finds of stations and fixtures. A chart of a
    station or fixture has all values measured there; where units were measured more than once, each is charted by its
    deviation from the value expected of its unit. Other charts have the first value of each unit, since values of one
    unit are correlated. The limits are computed from the first `baseline` points, by default from all. `specification`:
    limits of all values; where they have none in common, `limits_of` gives those of each chart. Stations, fixtures and
    lots are compared within each product.
    """
    if by is None and len(set(series.unit)) == 1:
        by = "unit"
    shifts = level_shifts(series.within_products(), false_alarm=FALSE_ALARM)
    drifts = level_drifts(series, false_alarm=FALSE_ALARM)
    found = found_effects(series, shifts, drifts, false_alarm=FALSE_ALARM)
    parts = _parts(series, by, shifts, found.of_units)
    tested = sum(part.charted.size >= LEAST_POINTS for part in parts)  # the others cannot give a false alarm
    noises: list[FloatArray | None] = [None] * len(parts)
    if by == "unit":  # all are measured in the same places
        noises = [*shared_noises([(_days(part.series), part.charted) for part in parts])]
    charts = tuple(
        _chart(part, max(1, tested), baseline, spread, of_part) for part, of_part in zip(parts, noises, strict=True)
    )
    limits = [specification] * len(charts)
    if limits_of is not None and specification.why_not is not None and by != "unit":
        limits = [limits_of(chart.series) for chart in charts]
    capabilities = tuple(_capability(*each, by) for each in zip(charts, limits, strict=True))
    kept = np.setdiff1d(np.arange(series.value.size), found.wild)
    scatters = scatter_differences(series.where(kept), of_units=found.of_units[kept])
    return Trend(series, by, charts, shifts, drifts, found, scatters, specification, tuple(limits), capabilities)


class _Part(NamedTuple):
    """The input of one chart: its values, as charted, and the level shifts of their stations."""

    name: str
    series: MetricSeries
    charted: FloatArray
    is_adjusted: bool
    shifts: tuple[LevelShift, ...] = ()
    changes: Changes | None = None
    is_unsteady: bool = False


def _parts(
    series: MetricSeries, by: str | None, shifts: LevelShifts | NotComputed, of_units: FloatArray
) -> list[_Part]:
    found = []
    places = {"": np.arange(series.value.size)} if by is None else series.places(by)
    for name, at in places.items():
        part = series.where(at)
        if by == "unit":
            is_adjusted = not np.allclose(of_units[at], part.value, rtol=1e-9, atol=0.0)
            found.append(_Part(name, part, of_units[at] if is_adjusted else part.value, is_adjusted))
            continue
        if isinstance(shifts, NotComputed):
            part = part.first_of_units()
            found.append(_Part(name, part, part.value, is_adjusted=False))
            continue
        is_adjusted = by in {"station", "fixture"}
        shown = at if is_adjusted else at[part.first_places()]
        # the points of a station have the certain ones alone
        known = [each for each in shifts.shifts if each.is_certain or not is_adjusted]
        own = tuple(each for each in known if _crosses(each, shown, series))
        sessions = {(series.groups["station"][each], series.run[each]) for each in shown.tolist()}
        is_unsteady = shifts.unsteady is not None and len(sessions) > 1
        if is_adjusted:
            changes = _changes_of(own, at, shifts.points[at]) if by == "station" else None
            found.append(_Part(name, part, shifts.points[at], True, own, changes, is_unsteady))
        else:
            first = series.where(shown)
            found.append(_Part(name, first, first.value, False, own, None, is_unsteady))
    return found


def _crosses(shift: LevelShift, shown: IntArray, series: MetricSeries) -> bool:
    """Whether some values of the series, by their indices, were measured there before and after a shift."""
    there = [each for each in shown.tolist() if shift.station in {"", series.groups["station"][each]}]
    return bool(there) and there[0] <= shift.first and there[-1] >= shift.last


def _changes_of(shifts: tuple[LevelShift, ...], at: IntArray, points: FloatArray) -> Changes:
    """Level shifts as changes of the chart with these values of the series."""
    changes = tuple(
        ChangePoint(
            int(np.searchsorted(at, each.at)), int(np.searchsorted(at, each.first, side="right")),
            min(int(np.searchsorted(at, each.last)), at.size - 1), each.size, each.lo, each.hi,
        )
        for each in shifts
    )  # fmt: skip
    edges = sorted({0, *(each.at for each in changes), at.size})
    stretches = [points[first:last] for first, last in pairwise(edges)]
    squares = sum(float(((each - each.mean()) ** 2).sum()) for each in stretches)
    sigma = float(np.sqrt(squares / max(at.size - len(stretches), 1)))
    return Changes(changes, tuple(float(each.mean()) for each in stretches), sigma, FALSE_ALARM)


def _days(series: MetricSeries) -> FloatArray:
    """Days from the first value; numbers of the points where dates are unknown."""
    if not series.dated:
        return np.arange(series.value.size, dtype=np.float64)
    return np.asarray((series.t_ns - series.t_ns[:1]) / NS_PER_DAY, np.float64)


def _chart(part: _Part, tested: int, baseline: int | None, spread: Spread, noises: FloatArray | None) -> Chart:
    """The chart of a part, one of so many that are `tested`; `noises`: what other charts say of its noise."""
    share = FALSE_ALARM / tested
    values = part.charted
    limits = individuals_chart(values, baseline=baseline, spread=spread)
    changes = change_points(values, false_alarm=share) if part.changes is None else part.changes
    series = part.series
    slope = drift(_days(series), values, noises=noises)
    has_steps = bool(part.shifts) or (isinstance(changes, Changes) and bool(changes.points))
    # a step gives a slope too; where there are steps, they are reported
    drifts = isinstance(slope, Drift) and slope.chance <= share and not has_steps
    own = (part.name, series, values, part.is_adjusted)
    chart = Chart(*own, limits, changes, slope, drifts, part.shifts, part.is_unsteady, tested=tested)
    if isinstance(limits, NotComputed):
        return chart
    if series.is_magnitude:
        chart = chart._replace(limits=limits._replace(lower=max(limits.lower, 0.0)))
    z = (values - limits.centre) / limits.sigma
    flags = rule_flags(z)
    counts = flags.sum(axis=-1)
    noise = changes.noise if isinstance(changes, Changes) and changes.noise is not None else NOISES[0]
    chance = None
    if tested <= _MOST_SIMULATED:
        chance = chart_chance(values, counts, baseline=limits.baseline, spread=spread, noise=noise)
    is_wild = wild_point_chance(values) <= share
    return chart._replace(
        z=z, signals=points_of(flags, z), counts=tuple(int(each) for each in counts),
        averages=ewma_chart(values, limits.centre, limits.sigma), chance=chance,
        wild_point=int(np.abs(values - values.mean()).argmax()) if is_wild else None,
        too_many=chance.rule if chance is not None and chance.signals <= share else None,
    )  # fmt: skip


def _capability(chart: Chart, limits: SpecifiedLimits, by: str | None) -> Capability | NotComputed:
    if by == "unit":
        return not_computed("capability_of_one_unit")
    if limits.why_not is not None:
        return NotComputed(limits.why_not)
    # one value a unit: a repeated measurement is no other unit
    units = chart.series.first_of_units()
    why = None if chart.in_control is not False else _what_is_significant(chart)
    lower, upper = limits.lower, limits.upper
    return capability(
        units.value, lower, upper, out_of_control=why, uncertainty=units.uncertainty, units=len(set(units.serial))
    )


def _what_is_significant(chart: Chart) -> Words:
    seen = {
        "has_wild_point": chart.wild_point is not None, "has_changed": chart.has_changed,
        "has_wandered": chart.is_unsteady, "has_drifted": chart.drifts, "has_met_rule": chart.too_many is not None,
    }  # fmt: skip
    return joined((words(key, rule=chart.too_many) for key, is_so in seen.items() if is_so), ", ", "，")
