"""Repeatability over days: standard deviations and components of variance, less the noise of what was measured.

All functions are of many tests at once: unless stated otherwise an array has an element for each test.
"""

from collections.abc import Callable, Hashable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import special

from analytics.methods.confidence_bounds import CONFIDENCE
from stream.batch import BoolArray, FloatArray, IntArray

KINDS = ("all", "run_to_run", "day_to_day", "within_day_component", "between_day_component")
_MANY = 1e9  # degrees of freedom of what is known
_TAIL = (1 - CONFIDENCE) / 2
Reasons = npt.NDArray[np.object_]  # texts, None where there is a value


class DeviationEstimate(NamedTuple):
    """Standard deviations with their bounds, standard uncertainties and degrees of freedom."""

    value: FloatArray
    lo: FloatArray
    hi: FloatArray
    standard_uncertainty: FloatArray
    freedom: FloatArray


class Variance(NamedTuple):
    """Estimates of variances and their degrees of freedom; NaN where one is not known."""

    value: FloatArray
    freedom: FloatArray


class MeansNoise(NamedTuple):
    """What the values' own uncertainty adds to the variances of a one-way layout."""

    square: Variance  # to the variance of all values
    within: Variance  # to that within the groups
    of_means: Variance  # to that of the groups' means


class ValuesNoise(NamedTuple):
    """What the noise of values adds to their scatter: as estimated, and the least that it can be."""

    likely: MeansNoise
    least: MeansNoise


