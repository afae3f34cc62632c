"""Compiled core of the noise fit: non-negative least squares, and the descent of a curve's deviance."""

import math

import numpy as np
import numpy.typing as npt

from stream.batch import FloatArray
from stream.compiled import kernel, kernel_part

MOST_ROUNDS = 50
TOLERANCE = 1e-8
LEAST_MODEL = 1e-100
_HALVINGS = 20
_MOST_CHANGES = 30
_DEPENDENT = 1e-13
_EPSILON = float(np.finfo(np.float64).eps)

Mask = npt.NDArray[np.bool_]


@kernel_part("reassoc", "contract")
def _dot(a: FloatArray, b: FloatArray) -> float:
    total = 0.0
    for i in range(a.shape[0]):
        total += a[i] * b[i]
    return total


@kernel_part()
def _copy(source: FloatArray, out: FloatArray) -> None:
    """The same as ``out[:] = source``, which takes a second to compile each time."""
    for i in range(out.shape[0]):
        out[i] = source[i]


@kernel_part()
def _add(source: FloatArray, out: FloatArray) -> None:
    """The same as ``out += source``."""
    for i in range(out.shape[0]):
        out[i] += source[i]


@kernel_part()
def _orthogonalise(basis: FloatArray, k: int, is_used: Mask, upper: FloatArray) -> bool:
    """Subtract from column k its shares of the used ones before it, and normalise it; False where nothing is left."""
    column = basis[k]
    before = math.sqrt(_dot(column, column))
    for _ in range(2):  # once more, so that nearly dependent columns stay orthogonal
        for j in range(k):
            if is_used[j]:
                share = _dot(basis[j], column)
                upper[j, k] += share
                for i in range(column.shape[0]):
                    column[i] -= share * basis[j, i]
    norm = math.sqrt(_dot(column, column))
    if norm <= _DEPENDENT * before:
        return False
    upper[k, k] = norm
    for i in range(column.shape[0]):
        column[i] /= norm
    return True


@kernel_part()
def _solve(rows: FloatArray, target: FloatArray, chosen: Mask, found: FloatArray, basis: FloatArray) -> None:
    """Least squares over the chosen columns by modified Gram-Schmidt; a column that depends on others gets 0.

    `rows`, shape (p, n), are the columns of the matrix; `basis`, shape (p + 1, n), is room for the orthogonal ones.
    """
    size, n = rows.shape
    upper = np.zeros((size, size))
    projected = np.zeros(size)
    is_used = np.zeros(size, np.bool_)
    left = basis[size]
    _copy(target, left)
    for k in range(size):
        found[k] = 0.0
        if not chosen[k]:
            continue
        column = basis[k]
        _copy(rows[k], column)
        is_used[k] = _orthogonalise(basis, k, is_used, upper)
        if not is_used[k]:
            continue
        projected[k] = _dot(column, left)
        for i in range(n):
            left[i] -= projected[k] * column[i]
    for k in range(size - 1, -1, -1):
        if is_used[k]:
            value = projected[k]
            for j in range(k + 1, size):
                value -= upper[k, j] * found[j]
            found[k] = value / upper[k, k]


@kernel_part()
def _steepest(rows: FloatArray, left: FloatArray, passive: Mask, rejected: Mask) -> int:
    """Column along which the residual falls most; -1 where rounding is all that is left."""
    largest = most = 0.0
    for k in range(rows.shape[0]):
        total = 0.0
        for i in range(rows.shape[1]):
            total += abs(rows[k, i])
        largest = max(largest, total)
    for i in range(left.shape[0]):
        most = max(most, abs(left[i]))
    best, gain = -1, _EPSILON * largest * most
    for k in range(rows.shape[0]):
        if not passive[k] and not rejected[k]:
            slope = _dot(rows[k], left)
            if slope > gain:
                best, gain = k, slope
    return best


@kernel_part()
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


