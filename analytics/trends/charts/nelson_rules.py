"""Nelson's eight rules for a chart of individual values, and the probability of its signals in noise.

L. S. Nelson, Journal of Quality Technology 16, 1984, 237-239. On a chart of 300 points noise alone meets some rule
about four times; only what exceeds that is significant.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from analytics.methods.distributions import student_sf
from analytics.trends.charts.control_chart import Spread, centre_and_sigma
from analytics.trends.wander import NOISES, Noise, simulated
from analytics.trends.words import words
from stream.batch import FloatArray, IntArray

BoolArray = NDArray[np.bool_]

_SIMULATED_POINTS = 1_000_000
_MOST_SERIES = 4000
_LEAST_SERIES = 400
_SEED = 20260101

RULES = tuple(words(f"rule_{number}") for number in range(1, 9))
LENGTHS = (1, 9, 6, 14, 3, 5, 15, 8)  # points that each rule looks at together


def rule_flags(z: FloatArray) -> BoolArray:
    """Where each rule is met, shape (8, ..., points): True at the last point of each pattern.

    `z` of shape (..., points) is (value - centre)/sigma, in order of time, of one series or several. White noise with
    known centre and sigma first meets a rule after so many points, on average: 370 (rule 1), 511 (2), 422 (3), 600 (4),
    512 (5), 292 (6), 963 (7), 14,000 (8); one of the eight after 74. One signal is not significant: see `chart_chance`.

    >>> flags = rule_flags(np.array([0.1] * 8 + [3.5]))
    >>> [number + 1 for number in range(8) if flags[number, -1]]
    [1, 2]
    """
    above, below = z > 0, z < 0
    steps = np.diff(z, axis=-1)
    turning = np.sign(steps[..., 1:]) * np.sign(steps[..., :-1]) < 0
    flags = np.zeros((len(RULES), *z.shape), bool)
    flags[0] = np.abs(z) > 3
    flags[1] = _of_last(above, 9, 9) | _of_last(below, 9, 9)
    flags[2, ..., 1:] = _of_last(steps > 0, 5, 5) | _of_last(steps < 0, 5, 5)
    flags[3, ..., 2:] = _of_last(turning, 12, 12)
    for rule, (sigma, least, of) in ((4, (2.0, 2, 3)), (5, (1.0, 4, 5))):
        # the point that completes the pattern is one of those outside
        flags[rule] = (_of_last(z > sigma, least, of) & (z > sigma)) | (_of_last(z < -sigma, least, of) & (z < -sigma))
    flags[6] = _of_last(np.abs(z) < 1, 15, 15)
    flags[7] = _of_last(np.abs(z) > 1, 8, 8)
    return flags


def points_of(flags: BoolArray, z: FloatArray) -> dict[int, list[int]]:
    """All points in the patterns of each rule that is met, by its number, 1 to 8.

    >>> z = np.array([0.0, 2.5, 0.0, 2.2, 0.0])
    >>> points_of(rule_flags(z), z)
    {5: [1, 3]}
    """
    found = {}
    for rule, (flag, length) in enumerate(zip(flags, LENGTHS, strict=True)):
        ends = np.flatnonzero(flag)
        if not ends.size:
            continue
        taking_part = np.zeros(z.size, bool)
        for end in ends:
            window = slice(max(0, int(end) - length + 1), int(end) + 1)
            if rule in {4, 5}:
                taking_part[window] |= z[window] * np.sign(z[end]) > (2.0 if rule == 4 else 1.0)
            else:
                taking_part[window] = True
        found[rule + 1] = [int(each) for each in np.flatnonzero(taking_part)]
    return found


def _of_last(condition: BoolArray, least: int, of: int) -> BoolArray:
    """Whether at least so many of the last `of` are true; before the first point nothing is."""
    if least == of:
        met = np.zeros(condition.shape, bool)
        if condition.shape[-1] >= of:
            met[..., of - 1 :] = sliding_window_view(condition, of, axis=-1).all(axis=-1)
        return met
    if condition.shape[-1] == 0:
        return condition.copy()
    padded = np.concatenate([np.zeros((*condition.shape[:-1], of - 1), bool), condition], axis=-1)
    return np.asarray(sliding_window_view(padded, of, axis=-1).sum(axis=-1) >= least)


class ChartChance(NamedTuple):
    """Probabilities in noise alone of results at least as extreme as those of the chart."""

    wild_point: float  # of the most distant point; a bound (Bonferroni), 1 where there are too few points
    signals: float  # of the number of signals of the most significant rule, adjusted for all eight
    rule: int | None  # that rule
    expected: tuple[float, ...]  # mean number of signals of each rule on such a chart of noise


class _NullSignals(NamedTuple):
    counts: IntArray  # signals of each rule in simulated noise, sorted
    least: FloatArray  # the least probability over the rules in each series, sorted
    mean: tuple[float, ...]


def chart_chance(
    values: FloatArray, counts: IntArray, *, baseline: int, spread: Spread, noise: Noise = NOISES[0]
) -> ChartChance:
    """Significance of a chart whose rules have these `counts` of signals.

    White noise, and `noise` where points are correlated, are simulated on the same chart, with limits from the same
    points by the same rule, and the least of the eight probabilities is compared with the least of the eight in the
    simulated charts; the larger result counts. Its lower end is one over the simulated charts (400 to 4000).
    """
    wild_point = wild_point_chance(values)
    found = []
    for each in dict.fromkeys((NOISES[0], noise)):
        null = _null(values.size, baseline, spread, each)
        series = null.counts.shape[1]
        chances = np.array([_chances(of_rule, count) for of_rule, count in zip(null.counts, counts, strict=True)])
        rule = int(chances.argmin())
        signals = float((np.searchsorted(null.least, chances[rule], side="right") + 1) / (series + 1))
        found.append(ChartChance(wild_point, min(signals, 1.0), rule + 1 if counts[rule] else None, null.mean))
    return max(found, key=lambda each: each.signals)


def wild_point_chance(values: FloatArray) -> float:
    """Bound on the probability that the most distant of normal values is at least this distant (Grubbs 1950)."""
    n = values.size
    deviations = values - values.mean()
    squares = float(deviations @ deviations)
    if n < 4 or squares <= 0:
        return 1.0
    largest = float(np.max(deviations**2)) * n / (n - 1)
    rest = max(squares - largest, 1e-30 * squares)
    distance = np.sqrt(largest * (n - 2) / rest)
    return min(1.0, 2 * n * student_sf(distance, n - 2))


@lru_cache(maxsize=64)
def _null(points: int, baseline: int, spread: Spread, noise: Noise) -> _NullSignals:
    series = int(np.clip(_SIMULATED_POINTS // points, _LEAST_SERIES, _MOST_SERIES))
    rng = np.random.default_rng([_SEED, points, baseline])
    counts = np.empty((8, series), np.int64)
    at_once = max(1, _SIMULATED_POINTS // points // 4)
    for start in range(0, series, at_once):
        values = simulated(noise, min(at_once, series - start), points, rng)
        centre, sigma = centre_and_sigma(values[:, :baseline], spread)
        z = (values - centre[:, None]) / sigma[:, None]
        counts[:, start : start + values.shape[0]] = rule_flags(z).sum(axis=-1)
    ordered = np.sort(counts, axis=1)
    chances = np.array([_chances(*pair) for pair in zip(ordered, counts, strict=True)])
    return _NullSignals(ordered, np.sort(chances.min(axis=0)), tuple(float(each) for each in counts.mean(axis=1)))


def _chances(ordered: IntArray, counts: IntArray) -> FloatArray:
    """Shares of simulated counts that are at least as large."""
    return np.asarray((ordered.size - np.searchsorted(ordered, counts) + 1) / (ordered.size + 1), np.float64)
