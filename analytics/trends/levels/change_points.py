"""Changes of the level of a series whose noise may wander from point to point."""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter
from scipy.optimize import brentq
from scipy.special import stdtr

from analytics.trends.charts.control_chart import sigma_of_ranges
from analytics.trends.levels.change_search import ChangeSearch
from analytics.trends.levels.divisions import divisions
from analytics.trends.wander import NOISES, Noise
from analytics.trends.words import NotComputed, not_computed
from stream.batch import FloatArray

LEAST_POINTS = 12
MOST_CHANGES = 8
_CONFIDENCE = 0.95
_OUTLIER = 5.0
_NEIGHBOURS = 7
_MOST_POINTS = 5000
_MOST_REFINEMENTS = 5
_LONG = 60
# evidence for a line beyond that for steps with which it is preferred: a ratio of e
_CLEARLY = 2.0


class ChangePoint(NamedTuple):
    """A change of level."""

    at: int  # first point of the new level
    first: int  # earliest and latest such point with 95 % confidence
    last: int
    size: float  # change of the level with 95 % bounds, in the unit of the values
    lo: float
    hi: float

    @property
    def is_certain(self) -> bool:
        """Whether its bounds exclude no change."""
        return not self.lo <= 0.0 <= self.hi


class Changes(NamedTuple):
    """The changes of level of a series."""

    points: tuple[ChangePoint, ...]  # in order; empty where the level is constant
    levels: tuple[float, ...]  # of the segments
    sigma: float  # standard deviation about the levels
    false_alarm: float  # probability that noise alone, independent or wandering, shows any change
    is_drift: bool = False  # whether a straight line describes the series as well: then there are no points
    noise: Noise | None = None  # the most probable noise about the levels; None where it was not sought


def change_points(values: FloatArray, *, false_alarm: float = 0.01) -> Changes | NotComputed:
    """Find the changes of level in a series whose noise may be correlated from point to point.

    values = levels + wander + scatter, where the wander is autoregressive with any correlation from 0 to 0.99 and
    any share of the variance. The evidence for a change is how much more probable it makes the values, averaged
    over all moments and noises, with flat priors of levels and variance; a change counts where noise alone, with a
    correlation of up to 0.8, shows such evidence with at most about the probability `false_alarm`. Two changes at
    once, a bump that returns, are tried as well. Outliers, beyond 5 standard deviations from the median of their
    neighbours, are clipped to there first. Where a straight line makes the series more probable, it drifts and does
    not change. The bounds hold 95 % of the probability of moment and size over all noises.

    >>> series = np.random.default_rng(1).standard_normal(60) + np.repeat([0.0, 4.0], [40, 20])
    >>> found = change_points(series)
    >>> [(each.at, each.lo < 4.0 < each.hi) for each in found.points]
    [(40, True)]
    """
    n = values.size
    if n < LEAST_POINTS or n > _MOST_POINTS:
        return not_computed("changes_short", points=n, least=LEAST_POINTS, most=_MOST_POINTS)
    middle, scale = float(values.mean()), float(values.std())
    if not scale > 1e-12 * abs(middle):
        return Changes((), (middle,), 0.0, false_alarm)
    tame = clipped((values - middle) / scale)
    moments, gained = _found(tame, false_alarm)
    line = ChangeSearch(tame).of_line() - charge(1, n, false_alarm)
    is_drift = bool(moments) and line >= gained + _CLEARLY
    moments = () if is_drift else moments
    edges = [0, *moments, n]
    levels = tuple(float(values[first:last].mean()) for first, last in pairwise(edges))
    squares = sum(float(np.sum((tame[a:b] - tame[a:b].mean()) ** 2)) for a, b in pairwise(edges))
    sigma = scale * math.sqrt(squares / (n - len(moments) - 1))
    points = tuple(_located(tame, moments, at, scale) for at in moments)
    noise = NOISES[int(ChangeSearch(tame, moments).noise_weights().argmax())]
    return Changes(points, levels, sigma, false_alarm, is_drift, noise)


