"""Components of variance by restricted maximum likelihood: units as a random effect, stations fixed or random.

Patterson and Thompson 1971; degrees of freedom after Satterthwaite (Giesbrecht and Burns 1985).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq, minimize
from scipy.special import chdtr, lambertw

from analytics.trends.groups.contrasts import ContrastEstimate, estimate, less_block_means
from stream.batch import FloatArray, IntArray

_CONFIDENCE = 0.95
_STEP = 1e-3
# of the logarithm of a variance ratio: beyond it the component is as good as none
_LEAST, _MOST = -16.0, 12.0
# where a component that may be none starts, likewise
_LIFTED = -3.0
# of the deviance: a component that lowers it by less is none
_NONE = 1e-6


class ComponentDeviation(NamedTuple):
    """Standard deviation of a component, with 95 % bounds by its profile likelihood."""

    value: float
    lo: float
    hi: float


class _Sums(NamedTuple):
    """Cross products of [random, fixed, y]."""

    within: FloatArray  # of what is less the mean of its unit
    between: FloatArray  # shape (sizes, m, m); of the sums over each unit, added over the units of one size
    sizes: IntArray  # numbers of values of a unit
    units: IntArray  # how many units have as many
    least: float  # squares that remain where all effects are free; no variances leave less


class _Equations(NamedTuple):
    """Equations of the random effects, the units absorbed and the fixed ones removed; the residual has variance 1."""

    ratio: float  # variance of units
    inverse_fixed: FloatArray  # of the cross products of the fixed columns
    beside: FloatArray  # coefficients of the fixed columns in [random, y]
    scale: FloatArray  # standard deviation of each random effect
    inverse: FloatArray  # of 1 + the cross products of the scaled random columns
    solution: FloatArray  # of the random effects in units of their scale
    squares: float  # y'V^-1 y that remains
    log_det: float  # of the two matrices that are inverted


@dataclass(frozen=True)
class MixedModel:
    """y = fixed @ beta + unit effects + effects of groups + residual, all effects normal and independent.

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
    # by name, of shape (n, levels); indicators of the levels of further random effects, which may cross each other
    random: Mapping[str, FloatArray] = field(default_factory=dict)

    @cached_property
    def _sums(self) -> _Sums:
        columns = np.column_stack([*self.random.values(), self.fixed, (self.y - self.y.mean())[:, None]])
        counts = np.bincount(self.unit)
        order = np.argsort(self.unit, kind="stable")
        sums = np.add.reduceat(columns[order], np.r_[0, np.cumsum(counts)[:-1]], axis=0)
        within = less_block_means(columns, self.unit)
        sizes = np.unique(counts)
        between = np.array([sums[counts == size].T @ sums[counts == size] for size in sizes])
        units = np.array([(counts == size).sum() for size in sizes])
        free = within[:, -1] - within[:, :-1] @ np.linalg.lstsq(within[:, :-1], within[:, -1])[0]
        return _Sums(within.T @ within, between, sizes, units, float(free @ free))

    @property
    def has_repeats(self) -> bool:
        """Whether any unit has more than one value: else unit and residual cannot be separated."""
        return bool((self._sums.sizes > 1).any())

    def variance_ratio(self, name: str = "unit") -> float:
        """Variance of a component over that of the residual; 0 where there is no such component."""
        if name not in self._names:
            return 0.0
        return float(np.exp(self._optimum[self._names.index(name)] - self._optimum[0]))

    def effects(self, contrasts: FloatArray) -> list[ContrastEstimate]:
        """Values of combinations of the fixed effects, with coefficients of shape (combinations, p)."""
        at = self._optimum
        beta, covariance = self._solved(at)
        freedoms = self._freedoms(at, contrasts)
        found = []
        for contrast, freedom in zip(contrasts, freedoms, strict=True):
            value = float(contrast @ beta) + float(contrast @ self._centre) * float(self.y.mean())
            found.append(estimate(value, float(np.sqrt(contrast @ covariance @ contrast)), float(freedom)))
        return found

    def deviations(self) -> dict[str, ComponentDeviation]:
        """Standard deviations of `residual`, `unit` where any was measured twice, and the other random effects."""
        return {name: self.deviation(name) for name in self._names}

    def deviation(self, name: str) -> ComponentDeviation:
        """One of the `deviations`."""
        return self._profile(self._names.index(name))

    @property
    def _names(self) -> list[str]:
        return ["residual", *["unit"] * self.has_repeats, *self.random]

    @cached_property
    def _centre(self) -> FloatArray:
        """Coefficients whose combination of the fixed columns is constant 1; zero where there are none."""
        ones = np.ones(self.y.size)
        beta = np.linalg.lstsq(self.fixed, ones, rcond=None)[0]
        return np.asarray(beta if np.allclose(self.fixed @ beta, ones) else 0.0 * beta, np.float64)

    @cached_property
    def _levels(self) -> list[slice]:
        """Columns of each of the further random effects."""
        ends = np.cumsum([0, *(each.shape[1] for each in self.random.values())])
        return [slice(int(first), int(last)) for first, last in pairwise(ends)]

    def _equations(self, logs: FloatArray) -> _Equations:
        """At the logarithms of the variances in the order of their names."""
        sums, q = self._sums, sum(each.shape[1] for each in self.random.values())
        ratio = float(np.exp(logs[1] - logs[0])) if self.has_repeats else 0.0
        # what lies between units is added to what lies within: no difference of large numbers
        inner = sums.within + np.tensordot(1 / (sums.sizes * (1 + ratio * sums.sizes)), sums.between, axes=1)
        fixed, rest = slice(q, len(inner) - 1), np.r_[:q, len(inner) - 1]
        size = 1 / np.sqrt(np.diag(inner)[fixed])
        correlated = size[:, None] * inner[fixed, fixed] * size
        inverse_fixed = size[:, None] * np.linalg.inv(correlated) * size
        beside = inverse_fixed @ inner[fixed][:, rest]
        left = inner[np.ix_(rest, rest)] - inner[rest, fixed] @ beside
        scale = np.empty(q)
        for at, levels in enumerate(self._levels, start=logs.size - len(self.random)):
            scale[levels] = np.exp((logs[at] - logs[0]) / 2)
        matrix, right = np.eye(q) + scale[:, None] * left[:-1, :-1] * scale, scale * left[:-1, -1]
        values, vectors = np.linalg.eigh(matrix)
        values = np.maximum(values, 1.0)  # 1 and what is not negative; rounding may lose the 1 beside large numbers
        inverse = np.asarray((vectors / values) @ vectors.T, np.float64)
        solution = inverse @ right
        log_det = float(np.linalg.slogdet(correlated)[1] - 2 * np.log(size).sum() + np.log(values).sum())
        # beside ratios of 1e16 the difference is rounding alone, perhaps negative, and would be the likeliest
        squares = max(float(left[-1, -1] - solution @ right), sums.least)
        return _Equations(ratio, inverse_fixed, beside, scale, inverse, solution, squares, log_det)

    def _deviance(self, logs: FloatArray) -> float:
        """-2 ln of the restricted likelihood, up to a constant."""
        return self._deviance_at(logs, self._equations(logs))

    def _deviance_at(self, logs: FloatArray, found: _Equations) -> float:
        freedom = self.y.size - self.fixed.shape[1]
        of_units = float(self._sums.units @ np.log1p(found.ratio * self._sums.sizes))
        return float(freedom * logs[0] + of_units + found.log_det + found.squares * np.exp(-logs[0]))

    def _slopes(self, logs: FloatArray, found: _Equations) -> FloatArray:
        """Derivatives of the deviance."""
        sums, precision, q = self._sums, float(np.exp(-logs[0])), found.scale.size
        slopes = np.empty(logs.size)
        if self.has_repeats:
            change = np.tensordot(-1 / (1 + found.ratio * sums.sizes) ** 2, sums.between, axes=1)
            of_fixed = float((found.inverse_fixed * change[q:-1, q:-1]).sum())
            turn = np.insert(np.eye(q + 1), [q] * len(found.beside), -found.beside, axis=0)
            change = turn.T @ change @ turn
            turned = found.scale[:, None] * found.inverse * found.scale
            rest = np.r_[-found.scale * found.solution, 1.0]
            of_units = float(sums.units @ (sums.sizes / (1 + found.ratio * sums.sizes)))
            of_groups = float((turned * change[:-1, :-1]).sum())
            slopes[1] = found.ratio * (of_units + of_fixed + of_groups + float(rest @ change @ rest) * precision)
        for at, levels in enumerate(self._levels, start=logs.size - len(self.random)):
            kept = np.diag(found.inverse)[levels]
            slopes[at] = kept.size - kept.sum() - float((found.solution[levels] ** 2).sum()) * precision
        # all variances multiplied by one number scale the squares alone
        slopes[0] = self.y.size - self.fixed.shape[1] - found.squares * precision - slopes[1:].sum()
        return slopes

    def _solved(self, logs: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Fixed effects and their covariance."""
        found = self._equations(logs)
        of_random = found.beside[:, :-1] * found.scale
        covariance = found.inverse_fixed + of_random @ found.inverse @ of_random.T
        return found.beside[:, -1] - of_random @ found.solution, covariance * float(np.exp(logs[0]))

    @cached_property
    def _bounds(self) -> tuple[float, float]:
        """Bounds of the logarithms of the variances."""
        within = float(self._sums.within[-1, -1]) / max(self.y.size - int(self._sums.units.sum()), 1)
        total = max(float(self.y.var()), 1e-300)
        return float(np.log(within if within > 1e-20 * total else total)) + _LEAST, float(np.log(total)) + _MOST

    @cached_property
    def _optimum(self) -> FloatArray:
        """Logarithms of the variances at the greatest restricted likelihood."""
        low, high = self._bounds
        total, within = high - _MOST, low - _LEAST
        shifts = ((total, *[total - 1.0] * (len(self._names) - 1)), (within, *[total] * (len(self._names) - 1)))
        best, least = min((self._least(np.array(start)) for start in shifts), key=lambda each: each[1])
        for index in range(1, best.size):
            # a component that makes the data no likelier is none
            without = best.copy()
            without[index] = low
            found = self._least(without, (index, low)) if best[index] > low else (without, least)
            if found[1] <= least + _NONE:
                best, least = found
        return best

    def _least(self, start: FloatArray, fixed: tuple[int, float] | None = None) -> tuple[FloatArray, float]:
        """The best point from a start, with one of the logarithms fixed if given."""
        free = [index for index in range(start.size) if fixed is None or index != fixed[0]]
        whole = start.copy()
        if fixed is not None:
            if fixed[1] < start[fixed[0]]:
                # others may take over; from none they would not come back, the likelihood hardly changes there
                whole = np.maximum(whole, whole[0] + _LIFTED)
            whole[fixed[0]] = fixed[1]
        if not free:
            return whole, self._deviance(whole)

        def deviance(part: FloatArray) -> tuple[float, FloatArray]:
            at = whole.copy()
            at[free] = part
            found = self._equations(at)
            return self._deviance_at(at, found), self._slopes(at, found)[free]

        options = {"ftol": 1e-12 if fixed is None else 1e-9, "gtol": 1e-6, "maxiter": 500}
        best = minimize(
            deviance, whole[free], jac=True, method="L-BFGS-B", bounds=[self._bounds] * len(free), options=options
        )
        whole[free] = best.x
        return whole, float(best.fun)

    def _freedoms(self, at: FloatArray, contrasts: FloatArray) -> FloatArray:
        """Satterthwaite: 2*v**2 over the variance of v, by the curvature of the likelihood."""
        residual = float(self.y.size - self.fixed.shape[1])
        # a component at its bound does not change the uncertainty
        live = [index for index in range(at.size) if index == 0 or at[index] > self._bounds[0]]
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

    def _freedom(self, index: int) -> int:
        """Degrees of freedom of a component at most: one less than it has levels."""
        levels = [int(self._sums.units.sum())] * self.has_repeats + [each.shape[1] for each in self.random.values()]
        rest = int(self.y.size) - self.fixed.shape[1] - sum(each - 1 for each in levels)
        return max(1, int(rest) if index == 0 else levels[index - 1] - 1)

    def _profile(self, index: int) -> ComponentDeviation:
        at = self._optimum
        rise = _rise(self._freedom(index))
        least = self._deviance(at)

        def above(log: float) -> float:
            return self._least(at, (index, log))[1] - least - rise

        most = max(_MOST, self._bounds[1] - float(at[index]))  # also from a component that is none
        is_none = index > 0 and at[index] <= self._bounds[0]
        lo = None if is_none else _crossing(above, float(at[index]), -1.0, _LEAST)
        hi = _crossing(above, float(at[index]), 1.0, most)
        low, high = 0.0 if lo is None else np.exp(lo / 2), np.inf if hi is None else np.exp(hi / 2)
        return ComponentDeviation(0.0 if is_none else float(np.exp(at[index] / 2)), float(low), float(high))


@cache
def _rise(freedom: int) -> float:
    """How far above its least the deviance of a variance with so many degrees of freedom is at the 95 % bounds.

    For a mean square, which follows a chi-square law; for many degrees of freedom that of the likelihood ratio.
    """

    def beyond(rise: float) -> float:
        edge = -np.exp(-1 - rise / freedom)
        low, high = (-freedom * float(lambertw(edge, branch).real) for branch in (0, -1))
        return _CONFIDENCE - float(chdtr(freedom, high) - chdtr(freedom, low))

    return float(brentq(beyond, 3.0, 8.0))


def _crossing(above: Callable[[float], float], start: float, step: float, most: float) -> float | None:
    """Where a function that is negative at `start` becomes positive in steps of that sign; None if it does not."""
    inside = start
    while abs(inside - start) < abs(most):
        outside = inside + step
        if above(outside) > 0:
            if above(inside) >= 0:  # at the optimum itself, within its tolerance
                return inside
            return float(brentq(above, min(inside, outside), max(inside, outside), xtol=3e-3))
        inside, step = outside, step * 1.5
    return None
