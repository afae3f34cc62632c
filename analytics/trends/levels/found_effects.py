"""What a report finds of all units, of single units and of single values, taken off before the rest is compared.

Fitted within units: a unit's own level says nothing of a station, and a station says nothing of a unit.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from analytics.trends.charts.nelson_rules import wild_point_chance
from analytics.trends.groups.between_stations import LEAST_PAIRS, GroupComparison, compare_groups
from analytics.trends.groups.contrasts import less_block_means
from analytics.trends.groups.level_drifts import PLACES, LevelDrift, drift_columns
from analytics.trends.levels.drift import LEAST_POINTS, Drift, drift, shared_noises
from analytics.trends.levels.level_shifts import LevelShift, LevelShifts
from analytics.trends.levels.sessions import LEAST_UNITS
from analytics.trends.series import GROUPS, NS_PER_DAY, MetricSeries
from analytics.trends.words import NotComputed
from stream.batch import FloatArray, IntArray

FALSE_ALARM = 0.01
# more wild values than this are no exceptions
_MOST_WILD_SHARE = 0.05
_MOST_WILD = 20
_MOST_DRIFTING = 20


class FoundEffects(NamedTuple):
    """What is found, and the values without it."""

    wild: tuple[int, ...]  # wild values, by their indices
    drifting: tuple[str, ...]  # units that drift against the others
    shifts: tuple[LevelShift, ...]  # changes of level that are taken off
    # all values that are not wild, without changes of level, drifts of places and what the units that drift do
    rest: MetricSeries
    # shape (n,); values without changes of level, and differences and drifts of stations and fixtures; the mean of each
    # unit remains
    of_units: FloatArray
    comparison: GroupComparison | NotComputed  # of stations, fixtures and lots, without what is found


def found_effects(
    series: MetricSeries, shifts: LevelShifts | NotComputed, drifts: tuple[LevelDrift, ...],
    *, false_alarm: float = FALSE_ALARM,
) -> FoundEffects:  # fmt: skip
    """Compare groups without what is found of all units, of single units and of single values.

    Changes of level are those whose bounds exclude 0 and that three units crossed. A value is wild where it is the
    most distant from the level expected of its unit, by Grubbs' test at `false_alarm` among the values of its station,
    of its fixture and of its lot, and, where the unit has as many values as a chart needs, among those of its unit: so
    neither a place that scatters more nor a unit that drifts makes values wild. A unit drifts where its slope, with
    all of this and differences of stations and fixtures taken off, is significant at `false_alarm` over all units; the
    plainest first, and its own slope is fitted beside the others from then on.
    """
    alike = series.within_products()
    steps = () if isinstance(shifts, NotComputed) else _certain(shifts.shifts)
    known = np.column_stack([_step_columns(series, steps), drift_columns(series, drifts)])
    unit = np.unique(np.array(series.unit), return_inverse=True)[1]
    # beside the places: a change of a station fitted alone takes what differs between stations for its own
    beside = _place_columns(series, PLACES)
    wild = _wild(series, unit, np.column_stack([known, beside]), false_alarm)
    kept = np.setdiff1d(np.arange(series.value.size), wild)
    rest = _without(alike, known, beside, unit, kept)
    comparison = compare_groups(rest, GROUPS, beside=known[kept])
    places = _places_that_differ(comparison, drifts, false_alarm)
    of_all = np.column_stack([known, _place_columns(series, places)])
    drifting = _drifting(series, unit, of_all, kept, false_alarm)
    slopes = _slope_columns(series, drifting)
    if drifting:
        known = np.column_stack([known, slopes])
        rest = _without(alike, known, beside, unit, kept)
        comparison = compare_groups(rest, GROUPS, beside=known[kept])
    effect = _effect(series.value, np.column_stack([of_all, slopes]), unit, kept, of_all.shape[1])
    return FoundEffects(wild, drifting, steps, rest, series.value - less_block_means(effect, unit), comparison)


def _certain(shifts: tuple[LevelShift, ...]) -> tuple[LevelShift, ...]:
    return tuple(each for each in shifts if each.is_certain and each.units >= LEAST_UNITS)


def _step_columns(series: MetricSeries, shifts: tuple[LevelShift, ...]) -> FloatArray:
    """Steps, a column each, 0 after the step of one station: differences of stations are those since then."""
    station, at = np.array(series.groups["station"]), np.arange(series.value.size)
    columns = np.zeros((series.value.size, len(shifts)))
    for column, shift in zip(columns.T, shifts, strict=True):
        is_there = (station == shift.station) | (shift.station == "")
        column[:] = is_there * (at >= shift.at)
        column[is_there] -= 1.0 if shift.station else column[is_there].mean()
    return columns


def _place_columns(series: MetricSeries, groups: tuple[str, ...]) -> FloatArray:
    """Indicators of all levels of groups but the first."""
    columns = [np.empty((series.value.size, 0))]
    for group in groups:
        levels, code = np.unique(np.array(series.groups[group]), return_inverse=True)
        columns.append((code[:, None] == np.arange(1, levels.size)).astype(np.float64))
    return np.column_stack(columns)


def _days(series: MetricSeries) -> FloatArray:
    if not series.dated:
        return np.arange(series.value.size, dtype=np.float64)
    return np.asarray((series.t_ns - series.t_ns[:1]) / NS_PER_DAY, np.float64)


def _slope_columns(series: MetricSeries, units: tuple[str, ...]) -> FloatArray:
    """Time at each of the units, from its mean there."""
    time, names = _days(series), np.array(series.unit)
    columns = np.zeros((series.value.size, len(units)))
    for column, name in zip(columns.T, units, strict=True):
        own = names == name
        column[own] = time[own] - time[own].mean()
    return columns


def _effect(
    value: FloatArray, columns: FloatArray, unit: IntArray, kept: IntArray, first: int | None = None
) -> FloatArray:
    """What the columns, or the first of them, do to each value, fitted within units to the values that are kept."""
    if not columns.shape[1]:
        return np.zeros(value.size)
    block = np.unique(unit[kept], return_inverse=True)[1]
    within = less_block_means(columns[kept], block)
    # a column that no unit tells has no effect
    size = np.linalg.lstsq(within, less_block_means(value[kept], block), rcond=1e-9)[0]
    return np.asarray(columns[:, :first] @ size[:first], np.float64)


def _without(
    series: MetricSeries, known: FloatArray, beside: FloatArray, unit: IntArray, kept: IntArray
) -> MetricSeries:
    """The values that are kept, without what is known; fitted beside other columns."""
    effect = _effect(series.value, np.column_stack([known, beside]), unit, kept, known.shape[1])
    return replace(series, value=series.value - effect).where(kept)


def _places_that_differ(
    comparison: GroupComparison | NotComputed, drifts: tuple[LevelDrift, ...], false_alarm: float
) -> tuple[str, ...]:
    found = {each.group for each in drifts}
    if not isinstance(comparison, NotComputed):
        found |= {
            each.group
            for each in comparison.differences
            if each.adjusted <= false_alarm and each.on_both >= LEAST_PAIRS
        }
    return tuple(group for group in PLACES if group in found)


def _wild(series: MetricSeries, unit: IntArray, columns: FloatArray, false_alarm: float) -> tuple[int, ...]:
    """Indices of the wild values; of a unit with two values, which do not tell, both."""
    groups = [np.unique(np.array(series.groups[name]), return_inverse=True)[1] for name in GROUPS]
    found: list[int] = []
    kept = np.flatnonzero(np.bincount(unit)[unit] > 1)  # others have no distance from their unit's level
    while len(found) < min(_MOST_WILD, _MOST_WILD_SHARE * series.value.size) and kept.size:
        block = np.unique(unit[kept], return_inverse=True)[1]
        within = less_block_means(columns[kept], block)
        off = less_block_means(series.value[kept], block)
        off = off - within @ np.linalg.lstsq(within, off, rcond=1e-9)[0] if columns.shape[1] else off
        place = int(np.abs(off).argmax())
        own = block == block[place]
        among = [(code[kept] == code[kept[place]], int(code.max()) + 1) for code in groups] + [(own, 1)]
        among = [each for each in among if each[0].sum() >= LEAST_POINTS]
        if not among or any(wild_point_chance(off[same]) * levels > false_alarm for same, levels in among):
            break
        out = kept[own] if own.sum() == 2 else kept[[place]]
        found += out.tolist()
        kept = np.setdiff1d(kept, out)
    return tuple(sorted(found))


def _drifting(
    series: MetricSeries, unit: IntArray, of_all: FloatArray, kept: IntArray, false_alarm: float
) -> tuple[str, ...]:
    places = {name: np.intersect1d(at, kept) for name, at in series.places("unit").items()}
    places = {name: at for name, at in places.items() if at.size >= LEAST_POINTS}
    time = _days(series)
    found: list[str] = []
    while len(found) < _MOST_DRIFTING:
        columns = np.column_stack([of_all, _slope_columns(series, tuple(found))])
        level = series.value - _effect(series.value, columns, unit, kept, of_all.shape[1])
        noises = shared_noises([(time[at], level[at]) for at in places.values()])
        slopes = {
            name: drift(time[at], level[at], noises=noises[number])
            for number, (name, at) in enumerate(places.items())
            if name not in found
        }
        chances = {name: each.chance for name, each in slopes.items() if isinstance(each, Drift)}
        plainest = min(chances, key=chances.__getitem__, default=None)
        if plainest is None or chances[plainest] * len(places) > false_alarm:
            break
        found.append(plainest)
    return tuple(sorted(found))
