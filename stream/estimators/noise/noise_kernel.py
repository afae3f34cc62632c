"""Compiled core of the noise fit: non-negative least squares, and the descent of a curve's deviance."""

import math

import numpy as np
import numpy.typing as npt

from stream.batch import FloatArray
from stream.compiled import kernel

MOST_ROUNDS = 50
TOLERANCE = 1e-8
LEAST_MODEL = 1e-100
_HALVINGS = 20
_MOST_CHANGES = 30
_DEPENDENT = 1e-13
_EPSILON = float(np.finfo(np.float64).eps)

Mask = npt.NDArray[np.bool_]


@kernel
def _solve(matrix: FloatArray, target: FloatArray, chosen: Mask, found: FloatArray) -> None:
    """Least squares over the chosen columns by modified Gram-Schmidt; a column that depends on others gets 0."""
    rows, columns = matrix.shape
    order = np.flatnonzero(chosen)
    size = len(order)
    basis = np.empty((size, rows))
    upper = np.zeros((size, size))
    projected = np.zeros(size)
    left = target.copy()
    is_used = np.zeros(size, np.bool_)
    for i in range(size):
        column = matrix[:, order[i]].copy()
        before = math.sqrt(np.dot(column, column))
        for _ in range(2):  # once more, so that nearly dependent columns stay orthogonal
            for j in range(i):
                if is_used[j]:
                    share = np.dot(basis[j], column)
                    upper[j, i] += share
                    column -= share * basis[j]
        norm = math.sqrt(np.dot(column, column))
        if norm <= _DEPENDENT * before:
            continue
        is_used[i] = True
        upper[i, i] = norm
        basis[i] = column / norm
        projected[i] = np.dot(basis[i], left)
        left -= projected[i] * basis[i]
    for k in range(columns):
        found[k] = 0.0
    for i in range(size - 1, -1, -1):
        if is_used[i]:
            value = projected[i]
            for j in range(i + 1, size):
                value -= upper[i, j] * found[order[j]]
            found[order[i]] = value / upper[i, i]


@kernel
def _steepest(matrix: FloatArray, left: FloatArray, barred: Mask) -> int:
    """Column along which the residual falls most; -1 where rounding is all that is left."""
    largest = 0.0
    for k in range(matrix.shape[1]):
        largest = max(largest, np.abs(matrix[:, k]).sum())
    best, gain = -1, _EPSILON * largest * np.abs(left).max()
    for k in range(matrix.shape[1]):
        if not barred[k]:
            slope = np.dot(matrix[:, k].copy(), left)
            if slope > gain:
                best, gain = k, slope
    return best


@kernel
def _step_inside(found: FloatArray, trial: FloatArray, passive: Mask) -> bool:
    """Move from found towards trial as far as no coefficient is negative; False where the whole step is allowed."""
    step, first = 1.0, -1
    for k in range(len(found)):
        if passive[k] and trial[k] <= 0.0:
            reach = found[k] / (found[k] - trial[k]) if found[k] > 0.0 else 0.0
            if first < 0 or reach < step:
                step, first = reach, k
    if first < 0:
        return False
    for k in range(len(found)):
        found[k] += step * (trial[k] - found[k])
        if k == first or (passive[k] and trial[k] <= 0.0 and found[k] <= _EPSILON * abs(trial[k])):
            found[k] = 0.0
            passive[k] = False
    return True


@kernel
def nonnegative_least_squares(matrix: FloatArray, target: FloatArray) -> FloatArray:
    """The x >= 0 of least ``|matrix x - target|`` (Lawson, Hanson, Solving Least Squares Problems, 1974, 23.3).

    The columns of the matrix, shape (n, p), have about unit length.

    >>> nonnegative_least_squares(np.array([[1.0, 0.0], [0.0, 1.0]]), np.array([2.0, -1.0])).tolist()
    [2.0, 0.0]
    """
    columns = matrix.shape[1]
    found, trial = np.zeros(columns), np.zeros(columns)
    passive, rejected = np.zeros(columns, np.bool_), np.zeros(columns, np.bool_)
    for _ in range(_MOST_CHANGES * columns):
        best = _steepest(matrix, target - matrix @ found, passive | rejected)
        if best < 0:
            break
        passive[best] = True
        _solve(matrix, target, passive, trial)
        if trial[best] <= 0.0:  # its slope was rounding
            passive[best] = False
            rejected[best] = True
            continue
        rejected[:] = False
        while _step_inside(found, trial, passive):
            _solve(matrix, target, passive, trial)
        found[:] = trial
    return found


@kernel
def deviance(degrees: FloatArray, model: FloatArray) -> float:
    """D of a model, given relative to the curve; see `noise_likelihood.CurveLikelihood`."""
    total = 0.0
    for i in range(len(model)):
        inverse = 1.0 / model[i]
        total += degrees[i] * (inverse - 1.0 - math.log(inverse))
    return total


@kernel
def weighted_least_squares(
    columns: FloatArray, degrees: FloatArray, model: FloatArray, fixed: FloatArray, free: Mask
) -> FloatArray:
    """Non-negative coefficients of the free columns, weighted by the scatter expected by the model; others are 0."""
    order = np.flatnonzero(free)
    weights = np.sqrt(degrees) / model
    weighted = np.empty((len(weights), len(order)))
    norms = np.empty(len(order))
    for j in range(len(order)):
        weighted[:, j] = columns[:, order[j]] * weights
        norm = math.sqrt((weighted[:, j] ** 2).sum())
        norms[j] = norm if norm > 0.0 else 1.0  # a term so far below the others that its squares vanish stays 0
        weighted[:, j] /= norms[j]
    found = nonnegative_least_squares(weighted, (1.0 - fixed) * weights)
    theta = np.zeros(len(free))
    for j in range(len(order)):
        theta[order[j]] = found[j] / norms[j]
    return theta


@kernel
def descend(columns: FloatArray, degrees: FloatArray, theta: FloatArray, free: Mask) -> tuple[FloatArray, float]:
    """Iterate the weighted least squares from theta, the other coefficients fixed, until the deviance converges."""
    theta = theta.copy()
    fixed = np.zeros(len(degrees))
    for k in range(len(theta)):
        if not free[k]:
            fixed += columns[:, k] * theta[k]
    model = np.maximum(columns @ theta, LEAST_MODEL)
    least = deviance(degrees, model)
    for _ in range(MOST_ROUNDS):
        aim = weighted_least_squares(columns, degrees, model, fixed, free)
        step = np.zeros(len(theta))
        for k in range(len(theta)):
            if free[k]:
                step[k] = aim[k] - theta[k]
        reached, is_lower = math.inf, False
        for _ in range(_HALVINGS):
            model = columns @ (theta + step)
            reached = deviance(degrees, model) if model.min() > LEAST_MODEL else math.inf
            if reached <= least:
                is_lower = True
                break
            step /= 2.0
        if not is_lower:
            return theta, least
        theta = theta + step
        gain = least - reached
        least = reached
        if gain < TOLERANCE:
            break
    return theta, least
