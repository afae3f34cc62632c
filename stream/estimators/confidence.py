"""Confidence bounds of a deviation by its equivalent degrees of freedom.

C. A. Greenhall, W. J. Riley, Uncertainty of stability variances based on finite differences, Proc. 35th PTTI (2003)
267-278, with its equation numbers below; summarised in NIST SP 1065 (2008), section 5.4.

The squares averaged in an Allan variance overlap and are correlated: M of them have fewer than M equivalent degrees of
freedom (edf), with which the variance approximately follows chi-square. The edf depend on the noise, a power law
S_y(f) ~ f**alpha: alpha = 2 quantisation, 1 flicker of angle, 0 angle random walk, -1 bias instability, -2 rate
random walk.
"""

import math
from functools import lru_cache

import numpy as np
import scipy

from stream.batch import FloatArray

NOISE_EXPONENTS = (2, 1, 0, -1, -2)
_FAR = 100.0


def sw(t: FloatArray, alpha: int) -> FloatArray:
    """Autocovariance of the phase of noise `alpha`, equation (7), up to a factor that cancels in ratios."""
    size = np.abs(t)
    if alpha % 2 == 0:
        return size ** (3 - alpha) * (-1.0 if alpha == 2 else 1.0)
    return size ** (3 - alpha) * np.log(np.where(size == 0.0, 1.0, size))


def sx(t: FloatArray, averaging_factor: int, alpha: int) -> FloatArray:
    """Autocovariance of the phase averaged over 1/F, F the averaging factor; t in units of tau, equation (8).

    sx = F**2 (2 sw(t) - sw(t - 1/F) - sw(t + 1/F)). This difference loses all its digits for large F: it is computed
    in u = F t, and far from zero by its series, so that it holds for every F.
    """
    factor = float(averaging_factor)
    u = np.abs(t) * factor
    near = 2.0 * sw(u, alpha) - sw(u - 1.0, alpha) - sw(u + 1.0, alpha)
    if alpha == 2:
        return factor * np.where(u < 1.0, near, 0.0)
    if alpha == 0:
        return np.where(u < 1.0, near / factor, -6.0 * np.abs(t))
    if alpha == -2:
        return np.where(u < 1.0, near / factor**3, -20.0 * np.abs(t) ** 3 - 10.0 * np.abs(t) / factor**2)
    far = np.where(u > _FAR, np.abs(t), 1.0)
    logarithm = np.log(far)
    if alpha == 1:
        near = near + 2.0 * math.log(factor)
        series = -(2.0 * logarithm + 3.0) + 1.0 / (6.0 * (far * factor) ** 2)
    else:
        near = (near + (12.0 * u**2 + 2.0) * math.log(factor)) / factor**2
        series = -(12.0 * far**2 * logarithm + 7.0 * far**2) - (24.0 * logarithm + 50.0) / (12.0 * factor**2)
    return np.where(u > _FAR, series, near)


def sz(t: FloatArray, averaging_factor: int, alpha: int, d: int) -> FloatArray:
    """Autocovariance of the d-th difference over tau of the averaged phase, equation (9)."""
    total = np.zeros_like(t)
    for i in range(-d, d + 1):
        total = total + (-1) ** i * math.comb(2 * d, d + i) * sx(t + i, averaging_factor, alpha)
    return total


def basic_sum(windows: int, averaging_factor: int, stride_per_tau: int, alpha: int, d: int) -> float:
    """Sum over pairs of windows of squared correlations, over the windows: (10) over sz(0)**2, cut off by (13)."""
    flat, rising = _partial_sums(averaging_factor, stride_per_tau, alpha, d)
    last = min(windows, (d + 1) * stride_per_tau)
    squares, lag_squares = flat[last - 1], rising[last - 1]
    half = 0.5 * (flat[last] - flat[last - 1])
    return 1.0 + 2.0 * (squares + half - (lag_squares + half * last) / windows)


@lru_cache(maxsize=4096)
def _partial_sums(
    averaging_factor: int, stride_per_tau: int, alpha: int, d: int
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Sums over lags 1..j of r**2 and of lag * r**2, r the correlation of windows; independent of the record."""
    lags = np.arange((d + 1) * stride_per_tau + 1, dtype=np.float64)
    covariance = sz(lags / stride_per_tau, averaging_factor, alpha, d)
    squares = (covariance / covariance[0]) ** 2
    squares[0] = 0.0
    return tuple(np.cumsum(squares).tolist()), tuple(np.cumsum(lags * squares).tolist())


def edf(alpha: int, d: int, averaging_factor: int, windows: int, stride_per_tau: int) -> float:
    """Equivalent degrees of freedom of an unmodified variance of d-th differences, equation (6).

    `alpha` is the noise exponent, +2 .. -2, and `d` the order of the difference: 2 for the Allan variance, 3 for
    Hadamard's; alpha + 2 d > 1. `averaging_factor` is tau over the sample interval; `windows`, at least 1, how many
    squares were truly averaged, not those of a record without gaps; `stride_per_tau` tau over the distance of
    neighbouring windows: the averaging factor for a full overlap, 1 for none.

    edf = M / (sum over pairs of windows of their squared correlation / M), between 1 and M.
    Windows that gaps have driven apart are less correlated than assumed here, so that the result is on the safe side.
    A modified variance averages the phase over all of tau, F = 1: its edf are those for `averaging_factor` 1, whatever
    tau is, with its own windows and stride.

    >>> round(edf(alpha=0, d=2, averaging_factor=64, windows=873, stride_per_tau=64), 1)
    20.9
    """
    return max(1.0, windows / basic_sum(windows, averaging_factor, stride_per_tau, alpha, d))


def least_edf(averaging_factor: int, windows: int, stride_per_tau: int, d: int = 2) -> float:
    """Least equivalent degrees of freedom that any of the `NOISE_EXPONENTS` gives.

    For unknown noise: the bounds keep their level with each of them. Quantisation (+2) has the least at tau of one or
    two intervals, random walk (-2) at long ones; bounds for white noise become wider by at most the root of 1.7. Where
    the curve identifies the noise, `noise_exponent` leaves out the exponents that it excludes.
    """
    return min(edf(alpha, d, averaging_factor, windows, stride_per_tau) for alpha in NOISE_EXPONENTS)


def deviation_bounds(value: float, edf: float, confidence: float) -> tuple[float, float]:
    """Two-sided bounds of a deviation whose square follows chi-square, NIST SP 1065 equation (45).

    s * sqrt(edf / chi2), chi2 the quantiles at (1 + confidence)/2 and (1 - confidence)/2. A deviation of 0 has the
    bounds 0 and 0.

    >>> lo, hi = deviation_bounds(1.0, edf=10.0, confidence=0.95)
    >>> round(lo, 4), round(hi, 4)
    (0.6987, 1.7549)
    """
    tail = (1.0 - confidence) / 2.0
    upper = 2.0 * float(scipy.special.gammainccinv(edf / 2.0, tail))
    lower = 2.0 * float(scipy.special.gammaincinv(edf / 2.0, tail))
    return value * math.sqrt(edf / upper), value * math.sqrt(edf / lower)
