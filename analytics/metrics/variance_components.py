"""Components of variance: how far values scatter within groups, and how far the groups scatter beyond that.

The groups are days in a repeatability, stations or fixtures where these are compared.
"""

import math
from collections.abc import Hashable, Sequence
from typing import NamedTuple

from scipy import special

from analytics.metrics.limits_of_value import CONFIDENCE

_TAIL = (1 - CONFIDENCE) / 2


class Deviation(NamedTuple):
    """A standard deviation with its limits, standard uncertainty and degrees of freedom."""

    value: float
    lo: float
    hi: float
    standard_uncertainty: float
    freedom: float


class Scatter(NamedTuple):
    """Sums of a one-way layout.

    Parameters
    ----------
    values : int
        How many values.
    square : float
        Variance of all of them, NaN for one.
    within, within_freedom : float
        Variance inside the groups, pooled, and its degrees of freedom; NaN and 0 where no group has two.
    groups : int
        How many groups.
    of_means : float
        Variance of the groups' means, NaN for one.
    size : float
        Harmonic mean of the groups' sizes, NaN where there is none.
    """

    values: int
    square: float
    within: float
    within_freedom: int
    groups: int
    of_means: float
    size: float


def scatter(values: Sequence[float], groups: Sequence[Hashable]) -> Scatter:
    """Sums of values in groups.

    Examples
    --------
    >>> scatter([1.0, 3.0, 5.0, 7.0], ["a", "a", "b", "b"])
    Scatter(values=4, square=6.666666666666667, within=2.0, within_freedom=2, groups=2, of_means=8.0, size=2.0)
    """
    told: dict[Hashable, list[float]] = {}
    for value, group in zip(values, groups, strict=True):
        told.setdefault(group, []).append(value)
    parts = list(told.values())
    means = [math.fsum(part) / len(part) for part in parts]
    freedom = len(values) - len(parts)
    inside = math.fsum((value - mean) ** 2 for part, mean in zip(parts, means, strict=True) for value in part)
    return Scatter(
        values=len(values),
        square=_variance(values),
        within=inside / freedom if freedom else math.nan,
        within_freedom=freedom,
        groups=len(parts),
        of_means=_variance(means),
        size=len(parts) / math.fsum(1 / len(part) for part in parts) if parts else math.nan,
    )


def _variance(values: Sequence[float]) -> float:
    if len(values) < 2:
        return math.nan
    mean = math.fsum(values) / len(values)
    return math.fsum((value - mean) ** 2 for value in values) / (len(values) - 1)


def deviation(variance: float, freedom: float) -> Deviation:
    """Root of a variance of normal values: limits by chi-square (JCGM 100:2008 E.4.3 for its uncertainty).

    Examples
    --------
    >>> [round(each, 3) for each in deviation(1.0, 5)]
    [1.0, 0.624, 2.453, 0.316, 5]
    """
    value = math.sqrt(variance)
    lo, hi = (value * math.sqrt(freedom / special.chdtri(freedom, tail)) for tail in (_TAIL, 1 - _TAIL))
    return Deviation(value, lo, hi, value / math.sqrt(2 * freedom), freedom)


def between(found: Scatter) -> Deviation:
    """Root of the variance between groups, beyond what the scatter within them makes of their means.

    Parameters
    ----------
    found : Scatter
        Of at least 2 groups, one of them of at least 2 values.

    Notes
    -----
    With h the harmonic mean of the sizes, the variance of the groups' means is sigma_b**2 + sigma_w**2/h on average, so
    sigma_b**2 = var(means) - within/h, 0 where that is negative; with equal sizes it is what the analysis of variance
    gives. The limits are those of Tukey and Williams with h times the variance of the means for the mean square between
    groups (Thomas and Hultquist 1978); they hold at least at their level also where the component is nearly 0. Degrees
    of freedom are by Satterthwaite.

    Examples
    --------
    >>> found = between(scatter([1.0, 3.0, 5.0, 7.0], ["a", "a", "b", "b"]))
    >>> round(found.value, 3), round(found.lo, 3), round(found.hi, 1)
    (2.646, 0.0, 90.2)
    """
    h, freedom, within_freedom = found.size, found.groups - 1, found.within_freedom
    variance = max(found.of_means - found.within / h, 0.0)
    bounds = []
    for tail in (_TAIL, 1 - _TAIL):
        least = h * found.of_means - found.within * special.fdtri(freedom, within_freedom, 1 - tail)
        bounds.append(math.sqrt(max(freedom * least / (h * special.chdtri(freedom, tail)), 0.0)))
    spread = 2 * (found.of_means**2 / freedom + (found.within / h) ** 2 / within_freedom)
    value = math.sqrt(variance)
    # where it is nearly 0 its root has no slope: a quarter of the interval says as much
    u = min(math.sqrt(spread) / (2 * value), (bounds[1] - bounds[0]) / 4) if value else (bounds[1] - bounds[0]) / 4
    return Deviation(value, bounds[0], bounds[1], u, max(2 * variance**2 / spread, 1.0) if spread else float(freedom))
