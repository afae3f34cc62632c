"""The trend of a characteristic: charts, what stands out on them, which group differs, what the process can keep."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from analytics.trends.between_stations import Comparison, compare_groups
from analytics.trends.capability import Capability, capability
from analytics.trends.change_points import ChangePoint, Changes, change_points
from analytics.trends.chart_chance import ChartChance, chart_chance, wild_point_chance
from analytics.trends.control_chart import IndividualsChart, Spread, individuals_chart
from analytics.trends.drift import Drift, drift
from analytics.trends.ewma import EwmaChart, ewma_chart
from analytics.trends.level_shifts import LevelShift, LevelShifts, level_shifts
from analytics.trends.mixed_model import Deviation
from analytics.trends.nelson_rules import points_of, rule_flags
from analytics.trends.series import GROUPS, Series
from analytics.trends.variance_components import components
from analytics.trends.words import Refused, Words
from stream.batch import FloatArray, IntArray

FALSE_ALARM = 0.01
"""Probability with which noise alone shows a wild point, a change, a drift, or too many signals: of each of these."""
NS_PER_DAY = 86_400 * 10**9
_MOST_SIMULATED = 40


class Limits(NamedTuple):
    """Limits of the specification that hold for a series, in its unit; `why_not` where there are none."""

    lower: float | None = None
    upper: float | None = None
    source: str = ""
    why_not: Words | None = None


class Chart(NamedTuple):
    """One series and what is seen in it.

    Parameters
    ----------
    name: Unit, or level of the group; empty where all units stand on one chart.
    series: The values, in order of time.
    charted: shape (points,); where its points stand: the values; of a station or fixture that measured units more than
        once, the level there and how far each value is from what its unit lets expect (`LevelShifts.points`).
    is_adjusted: Whether these differ.
    limits: Centre and control limits; none below zero of what cannot be negative.
    z: shape (points,); distances from the centre in sigma; empty where there are no limits.
    signals: Points that take part in each of Nelson's rules that is met, by its number.
    counts: How often each of the eight is met.
    averages: Moving averages.
    chance: What noise would show; None where there are so many charts that no number of signals would say anything.
    wild_point: The most distant point, where it is no chance.
    too_many: The rule that is met more often than by chance.
    changes: Changes of level; of a chart that is adjusted, those of `shifts`.
    drift: Per day; per point where dates are not known.
    drifts: Whether the drift is no chance.
    shifts: Changes of level of the stations that the values are of, from all their measurements.
    is_unsteady: Whether these wander from session to session.
    """

    name: str
    series: Series
    charted: FloatArray
    is_adjusted: bool
    limits: IndividualsChart | Refused
    z: FloatArray
    signals: dict[int, list[int]]
    counts: tuple[int, ...]
    averages: EwmaChart | None
    chance: ChartChance | None
    wild_point: int | None
    too_many: int | None
    changes: Changes | Refused
    drift: Drift | Refused
    drifts: bool
    shifts: tuple[LevelShift, ...] = ()
    is_unsteady: bool = False

    @property
    def has_changed(self) -> bool:
        """Whether the level of the chart has changed."""
        return isinstance(self.changes, Changes) and bool(self.changes.points)

    @property
    def in_control(self) -> bool | None:
        """Whether nothing stands out; None where there are too few points to say."""
        if isinstance(self.limits, Refused):
            return None
        return not any(
            (
                self.wild_point is not None,
                self.too_many is not None,
                self.has_changed,
                self.drifts,
                self.shifts,
                self.is_unsteady,
            )
        )


@dataclass(frozen=True)
class Trend:
    """The trend of a characteristic.

    Parameters
    ----------
    series: All values.
    by: What each chart is of: ``unit``, ``lot``, ``station``, ``fixture``; None where all units stand on one.
    charts: In order of their names.
    shifts: Changes of level of single stations, from all values.
    comparison: Between stations, fixtures and lots.
    specification: What the values are compared with.
    capabilities: Of each chart.
    """

    series: Series
    by: str | None
    charts: tuple[Chart, ...]
    shifts: LevelShifts | Refused
    comparison: Comparison | Refused
    specification: Limits
    capabilities: tuple[Capability | Refused, ...]

    @cached_property
    def components(self) -> dict[str, Deviation]:
        """Scatter of units, of measurements, and of groups."""
        return components(self.series, GROUPS)


def trend_of(
    series: Series,
    *,
    by: str | None = None,
    baseline: int | None = None,
    spread: Spread = Spread.MEDIAN_MOVING_RANGE,
    specification: Limits = Limits(),  # noqa: B008  it is a tuple
) -> Trend:
    """Draw up the charts of a series and compare its groups.

    Parameters
    ----------
    series: All values in order of time.
    by: One chart for each unit, lot, station or fixture. A chart of a unit has all its values. A chart of a station or
        fixture has all values measured there; where units were measured more than once, each is charted by how far it
        is from what its unit lets expect. Other charts have the first value of each unit, since values of one unit
        resemble each other more than those of different units.
    baseline: From how many first points the limits are computed; from all if left out.
    spread: By which rule.
    specification: For the capability.
    """
    if by is None and len(set(series.unit)) == 1:
        by = "unit"
    shifts = level_shifts(series, false_alarm=FALSE_ALARM)
    parts = _parts(series, by, shifts)
    charts = tuple(_chart(part, len(parts), baseline, spread) for part in parts)
    return Trend(
        series=series,
        by=by,
        charts=charts,
        shifts=shifts,
        comparison=compare_groups(series, GROUPS),
        specification=specification,
        capabilities=tuple(_capability(chart, by, specification) for chart in charts),
    )


class _Part(NamedTuple):
    """What stands on one chart: its values, where they stand, and the shifts of their stations."""

    name: str
    series: Series
    charted: FloatArray
    is_adjusted: bool
    shifts: tuple[LevelShift, ...] = ()
    changes: Changes | None = None
    is_unsteady: bool = False


def _parts(series: Series, by: str | None, shifts: LevelShifts | Refused) -> list[_Part]:
    found = []
    places = {"": np.arange(series.value.size)} if by is None else series.places(by)
    for name, at in places.items():
        part = series.where(at)
        if isinstance(shifts, Refused):
            part = part if by == "unit" else part.first_of_units()
            found.append(_Part(name, part, part.value, is_adjusted=False))
            continue
        if by == "unit":
            found.append(_Part(name, part, part.value, is_adjusted=False))
            continue
        stations = set(part.groups["station"])
        own = tuple(each for each in shifts.shifts if each.station in {"", *stations})
        is_unsteady = shifts.unsteady is not None
        if by in {"station", "fixture"}:
            changes = _changes_of(own, at, shifts.points[at]) if by == "station" else None
            found.append(_Part(name, part, shifts.points[at], True, own, changes, is_unsteady))
        else:
            first = part.first_of_units()
            found.append(_Part(name, first, first.value, False, own, None, is_unsteady))
    return found


def _changes_of(shifts: tuple[LevelShift, ...], at: IntArray, points: FloatArray) -> Changes:
    """Shifts as changes of the chart with these values of the series."""
    changes = tuple(
        ChangePoint(
            at=int(np.searchsorted(at, each.at)),
            first=int(np.searchsorted(at, each.first, side="right")),
            last=min(int(np.searchsorted(at, each.last)), at.size - 1),
            size=each.size,
            lo=each.lo,
            hi=each.hi,
        )
        for each in shifts
    )
    edges = sorted({0, *(each.at for each in changes), at.size})
    stretches = [points[first:last] for first, last in pairwise(edges)]
    squares = sum(float(((each - each.mean()) ** 2).sum()) for each in stretches)
    return Changes(
        changes,
        tuple(float(each.mean()) for each in stretches),
        float(np.sqrt(squares / max(at.size - len(stretches), 1))),
        FALSE_ALARM,
    )


def time_axis(series: Series) -> FloatArray:
    """Days from the first value; numbers of the points where dates are not known."""
    if not series.dated:
        return np.arange(series.value.size, dtype=np.float64)
    return np.asarray((series.t_ns - series.t_ns[:1]) / NS_PER_DAY, np.float64)


def _chart(part: _Part, charts: int, baseline: int | None, spread: Spread) -> Chart:
    share = FALSE_ALARM / charts
    values = part.charted
    limits = individuals_chart(values, baseline=baseline, spread=spread)
    changes = change_points(values, false_alarm=share) if part.changes is None else part.changes
    slope = drift(time_axis(part.series), values)
    empty = Chart(
        name=part.name,
        series=part.series,
        charted=values,
        is_adjusted=part.is_adjusted,
        limits=limits,
        z=np.empty(0),
        signals={},
        counts=(0,) * 8,
        averages=None,
        chance=None,
        wild_point=None,
        too_many=None,
        changes=changes,
        drift=slope,
        # a step is a slope too; where there are steps, they are what is told
        drifts=isinstance(slope, Drift)
        and slope.chance <= share
        and not (isinstance(changes, Changes) and changes.points)
        and not part.shifts,
        shifts=part.shifts,
        is_unsteady=part.is_unsteady,
    )
    if isinstance(limits, Refused):
        return empty
    if part.series.is_magnitude:
        empty = empty._replace(limits=limits._replace(lower=max(limits.lower, 0.0)))
    z = (values - limits.centre) / limits.sigma
    flags = rule_flags(z)
    counts = flags.sum(axis=-1)
    chance = None
    if charts <= _MOST_SIMULATED:
        chance = chart_chance(values, counts, baseline=limits.baseline, spread=spread)
    is_wild = wild_point_chance(values) <= share
    return empty._replace(
        z=z,
        signals=points_of(flags, z),
        counts=tuple(int(each) for each in counts),
        averages=ewma_chart(values, limits.centre, limits.sigma),
        chance=chance,
        wild_point=int(np.abs(values - values.mean()).argmax()) if is_wild else None,
        too_many=chance.rule if chance is not None and chance.signals <= share else None,
    )


def _capability(chart: Chart, by: str | None, limits: Limits) -> Capability | Refused:
    if by == "unit":
        return Refused(
            Words("it is of a process with many units, not of one unit", "过程能力针对多个样品，而非单个样品")
        )
    if limits.why_not is not None:
        return Refused(limits.why_not)
    # of units: one that was measured again is no other unit
    units = chart.series.first_of_units()
    return capability(
        units.value,
        limits.lower,
        limits.upper,
        out_of_control=None if chart.in_control is not False else _what_stands_out(chart),
        uncertainty=units.uncertainty,
    )


def _what_stands_out(chart: Chart) -> Words:
    seen = [
        (chart.wild_point is not None, Words("a wild point", "有异常点")),
        (chart.has_changed or bool(chart.shifts), Words("its level changes", "水平发生变化")),
        (chart.is_unsteady, Words("levels wander from session to session", "各次测试间水平不稳定")),
        (chart.drifts, Words("it drifts", "存在漂移")),
        (
            chart.too_many is not None,
            Words(f"rule {chart.too_many} is met more often than by chance", f"判异准则 {chart.too_many} 超出随机预期"),
        ),
    ]
    told = [words for is_so, words in seen if is_so]
    return Words(", ".join(each.en for each in told), "，".join(each.zh for each in told))
