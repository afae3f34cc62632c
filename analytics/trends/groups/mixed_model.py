"""Components of variance by restricted maximum likelihood: units as a random effect, stations fixed or random.

Patterson and Thompson 1971; degrees of freedom after Satterthwaite (Giesbrecht and Burns 1985).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq, minimize

from analytics.methods.distributions import chi_square_quantile, student_quantile, student_sf
from stream.batch import FloatArray, IntArray

_CONFIDENCE = 0.95
_STEP = 1e-3
_DEPENDENT = 1e-9
# of the logarithm of a variance ratio: beyond it the component is as good as none
_LEAST, _MOST = -16.0, 16.0


class ContrastEstimate(NamedTuple):
    """A combination of fixed effects, with 95 % bounds."""

    value: float  # in the unit of the values, as its bounds and standard uncertainty
    lo: float
    hi: float
    standard_uncertainty: float
    freedom: float  # degrees of freedom of the uncertainty
    chance: float  # probability of a value at least this far from 0 if it is 0


class ComponentDeviation(NamedTuple):
    """Standard deviation of a component, with 95 % bounds by its profile likelihood."""

    value: float
    lo: float
    hi: float


@dataclass(frozen=True)
class MixedModel:
    """y = fixed @ beta + unit effects + random effects + residual, all effects normal and independent.

    >>> rng = np.random.default_rng(2)
    >>> unit = np.repeat(np.arange(500), 3)
    >>> y = 10 + rng.normal(0, 2, 500)[unit] + rng.normal(0, 1, 1500)
    >>> found = MixedModel(y, np.ones((1500, 1)), unit).deviations()
    >>> found["unit"].lo < 2.0 < found["unit"].hi, found["residual"].lo < 1.0 < found["residual"].hi
    (True, True)
    """

    y: FloatArray
    fixed: FloatArray  # shape (n, p); columns of full rank
    unit: IntArray  # shape (n,); unit of each value, from 0
    random: FloatArray | None = None  # shape (n, q); indicators of the levels of a second random effect

    @cached_property
    def _sums(self) -> tuple[FloatArray, FloatArray, IntArray]:
        """Cross products within units of [random, fixed, y], their sums in each unit, and values in each unit."""
        random = [] if self.random is None else [self.random]
        columns = np.column_stack([*random, self.fixed, (self.y - self.y.mean())[:, None]])
        counts = np.bincount(self.unit)
        order = np.argsort(self.unit, kind="stable")
        starts = np.r_[0, np.cumsum(counts)[:-1]]
        within = less_block_means(columns, self.unit)
        return within.T @ within, np.add.reduceat(columns[order], starts, axis=0), counts

    @property
    def has_repeats(self) -> bool:
        """Whether any unit has more than one value: else unit and residual cannot be separated."""
        return bool((self._sums[2] > 1).any())

    @property
    def variance_ratio(self) -> float:
        """Variance from unit to unit over that of the residual; 0 where no unit has two values."""
        return float(np.exp(self._optimum[1] - self._optimum[0])) if self.has_repeats else 0.0

    def effects(self, contrasts: FloatArray) -> list[ContrastEstimate]:
        """Values of combinations of the fixed effects, with coefficients of shape (combinations, p)."""
        at = self._optimum
        beta, covariance = self._solved(at)
        freedoms = self._freedoms(at, contrasts)
        found = []
        for contrast, freedom in zip(contrasts, freedoms, strict=True):
            value = float(contrast @ beta) + float(contrast @ self._centre) * float(self.y.mean())
            found.append(_estimate(value, float(np.sqrt(contrast @ covariance @ contrast)), float(freedom)))
        return found

    def deviations(self) -> dict[str, ComponentDeviation]:
        """Standard deviations of `unit`, `residual` and, where there is one, the second random effect (`random`)."""
        return {name: self.deviation(name) for name in self._names}

    def deviation(self, name: str) -> ComponentDeviation:
        """One of the `deviations`."""
        return self._profile(self._names.index(name))

    @property
    def _names(self) -> list[str]:
        return ["residual", *["unit"] * self.has_repeats, *["random"] * (self.random is not None)]

    @cached_property
    def _centre(self) -> FloatArray:
        """Coefficients whose combination of the fixed columns is constant 1; zero where there are none."""
        ones = np.ones(self.y.size)
        beta = np.linalg.lstsq(self.fixed, ones, rcond=None)[0]
        return np.asarray(beta if np.allclose(self.fixed @ beta, ones) else 0.0 * beta, np.float64)

    def _reduced(self, logs: FloatArray) -> tuple[FloatArray, float]:
        """[fixed, y]' V^-1 [fixed, y] and ln|V|, from the logarithms of the variances in the order of their names."""
        products, sums, counts = self._sums
        log_residual = float(logs[0])
        ratio = np.exp(logs[1] - log_residual) if self.has_repeats else 0.0
        # what lies between units is added to what lies within: no difference of large numbers
        weight = 1 / (counts * (1 + ratio * counts))
        inner = products + sums.T @ (weight[:, None] * sums)
        log_det = self.y.size * log_residual + float(np.log1p(ratio * counts).sum())
        if self.random is not None:
            q = self.random.shape[1]
            gamma = np.exp(logs[-1] - log_residual)
            middle = np.eye(q) + gamma * inner[:q, :q]
            inner = inner[q:, q:] - gamma * inner[q:, :q] @ np.linalg.solve(middle, inner[:q, q:])
            log_det += float(np.linalg.slogdet(middle)[1])
        return inner / np.exp(log_residual), log_det

    def _deviance(self, logs: FloatArray) -> float:
        """-2 ln of the restricted likelihood, up to a constant."""
        inner, log_det = self._reduced(logs)
        normal, right = inner[:-1, :-1], inner[:-1, -1]
        squares = float(inner[-1, -1] - right @ np.linalg.solve(normal, right))
        return log_det + float(np.linalg.slogdet(normal)[1]) + squares

    def _solved(self, logs: FloatArray) -> tuple[FloatArray, FloatArray]:
        inner, _ = self._reduced(logs)
        covariance = np.asarray(np.linalg.inv(inner[:-1, :-1]), np.float64)
        return covariance @ inner[:-1, -1], covariance

    @cached_property
    def _optimum(self) -> FloatArray:
        """Logarithms of the variances at the greatest restricted likelihood."""
        start = np.log(max(float(self.y.var()), 1e-300))
        shifts = ((0.0, -1.0, -1.0), (-3.0, 0.0, -4.0))
        candidates = [self._least(start + np.array(shift[: len(self._names)])) for shift in shifts]
        found = min(candidates, key=lambda each: each[1])[0]
        return np.clip(found, start + _LEAST, start + _MOST)

    def _least(self, start: FloatArray, fixed: tuple[int, float] | None = None) -> tuple[FloatArray, float]:
        """The best point from a start, with one of the logarithms fixed if given."""
        free = [index for index in range(start.size) if fixed is None or index != fixed[0]]
        whole = start.copy()
        if fixed is not None:
            whole[fixed[0]] = fixed[1]
        low, high = float(start[free[0]]) + _LEAST, float(start[free[0]]) + _MOST

        def deviance(part: FloatArray) -> float:
            at = whole.copy()
            at[free] = np.clip(part, low, high)
            return self._deviance(at)

        if fixed is None:
            options = {"xatol": 1e-7, "fatol": 1e-7, "maxiter": 2000}
            best = minimize(deviance, whole[free], method="Nelder-Mead", options=options)
        else:
            best = minimize(deviance, whole[free], method="L-BFGS-B", bounds=[(low, high)] * len(free))
        whole[free] = np.clip(best.x, low, high)
        return whole, float(best.fun)

    def _freedoms(self, at: FloatArray, contrasts: FloatArray) -> FloatArray:
        """Satterthwaite: 2*v**2 over the variance of v, by the curvature of the likelihood."""
        residual = float(self.y.size - self.fixed.shape[1])
        # a component at its bound does not change the uncertainty
        live = [index for index in range(at.size) if index == 0 or at[index] - at.max() > _LEAST / 2]
        shifts = np.zeros((len(live), at.size))
        shifts[np.arange(len(live)), live] = _STEP
        curvature = np.empty((len(live), len(live)))
        for i, one in enumerate(shifts):
            for j, two in enumerate(shifts):
                corners = [self._deviance(at + a * one + b * two) * a * b for a in (1, -1) for b in (1, -1)]
                curvature[i, j] = sum(corners) / (4 * _STEP**2)
        spread = 2 * np.linalg.pinv(curvature, hermitian=True)

        def variances(logs: FloatArray) -> FloatArray:
            covariance = self._solved(logs)[1]
            return np.asarray(np.einsum("ij,jk,ik->i", contrasts, covariance, contrasts), np.float64)

        slopes = np.array([(variances(at + one) - variances(at - one)) / (2 * _STEP) for one in shifts])
        wobble = np.einsum("ki,kl,li->i", slopes, spread, slopes)
        with np.errstate(divide="ignore", invalid="ignore"):
            freedom = 2 * variances(at) ** 2 / wobble
        return np.clip(np.where(wobble > 0, freedom, residual), 1.0, residual)

    def _profile(self, index: int) -> ComponentDeviation:
        at = self._optimum
        rise = float(chi_square_quantile(_CONFIDENCE, 1))
        least = self._deviance(at)

        def above(log: float) -> float:
            if at.size == 1:
                return self._deviance(np.array([log])) - least - rise
            return self._least(at, (index, log))[1] - least - rise

        lo, hi = (_crossing(above, float(at[index]), *way) for way in ((-1.0, _LEAST), (1.0, _MOST)))
        zero = index > 0 and at[index] - at.max() < _LEAST / 2
        low, high = 0.0 if lo is None else np.exp(lo / 2), np.inf if hi is None else np.exp(hi / 2)
        return ComponentDeviation(0.0 if zero else float(np.exp(at[index] / 2)), float(low), float(high))


