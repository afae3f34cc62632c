"""Errors of prediction of one column under several sets of noise coefficients, in one pass over the blocks.

The derivatives of a likelihood need the filter with each coefficient changed a little. Side by side they take a
quarter of the time of one after the other.
"""

from collections.abc import Sequence

import numpy as np
from numba import njit

from analytics.loop.model.error_model import ModelNoise
from analytics.loop.tracing.whitening.stack import UnitRecord
from stream.batch import FloatArray

SIDE_BY_SIDE = 4  # as many as there are coefficients of noise, and numbers in a vector register


def prediction_errors(
    record: UnitRecord, column: FloatArray, noises: Sequence[ModelNoise]
) -> tuple[FloatArray, FloatArray]:
    """Error of the prediction of each block of a column from those before it, and its variance, for up to four noises.

    Both have the shape (n, noises). The error over the root of its variance is the whitened column, see `Whitener`.
    """
    spaces = [record.noise_model.space(noise) for noise in noises]
    spaces += spaces[-1:] * (SIDE_BY_SIDE - len(spaces))
    variance = np.ascontiguousarray(np.array([space.variance for space in spaces]).T)
    error, expected = np.empty((2, len(record), SIDE_BY_SIDE))
    _predict(
        np.ascontiguousarray(column), record.steps, record.white, np.array([space.white for space in spaces]),
        np.array([space.walk for space in spaces]), np.array([space.start for space in spaces]), spaces[0].decay,
        variance, error, expected,
    )  # fmt: skip
    return error[:, : len(noises)], expected[:, : len(noises)]


@njit(cache=True, nogil=True, fastmath=True)
def _predict(column, steps, relative, white, walk, start, decay, variance, error, expected):  # type: ignore[no-untyped-def]
    states = decay.size + 1
    covariance, state = np.zeros((states, states, SIDE_BY_SIDE)), np.zeros((states, SIDE_BY_SIDE))
    shrink, grow = np.ones(states), np.empty((states, SIDE_BY_SIDE))
    row, total, off = np.empty((states, SIDE_BY_SIDE)), np.empty(SIDE_BY_SIDE), np.empty(SIDE_BY_SIDE)
    prepared = 0  # number of blocks that `shrink` and `grow` are for
    for t in range(column.size):
        if steps[t] == 0:
            _begin(start, variance, covariance, state)
        else:
            if steps[t] != prepared:
                prepared = steps[t]
                _prepare(prepared, walk, decay, variance, shrink, grow)
            _go_on(shrink, grow, covariance, state)
        for k in range(SIDE_BY_SIDE):
            total[k] = white[k] * relative[t]
            off[k] = column[t]
        _expect(covariance, state, row, total, off)
        for k in range(SIDE_BY_SIDE):
            error[t, k] = off[k]
            expected[t, k] = total[k]
        _correct(row, total, off, covariance, state)


@njit(cache=True, nogil=True, fastmath=True)
def _begin(start, variance, covariance, state):  # type: ignore[no-untyped-def]
    covariance[:] = 0.0
    state[:] = 0.0
    for k in range(SIDE_BY_SIDE):
        covariance[0, 0, k] = start[k]
        for i in range(variance.shape[0]):
            covariance[i + 1, i + 1, k] = variance[i, k]


@njit(cache=True, nogil=True, fastmath=True)
def _prepare(step, walk, decay, variance, shrink, grow):  # type: ignore[no-untyped-def]
    """Set what a number of blocks multiplies the states by, and what it adds to their variances."""
    for k in range(SIDE_BY_SIDE):
        grow[0, k] = walk[k] * step
    for i in range(decay.size):
        factor = decay[i] ** step
        shrink[i + 1] = factor
        for k in range(SIDE_BY_SIDE):
            grow[i + 1, k] = variance[i, k] * (1 - factor * factor)


@njit(cache=True, nogil=True, fastmath=True)
def _go_on(shrink, grow, covariance, state):  # type: ignore[no-untyped-def]
    """Predict states and covariance; of this symmetric matrix only the upper half is kept."""
    for i in range(shrink.size):
        for j in range(i, shrink.size):
            factor = shrink[i] * shrink[j]
            for k in range(SIDE_BY_SIDE):
                covariance[i, j, k] *= factor
        for k in range(SIDE_BY_SIDE):
            covariance[i, i, k] += grow[i, k]
            state[i, k] *= shrink[i]


@njit(cache=True, nogil=True, fastmath=True)
def _expect(covariance, state, row, total, off):  # type: ignore[no-untyped-def]
    """Set the sums of the rows, add them to the variance of the block, and subtract its prediction."""
    states = state.shape[0]
    for i in range(states):
        for k in range(SIDE_BY_SIDE):
            row[i, k] = covariance[i, i, k]
            off[k] -= state[i, k]
    for i in range(states):
        for j in range(i + 1, states):
            for k in range(SIDE_BY_SIDE):
                row[i, k] += covariance[i, j, k]
                row[j, k] += covariance[i, j, k]
    for i in range(states):
        for k in range(SIDE_BY_SIDE):
            total[k] += row[i, k]


@njit(cache=True, nogil=True, fastmath=True)
def _correct(row, total, off, covariance, state):  # type: ignore[no-untyped-def]
    """Correct states and covariance by the block; `total` is inverted in place."""
    for k in range(SIDE_BY_SIDE):
        total[k] = 1 / total[k]
    for i in range(state.shape[0]):
        for k in range(SIDE_BY_SIDE):
            state[i, k] += row[i, k] * total[k] * off[k]
        for j in range(i, state.shape[0]):
            for k in range(SIDE_BY_SIDE):
                covariance[i, j, k] -= row[i, k] * total[k] * row[j, k]
