"""Least squares of readings with known uncertainties; each counts alike, as the equations of the standards have it."""

from typing import NamedTuple

import numpy as np

from stream.batch import FloatArray


class WeightedFit(NamedTuple):
    """Coefficients, their standard uncertainties and degrees of freedom, and the residuals."""

    values: FloatArray
    errors: FloatArray
    freedoms: FloatArray
    residuals: FloatArray


def weighted_fit(design: FloatArray, readings: FloatArray, u: FloatArray, freedom: FloatArray) -> WeightedFit:
    """Ordinary least squares; a coefficient is a sum of the readings with weights w.

    Its variance is sum(w^2 u^2), with the degrees of freedom of Welch and Satterthwaite; where the residuals v are
    larger than these uncertainties explain, sum(w^2) sum(v^2)/(n - p) with n - p: the larger of the two, as
    `weighted_variance` in SQL. An uncertainty that is not known is NaN and leaves the residuals alone to tell.

    >>> found = weighted_fit(np.ones((4, 1)), np.array([1.0, 2.0, 1.0, 2.0]), np.full(4, 0.1), np.full(4, 10.0))
    >>> float(found.values[0]), float(round(found.errors[0], 4)), float(found.freedoms[0])
    (1.5, 0.2887, 3.0)
    """
    weights = np.linalg.pinv(design)
    values = weights @ readings
    residuals = readings - design @ values
    spare = len(readings) - design.shape[1]
    given = ((weights * u) ** 2).sum(axis=1)
    fourth = ((weights * u) ** 4 / np.maximum(freedom, 1.0)).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        freedoms = np.where(fourth > 0, given**2 / fourth, 1e9)
    if spare > 0:
        seen = (weights**2).sum(axis=1) * float(residuals @ residuals) / spare
        is_seen = ~(seen <= given)
        given, freedoms = np.where(is_seen, seen, given), np.where(is_seen, float(spare), freedoms)
    return WeightedFit(values, np.sqrt(given), freedoms, residuals)
