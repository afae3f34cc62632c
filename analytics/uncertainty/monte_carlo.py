"""Propagation of distributions by Monte Carlo (JCGM 101), the check of the law of propagation."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import scipy

from analytics.uncertainty.budget import Budget, Expanded
from analytics.uncertainty.component import Component
from analytics.uncertainty.correlation import correlation_matrix
from analytics.uncertainty.distribution import Distribution
from stream.batch import FloatArray
from stream.errors import BadInput, NotEnoughData

# deviations of the input quantities, one row a component, to deviations of the measurand
Model = Callable[[FloatArray], FloatArray]
_BATCH = 10_000  # trials of one round (JCGM 101 7.9.4 b)
_LEAST_ROUNDS = 10


class Propagated(NamedTuple):
    """Distribution of a measurand: its standard deviation and the probabilistically symmetric coverage interval."""

    mean: float  # deviation of the expectation from the value
    u: float
    lo: float  # of the deviation from the value
    hi: float
    p: float
    trials: int
    is_stable: bool  # the numerical tolerance of two digits of u is reached (JCGM 101 7.9.4)

    def expanded(self) -> Expanded:
        """As an expanded uncertainty: half the length of the coverage interval, k = U/u (JCGM 101 3.16)."""
        half = (self.hi - self.lo) / 2
        k = half / self.u if self.u else 0.0
        return Expanded(self.u, math.inf, k, self.p, half, "JCGM 101")

    def confirms(self, first_order: Expanded, digits: int = 2) -> bool:
        """Whether a first-order interval agrees within the numerical tolerance of its u (JCGM 101 8.1).

        The first-order interval must be of the same p.
        """
        if not math.isclose(first_order.p, self.p, abs_tol=1e-9):
            raise BadInput(f"an interval of p = {first_order.p:g} cannot be compared with one of p = {self.p:g}")
        tolerance = numerical_tolerance(first_order.u, digits)
        return abs(self.lo + first_order.expanded) <= tolerance and abs(self.hi - first_order.expanded) <= tolerance


def numerical_tolerance(u: float, digits: int = 2) -> float:
    """Half a unit of the last of some significant digits of u (JCGM 101 7.9.2).

    >>> numerical_tolerance(0.000352), numerical_tolerance(0.000352, digits=1)
    (5e-06, 5e-05)
    """
    return 0.5 * 10.0 ** (math.floor(math.log10(u)) - digits + 1) if u > 0 else 0.0


def propagate(
    budget: Budget, p: float = 0.95, *, model: Model | None = None, seed: int = 1, most_trials: int = 2_000_000
) -> Propagated:
    """Propagate the distributions of a budget's components until two digits of the results are stable.

    Parameters
    ----------
    budget
        Its components; unknown ones are refused.
    p
        Coverage probability.
    model
        Deviation of the measurand by the deviations of the input quantities, one row a component; without it,
        the sum of sensitivity times deviation.
    seed
        Seed of the random numbers.
    most_trials
        Trials after which it stops, stable or not.

    Examples
    --------
    Four uniform inputs of u = 1 (JCGM 101 9.2.3: u = 2.0, interval -+ 3.88):

    >>> one = [Component.from_half_width(f"x{i}", "", 3**0.5, Distribution.UNIFORM, "1") for i in range(4)]
    >>> found = propagate(Budget(en="sum", zh="和", value=0.0, unit="1", components=tuple(one)))
    >>> round(found.u, 1), round(found.hi, 1), found.is_stable
    (2.0, 3.9, True)
    """
    if budget.unknown or not budget.components:
        lacking = ", ".join(each.en for each in budget.unknown) or "its components"
        raise NotEnoughData(f"{budget.en}: nothing can be propagated, nothing is stated of {lacking}")
    sensitivity = np.array([each.sensitivity for each in budget.components])
    sampler = _Sampler(budget.components, correlation_matrix(budget.components, budget.correlations), seed)
    found: list[tuple[float, float, float, float]] = []
    every: list[FloatArray] = []
    while True:
        deviations = sampler.draw(_BATCH)
        result = np.asarray(model(deviations) if model is not None else sensitivity @ deviations, dtype=np.float64)
        every.append(result)
        lo, hi = np.quantile(result, [(1 - p) / 2, (1 + p) / 2])
        found.append((float(result.mean()), float(result.std(ddof=1)), float(lo), float(hi)))
        trials = len(every) * _BATCH
        if len(found) >= _LEAST_ROUNDS:
            spread = 2 * np.std(found, axis=0, ddof=1) / math.sqrt(len(found))
            is_stable = bool(np.all(spread <= numerical_tolerance(float(np.mean(found, axis=0)[1]))))
            if is_stable or trials + _BATCH > most_trials:
                break
    values = np.concatenate(every)
    lo, hi = np.quantile(values, [(1 - p) / 2, (1 + p) / 2])
    return Propagated(float(values.mean()), float(values.std(ddof=1)), float(lo), float(hi), p, trials, is_stable)


class _Sampler:
    """Draws of the components' deviations; correlated ones by a Gaussian copula, exact at 0, 1 and for normals."""

    def __init__(self, components: Sequence[Component], matrix: FloatArray, seed: int) -> None:
        self.components = components
        self.random = np.random.default_rng(seed)
        values, vectors = np.linalg.eigh(matrix)
        self.root = vectors * np.sqrt(np.clip(values, 0, None))

    def draw(self, trials: int) -> FloatArray:
        normals = self.root @ self.random.standard_normal((len(self.components), trials))
        rows = []
        for component, normal in zip(self.components, normals, strict=True):
            is_normal = component.distribution is Distribution.NORMAL
            chances = None if is_normal else scipy.special.ndtr(normal)
            unit = normal if chances is None else component.distribution.quantiles(chances, component.freedom)
            rows.append(unit * component.u)
        return np.array(rows)
