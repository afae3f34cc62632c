"""Capability of a process against its specification: Cp and Cpk (NIST/SEMATECH e-Handbook 6.1.6, ISO 22514-2)."""

import math
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2, norm, shapiro

from analytics.trends.words import Refused, Words
from stream.batch import FloatArray

LEAST_POINTS = 20
_CONFIDENCE = 0.95
_NOT_NORMAL = 0.01
_MOST_FOR_SHAPIRO = 5000


class Index(NamedTuple):
    """A capability index with 95 % limits."""

    value: float
    lo: float
    hi: float


class Capability(NamedTuple):
    """What a process can keep.

    Parameters
    ----------
    lower, upper: Limits of the specification, in the unit of the values.
    mean, sigma: Of the values; `sigma` is the standard deviation of all of them (n - 1), which in a process in control
        is also that from point to point.
    n: Values.
    cp: (upper - lower)/(6*sigma); None where there is one limit only.
    cpk: Distance of the mean from the nearer limit over 3*sigma.
    measurement_share: Part of the variance that the uncertainty of the measurements is; the process itself is better by
        that.
    normality_chance: Probability of values at least so far from normal where they are normal (Shapiro and Wilk). Below
        0.01 the indices do not say how many units lie outside.
    """

    lower: float | None
    upper: float | None
    mean: float
    sigma: float
    n: int
    cp: Index | None
    cpk: Index
    measurement_share: float | None
    normality_chance: float

    @property
    def is_normal(self) -> bool:
        """Whether the values may be normal."""
        return self.normality_chance >= _NOT_NORMAL


def capability(
    values: FloatArray,
    lower: float | None,
    upper: float | None,
    *,
    out_of_control: Words | None = None,
    uncertainty: FloatArray | None = None,
) -> Capability | Refused:
    """Capability indices.

    Parameters
    ----------
    values: shape (points,); one of each unit.
    lower, upper: Limits of the specification.
    out_of_control: What shows that the process is not in control; then it has no capability.
    uncertainty: shape (points,); standard uncertainties of the values; NaN where unknown.

    Notes
    -----
    Limits of Cp: from chi-square with n - 1 degrees of freedom; of Cpk: Cpk -+ z*sqrt(1/(9n) + Cpk**2/(2(n - 1)))
    (Bissell 1990). Both hold for normal values.

    Examples
    --------
    >>> found = capability(np.random.default_rng(4).normal(16.0, 2.0, 400), 8.0, 20.0)
    >>> round(found.cp.value, 1), found.cpk.lo < 0.667 < found.cpk.hi
    (1.0, True)
    """
    refused = _why_not(values, lower, upper, out_of_control)
    if refused is not None:
        return refused
    n = values.size
    mean, sigma = float(values.mean()), float(values.std(ddof=1))
    cp = cp_index((upper - lower) / (6 * sigma), n) if lower is not None and upper is not None else None
    sides = [side for side in (_side(upper, mean, sigma, 1), _side(lower, mean, sigma, -1)) if side is not None]
    share = None
    if uncertainty is not None and np.isfinite(uncertainty).all():
        share = min(1.0, float(np.mean(uncertainty**2)) / sigma**2)
    chance = float(shapiro(values[:_MOST_FOR_SHAPIRO]).pvalue)
    return Capability(lower, upper, mean, sigma, n, cp, cpk_index(min(sides), n), share, chance)


def cp_index(cp: float, n: int) -> Index:
    """Cp with its limits.

    Examples
    --------
    >>> [round(each, 2) for each in cp_index(2.29, 20)]
    [2.29, 1.57, 3.01]
    """
    tail = (1 - _CONFIDENCE) / 2
    lo, hi = (cp * math.sqrt(float(chi2.ppf(p, n - 1)) / (n - 1)) for p in (tail, 1 - tail))
    return Index(cp, lo, hi)


def cpk_index(cpk: float, n: int) -> Index:
    """Cpk with its limits.

    Examples
    --------
    >>> [round(each, 2) for each in cpk_index(1.33, 20)]
    [1.33, 0.88, 1.78]
    """
    half = float(norm.ppf((1 + _CONFIDENCE) / 2)) * math.sqrt(1 / (9 * n) + cpk**2 / (2 * (n - 1)))
    return Index(cpk, cpk - half, cpk + half)


def _side(limit: float | None, mean: float, sigma: float, sign: int) -> float | None:
    return None if limit is None else sign * (limit - mean) / (3 * sigma)


def _why_not(
    values: FloatArray, lower: float | None, upper: float | None, out_of_control: Words | None
) -> Refused | None:
    if lower is None and upper is None:
        return Refused(
            Words(
                "no specification limits this characteristic: add one with `gyrofleet limits add`",
                "产品规范中没有该特性的限值：请用 `gyrofleet limits add` 添加",
            )
        )
    if values.size < LEAST_POINTS:
        return Refused(
            Words(
                f"{values.size} units, capability is given from {LEAST_POINTS} on",
                f"仅 {values.size} 个样品，过程能力至少需要 {LEAST_POINTS} 个",
            )
        )
    if out_of_control is not None:
        return Refused(
            Words(
                f"the process is not in control ({out_of_control.en}), so it has no capability: mend that first",
                f"过程未受控（{out_of_control.zh}），过程能力无意义：请先消除异因",
            )
        )
    if not values.std() > 0:
        return Refused(Words("the values do not vary", "各值无变化"))
    return None
