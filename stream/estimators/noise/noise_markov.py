"""Whether an Allan curve requires Markov noise beside the five terms, and its correlation time."""

import math

import msgspec
import numpy as np

from stream.batch import FloatArray
from stream.estimators.noise.noise_likelihood import CurveLikelihood
from stream.estimators.noise.noise_model import markov_column

FALSE_ALARM = 0.001
SHORTEST = 4.0
_TIMES_PER_OCTAVE = 3
_REFINED = 8
_LEAST_LEFT = 1e-6
_LEAST_TIMES = 3


class Offer(msgspec.Struct, frozen=True, kw_only=True):
    """The Markov noise that fits a curve best, significant or not: its correlation time with bounds.

    It lowers the deviance by `gain`, which is significant if it is more than `bound` times `inflation`, the variance of
    its amplitude over that of independent points. `bound` is infinite at the shortest correlation time searched.
    """

    correlation_s: float
    lo_s: float
    hi_s: float
    gain: float
    inflation: float
    bound: float

    def is_significant(self, gain: float) -> bool:
        """Whether a gain in deviance is more than chance."""
        return gain / self.inflation > self.bound


def best_markov(
    taus_s: FloatArray, variances: FloatArray, likelihood: CurveLikelihood, quantile: float
) -> Offer | None:
    """Markov noise that lowers the deviance of a curve most; None where the curve is too short.

    The likelihood is that of the five terms; the quantile of chi-square with 1 degree of freedom is for the bounds.

    Correlation times are searched from the second tau, and at least four times the first, to half the longest, three
    an octave; Markov noise of a shorter time is white except at the first points, where a sensor's filter has the same
    effect, and if the shortest fits best none is significant. Without Markov noise the time is undefined, and the best
    of many is no single test: the gain in deviance over its inflation is the square of a Gaussian process along the
    grid, which exceeds u anywhere with a probability of at most

        Phi(-sqrt(u)) + L/(2 pi) exp(-u/2)

    (Davies, Biometrika 74 (1987) 33-43), L the length of the path of its unit vectors, the sum of the angles between
    neighbours. The bound sets that to 0.1 %: Markov noise and flicker explain much the same, and a false detection
    removes all of B. The bounds of the time are where the deviance has risen by the quantile, or the end of the grid.
    """
    shortest_s, longest_s = max(taus_s[1], SHORTEST * taus_s[0]), taus_s[-1] / 2.0
    octaves = math.log2(longest_s / shortest_s)
    if octaves <= 1.0:
        return None
    times_s = np.geomspace(shortest_s, longest_s, round(octaves * _TIMES_PER_OCTAVE) + 1)
    theta, least = likelihood.minimum()
    relative = _relative(taus_s, variances, times_s)
    left = likelihood.residual(theta, relative / relative.max(axis=0))
    information = np.sum(left**2, axis=0)
    tells = information > _LEAST_LEFT
    if np.count_nonzero(tells) < _LEAST_TIMES:
        return None
    times_s, left, information = times_s[tells], left[:, tells], information[tells]
    covariance = likelihood.covariance(left)
    inflation = np.maximum(1.0, np.diag(covariance) / information)
    deviances = likelihood.deviances_beside(relative[:, tells])
    best = int(np.argmax((least - deviances) / inflation))
    around = np.geomspace(times_s[max(0, best - 1)], times_s[min(len(times_s) - 1, best + 1)], 2 * _REFINED + 1)
    refined = likelihood.deviances_beside(_relative(taus_s, variances, around))
    every, order = np.unique(np.concatenate([times_s, around]), return_index=True)
    rise = np.concatenate([deviances, refined])[order]
    rise = (rise - rise.min()) / inflation[best] - likelihood.spread(theta, quantile)
    correlation_s, lo_s, hi_s = _crossings(every, rise)
    return Offer(
        correlation_s=correlation_s, lo_s=lo_s, hi_s=hi_s, gain=float(least - deviances[best]),
        inflation=float(inflation[best]),
        bound=math.inf if correlation_s <= shortest_s else davies_bound(path_length(covariance), FALSE_ALARM),
    )  # fmt: skip


def _relative(taus_s: FloatArray, variances: FloatArray, times_s: FloatArray) -> FloatArray:
    """Markov noise of each correlation time, relative to the curve, a column each."""
    return markov_column(taus_s[:, np.newaxis], times_s) / variances[:, np.newaxis]


def _crossings(times_s: FloatArray, rise: FloatArray) -> tuple[float, float, float]:
    """The lowest point, and where `rise` leaves zero on either side of it, between neighbours by a straight line."""
    best, logarithms = int(np.argmin(rise)), np.log(times_s)

    def end(step: int) -> float:
        i = best
        while 0 <= i + step < len(rise) and rise[i + step] < 0.0:
            i += step
        if not 0 <= i + step < len(rise):
            return float(times_s[i])
        share = rise[i] / (rise[i] - rise[i + step])
        return float(np.exp(logarithms[i] + share * (logarithms[i + step] - logarithms[i])))

    return float(times_s[best]), end(-1), end(1)


def path_length(covariance: FloatArray) -> float:
    """Length of the path of a Gaussian process along its grid: the sum of angles between neighbours, in radians.

    >>> round(path_length(np.array([[1.0, 0.5], [0.5, 1.0]])), 4)
    1.0472
    """
    # correlations are approximate, and a combination of the variances can come out without scatter
    deviations = np.sqrt(np.maximum(np.diag(covariance), _LEAST_LEFT))
    cosines = np.diag(covariance, 1) / (deviations[1:] * deviations[:-1])
    return float(np.sum(np.arccos(np.clip(cosines, -1.0, 1.0))))


def davies_bound(length: float, probability: float) -> float:
    """Square that the maximum of a Gaussian process of such a path exceeds with at most this probability.

    >>> round(davies_bound(0.0, 0.01), 2), round(davies_bound(4.0, 0.01), 2)
    (5.41, 8.66)
    """
    lo, hi = 0.0, 200.0
    for _ in range(60):
        middle = (lo + hi) / 2.0
        tail = math.erfc(math.sqrt(middle / 2.0)) / 2.0 + length / (2.0 * math.pi) * math.exp(-middle / 2.0)
        lo, hi = (middle, hi) if tail > probability else (lo, middle)
    return hi
