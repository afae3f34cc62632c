"""How likely what a chart shows is by chance: one wild point, or more signals than noise alone gives.

On a chart of 300 points noise alone breaks some rule about four times; only what exceeds that says something.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from analytics.trends.control_chart import Spread, centre_and_sigma
from analytics.trends.nelson_rules import rule_flags
from stream.batch import FloatArray, IntArray

_SIMULATED_POINTS = 1_000_000
_MOST_SERIES = 4000
_LEAST_SERIES = 400
_SEED = 20260101


class ChartChance(NamedTuple):
    """Probabilities under white noise, each of something at least so striking as what the chart shows.

    Parameters
    ----------
    wild_point: Of the most distant point; a bound (Bonferroni), 1 where there are too few points.
    signals: Of the number of signals of the rule that stands out most, all eight taken into account.
    rule: Which rule that is.
    expected: Signals of each rule that white noise gives on such a chart, on average.
    """

    wild_point: float
    signals: float
    rule: int | None
    expected: tuple[float, ...]


class _Null(NamedTuple):
    """Signals of each rule in simulated series, sorted; and the least probability over the rules in each, sorted."""

    counts: IntArray
    least: FloatArray
    mean: tuple[float, ...]


def chart_chance(values: FloatArray, counts: IntArray, *, baseline: int, spread: Spread) -> ChartChance:
    """Judge a chart.

    Parameters
    ----------
    values: shape (points,); in order of time.
    counts: shape (8,); signals of each rule, with limits from the first `baseline` points by `spread`.

    Notes
    -----
    Signals: the same chart is drawn of simulated white noise, with limits from the same points by the same rule, and
    the least of the eight probabilities is compared with the least of the eight in the simulated charts. It cannot be
    found below one over the simulated charts (400 to 4000).
    """
    null = _null(values.size, baseline, spread)
    series = null.counts.shape[1]
    chances = np.array(
        [(series - np.searchsorted(null.counts[rule], counts[rule]) + 1) / (series + 1) for rule in range(len(counts))]
    )
    rule = int(chances.argmin())
    signals = float((np.searchsorted(null.least, chances[rule], side="right") + 1) / (series + 1))
    return ChartChance(wild_point_chance(values), min(signals, 1.0), rule + 1 if counts[rule] else None, null.mean)


def wild_point_chance(values: FloatArray) -> float:
    """Bound on the probability that the most distant of normal values is at least so distant (Grubbs 1950).

    Examples
    --------
    >>> bool(wild_point_chance(np.array([1.0, 2, 3, 2, 1, 2, 3, 2, 40])) < 1e-6)
    True
    """
    n = values.size
    deviations = values - values.mean()
    squares = float(deviations @ deviations)
    if n < 4 or squares <= 0:
        return 1.0
    largest = float(np.max(deviations**2)) * n / (n - 1)
    rest = max(squares - largest, 1e-30 * squares)
    distance = np.sqrt(largest * (n - 2) / rest)
    return float(min(1.0, 2 * n * student.sf(distance, n - 2)))


@lru_cache(maxsize=64)
def _null(points: int, baseline: int, spread: Spread) -> _Null:
    series = int(np.clip(_SIMULATED_POINTS // points, _LEAST_SERIES, _MOST_SERIES))
    rng = np.random.default_rng([_SEED, points, baseline])
    counts = np.empty((8, series), np.int64)
    at_once = max(1, _SIMULATED_POINTS // points // 4)
    for start in range(0, series, at_once):
        noise = rng.standard_normal((min(at_once, series - start), points))
        centre, sigma = centre_and_sigma(noise[:, :baseline], spread)
        z = (noise - centre[:, None]) / sigma[:, None]
        counts[:, start : start + noise.shape[0]] = rule_flags(z).sum(axis=-1)
    ordered = np.sort(counts, axis=1)
    chances = np.array(
        [(series - np.searchsorted(ordered[rule], counts[rule]) + 1) / (series + 1) for rule in range(8)]
    )
    return _Null(ordered, np.sort(chances.min(axis=0)), tuple(float(each) for each in counts.mean(axis=1)))