def charge(changes: int, points: int, false_alarm: float) -> float:
    """Evidence that one change needs, or two at once.

    At 1 % the largest quantile of simulated series of 12 to 600 points that wander with a correlation of up to 0.8
    (``python -m tests.bench.change_points --calibrate``); beyond it falls as the likelihood ratio does.

    >>> charge(1, 90, 0.01) < charge(2, 90, 0.01) < charge(2, 90, 0.001)
    True
    """
    return _CHARGES[changes] + 2 * points / (points - 3) * math.log(0.01 / false_alarm)


_CHARGES = {1: 11.3, 2: 18.0}


def _found(values: FloatArray, false_alarm: float) -> tuple[tuple[int, ...], float]:
    """Moments of the changes, and by how much their evidence exceeds its charges."""
    moments, gained = _one_by_one(values, false_alarm)
    if values.size < _LONG:
        return moments, gained
    # in long series several changes together look like a slow wander as long as one of them is missing
    search = ChangeSearch(values)
    for division in divisions(values, MOST_CHANGES)[1:]:
        evidence = search.of_changes(division) - len(division) * charge(1, values.size, false_alarm)
        if evidence > gained:
            moments, gained = _refined(values, division), evidence
    return moments, gained


def _one_by_one(values: FloatArray, false_alarm: float) -> tuple[tuple[int, ...], float]:
    """The same by adding one or two changes at a time."""
    n = values.size
    moments: tuple[int, ...] = ()
    gained = 0.0
    while len(moments) < MOST_CHANGES:
        search = ChangeSearch(values, moments)
        one, two = search.one(), search.two()
        more = [] if one is None else [(one.ratio - charge(1, n, false_alarm), one.at)]
        if two is not None and len(moments) + 2 <= MOST_CHANGES:
            more.append((two.ratio - charge(2, n, false_alarm), two.at))
        # one change that suffices is taken alone: the second is sought beside it
        chosen = next((each for each in more if each[0] > 0), None)
        if chosen is None:
            break
        gained += chosen[0]
        moments = _refined(values, (*moments, *chosen[1]))
    return moments, gained


def _refined(values: FloatArray, moments: tuple[int, ...]) -> tuple[int, ...]:
    """Each moment at its most probable place beside the others, until none moves."""
    for _ in range(_MOST_REFINEMENTS):
        before = moments
        for at in before:
            others = tuple(each for each in moments if each != at)
            best = ChangeSearch(values, others).one()
            if best is not None:
                moments = tuple(sorted((*others, *best.at)))
        if moments == before:
            break
    return tuple(sorted(moments))


def clipped(values: FloatArray) -> FloatArray:
    """Outliers clipped to 5 standard deviations from the median of their neighbours."""
    middle = median_filter(values, size=_NEIGHBOURS, mode="reflect")
    sigma = sigma_of_ranges(values)
    return np.asarray(np.clip(values, middle - _OUTLIER * sigma, middle + _OUTLIER * sigma))


def _located(values: FloatArray, moments: tuple[int, ...], at: int, scale: float) -> ChangePoint:
    """One change beside the others: where and how large, with bounds over all moments and noises."""
    others = tuple(each for each in moments if each != at)
    found = ChangeSearch(values, others).moments()
    # the other changes divide the series: this one lies between its own neighbours
    left = max((each for each in others if each < at), default=0)
    right = min((each for each in others if each > at), default=values.size)
    near = (found.at > left) & (found.at < right)
    of_moment = found.weight[:, near].sum(axis=0)
    order = np.argsort(-of_moment, kind="stable")
    within = order[: int(np.searchsorted(np.cumsum(of_moment[order]), _CONFIDENCE * of_moment.sum())) + 1]
    live = found.weight[:, near] > 1e-9
    weight, sizes, errors = (each[:, near][live] for each in (found.weight, found.size, found.error))
    weight = weight / weight.sum()
    mean = float(weight @ sizes)
    far = 50 * float(errors.max()) + float(np.ptp(sizes)) + 1.0

    def below(size: float) -> float:
        return float(weight @ stdtr(found.freedom, (size - sizes) / errors))

    tail = (1 - _CONFIDENCE) / 2
    lo, hi = (float(brentq(lambda size, p=p: below(size) - p, mean - far, mean + far)) for p in (tail, 1 - tail))
    places = found.at[near][within]
    return ChangePoint(at, int(places.min()), int(places.max()), mean * scale, lo * scale, hi * scale)
