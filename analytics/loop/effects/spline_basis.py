"""Cubic B-splines over given knots: all of them as columns, or their sum at once."""

from collections.abc import Sequence

import numpy as np

from stream.batch import FloatArray

_DEGREE = 3


def spline_columns(value: FloatArray, knots: FloatArray) -> FloatArray:
    """Each B-spline at each value, shape (values, knots + 2); NaN in a row whose value is NaN. Rows sum to 1.

    Examples
    --------
    >>> columns = spline_columns(np.array([0.0, 0.5, 9.0]), np.array([0.0, 1.0, 2.0]))
    >>> columns.shape, columns.sum(axis=1)
    ((3, 5), array([1., 1., 1.]))
    """
    from scipy.interpolate import BSpline

    inside = np.clip(np.where(np.isfinite(value), value, knots[0]), knots[0], knots[-1])
    columns = np.asarray(BSpline.design_matrix(inside, _padded(knots), _DEGREE).toarray(), np.float64)
    columns[~np.isfinite(value)] = np.nan
    return columns


def spline_value(value: FloatArray, knots: FloatArray, coefficients: Sequence[float]) -> FloatArray:
    """The spline with these coefficients, by de Boor's recurrence."""
    padded = _padded(knots)
    inside = np.clip(value, knots[0], knots[-1])
    interval = np.clip(np.searchsorted(knots, inside, side="right") - 1, 0, knots.size - 2) + _DEGREE
    weights = np.asarray(coefficients, np.float64)
    levels = [weights[interval - _DEGREE + j] for j in range(_DEGREE + 1)]
    for order in range(1, _DEGREE + 1):
        for j in range(_DEGREE, order - 1, -1):
            left = padded[interval - _DEGREE + j]
            right = padded[interval + 1 + j - order]
            share = (inside - left) / (right - left)
            levels[j] = (1.0 - share) * levels[j - 1] + share * levels[j]
    return np.asarray(levels[_DEGREE], np.float64)


def _padded(knots: FloatArray) -> FloatArray:
    return np.concatenate((np.full(_DEGREE, knots[0]), knots, np.full(_DEGREE, knots[-1])))
