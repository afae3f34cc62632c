"""Probability of conformity, and consumer's and producer's risk (JCGM 106:2012 7, 9)."""

import itertools
import math
from typing import NamedTuple

import numpy as np
import scipy

from stream.batch import FloatArray

_REACH = 9.0  # standard deviations beyond which nothing is left
_NODES = 64  # of Gauss and Legendre in each piece


class Interval(NamedTuple):
    """Tolerance or acceptance interval; None where it has no limit."""

    lower: float | None = None
    upper: float | None = None

    @property
    def bounds(self) -> tuple[float, float]:
        """Its limits, infinite where it has none."""
        return (-math.inf if self.lower is None else self.lower, math.inf if self.upper is None else self.upper)


class Risks(NamedTuple):
    """Global risks of a process (JCGM 106 9.5): shares of all units."""

    consumer: float  # accepted and not conforming
    producer: float  # rejected and conforming


def probability_of_conformity(value: float, u: float, tolerance: Interval, freedom: float = math.inf) -> float:
    """Probability that a quantity lies within its tolerance, of a measured value alone (JCGM 106 (7), A.4).

    Of an accepted value the specific consumer's risk is what is missing from 1, of a rejected one it is the specific
    producer's risk.

    >>> round(probability_of_conformity(2.7, 0.1, Interval(upper=3.0)), 4)
    0.9987
    """
    lower, upper = ((limit - value) / u for limit in tolerance.bounds)
    if math.isinf(freedom):
        return float(scipy.special.ndtr(upper) - scipy.special.ndtr(lower))
    return float(scipy.special.stdtr(freedom, upper) - scipy.special.stdtr(freedom, lower))


def global_risks(mean: float, deviation: float, u: float, tolerance: Interval, acceptance: Interval) -> Risks:
    """Risks over a process of true values normal about `mean`, measured with `u` (JCGM 106 9.5.2, (17)-(20)).

    >>> risks = global_risks(0.0, 1.0, 0.2, Interval(-2.0, 2.0), Interval(-2.0, 2.0))
    >>> round(risks.consumer, 4), round(risks.producer, 4)
    (0.0068, 0.0111)
    """
    lower, upper = tolerance.bounds
    inside = acceptance.bounds

    def accepted(true: FloatArray) -> FloatArray:
        share = scipy.special.ndtr((inside[1] - true) / u) - scipy.special.ndtr((inside[0] - true) / u)
        return np.asarray(share, dtype=np.float64)

    def share_of(first: float, last: float, *, is_accepted: bool) -> float:
        total = 0.0
        reach = _REACH * deviation
        for begin, end in _pieces(max(first, mean - reach), min(last, mean + reach), inside, u):
            nodes, weights = np.polynomial.legendre.leggauss(_NODES)
            true = (begin + end) / 2 + (end - begin) / 2 * nodes
            density = np.exp(-(((true - mean) / deviation) ** 2) / 2) / (deviation * math.sqrt(2 * math.pi))
            chance = accepted(true) if is_accepted else 1 - accepted(true)
            total += (end - begin) / 2 * float(weights @ (density * chance))
        return total

    consumer = share_of(-math.inf, lower, is_accepted=True) + share_of(upper, math.inf, is_accepted=True)
    return Risks(consumer, share_of(lower, upper, is_accepted=False))


def _pieces(first: float, last: float, limits: tuple[float, float], u: float) -> list[tuple[float, float]]:
    """An interval in pieces, in each of which the chance of being accepted is smooth."""
    if not first < last:
        return []
    cuts = {limit + sign * reach * u for limit in limits for sign in (-1, 1) for reach in (0, 2, 4, 8)}
    grid = {first + (last - first) * part / 8 for part in range(9)}
    places = sorted({each for each in cuts | grid if first <= each <= last} | {first, last})
    return list(itertools.pairwise(places))
