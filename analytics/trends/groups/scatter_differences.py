"""Stations, fixtures and lots whose values scatter more, or less, than those of the others."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import stdtr, stdtrit

from analytics.trends.groups.contrasts import less_block_means
from analytics.trends.groups.nested_units import alone
from analytics.trends.series import GROUPS, NS_PER_DAY, MetricSeries
from analytics.trends.words import Words, group_name, listed, words
from stream.batch import BoolArray, FloatArray

LEAST_PAIRS = 8
_FEWEST_OF_DAY = 3
_MOST_LEVELS = 200
_CONFIDENCE = 0.95


class ScatterDifference(NamedTuple):
    """A level of a group whose values scatter by another standard deviation than those of the others."""

    group: str
    level: str
    is_within_units: bool  # whether it is of measurements of one unit, else of values from unit to unit
    ratio: float  # to the scatter of the others, with 95 % bounds
    lo: float
    hi: float
    chance: float  # probability of such a ratio by chance, adjusted for all levels that were compared


class ScatterComparison(NamedTuple):
    """The scatter of levels of groups against that of the others, and what was not compared."""

    differences: tuple[ScatterDifference, ...]
    left_out: tuple[Words, ...]


def scatter_differences(
    series: MetricSeries, groups: tuple[str, ...] = GROUPS, *, of_units: FloatArray | None = None
) -> ScatterComparison:
    """Compare the scatter of each level of groups with that of the other levels.

    Values at one level are taken in pairs. The first values of units, where each unit is of one level, as of one lot:
    a pair are neighbours in time of one station, fixture, lot and product. Measurements of one unit, where units were
    measured more than once: a pair is of one unit, each value less its unit's own mean, then taken from the mean of its
    day at the level and station; days with few values give no result. So neither a step nor a slow drift widens the
    differences. The square roots of the distances within pairs, nearly normal, are compared by Welch's test; the ratio
    is the square of that of their means. `of_units`: the values without what is found of stations and fixtures; by
    default as they are.
    """
    found: list[ScatterDifference] = []
    left_out: list[Words] = []
    within = series if of_units is None else replace(series, value=of_units)
    for group in groups:
        if not 1 < len(set(series.groups[group])) <= _MOST_LEVELS:
            continue
        for differences, why_not in (_between_units(series, group), _within_units(within, group)):
            found += differences
            left_out += why_not
    adjusted = (each._replace(chance=min(1.0, each.chance * len(found))) for each in found)
    return ScatterComparison(tuple(adjusted), tuple(left_out))


_Compared = tuple[list[ScatterDifference], list[Words]]


def _between_units(series: MetricSeries, group: str) -> _Compared:
    """The scatter from unit to unit, by the first value of each."""
    if len(set(zip(series.unit, series.groups[group], strict=True))) > len(set(series.unit)):
        return [], []  # the same units were measured at several levels: these say nothing of their spread
    first = series.first_of_units()
    like = zip(*(first.groups.get(name, [""] * first.value.size) for name in (*GROUPS, "product")), strict=True)
    alike = ["\0".join(each) for each in like]
    roots = _roots_of_levels(first, group, alike, first.value, np.ones(first.value.size, np.bool_))
    return _compared(first, group, roots, is_within_units=False)


def _within_units(series: MetricSeries, group: str) -> _Compared:
    """The scatter of measurements of one unit."""
    if len(set(series.unit)) == series.value.size:
        return [], []
    off = _within_days(series, group)
    if off is None:
        of = words("scatter_of", of=words("scatter_within"), group=group_name(group))
        return [], [words("scatter_days", of=of, least=_FEWEST_OF_DAY)]
    single = alone(series, group)
    roots = _roots_of_levels(series, group, series.unit, *off)
    found, left_out = _compared(
        series, group, {level: own for level, own in roots.items() if level not in single}, is_within_units=True
    )
    if own := sorted(roots.keys() & set(single)):
        of = words("scatter_of", of=words("scatter_within"), group=group_name(group))
        left_out.append(words("scatter_units", of=of, names=listed(own)))
    return found, left_out


def _compared(series: MetricSeries, group: str, roots: Mapping[str, FloatArray], *, is_within_units: bool) -> _Compared:
    found = []
    for level, own in roots.items():
        others = [each for name, each in roots.items() if name != level]
        if others and own.any() and np.concatenate(others).any():
            found.append(ScatterDifference(group, level, is_within_units, *_ratio(own, np.concatenate(others))))
    few = sorted(set(series.groups[group]) - set(roots) - set(alone(series, group) if is_within_units else ()))
    of = words(
        "scatter_of", of=words("scatter_within" if is_within_units else "scatter_first"), group=group_name(group)
    )
    return found, [words("scatter_few", of=of, names=listed(few), least=LEAST_PAIRS)] if few else []


def _roots_of_levels(
    series: MetricSeries, group: str, alike: list[str], value: FloatArray, is_kept: BoolArray
) -> dict[str, FloatArray]:
    """Square roots of the distances within pairs of values that are alike, of each level with enough of them."""
    levels = np.array(series.groups[group])
    kinds = np.unique(np.array(alike), return_inverse=True)[1]
    found = {}
    for level in np.unique(levels):
        own = np.flatnonzero((levels == level) & is_kept)
        own = own[np.lexsort((series.t_ns[own], kinds[own]))]
        # pairs of neighbours of one kind; of an odd number the last is left over
        begins = np.flatnonzero(np.r_[True, kinds[own][1:] != kinds[own][:-1]])
        place = np.arange(own.size) - np.repeat(begins, np.diff(np.r_[begins, own.size]))
        second = np.flatnonzero(place % 2 == 1)
        if second.size >= LEAST_PAIRS:
            found[str(level)] = np.sqrt(np.abs(value[own[second]] - value[own[second - 1]]))
    return found


def _within_days(series: MetricSeries, group: str) -> tuple[FloatArray, BoolArray] | None:
    """Values less the mean of their day at their level and station, scaled to the scatter of one, and which have one.

    None where most days have fewer than three values there.
    """
    if not series.dated or not series.value.size:
        return None
    names = zip(series.groups[group], series.groups["station"], (series.t_ns // NS_PER_DAY).tolist(), strict=True)
    numbers: dict[tuple[str, str, int], int] = {}
    day = np.array([numbers.setdefault(name, len(numbers)) for name in names])
    counts = np.bincount(day)[day]
    if np.median(counts) < _FEWEST_OF_DAY:
        return None
    # units differ by more than each scatters: the mean of a day is not to depend on which of them were there
    unit = np.unique(np.array(series.unit), return_inverse=True)[1]
    off = less_block_means(less_block_means(series.value, unit), day)
    return off / np.sqrt(1.0 - 1.0 / np.maximum(counts, 2)), counts >= _FEWEST_OF_DAY


def _ratio(own: FloatArray, others: FloatArray) -> tuple[float, float, float, float]:
    """Ratio of two scatters with bounds, and the chance that equal ones show it."""
    squares = np.array([each.var(ddof=1) / each.size for each in (own, others)])
    freedom = squares.sum() ** 2 / (squares**2 / np.array([own.size - 1, others.size - 1])).sum()
    t = (own.mean() - others.mean()) / np.sqrt(squares.sum())
    # of the logarithm of each mean, by the delta method
    relative = np.sqrt((squares / np.array([own.mean(), others.mean()]) ** 2).sum())
    half = float(stdtrit(freedom, 0.5 + _CONFIDENCE / 2) * 2 * relative)
    ratio = float((own.mean() / others.mean()) ** 2)
    bounds = (ratio * math.exp(-half), ratio * math.exp(half))
    return ratio, *bounds, float(2 * stdtr(freedom, -abs(t)))
