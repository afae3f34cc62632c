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


class Variance(NamedTuple):
    """An estimate of a variance and its degrees of freedom; NaN where it is not known."""

    value: float
    freedom: float


_NOTHING = Variance(0.0, 1e9)


class MeansNoise(NamedTuple):
    """What the values' own uncertainty adds to the variances of a one-way layout.

    Parameters
    ----------
    square, within, of_means: To the variance of all values, to that inside the groups, to that of the groups' means.
    """

    square: Variance
    within: Variance
    of_means: Variance


class Scatter(NamedTuple):
    """Sums of a one-way layout.

    Parameters
    ----------
    values: How many values.
    square: Variance of all of them, NaN for one.
    within, within_freedom: Variance inside the groups, pooled, and its degrees of freedom; NaN and 0 where no group has
        two.
    groups: How many groups.
    of_means: Variance of the groups' means, NaN for one.
    size: Harmonic mean of the groups' sizes, NaN where there is none.
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


def pooled(uncertainties: Sequence[float | None], freedoms: Sequence[float | None]) -> list[float | None]:
    """Uncertainties of like records replaced by what they say together, each with its weight; None where one is None.

    Examples
    --------
    >>> [round(each, 3) for each in pooled([1.0, 3.0], [99, 1])]
    [1.039, 1.039]
    """
    known = [(u, max(freedom or 1.0, 1.0)) for u, freedom in zip(uncertainties, freedoms, strict=True) if u is not None]
    if len(known) < len(uncertainties):
        return list(uncertainties)
    weight = math.fsum(freedom for _, freedom in known)
    return [math.sqrt(math.fsum(freedom * u * u for u, freedom in known) / weight)] * len(known)


def means_noise(
    uncertainties: Sequence[float | None], freedoms: Sequence[float | None], groups: Sequence[Hashable]
) -> MeansNoise:
    """What values with these standard uncertainties add to the variances of their groups, on average.

    Examples
    --------
    >>> found = means_noise([1.0, 1.0, 1.0, 1.0], [9, 9, 9, 9], ["a", "a", "b", "b"])
    >>> found.square, found.of_means
    (Variance(value=1.0, freedom=36.0), Variance(value=0.5, freedom=36.0))
    """
    sizes: dict[Hashable, int] = {}
    for group in groups:
        sizes[group] = sizes.get(group, 0) + 1
    own = [sizes[group] for group in groups]
    n, free = len(own), len(own) - len(sizes)

    def mean_square(weights: Sequence[float]) -> Variance:
        parts = [
            (weight * u * u, freedom or 1.0)
            for weight, u, freedom in zip(weights, uncertainties, freedoms, strict=True)
            if u is not None
        ]
        total = math.fsum(part for part, _ in parts)
        if len(parts) < n or not n:
            return Variance(math.nan, math.nan)
        fourth = math.fsum(part * part / max(freedom, 1.0) for part, freedom in parts)
        return Variance(total, total * total / fourth if fourth else 1e9)

    return MeansNoise(
        square=mean_square([1 / n] * n) if n else Variance(math.nan, math.nan),
        within=mean_square([(1 - 1 / size) / free for size in own]) if free else Variance(math.nan, math.nan),
        of_means=mean_square([1 / (size * size * len(sizes)) for size in own]),
    )


def beyond(observed: Variance, known: Variance, least: Variance | None = None) -> Deviation:
    """Root of what a variance holds beyond a part that was estimated elsewhere, 0 where that is all of it.

    Parameters
    ----------
    observed: Sum of both parts; its estimate follows chi-square.
    known: The part that is taken off; NaN takes off nothing.
    least: The least that this part can be, for the upper limit; the same if left out.

    Notes
    -----
    sigma**2 = observed - known. The limits are those of Tukey and Williams; they hold at least at their level also
    where what is left is nearly 0, and are those of chi-square where nothing is taken off. Degrees of freedom by
    Satterthwaite.

    Examples
    --------
    >>> [round(each, 3) for each in beyond(Variance(1.0, 5), Variance(0.0, 1e9))]
    [1.0, 0.624, 2.453, 0.316, 5.0]
    >>> beyond(Variance(8.4, 6), Variance(9.1, 40)).lo
    0.0
    """
    part, part_freedom = known if known.value > 0 else _NOTHING
    variance = max(observed.value - part, 0.0)
    freedom = observed.freedom
    bounds = []
    for tail, off in ((_TAIL, known), (1 - _TAIL, known if least is None else least)):
        taken, taken_freedom = off if off.value > 0 else _NOTHING
        left = observed.value - taken * special.fdtri(freedom, taken_freedom, 1 - tail)
        bounds.append(math.sqrt(max(freedom * left / special.chdtri(freedom, tail), 0.0)))
    spread = 2 * (observed.value**2 / freedom + part**2 / part_freedom)
    value = math.sqrt(variance)
    # where it is nearly 0 its root has no slope: a quarter of the interval says as much
    quarter = (bounds[1] - bounds[0]) / 4
    u = min(math.sqrt(spread) / (2 * value), quarter) if value else quarter
    return Deviation(value, bounds[0], bounds[1], u, max(2 * variance**2 / spread, 1.0) if spread else float(freedom))


def between(found: Scatter) -> Deviation:
    """Root of the variance between groups, beyond what the scatter within them makes of their means.

    Parameters
    ----------
    found: Of at least 2 groups, one of them of at least 2 values.

    Notes
    -----
    With h the harmonic mean of the sizes, the variance of the groups' means is sigma_b**2 + sigma_w**2/h on average, so
    sigma_b**2 = var(means) - within/h, 0 where that is negative; with equal sizes it is what the analysis of variance
    gives (`beyond`; Thomas and Hultquist 1978).

    Examples
    --------
    >>> found = between(scatter([1.0, 3.0, 5.0, 7.0], ["a", "a", "b", "b"]))
    >>> round(found.value, 3), round(found.lo, 3), round(found.hi, 1)
    (2.646, 0.0, 90.2)
    """
    of_means = Variance(found.of_means, found.groups - 1)
    return beyond(of_means, Variance(found.within / found.size, found.within_freedom))