@kernel_part()
def _improve(rows: FloatArray, target: FloatArray, found: FloatArray) -> None:
    """Solve non-negative least squares from coefficients >= 0, which the solution replaces."""
    size, n = rows.shape
    trial, left, basis = np.zeros(size), np.empty(n), np.empty((size + 1, n))
    passive, rejected = np.zeros(size, np.bool_), np.zeros(size, np.bool_)
    is_started = False
    for k in range(size):
        passive[k] = found[k] > 0.0
        is_started = is_started or passive[k]
    if is_started:
        _solve(rows, target, passive, trial, basis)
        while _step_inside(found, trial, passive):
            _solve(rows, target, passive, trial, basis)
        _copy(trial, found)
    for _ in range(_MOST_CHANGES * size):
        _copy(target, left)
        for k in range(size):
            if found[k] != 0.0:
                for i in range(n):
                    left[i] -= found[k] * rows[k, i]
        best = _steepest(rows, left, passive, rejected)
        if best < 0:
            break
        passive[best] = True
        _solve(rows, target, passive, trial, basis)
        if trial[best] <= 0.0:  # its slope was rounding
            passive[best] = False
            rejected[best] = True
            continue
        for k in range(size):
            rejected[k] = False
        while _step_inside(found, trial, passive):
            _solve(rows, target, passive, trial, basis)
        _copy(trial, found)


@kernel
def nonnegative_least_squares(matrix: FloatArray, target: FloatArray) -> FloatArray:
    """The x >= 0 of least ``|matrix x - target|`` (Lawson, Hanson, Solving Least Squares Problems, 1974, 23.3).

    The columns of the matrix, shape (n, p), have about unit length.

    >>> nonnegative_least_squares(np.array([[1.0, 0.0], [0.0, 1.0]]), np.array([2.0, -1.0])).tolist()
    [2.0, 0.0]
    """
    found = np.zeros(matrix.shape[1])
    _improve(np.ascontiguousarray(matrix.T), target, found)
    return found


@kernel
def deviance(degrees: FloatArray, model: FloatArray) -> float:
    """D of a model, given relative to the curve; see `noise_likelihood.CurveLikelihood`."""
    total = 0.0
    for i in range(len(model)):
        inverse = 1.0 / model[i]
        total += degrees[i] * (inverse - 1.0 - math.log(inverse))
    return total


@kernel_part()
def _weighted(
    columns: FloatArray, degrees: FloatArray, model: FloatArray, fixed: FloatArray, free: Mask, theta: FloatArray,
    rows: FloatArray,
) -> FloatArray:  # fmt: skip
    """Coefficients of the free columns, searched from theta; `rows`, shape (p, n), is room for weighted columns."""
    n, terms = columns.shape
    weights, target = np.empty(n), np.empty(n)
    for i in range(n):
        weights[i] = math.sqrt(degrees[i]) / model[i]
        target[i] = (1.0 - fixed[i]) * weights[i]
    norms, found = np.ones(terms), np.zeros(terms)
    size = 0
    for k in range(terms):
        if not free[k]:
            continue
        row = rows[size]
        for i in range(n):
            row[i] = columns[i, k] * weights[i]
        norm = math.sqrt(_dot(row, row))
        norms[size] = norm if norm > 0.0 else 1.0  # a term so far below the others that its squares vanish stays 0
        for i in range(n):
            row[i] /= norms[size]
        found[size] = theta[k] * norms[size]
        size += 1
    _improve(rows[:size], target, found[:size])
    reached = np.zeros(terms)
    size = 0
    for k in range(terms):
        if free[k]:
            reached[k] = found[size] / norms[size]
            size += 1
    return reached


@kernel
def weighted_least_squares(
    columns: FloatArray, degrees: FloatArray, model: FloatArray, fixed: FloatArray, free: Mask
) -> FloatArray:
    """Non-negative coefficients of the free columns, weighted by the scatter expected by the model; others are 0."""
    return _weighted(columns, degrees, model, fixed, free, np.zeros(len(free)), np.empty(columns.T.shape))


@kernel_part()
def _fill_model(columns: FloatArray, theta: FloatArray, step: FloatArray, model: FloatArray) -> float:
    """Write the model of theta + step; its least value."""
    least = math.inf
    for i in range(columns.shape[0]):
        total = 0.0
        for k in range(columns.shape[1]):
            total += columns[i, k] * (theta[k] + step[k])
        model[i] = total
        least = min(least, total)
    return least


