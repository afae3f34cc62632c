"""Repeatability over days: standard deviations and components of variance, less the noise of what was measured."""

import math
from collections import Counter
from collections.abc import Hashable, Sequence
from typing import Any, NamedTuple

from scipy import special

from analytics.methods.confidence_bounds import CONFIDENCE

KINDS = ("all", "run_to_run", "day_to_day", "within_day_component", "between_day_component")
_TAIL = (1 - CONFIDENCE) / 2
_Numbers = Sequence[float | None]


class DeviationEstimate(NamedTuple):
    """A standard deviation with its bounds, standard uncertainty and degrees of freedom."""

    value: float
    lo: float
    hi: float
    standard_uncertainty: float
    freedom: float


class Variance(NamedTuple):
    """An estimate of a variance and its degrees of freedom; NaN where it is not known."""

    value: float
    freedom: float


_NOTHING, _UNKNOWN = Variance(0.0, 1e9), Variance(math.nan, math.nan)


class MeansNoise(NamedTuple):
    """What the values' own uncertainty adds to the variances of a one-way layout."""

    square: Variance = _UNKNOWN  # to the variance of all values
    within: Variance = _UNKNOWN  # to that within the groups
    of_means: Variance = _UNKNOWN  # to that of the groups' means


class ValuesNoise(NamedTuple):
    """What the noise of values adds to their scatter: as estimated, and the least that it can be."""

    likely: MeansNoise = MeansNoise()
    least: MeansNoise = MeansNoise()


_NO_NOISE = ValuesNoise()


class Scatter(NamedTuple):
    """Sums of a one-way layout."""

    values: int
    square: float  # variance of all of them, NaN for one
    within: float  # variance within the groups, pooled; NaN where no group has two
    within_freedom: int
    groups: int
    of_means: float  # variance of the groups' means, NaN for one
    size: float  # harmonic mean of the groups' sizes, NaN where there is none


def scatter(values: Sequence[float], groups: Sequence[Hashable]) -> Scatter:
    """Sums of values in groups."""
    by_group: dict[Hashable, list[float]] = {}
    for value, group in zip(values, groups, strict=True):
        by_group.setdefault(group, []).append(value)
    parts = list(by_group.values())
    means = [math.fsum(part) / len(part) for part in parts]
    freedom = len(values) - len(parts)
    inside = math.fsum((value - mean) ** 2 for part, mean in zip(parts, means, strict=True) for value in part)
    return Scatter(
        values=len(values), square=_variance(values), within=inside / freedom if freedom else math.nan,
        within_freedom=freedom, groups=len(parts), of_means=_variance(means),
        size=len(parts) / math.fsum(1 / len(part) for part in parts) if parts else math.nan,
    )  # fmt: skip


def _variance(values: Sequence[float]) -> float:
    if len(values) < 2:
        return math.nan
    mean = math.fsum(values) / len(values)
    return math.fsum((value - mean) ** 2 for value in values) / (len(values) - 1)


def pooled(uncertainties: _Numbers, freedoms: _Numbers) -> list[float | None]:
    """Uncertainties of equivalent records replaced by their pooled one, each weighted; unchanged where one is None.

    >>> [round(each, 3) for each in pooled([1.0, 3.0], [99, 1])]
    [1.039, 1.039]
    """
    known = [(u, max(freedom or 1.0, 1.0)) for u, freedom in zip(uncertainties, freedoms, strict=True) if u is not None]
    if len(known) < len(uncertainties):
        return list(uncertainties)
    weight = math.fsum(freedom for _, freedom in known)
    return [math.sqrt(math.fsum(freedom * u * u for u, freedom in known) / weight)] * len(known)


def means_noise(uncertainties: _Numbers, freedoms: _Numbers, groups: Sequence[Hashable]) -> MeansNoise:
    """What values with these standard uncertainties add to the variances of their groups, on average."""
    sizes = Counter(groups)
    own = [sizes[group] for group in groups]
    n, free = len(own), len(own) - len(sizes)

    def mean_square(weights: Sequence[float]) -> Variance:
        known = zip(weights, uncertainties, freedoms, strict=True)
        parts = [(weight * u * u, freedom or 1.0) for weight, u, freedom in known if u is not None]
        if len(parts) < n or not n:
            return _UNKNOWN
        total = math.fsum(part for part, _ in parts)
        fourth = math.fsum(part * part / max(freedom, 1.0) for part, freedom in parts)
        return Variance(total, total * total / fourth if fourth else 1e9)

    square = mean_square([1 / n] * n) if n else _UNKNOWN
    within = mean_square([(1 - 1 / size) / free for size in own]) if free else _UNKNOWN
    return MeansNoise(square, within, mean_square([1 / (size * size * len(sizes)) for size in own]))


