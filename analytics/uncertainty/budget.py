"""An uncertainty budget: its components, combined and expanded by the law of propagation (JCGM 100 5, 6)."""

import math
from functools import cached_property
from typing import Literal, NamedTuple

import msgspec
import numpy as np

from analytics.methods.distributions import normal_cdf, normal_quantile, student_quantile, student_sf
from analytics.uncertainty.component import Component, Evaluation
from analytics.uncertainty.correlation import Correlation, correlation_matrix
from analytics.uncertainty.effective_freedom import combined_variance, effective_freedom
from analytics.uncertainty.rounding import round_up
from stream.batch import FloatArray
from stream.errors import BadInput, NotEnoughData

Method = Literal["JCGM 100", "JCGM 101"]


class Unknown(NamedTuple):
    """A component that belongs to a budget and of which nothing is stated."""

    en: str
    zh: str
    reason: str


class Expanded(NamedTuple):
    """An expanded uncertainty.

    >>> Expanded(1.0, 9.0, 2.0, 0.95, 2.0, "JCGM 100").rounded
    2.0
    """

    u: float  # combined standard uncertainty
    freedom: float  # effective degrees of freedom
    k: float  # coverage factor
    p: float  # coverage probability
    expanded: float  # U, unrounded
    method: Method

    @property
    def rounded(self) -> float:
        """U rounded up to two significant digits."""
        return round_up(self.expanded)


class Budget(msgspec.Struct, frozen=True, kw_only=True, dict=True):
    """The uncertainty budget of one measured value.

    Parameters
    ----------
    en, zh
        Name of the measurand.
    value
        The measured value.
    unit
        Unit of measure of the value and of U.
    components
        Its components.
    correlations
        Coefficients of pairs of components that are correlated, beside the components' groups.
    unknown
        Components of which nothing is stated: while there are any, the budget has no U.
    sources
        Clauses that the budget follows.

    Examples
    --------
    JJF 2014-2022 annex B.1:

    >>> table = Component.from_certificate("rate table", "速率转台", 1e-4, 2, "1")
    >>> voltmeter = Component.from_certificate("voltmeter", "数字电压表", 6e-5, 2, "1")
    >>> scatter = Component.type_a("repeatability", "测量重复性", 1.54e-4, 9, "1")
    >>> budget = Budget(en="Scale factor", zh="标度因数", value=1.0, unit="1", components=(table, voltmeter, scatter))
    >>> found = budget.expand(k=2)
    >>> round(found.u, 6), found.rounded, round(found.freedom, 1), round(found.p, 3)
    (0.000165, 0.00033, 11.8, 0.931)
    """

    en: str
    zh: str
    value: float
    unit: str
    components: tuple[Component, ...]
    correlations: tuple[Correlation, ...] = ()
    unknown: tuple[Unknown, ...] = ()
    sources: tuple[str, ...] = ()

    @cached_property
    def matrix(self) -> FloatArray:
        """Correlation coefficients of the components."""
        return correlation_matrix(self.components, self.correlations)

    def standard_uncertainty(self, evaluation: Evaluation | None = None) -> float:
        """Combined standard uncertainty, or that of the components of type A or B alone (JCGM 100 (10), (16))."""
        chosen = [
            place for place, each in enumerate(self.components) if evaluation is None or each.evaluation == evaluation
        ]
        signed = np.array([self.components[place].signed for place in chosen], dtype=np.float64)
        return math.sqrt(combined_variance(signed, self.matrix[np.ix_(chosen, chosen)]))

    @property
    def freedom(self) -> float:
        """Effective degrees of freedom."""
        return effective_freedom(self.components, self.matrix)

    def expand(self, *, k: float | None = None, p: float | None = None) -> Expanded:
        """Expanded uncertainty U = k u, with a given `k`, 2 by default, or with the k of a coverage probability `p`.

        k and p belong together by Student's t at the effective degrees of freedom (JCGM 100 G.4).

        Raises BadInput if both are given, or out of range; NotEnoughData if the budget has unknown components.
        """
        if self.unknown:
            lacking = "; ".join(f"{each.en}: {each.reason}" for each in self.unknown)
            raise NotEnoughData(f"{self.en}: no expanded uncertainty: {lacking}")
        if k is not None and p is not None:
            raise BadInput("an expanded uncertainty has a given k or a given p, not both")
        if (k is not None and not 0 < k < math.inf) or (p is not None and not 0 < p < 1):
            raise BadInput("an expanded uncertainty has k above 0, or p between 0 and 1")
        u, freedom = self.standard_uncertainty(), self.freedom
        if p is not None:
            upper = (1 + p) / 2
            k = normal_quantile(upper) if math.isinf(freedom) else float(student_quantile(upper, freedom))
        else:
            k = 2.0 if k is None else k
            p = coverage_probability(k, freedom)
        return Expanded(u, freedom, k, p, k * u, "JCGM 100")


def coverage_probability(k: float, freedom: float) -> float:
    """Probability that a value lies within k u, by Student's t.

    >>> round(coverage_probability(2, math.inf), 4), round(coverage_probability(2, 4), 4)
    (0.9545, 0.8839)
    """
    return 2 * normal_cdf(k) - 1 if math.isinf(freedom) else 1 - 2 * student_sf(k, freedom)