class Layout(NamedTuple):
    """Values of tests in groups, as of days."""

    tests: int
    of: IntArray  # test of each value
    group: IntArray  # group of each value, numbered over all tests
    of_group: IntArray  # test of each group

    @classmethod
    def of_names(cls, counts: Sequence[int] | IntArray, names: Sequence[Hashable]) -> "Layout":
        """`counts`: how many values each test has; `names`: the group of each value, test after test.

        >>> Layout.of_names([2, 3], ["mon", "mon", "mon", "tue", "mon"]).group.tolist()
        [0, 0, 1, 2, 1]
        """
        of = np.repeat(np.arange(len(counts)), counts)
        numbers: dict[Hashable, int] = {}
        codes = np.array([numbers.setdefault(name, len(numbers)) for name in names], np.int64)
        groups, group = np.unique(of * max(len(numbers), 1) + codes, return_inverse=True)
        return cls(len(counts), of, group, groups // max(len(numbers), 1))

    def total(self, weights: FloatArray | None = None) -> FloatArray:
        """Sums of the values of each test, or how many it has."""
        return np.bincount(self.of, weights, self.tests).astype(np.float64)

    def group_total(self, weights: FloatArray | None = None) -> FloatArray:
        """The same of each group."""
        return np.bincount(self.group, weights, len(self.of_group)).astype(np.float64)

    def over_groups(self, weights: FloatArray | None = None) -> FloatArray:
        """Sums over the groups of each test of what there is of each group, or how many groups it has."""
        return np.bincount(self.of_group, weights, self.tests).astype(np.float64)


class Scatter(NamedTuple):
    """Sums of one-way layouts."""

    values: FloatArray  # how many
    square: FloatArray  # variance of all of them, NaN for one
    within: FloatArray  # variance within the groups, pooled; NaN where no group has two
    within_freedom: FloatArray
    groups: FloatArray  # how many
    of_means: FloatArray  # variance of the groups' means, NaN for one
    size: FloatArray  # harmonic mean of the groups' sizes, NaN where there is none


def scatter(values: FloatArray, layout: Layout) -> Scatter:
    """Sums of values (one for each value of the layout) in groups."""
    n, sizes, groups = layout.total(), layout.group_total(), layout.over_groups()
    # from the first value of each test on, so that the variance of equal values is 0
    first = np.zeros(layout.tests)
    first[layout.of[::-1]] = values[::-1]
    off = values - first[layout.of]
    means = layout.group_total(off) / sizes
    freedom = n - groups
    with np.errstate(divide="ignore", invalid="ignore"):
        square = layout.total((off - (layout.total(off) / n)[layout.of]) ** 2) / (n - 1)
        within = layout.total((off - means[layout.group]) ** 2) / freedom
        of_means = layout.over_groups((means - (layout.over_groups(means) / groups)[layout.of_group]) ** 2) / (
            groups - 1
        )
        size = groups / layout.over_groups(1 / sizes)
    return Scatter(
        n, np.where(n < 2, np.nan, square), np.where(freedom > 0, within, np.nan), freedom, groups,
        np.where(groups < 2, np.nan, of_means), size,
    )  # fmt: skip


def pooled(uncertainties: FloatArray, freedoms: FloatArray, layout: Layout) -> FloatArray:
    """Uncertainties (of each value) of equivalent records replaced by the pooled one of their test.

    Each is weighted; where one is NaN they stay as they are.

    >>> found = pooled(np.array([1.0, 3.0]), np.array([99.0, 1.0]), Layout.of_names([2], "aa"))
    >>> found.round(3).tolist()
    [1.039, 1.039]
    """
    weights = _at_least_one(freedoms)
    with np.errstate(invalid="ignore"):
        together = np.sqrt(layout.total(weights * uncertainties**2) / layout.total(weights))[layout.of]
    return np.where(np.isnan(together), uncertainties, together)


def _at_least_one(freedoms: FloatArray) -> FloatArray:
    return np.maximum(np.nan_to_num(freedoms, nan=1.0), 1.0)


def means_noise(uncertainties: FloatArray, freedoms: FloatArray, layout: Layout) -> MeansNoise:
    """What values with these standard uncertainties add to the variances of their groups, on average."""
    n, groups, own = layout.total(), layout.over_groups(), layout.group_total()[layout.group]
    degrees = _at_least_one(freedoms)

    def mean_square(weights: FloatArray) -> Variance:
        parts = weights * uncertainties**2
        total, fourth = layout.total(parts), layout.total(parts**2 / degrees)
        return Variance(total, np.where(fourth == 0, 1e9, total**2 / fourth))

    with np.errstate(divide="ignore", invalid="ignore"):
        within = (1 - 1 / own) / (n - groups)[layout.of]  # NaN where no group has two
        return MeansNoise(
            mean_square(1 / n[layout.of]), mean_square(within), mean_square(1 / (own**2 * groups[layout.of]))
        )


def beyond(observed: Variance, known: Variance, least: Variance | None = None) -> DeviationEstimate:
    """Root of what variances hold beyond a part that was estimated elsewhere, 0 where that is all of it.

    `observed`: sum of both parts; its estimate follows chi-square. `known`: the part that is subtracted; NaN subtracts
    nothing. `least`: the least that this part can be, for the upper bound; the same if omitted.

    sigma**2 = observed - known. The bounds are those of Tukey and Williams; they hold at least at their level also
    where what is left is nearly 0, and are those of chi-square where nothing is subtracted. Degrees of freedom by
    Satterthwaite.

    >>> def one(*numbers): return Variance(*(np.array([each]) for each in numbers))
    >>> [round(float(each[0]), 3) for each in beyond(one(1.0, 5.0), one(0.0, 1e9))]
    [1.0, 0.624, 2.453, 0.316, 5.0]
    >>> float(beyond(one(8.4, 6.0), one(9.1, 40.0)).lo[0])
    0.0
    """
    freedom = observed.freedom
    part, part_freedom = _taken(known)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        variance = np.maximum(observed.value - part, 0.0)
        bounds = []
        for tail, off in ((_TAIL, known), (1 - _TAIL, known if least is None else least)):
            taken, taken_freedom = _taken(off)
            left = observed.value - taken * special.fdtri(freedom, taken_freedom, 1 - tail)
            bounds.append(np.sqrt(np.maximum(freedom * left / special.chdtri(freedom, tail), 0.0)))
        spread = 2 * (observed.value**2 / freedom + part**2 / part_freedom)
        value = np.sqrt(variance)
        # near 0 the root has no slope: a quarter of the interval stands for its uncertainty
        quarter = (bounds[1] - bounds[0]) / 4
        by_slope = np.where(value > 0, np.sqrt(spread) / (2 * value), np.inf)
        u = np.minimum(by_slope, quarter)
        left_freedom = np.where(spread > 0, np.maximum(2 * variance**2 / spread, 1.0), freedom)
        # the interval has its degrees of freedom in it already: a quarter of it goes with a factor of 2
        left_freedom = np.where(quarter < by_slope, _MANY, left_freedom)
    return DeviationEstimate(value, bounds[0], bounds[1], u, left_freedom)


def are_none(reasons: Reasons) -> BoolArray:
    """Where there is no reason.

    >>> are_none(np.array(["no", None], dtype=object)).tolist()
    [False, True]
    """
    return np.array([each is None for each in reasons.tolist()], dtype=bool)


def _taken(known: Variance) -> Variance:
    is_known = known.value > 0
    return Variance(np.where(is_known, known.value, 0.0), np.where(is_known, known.freedom, 1e9))


def between(found: Scatter) -> DeviationEstimate:
    """Root of the variance between at least 2 groups, beyond what the scatter within them adds to their means.

    With h the harmonic mean of the sizes, the variance of the groups' means is sigma_b**2 + sigma_w**2/h on average, so
    sigma_b**2 = var(means) - within/h, 0 where that is negative; with equal sizes it is the estimate of the analysis of
    variance (`beyond`; Thomas and Hultquist 1978).
    """
    of_means = Variance(found.of_means, found.groups - 1)
    return beyond(of_means, Variance(found.within / found.size, found.within_freedom))


def deviations_of(
    found: Scatter, kind: str, what: str, is_dated: BoolArray, noise: ValuesNoise | None = None
) -> tuple[DeviationEstimate, Reasons]:
    """One of the `KINDS` of deviations of tests of at least 2 values, and the reasons where there is none.

    In groups of days; in groups of runs where the days are not known. `what`: what was measured, in the plural, as
    ``power-ons``. What the values' own `noise` adds is subtracted.
    """
    no_noise = Variance(np.zeros_like(found.square), np.full_like(found.square, _MANY))
    likely, least = noise or ValuesNoise(*(MeansNoise(no_noise, no_noise, no_noise),) * 2)
    unrepeated = found.within_freedom == 0
    reasons = np.full(len(found.values), None, dtype=object)

    def refuse(where: BoolArray, text: Callable[[int, int, str], str]) -> None:
        for at in np.flatnonzero(where & are_none(reasons)).tolist():
            reasons[at] = text(int(found.values[at]), int(found.groups[at]), "days" if is_dated[at] else "runs")

    of_days = kind in {"day_to_day", "between_day_component"}
    refuse(~is_dated & (unrepeated if not of_days and kind != "all" else of_days), lambda *_: (
        "the date is unknown, so the day is: import with the moment of the start"
    ))  # fmt: skip
    if kind == "all":
        refuse((found.groups > 1) & ~unrepeated, lambda n, groups, days: (
            f"{n} {what} of {groups} {days}, several of one, which share its effect: one deviation of all says "
            "neither; see run_to_run, day_to_day and their components"
        ))  # fmt: skip
        return beyond(Variance(found.square, found.values - 1), likely.square, least.square), reasons
    if kind != "day_to_day":
        refuse(unrepeated, lambda n, *_: f"each of the {n} {what} is of another day, 2 of one day are needed")
    if kind in {"run_to_run", "within_day_component"}:
        return beyond(Variance(found.within, found.within_freedom), likely.within, least.within), reasons
    refuse(found.groups < 2, lambda n, *_: f"all {n} {what} are of one day, 2 days are needed")
    if kind == "day_to_day":
        return beyond(Variance(found.of_means, found.groups - 1), likely.of_means, least.of_means), reasons
    # the scatter within the days contains the noise of the values
    return between(found), reasons


def scatters(found: Scatter, noise: ValuesNoise, kind: str) -> dict[str, FloatArray]:
    """Of a deviation the noise of the values in it, and the deviation without that noise."""
    part = {"all": "square", "run_to_run": "within", "within_day_component": "within"}.get(kind, "of_means")
    whole, known = getattr(found, part), getattr(noise.likely, part).value
    parts = {"uncertainty_of_means": known, "beyond_uncertainty": np.maximum(whole - known, 0.0)}
    return {name: np.sqrt(each) for name, each in parts.items()}
