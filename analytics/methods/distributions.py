"""Tails and quantiles of chi-square, normal, Student's t and F, from `scipy.special`.

The numbers are those of `scipy.stats`, whose import takes longer than most commands.
"""

import math

import numpy as np
import scipy

from stream.batch import FloatArray

_LOG_ROOT_TWO_PI = math.log(math.sqrt(2.0 * math.pi))


def chi_square_sf(value: FloatArray | float, degrees: float) -> FloatArray:
    """Probability of more than a value.

    >>> round(float(chi_square_sf(3.841458820694124, 1)), 12)
    0.05
    """
    return np.asarray(scipy.special.chdtrc(degrees, value))


def chi_square_cdf(value: FloatArray | float, degrees: float) -> FloatArray:
    """Probability of at most a value."""
    return np.asarray(scipy.special.chdtr(degrees, value))


def chi_square_log_sf(value: FloatArray | float, degrees: float) -> FloatArray:
    """Logarithm of the probability of more than a value; -inf where that is below the smallest number."""
    value = np.asarray(value)
    with np.errstate(divide="ignore"):
        above, below = np.log(chi_square_sf(value, degrees)), np.log1p(-chi_square_cdf(value, degrees))
    return np.where(value > chi_square_quantile(0.5, degrees), above, below)


def chi_square_isf(probability: FloatArray | float, degrees: float) -> FloatArray:
    """The value that is exceeded with a probability."""
    return np.asarray(scipy.special.chdtri(degrees, probability))


def chi_square_quantile(probability: float, degrees: FloatArray | float) -> FloatArray:
    """The value that is not exceeded with a probability."""
    return np.asarray(2.0 * scipy.special.gammaincinv(degrees / 2.0, probability))


def normal_sf(value: float) -> float:
    """Probability of more than a value of the standard normal distribution."""
    return float(scipy.special.ndtr(-value))


def normal_cdf(value: float) -> float:
    """Probability of at most a value of the standard normal distribution."""
    return float(scipy.special.ndtr(value))


def normal_quantile(probability: float) -> float:
    """The value that the standard normal distribution does not exceed with a probability."""
    return float(scipy.special.ndtri(probability))


def normal_isf(probability: float) -> float:
    """The value that the standard normal distribution exceeds with a probability."""
    return float(-scipy.special.ndtri(probability))


def normal_log_density(value: float, mean: float, deviation: float) -> float:
    """Logarithm of the density of a normal distribution."""
    return -(((value - mean) / deviation) ** 2) / 2.0 - _LOG_ROOT_TWO_PI - math.log(deviation)


def student_sf(value: float, degrees: float) -> float:
    """Probability of more than a value of Student's t."""
    return float(scipy.special.stdtr(degrees, -value))


def student_quantile(probability: FloatArray | float, degrees: FloatArray | float) -> FloatArray:
    """The value that Student's t does not exceed with a probability.

    >>> round(float(student_quantile(0.975, 10)), 6)
    2.228139
    """
    return np.asarray(scipy.special.stdtrit(degrees, probability))


def f_sf(value: float, over: float, under: float) -> float:
    """Probability that the ratio F, with degrees of freedom over and under the line, is more than a value."""
    return float(scipy.special.fdtrc(over, under, value))


def f_quantile(probability: float, over: float, under: float) -> float:
    """The value that the ratio F, with degrees of freedom over and under the line, does not exceed."""
    return float(scipy.special.fdtri(over, under, probability))
