"""Variation of a coefficient over units as a random effect: its mean, and its spread beyond the errors of the units."""

import msgspec
import numpy as np

from analytics.methods.distributions import chi_square_quantile, normal_log_density, student_quantile
from stream.batch import FloatArray

_CONFIDENCE = 0.95


class RandomEffect(msgspec.Struct, frozen=True, kw_only=True):
    """A coefficient that varies over units about a mean.

    Parameters
    ----------
    mean, lo, hi: Mean over units with its 95 % confidence bounds (Hartung and Knapp, Stat. Med. 20, 2001, 3875-3889).
    spread, spread_lo, spread_hi: Standard deviation over units (Paule and Mandel) with its 95 % bounds (Q-profile).
    """

    mean: float
    lo: float
    hi: float
    spread: float
    spread_lo: float
    spread_hi: float
    units: int


def random_effect(values: FloatArray, errors: FloatArray) -> RandomEffect | None:
    """Mean and spread of coefficients of units with their standard errors; None with fewer than three.

    The sum Q of squared deviations, weighted by 1 / (error^2 + spread^2), has a chi-square distribution of (units - 1)
    degrees of freedom at the true spread, which gives estimate and bounds. Viechtbauer, Stat. Med. 26, 2007, 37-52,
    doi:10.1002/sim.2514.

    >>> found = random_effect(np.array([1.0, 1.2, 0.8, 1.1]), np.full(4, 0.2))
    >>> round(found.mean, 3), found.spread
    (1.025, 0.0)
    """
    count = values.size
    if count < 3:
        return None
    variance = _variance_at(values, errors, float(count - 1))
    tail = (1.0 - _CONFIDENCE) / 2
    lowest = _variance_at(values, errors, float(chi_square_quantile(1.0 - tail, count - 1)))
    highest = _variance_at(values, errors, float(chi_square_quantile(tail, count - 1)))
    weights = 1.0 / (errors**2 + variance)
    mean = float(weights @ values / weights.sum())
    scale = max(1.0, _weighted_squares(values, errors, variance) / (count - 1))  # never narrower than the errors say
    half = float(student_quantile(1.0 - tail, count - 1) * np.sqrt(scale / weights.sum()))
    spread, spread_lo, spread_hi = (float(np.sqrt(each)) for each in (variance, lowest, highest))
    return RandomEffect(
        mean=mean, lo=mean - half, hi=mean + half, spread=spread, spread_lo=spread_lo, spread_hi=spread_hi, units=count
    )


def presence(number: int, values: FloatArray, errors: FloatArray) -> float:
    """Probability that a unit has the effect as the others do, not none, if both are equally likely beforehand."""
    others = np.arange(values.size) != number
    found = random_effect(values[others], errors[others])
    if found is None:
        return 0.5
    weights = 1.0 / (errors[others] ** 2 + found.spread**2)
    of_mean = 1.0 / float(weights.sum())
    value, error = float(values[number]), float(errors[number])
    has_it = normal_log_density(value, found.mean, np.sqrt(error**2 + found.spread**2 + of_mean))
    has_none = normal_log_density(value, 0.0, error)
    return float(1.0 / (1.0 + np.exp(np.clip(has_none - has_it, -700, 700))))


def _weighted_squares(values: FloatArray, errors: FloatArray, variance: float) -> float:
    weights = 1.0 / (errors**2 + variance)
    mean = weights @ values / weights.sum()
    return float(weights @ (values - mean) ** 2)


def _variance_at(values: FloatArray, errors: FloatArray, squares: float) -> float:
    """The spread squared at which the weighted squares are so large; 0 if they are smaller without any."""
    if _weighted_squares(values, errors, 0.0) <= squares:
        return 0.0
    most = float(np.ptp(values) ** 2)
    while _weighted_squares(values, errors, most) > squares:
        most *= 4.0
    from scipy.optimize import brentq  # slow to import

    return float(brentq(lambda each: _weighted_squares(values, errors, each) - squares, 0.0, most))
