"""Capability of a process against its specification: Cp and Cpk (NIST/SEMATECH e-Handbook 6.1.6, ISO 22514-2)."""

import math
from typing import NamedTuple

import numpy as np

from analytics.methods.distributions import chi_square_quantile, normal_quantile
from analytics.metric_registry.magnitudes import as_judged
from analytics.trends.series import MetricSeries, parameter_text
from analytics.trends.words import NotComputed, Words, not_computed, words
from storage.specifications.specification import SpecificationLimit
from storage.specifications.validity import Period, ordered_periods, stored_specifications
from storage.store import Store
from stream.batch import FloatArray
from stream.quantities import result_factor

LEAST_POINTS = 20
_CONFIDENCE = 0.95
_NOT_NORMAL = 0.01
_MOST_FOR_SHAPIRO = 5000


class LimitStretch(NamedTuple):
    """Specification limits between two moments; both None where there are none."""

    lower: float | None
    upper: float | None
    source: str
    from_ns: int
    until_ns: int


class SpecifiedLimits(NamedTuple):
    """Specification limits of a series, in its unit; `why_not` where there are none."""

    lower: float | None = None
    upper: float | None = None
    source: str = ""
    rule: str = ""  # decision rule of the limits
    why_not: Words | None = None
    stretches: tuple[LimitStretch, ...] = ()  # those with limits, from the first value to the last


def specified_limits(store: Store, series: MetricSeries) -> SpecifiedLimits:
    """Specification limits that are valid when the last value was measured, in the unit of the series.

    Values of products, or signals, with different limits have none in common. `stretches` are those that were valid
    when each value was measured.
    """
    periods = ordered_periods(stored_specifications(store))
    first, last = int(series.t_ns[0]), int(series.t_ns[-1])
    edges = sorted({first, *(t for each in periods for t in (each.from_ns, each.until_ns) if first < t <= last)})
    stretches = []
    for begin, end in zip(edges, [*edges[1:], last + 1], strict=True):
        there = _limits_at(periods, series, begin)
        if there.lower is not None or there.upper is not None:
            stretches.append(LimitStretch(there.lower, there.upper, there.source, begin, end))
    return _limits_at(periods, series, last)._replace(stretches=tuple(stretches))


def _limits_at(periods: list[Period], series: MetricSeries, moment: int) -> SpecifiedLimits:
    found: dict[tuple[float | None, float | None, str], str] = {}
    without = False
    valid = [each for each in periods if each.from_ns <= moment < each.until_ns]
    for product, signal in sorted(set(zip(series.groups["product"], series.groups["signal"], strict=True))):
        limits = ((as_judged(limit), each.specification.label) for each in valid for limit in each.specification.limits)
        own = [(limit, label) for limit, label in limits if _applies(limit, series, product, signal)]
        without = without or not own
        for limit, label in own:
            factor = result_factor(limit.unit_of_measure, series.unit_of_measure)
            lower, upper = (None if side is None else side * factor for side in (limit.lower, limit.upper))
            found[lower, upper, limit.decision_rule.value] = label
    if len(found) > 1 or (found and without):
        return SpecifiedLimits(why_not=words("limits_differ"))
    every = [SpecifiedLimits(lower, upper, label, rule) for (lower, upper, rule), label in found.items()]
    return every[0] if every else SpecifiedLimits()


def _applies(limit: SpecificationLimit, series: MetricSeries, product: str, signal: str) -> bool:
    parameters = dict(series.variant.parameters)
    return (
        limit.metric == series.metric
        and limit.product in {None, product}
        and limit.signal in {None, signal}
        and (limit.standard is None or limit.standard in series.variant.standard.split(", "))
        and all(parameters.get(name) == parameter_text(value) for name, value in limit.parameters.items())
    )


class Index(NamedTuple):
    """A capability index with 95 % bounds."""

    value: float
    lo: float
    hi: float


