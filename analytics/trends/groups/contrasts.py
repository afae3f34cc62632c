"""Estimates of combinations of fixed effects with their bounds, and chances adjusted for several of them."""

from typing import NamedTuple

import numpy as np

from analytics.methods.distributions import student_quantile, student_sf
from stream.batch import FloatArray, IntArray

_CONFIDENCE = 0.95
_DEPENDENT = 1e-9
# of the values: what is left is their rounding; and of what is explained: less cannot be computed beside it
_EXACT, _NEARLY_EXACT = 1e-12, 1e-3


class ContrastEstimate(NamedTuple):
    """A combination of fixed effects, with 95 % bounds."""

    value: float  # in the unit of the values, as its bounds and standard uncertainty
    lo: float
    hi: float
    standard_uncertainty: float
    freedom: float  # degrees of freedom of the uncertainty
    chance: float  # probability of a value at least this far from 0 if it is 0


def paired_difference(differences: FloatArray) -> ContrastEstimate:
    """Mean of at least 2 paired differences with bounds by Student's t."""
    n = differences.size
    return estimate(float(differences.mean()), float(differences.std(ddof=1) / np.sqrt(n)), float(n - 1))


def less_block_means(values: FloatArray, block: IntArray) -> FloatArray:
    """Values of shape (n,) or (n, k) less the mean of their block, blocks counted from 0.

    >>> less_block_means(np.array([1.0, 3.0, 5.0]), np.array([0, 0, 1])).tolist()
    [-1.0, 1.0, 0.0]
    """
    counts = np.bincount(block)
    flat = values.reshape(len(values), -1)
    means = np.array([np.bincount(block, column) / counts for column in flat.T]).reshape(flat.shape[1], counts.size)
    return np.asarray((flat - means.T[block]).reshape(values.shape), np.float64)


def do_not_scatter(y: FloatArray, columns: FloatArray, unit: IntArray, *, nearly: bool = False) -> bool:
    """Whether columns, and the levels of units where any was measured twice, explain the values exactly, or nearly.

    >>> unit = np.array([0, 0, 1, 1])
    >>> do_not_scatter(np.array([1.0, 1.5, 3.0, 3.5]), np.array([[0.0], [1.0], [0.0], [1.0]]), unit)
    True
    """
    block = unit if np.bincount(unit).max() > 1 else np.zeros_like(unit)
    inside, beside = less_block_means(y, block), less_block_means(columns, block)
    inverse = np.linalg.pinv(beside.T @ beside, rcond=_DEPENDENT, hermitian=True)
    rest = inside
    for _ in range(2):  # again, what the squares of the first round lose
        rest = rest - beside @ (inverse @ (beside.T @ rest))
    least = _NEARLY_EXACT * inside.std() if nearly else 0.0
    return bool(np.abs(rest).max() <= _EXACT * np.abs(y).max() or rest.std() <= least)


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
        found.append(estimate(float(contrast @ beta), error, float(freedom)) if is_determined else None)
    return found


def estimate(value: float, error: float, freedom: float) -> ContrastEstimate:
    """A value with its standard uncertainty, by Student's t."""
    half = float(student_quantile((1 + _CONFIDENCE) / 2, freedom)) * error
    chance = 2 * student_sf(abs(value) / error, freedom) if error > 0 else float(value == 0)
    return ContrastEstimate(value, value - half, value + half, error, freedom, chance)


def holm(chances: list[float]) -> list[float]:
    """Probabilities adjusted for multiple tests (Holm 1979)."""
    adjusted = [0.0] * len(chances)
    running = 0.0
    for rank, index in enumerate(sorted(range(len(chances)), key=chances.__getitem__)):
        running = max(running, min(1.0, (len(chances) - rank) * chances[index]))
        adjusted[index] = running
    return adjusted
