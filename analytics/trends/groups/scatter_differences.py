"""Stations, fixtures and lots whose values scatter more, or less, than those of the others."""

from typing import NamedTuple

import numpy as np
from scipy.special import stdtr, stdtrit

from analytics.trends.series import GROUPS, MetricSeries
from stream.batch import FloatArray

LEAST_PAIRS = 8
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

    Values at one level are taken in pairs, in order of time: of one unit where units were measured there again, else of
    one product, so that neither a step nor a drift of the level widens their differences. The square roots of the
    distances within pairs, nearly normal, are compared by Welch's test; the ratio is the square of that of their means.
    """
    found: list[ScatterDifference] = []
    tested = 0
    for group in groups:
        for is_within_units in (True, False):
            roots = _roots_of_levels(series, group, series.unit if is_within_units else series.groups.get("product"))
            if len(roots) < 2:
                continue
            for level, own in roots.items():
                others = np.concatenate([each for name, each in roots.items() if name != level])
                if own.any() and others.any():
                    tested += 1
                    found.append(ScatterDifference(group, level, is_within_units, *_ratio(own, others)))
            break
    return tuple(each._replace(chance=min(1.0, each.chance * tested)) for each in found)


def _roots_of_levels(series: MetricSeries, group: str, alike: list[str] | None) -> dict[str, FloatArray]:
    """Square roots of the distances within pairs of values that are alike, of each level with enough of them."""
    levels = np.array(series.groups[group])
    kinds = np.zeros(levels.size) if alike is None else np.unique(np.array(alike), return_inverse=True)[1]
    found = {}
    for level in np.unique(levels):
        own = np.flatnonzero(levels == level)
        own = own[np.lexsort((series.t_ns[own], kinds[own]))]
        # pairs of neighbours of one kind; of an odd number the last is left over
        begins = np.flatnonzero(np.r_[True, kinds[own][1:] != kinds[own][:-1]])
        place = np.arange(own.size) - np.repeat(begins, np.diff(np.r_[begins, own.size]))
        second = np.flatnonzero(place % 2 == 1)
        if second.size >= LEAST_PAIRS:
            found[str(level)] = np.sqrt(np.abs(series.value[own[second]] - series.value[own[second - 1]]))
    return found


def _ratio(own: FloatArray, others: FloatArray) -> tuple[float, float, float, float]:
    """Ratio of two scatters with bounds, and the chance that equal ones show it."""
    squares = np.array([each.var(ddof=1) / each.size for each in (own, others)])
    freedom = squares.sum() ** 2 / (squares**2 / np.array([own.size - 1, others.size - 1])).sum()
    t = (own.mean() - others.mean()) / np.sqrt(squares.sum())
    # of the logarithm of each mean, by the delta method
    relative = np.sqrt((squares / np.array([own.mean(), others.mean()]) ** 2).sum())
    half = float(stdtrit(freedom, 0.5 + _CONFIDENCE / 2) * 2 * relative)
    ratio = float((own.mean() / others.mean()) ** 2)
    return ratio, ratio * np.exp(-half), ratio * np.exp(half), float(2 * stdtr(freedom, -abs(t)))