def beyond(observed: Variance, known: Variance, least: Variance | None = None) -> DeviationEstimate:
    """Root of what a variance holds beyond a part that was estimated elsewhere, 0 where that is all of it.

    `observed`: sum of both parts; its estimate follows chi-square. `known`: the part that is subtracted; NaN subtracts
    nothing. `least`: the least that this part can be, for the upper bound; the same if omitted.

    sigma**2 = observed - known. The bounds are those of Tukey and Williams; they hold at least at their level also
    where what is left is nearly 0, and are those of chi-square where nothing is subtracted. Degrees of freedom by
    Satterthwaite.

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
    # near 0 the root has no slope: a quarter of the interval stands for its uncertainty
    quarter = (bounds[1] - bounds[0]) / 4
    u = min(math.sqrt(spread) / (2 * value), quarter) if value else quarter
    left_freedom = max(2 * variance**2 / spread, 1.0) if spread else float(freedom)
    return DeviationEstimate(value, bounds[0], bounds[1], u, left_freedom)


def between(found: Scatter) -> DeviationEstimate:
    """Root of the variance between at least 2 groups, beyond what the scatter within them adds to their means.

    With h the harmonic mean of the sizes, the variance of the groups' means is sigma_b**2 + sigma_w**2/h on average, so
    sigma_b**2 = var(means) - within/h, 0 where that is negative; with equal sizes it is the estimate of the analysis of
    variance (`beyond`; Thomas and Hultquist 1978).
    """
    of_means = Variance(found.of_means, found.groups - 1)
    return beyond(of_means, Variance(found.within / found.size, found.within_freedom))


def deviation_of(
    found: Scatter, kind: str, what: str, noise: ValuesNoise = _NO_NOISE, *, is_dated: bool
) -> dict[str, Any]:
    """One of the `KINDS` of deviations: the columns of a `DeviationEstimate`, or a `reason`.

    Of at least 2 values in groups of days; in groups of runs where the days are not known. `what`: what was measured,
    in the plural, as ``power-ons``. What the values' own `noise` adds is subtracted.
    """
    days = "days" if is_dated else "runs"
    likely, least = noise
    of_days = kind in {"day_to_day", "between_day_component"} or (kind != "all" and not found.within_freedom)
    if of_days and not is_dated:
        return {"reason": "the date is unknown, so the day is: import with the moment of the start"}
    if kind == "all":
        if found.groups > 1 and found.within_freedom:
            several = f"{found.values} {what} of {found.groups} {days}, several of one, which share its effect"
            other = "one deviation of all says neither; see run_to_run, day_to_day and their components"
            return {"reason": f"{several}: {other}"}
        return beyond(Variance(found.square, found.values - 1), likely.square, least.square)._asdict()
    if kind != "day_to_day" and not found.within_freedom:
        return {"reason": f"each of the {found.values} {what} is of another day, 2 of one day are needed"}
    if kind in {"run_to_run", "within_day_component"}:
        return beyond(Variance(found.within, found.within_freedom), likely.within, least.within)._asdict()
    if found.groups < 2:
        return {"reason": f"all {found.values} {what} are of one day, 2 days are needed"}
    if kind == "day_to_day":
        return beyond(Variance(found.of_means, found.groups - 1), likely.of_means, least.of_means)._asdict()
    # the scatter within the days contains the noise of the values
    return between(found)._asdict()


def scatters(found: Scatter, noise: ValuesNoise, kind: str) -> dict[str, float | None]:
    """The parts of a deviation: the scatter by the equation of the clauses, and the noise of the values in it."""
    part = {"all": "square", "run_to_run": "within", "within_day_component": "within"}.get(kind, "of_means")
    parts = {"scatter": getattr(found, part), "uncertainty_of_means": getattr(noise.likely, part).value}
    return {name: math.sqrt(each) if each >= 0 else None for name, each in parts.items()}