@kernel
def descend(columns: FloatArray, degrees: FloatArray, theta: FloatArray, free: Mask) -> tuple[FloatArray, float]:
    """Iterate the weighted least squares from theta, the other coefficients fixed, until the deviance converges."""
    n, terms = columns.shape
    theta = theta.copy()
    fixed, model, rows, step = np.zeros(n), np.empty(n), np.empty((terms, n)), np.zeros(terms)
    for k in range(terms):
        if not free[k]:
            for i in range(n):
                fixed[i] += columns[i, k] * theta[k]
    _fill_model(columns, theta, step, model)
    for i in range(n):
        model[i] = max(model[i], LEAST_MODEL)
    least = deviance(degrees, model)
    for _ in range(MOST_ROUNDS):
        aim = _weighted(columns, degrees, model, fixed, free, theta, rows)
        for k in range(terms):
            step[k] = aim[k] - theta[k] if free[k] else 0.0
        reached, is_lower = math.inf, False
        for _ in range(_HALVINGS):
            lowest = _fill_model(columns, theta, step, model)
            reached = deviance(degrees, model) if lowest > LEAST_MODEL else math.inf
            if reached <= least:
                is_lower = True
                break
            for k in range(terms):
                step[k] /= 2.0
        if not is_lower:
            return theta, least
        _add(step, theta)
        gain = least - reached
        least = reached
        if gain < TOLERANCE:
            break
    return theta, least


@kernel
def descend_with(
    columns: FloatArray, degrees: FloatArray, theta: FloatArray, which: int, at: float, negligible: float
) -> tuple[FloatArray, float]:
    """As `descend` from theta with one coefficient fixed `at`.

    Where no other term explains some point, its model falling below a `negligible` share, all others start there.
    """
    terms = columns.shape[1]
    start, free = theta.copy(), np.ones(terms, np.bool_)
    start[which], free[which] = at, False
    least = math.inf
    for i in range(columns.shape[0]):
        before = after = 0.0
        for k in range(terms):
            before += columns[i, k] * theta[k]
            after += columns[i, k] * start[k]
        least = min(least, after / before)
    if least < negligible:
        for k in range(terms):
            if free[k]:
                start[k] = max(start[k], negligible)
    return descend(columns, degrees, start, free)


@kernel
def residual_of(others: FloatArray, target: FloatArray) -> FloatArray:
    """What is left of columns, shape (n, m), after least squares on other columns, shape (n, p).

    >>> residual_of(np.array([[1.0], [1.0]]), np.array([[3.0, 1.0], [1.0, 1.0]])).round(12).tolist()
    [[1.0, 0.0], [-1.0, 0.0]]
    """
    n, size = others.shape
    basis, upper, is_used = np.empty((size, n)), np.zeros((size, size)), np.zeros(size, np.bool_)
    left = target.copy()
    shares = np.empty(left.shape[1])
    for k in range(size):
        for i in range(n):
            basis[k, i] = others[i, k]
        is_used[k] = _orthogonalise(basis, k, is_used, upper)
        if not is_used[k]:
            continue
        for j in range(left.shape[1]):
            shares[j] = 0.0
        for i in range(n):
            for j in range(left.shape[1]):
                shares[j] += basis[k, i] * left[i, j]
        for i in range(n):
            for j in range(left.shape[1]):
                left[i, j] -= basis[k, i] * shares[j]
    return left


@kernel
def least_deviances(columns: FloatArray, degrees: FloatArray, more: FloatArray) -> FloatArray:
    """Least deviance with one more column, for each column of `more`, shape (n, m); shape (m,)."""
    n, terms = columns.shape
    beside = np.empty((n, terms + 1))
    for i in range(n):
        for k in range(terms):
            beside[i, k] = columns[i, k]
    found = np.empty(more.shape[1])
    every, ones, nothing = np.ones(terms + 1, np.bool_), np.ones(n), np.zeros(n)
    for j in range(more.shape[1]):
        largest = more[0, j]
        for i in range(n):
            largest = max(largest, more[i, j])
        for i in range(n):
            beside[i, terms] = more[i, j] / largest
        start = weighted_least_squares(beside, degrees, ones, nothing, every)
        found[j] = descend(beside, degrees, start, every)[1]
    return found