class Capability(NamedTuple):
    """Capability indices of a process."""

    lower: float | None  # specification limits, in the unit of the values
    upper: float | None
    # mean, sigma: of the values; `sigma` is the standard deviation of all of them (n - 1), which in a process in
    # control equals that from point to point
    mean: float
    sigma: float
    n: int
    units: int  # whose values they are; several of one unit, as of its axes, may be alike
    cp: Index | None  # (upper - lower)/(6*sigma); None where there is one limit only
    cpk: Index  # distance of the mean from the nearer limit over 3*sigma
    measurement_share: float | None  # share of the measurement uncertainty in the variance
    share_of: int  # values whose uncertainty is known, of which the share is
    # probability of values at least this far from normal if they are normal (Shapiro and Wilk)
    normality_chance: float

    @property
    def is_normal(self) -> bool:
        """Whether the values may be normal; else the indices do not give the share of units outside the limits."""
        return self.normality_chance >= _NOT_NORMAL


def capability(
    values: FloatArray, lower: float | None, upper: float | None, *, out_of_control: Words | None = None,
    uncertainty: FloatArray | None = None, units: int | None = None,
) -> Capability | NotComputed:  # fmt: skip
    """Capability indices of one value of each unit.

    Of several values of each of `units`, as of their axes, the bounds are those of as many values as there are units.

    `lower`, `upper`: specification limits. `out_of_control`: why the process is not in control; then it has no
    capability. `uncertainty`: standard uncertainties of the values; NaN where unknown.

    Bounds of Cp: from chi-square with n - 1 degrees of freedom; of Cpk: Cpk -+ z*sqrt(1/(9n) + Cpk**2/(2(n - 1)))
    (Bissell 1990). Both hold for normal values.

    >>> found = capability(np.random.default_rng(4).normal(16.0, 2.0, 400), 8.0, 20.0)
    >>> round(found.cp.value, 1), found.cpk.lo < 0.667 < found.cpk.hi
    (1.0, True)
    """
    n = values.size if units is None else units
    if (refused := _why_not(values, n, lower is not None or upper is not None, out_of_control)) is not None:
        return refused
    mean, sigma = float(values.mean()), float(values.std(ddof=1))
    cp = cp_index((upper - lower) / (6 * sigma), n) if lower is not None and upper is not None else None
    sides = [sign * (limit - mean) / (3 * sigma) for limit, sign in ((upper, 1), (lower, -1)) if limit is not None]
    known = np.empty(0) if uncertainty is None else uncertainty[np.isfinite(uncertainty)]
    share = min(1.0, float(np.mean(known**2)) / sigma**2) if known.size else None
    from scipy.stats import shapiro  # slow to import

    chance = float(shapiro(values[:_MOST_FOR_SHAPIRO]).pvalue)
    indices = (cp, cpk_index(min(sides), n))
    return Capability(lower, upper, mean, sigma, values.size, n, *indices, share, known.size, chance)


def cp_index(cp: float, n: int) -> Index:
    """Cp with its bounds."""
    tail = (1 - _CONFIDENCE) / 2
    lo, hi = (cp * math.sqrt(float(chi_square_quantile(p, n - 1)) / (n - 1)) for p in (tail, 1 - tail))
    return Index(cp, lo, hi)


def cpk_index(cpk: float, n: int) -> Index:
    """Cpk with its bounds."""
    half = normal_quantile((1 + _CONFIDENCE) / 2) * math.sqrt(1 / (9 * n) + cpk**2 / (2 * (n - 1)))
    return Index(cpk, cpk - half, cpk + half)


def _why_not(values: FloatArray, units: int, has_limit: bool, out_of_control: Words | None) -> NotComputed | None:
    if not has_limit:
        return not_computed("capability_no_limit")
    if units < LEAST_POINTS:
        return not_computed("capability_short", units=units, s="s" * (units != 1), least=LEAST_POINTS)
    if out_of_control is not None:
        return not_computed("capability_not_in_control", why=out_of_control)
    return None if values.std() > 0 else not_computed("capability_constant")
