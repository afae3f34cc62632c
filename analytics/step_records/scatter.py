"""Standard deviation of values that may be correlated, with its degrees of freedom."""

import math
from typing import NamedTuple

import numpy as np

from analytics.step_records.record_noise import octave_variances
from stream.batch import FloatArray, IntArray

_LEAST_OCTAVES = 8  # values from which their octaves say how far they correlate
_LONGEST_GAPS = 64  # values between two averages, beyond which they are far apart


class Average(NamedTuple):
    """Standard deviation of consecutive averages: how many, their deviation, and its degrees of freedom."""

    n: int
    sd: float
    freedom: float


def bartlett_freedom(n: int, correlation: float) -> float:
    """Degrees of freedom of the variance of `n` values whose neighbours correlate (Bartlett 1946), within 1 and n - 1.

    >>> bartlett_freedom(101, 0.5)
    60.0
    """
    square = min(correlation * correlation, 1.0)
    return min(n - 1.0, max(1.0, (n - 1) * (1 - square) / (1 + square)))


def scatter_freedom(dense: FloatArray, variance: float, octaves: tuple[FloatArray, IntArray] | None = None) -> float:
    """Degrees of freedom of the variance of values on a grid, NaN where one is missing, however far they correlate.

    The octaves of the Haar wavelet split the variance: n/2m coefficients, of half the Allan variance at m, are at the
    octave m, uncorrelated enough for all power laws (Percival 1995, DOI 10.1093/biomet/82.3.619). What is slower than
    the record's octaves is one coefficient or more. At most those of neighbours that correlate as theirs (Bartlett
    1946), which is exact for Markov noise alone, and all that few values tell. `octaves` are the Allan variances and
    factors of `dense` where they are known.

    >>> values = np.random.default_rng(1).standard_normal(4096)
    >>> bool(3500 < scatter_freedom(values, float(values.var(ddof=1))) < 4200)
    True
    """
    known = dense[~np.isnan(dense)]
    n = known.size
    by_neighbours = bartlett_freedom(n, _neighbours(dense - float(known.mean()))) if n else 1.0
    if n < _LEAST_OCTAVES or variance <= 0:
        return by_neighbours
    variances, factors = octave_variances(dense) if octaves is None else octaves
    if not factors.size:  # no two values are neighbours
        return by_neighbours
    parts = np.minimum(variances / 2, variance)
    counts = np.maximum(n / (2.0 * factors), 1.0)
    slowest = max(0.0, variance - float(parts.sum()))
    of_slowest = max(1.0, n / (2.0 * float(factors[-1])) - 1.0)
    # the square of an estimate is too large by 2 over its degrees of freedom
    spread = float((parts**2 / (counts + 2)).sum()) + slowest**2 / of_slowest
    return min(by_neighbours, max(1.0, variance**2 / spread)) if spread > 0 else by_neighbours


def _neighbours(centred: FloatArray) -> float:
    """Correlation of neighbours."""
    pairs = ~np.isnan(centred[1:]) & ~np.isnan(centred[:-1])
    power = float(np.nansum(centred * centred))
    return float(centred[1:][pairs] @ centred[:-1][pairs]) / power if power > 0 else 0.0


def scatter_of_averages(number: IntArray, values: FloatArray) -> Average:
    """Standard deviation of consecutive averages; its degrees of freedom allow for correlated neighbours.

    `number`: shape (n,); place of each average on its grid, increasing.

    >>> scatter_of_averages(np.array([0, 1, 3]), np.array([1.0, 2.0, 3.0]))
    Average(n=3, sd=1.0, freedom=2.0)
    """
    if values.size < 2:
        return Average(int(values.size), math.nan, math.nan)
    centred = values - values.mean()
    variance = float(centred @ centred) / (values.size - 1)
    if number[-1] - number[0] > _LONGEST_GAPS * values.size:  # pieces far apart
        number = np.cumsum(np.r_[0, np.minimum(np.diff(number), _LONGEST_GAPS)])
    dense = np.full(int(number[-1] - number[0]) + 1, np.nan)
    dense[number - number[0]] = centred
    return Average(values.size, math.sqrt(variance), scatter_freedom(dense, variance))
