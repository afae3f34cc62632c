"""Whether the level of a growing series has changed, looked at as often as one likes."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from analytics.trends.levels.change_points import clipped
from analytics.trends.wander import NOISES, prior, reduced
from analytics.trends.words import NotComputed, not_computed
from stream.batch import FloatArray, IntArray

LEAST_POINTS = 8
# points at the new level before it can be seen: one wild point is no change
_LEAST_AFTER = 3
# slower wanders explain every step: beside them one is seen after more than twice as many points
_MOST_CORRELATION = 0.8
# prior standard deviation of a change, in standard deviations of the noise
_LIKELY_SIZE = 3.0


class LevelWatch(NamedTuple):
    """What the points so far say of a change of level."""

    # factor by which a change at any moment makes the points more probable than the noise that suits them best
    evidence: float
    at: int  # first point of the new level, if there is one

    def alarms(self, false_alarm: float) -> bool:
        """Whether there is a change; a steady series ever alarms with at most this probability."""
        return self.evidence * false_alarm >= 1.0


def level_watch(values: FloatArray) -> LevelWatch | NotComputed:
    """Evidence for a change of level in the points so far: an e-process.

    E_n = sum over moments k of w_k*m(k) / max over noises of m(none). Each m is the probability of the points with
    their level and scale integrated out (right Haar prior), a normal prior of the size of the change, and noise that is
    independent or wanders (`wander.NOISES` up to a correlation of 0.8). Over a steady series with any of these noises
    the mean of E_n is at most 1 wherever one stops, so that it exceeds 1/a at any time with at most the probability a
    (Ville): it may be asked after each point, for months. Shin, Ramdas, Rinaldo 2023, doi:10.51387/23-NEJSDS51;
    Hendriksen, de Heide, Grunwald 2021, doi:10.1214/20-BA1234.

    >>> steady = np.random.default_rng(1).standard_normal(60)
    >>> level_watch(steady).alarms(0.01), level_watch(steady + np.repeat([0, 5], [40, 20])).at
    (False, 40)
    """
    n = values.size
    if n < LEAST_POINTS:
        return not_computed("watch_short", points=n, least=LEAST_POINTS)
    middle, scale = float(np.median(values)), float(values.std())
    if not scale > 1e-12 * abs(middle):
        return LevelWatch(0.0, 0)
    found = reduced(clipped((values - middle) / scale), np.ones((1, n)))
    slow, weights = _suspects(), _weights(n)
    moments = np.arange(1, n - _LEAST_AFTER + 1)
    across, information = (each[slow][:, moments] for each in (found.across, found.information))
    squares, log_prior = found.squares[slow, None], np.log(prior()[slow] / prior()[slow].sum())
    gained = -0.5 * found.freedom * np.log(1 - across**2 / (information + _LIKELY_SIZE**-2) / squares)
    gained -= 0.5 * np.log1p(_LIKELY_SIZE**2 * information)
    steady = found.log_likelihood[slow]
    weighted = gained + (steady + log_prior)[:, None] + np.log(weights[moments])
    to_come = np.logaddexp.reduce(steady + log_prior) + math.log(1 - weights.sum())
    total = float(np.logaddexp(np.logaddexp.reduce(weighted, axis=None), to_come) - steady.max())
    at = int(moments[np.logaddexp.reduce(weighted, axis=0).argmax()])
    return LevelWatch(math.exp(min(total, 700.0)), at)


@lru_cache
def _suspects() -> IntArray:
    """Noises that a steady series may have."""
    return np.flatnonzero([each.correlation <= _MOST_CORRELATION for each in NOISES])


@lru_cache
def _weights(n: int) -> FloatArray:
    """Prior probability of a change at each of the first points: k*ln(k)^2 less and less, one over all."""
    k = np.arange(n) + math.e
    # the sum of 1/(x ln(x)^2) from x = e on is below 1.25
    return np.asarray(1 / (1.25 * k * np.log(k) ** 2), np.float64)
