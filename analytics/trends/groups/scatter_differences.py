"""Stations, fixtures and lots whose values scatter more, or less, than those of the others."""

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.special import stdtr, stdtrit

from analytics.trends.series import GROUPS, NS_PER_DAY, MetricSeries
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


def scatter_differences(series: MetricSeries, groups: tuple[str, ...] = GROUPS) -> tuple[ScatterDifference, ...]:
    """Compare the scatter of each level of groups with that of the other levels.

    Values at one level are taken in pairs. Where units were measured more than once, a pair is of one unit, each value
    taken from the mean of its day at the level and station; days with few values give no result.
    Else a pair are neighbours in time of one station, fixture, lot and product. So neither a step nor a slow drift
    widens the differences. The square roots of the distances within pairs, nearly normal, are compared by Welch's
    test; the ratio is the square of that of their means.
    """
    is_repeated = len(set(series.unit)) < series.value.size
    like = zip(*(series.groups.get(name, [""] * series.value.size) for name in (*GROUPS, "product")), strict=True)
    alike = series.unit if is_repeated else ["\0".join(each) for each in like]
    found: list[ScatterDifference] = []
    for group in groups:
        levels = np.array(series.groups[group])
        if np.unique(levels).size > _MOST_LEVELS:
            continue
        value, is_kept = series.value, np.ones(levels.size, np.bool_)
        if is_repeated:
            if (off := _within_days(series, levels)) is None:
                continue
            value, is_kept = off
        roots = _roots_of_levels(series, levels, alike, value, is_kept)
        for level, own in roots.items():
            others = [each for name, each in roots.items() if name != level]
            if others and own.any() and np.concatenate(others).any():
                found.append(ScatterDifference(group, level, is_repeated, *_ratio(own, np.concatenate(others))))
    return tuple(each._replace(chance=min(1.0, each.chance * len(found))) for each in found)


def _roots_of_levels(
    series: MetricSeries, levels: "np.ndarray[Any, Any]", alike: list[str], value: FloatArray, is_kept: BoolArray
) -> dict[str, FloatArray]:
    """Square roots of the distances within pairs of values that are alike, of each level with enough of them."""
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


def _within_days(series: MetricSeries, levels: "np.ndarray[Any, Any]") -> tuple[FloatArray, BoolArray] | None:
    """Values less the mean of their day at their level and station, scaled to the scatter of one, and which have one.

    None where most days have fewer than three values there.
    """
    if not series.dated or not series.value.size:
        return None
    names = zip(levels.tolist(), series.groups["station"], (series.t_ns // NS_PER_DAY).tolist(), strict=True)
    numbers: dict[tuple[str, str, int], int] = {}
    day = np.array([numbers.setdefault(name, len(numbers)) for name in names])
    counts = np.bincount(day)[day]
    if np.median(counts) < _FEWEST_OF_DAY:
        return None
    off = series.value - (np.bincount(day, series.value) / np.bincount(day))[day]
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
