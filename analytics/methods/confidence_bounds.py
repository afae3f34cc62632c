"""Confidence bounds of metrics, for whole columns at once."""

import numpy as np

from analytics.methods.distributions import chi_square_quantile, student_quantile
from stream.batch import FloatArray

CONFIDENCE = 0.95
TWO_SIDED = 1.959963984540054  # standard normal quantile of two-sided 95 % bounds


def t_bounds(value: FloatArray, standard_uncertainty: FloatArray, freedom: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bounds of a value with a normal error: value -+ t * u (JCGM 100:2008 G.3.2).

    >>> lo, hi = t_bounds(np.array([10.0]), np.array([1.0]), np.array([1e9]))
    >>> float(round(hi[0], 2))
    11.96
    """
    half = student_quantile((1 + CONFIDENCE) / 2, np.maximum(freedom, 1.0)) * standard_uncertainty
    return value - half, value + half


def joint_half_widths(u: FloatArray, freedom: FloatArray, independent: int | FloatArray | None = None) -> FloatArray:
    """Half widths of bounds that hold for all values together: t at 1 - (1 - confidence)/(2 m), times u.

    m is the number of values, or of those that are `independent` (Bonferroni), of each value if it is an array.
    """
    tail = (1 - CONFIDENCE) / 2 / (len(u) if independent is None else independent)
    return -student_quantile(tail, np.maximum(np.nan_to_num(freedom, nan=1.0), 1.0)) * u


def chi_square_bounds(value: FloatArray, freedom: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bounds of a standard deviation: value * sqrt(freedom/chi2) (NIST SP 1065 (45)).

    >>> lo, hi = chi_square_bounds(np.array([1.0]), np.array([5.0]))
    >>> float(round(lo[0], 3)), float(round(hi[0], 3))
    (0.624, 2.453)
    """
    degrees = np.maximum(freedom, 1.0)
    hi = value * np.sqrt(degrees / chi_square_quantile((1 - CONFIDENCE) / 2, degrees))
    return value * np.sqrt(degrees / chi_square_quantile((1 + CONFIDENCE) / 2, degrees)), hi


def deviation_uncertainty(value: FloatArray, freedom: FloatArray) -> FloatArray:
    """Standard uncertainty of a standard deviation: value / sqrt(2 * freedom) (JCGM 100:2008 E.4.3)."""
    return np.asarray(value / np.sqrt(2 * np.maximum(freedom, 1.0)), dtype=np.float64)