def paired_difference(differences: FloatArray) -> ContrastEstimate:
    """Mean of at least 2 paired differences with bounds by Student's t."""
    n = differences.size
    return _estimate(float(differences.mean()), float(differences.std(ddof=1) / np.sqrt(n)), float(n - 1))


def less_block_means(values: FloatArray, block: IntArray) -> FloatArray:
    """Values of shape (n,) or (n, k) less the mean of their block, blocks counted from 0.

    >>> less_block_means(np.array([1.0, 3.0, 5.0]), np.array([0, 0, 1])).tolist()
    [-1.0, 1.0, 0.0]
    """
    counts = np.bincount(block)
    flat = values.reshape(len(values), -1)
    means = np.array([np.bincount(block, column) / counts for column in flat.T]).reshape(flat.shape[1], counts.size)
    return np.asarray((flat - means.T[block]).reshape(values.shape), np.float64)


def ols_estimates(
    y: FloatArray, columns: FloatArray, contrasts: FloatArray, *, blocks: int
) -> list[ContrastEstimate | None]:
    """Contrasts of a least-squares fit of values and columns from which the means of blocks were taken.

    None of a contrast that the columns do not determine.
    """
    inverse = np.linalg.pinv(columns.T @ columns, rcond=_DEPENDENT, hermitian=True)
    beta = inverse @ (columns.T @ y)
    freedom = y.size - blocks - int(np.linalg.matrix_rank(columns, tol=None))
    if freedom < 1:
        return [None] * len(contrasts)
    variance = float(((y - columns @ beta) ** 2).sum()) / freedom
    normal = columns.T @ columns
    found: list[ContrastEstimate | None] = []
    for contrast in contrasts:
        is_determined = np.allclose(normal @ (inverse @ contrast), contrast, atol=1e-6 * np.abs(contrast).max())
        error = float(np.sqrt(variance * (contrast @ inverse @ contrast)))
        found.append(_estimate(float(contrast @ beta), error, float(freedom)) if is_determined else None)
    return found


def _estimate(value: float, error: float, freedom: float) -> ContrastEstimate:
    half = float(student_quantile((1 + _CONFIDENCE) / 2, freedom)) * error
    chance = 2 * student_sf(abs(value) / error, freedom) if error > 0 else float(value == 0)
    return ContrastEstimate(value, value - half, value + half, error, freedom, chance)


def _crossing(above: Callable[[float], float], start: float, step: float, most: float) -> float | None:
    """Where a function that is negative at `start` becomes positive in steps of that sign; None if it does not."""
    inside = start
    while abs(inside - start) < abs(most):
        outside = inside + step
        if above(outside) > 0:
            return float(brentq(above, min(inside, outside), max(inside, outside), xtol=3e-3))
        inside, step = outside, step * 1.5
    return None


def holm(chances: list[float]) -> list[float]:
    """Probabilities adjusted for multiple tests (Holm 1979)."""
    adjusted = [0.0] * len(chances)
    running = 0.0
    for rank, index in enumerate(sorted(range(len(chances)), key=chances.__getitem__)):
        running = max(running, min(1.0, (len(chances) - rank) * chances[index]))
        adjusted[index] = running
    return adjusted
