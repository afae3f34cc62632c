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
    # rows of states with the noises side by side, long enough for the compiler to take several numbers at once
    width = states * SIDE_BY_SIDE
    covariance, shrink, gain = np.zeros((states, width)), np.ones((states, width)), np.zeros((states, width))
    state, fade, grow = np.zeros(width), np.ones(width), np.zeros(width)
    total, before = np.zeros(width), np.zeros(width)  # sums over the states of each column
    prepared = 0  # number of blocks that `shrink`, `fade` and `grow` are for
    for t in range(column.size):
        if steps[t] == 0:
            _begin(start, variance, covariance, state, total)
        else:
            if steps[t] != prepared:
                prepared = steps[t]
                _prepare(prepared, walk, decay, variance, shrink, fade, grow)
            _go_on(shrink, fade, grow, gain, covariance, state, total, before)
        for k in range(SIDE_BY_SIDE):
            off, sum_ = column[t], white[k] * relative[t]
            for i in range(states):
                off -= state[i * SIDE_BY_SIDE + k]
                sum_ += total[i * SIDE_BY_SIDE + k]
            error[t, k], expected[t, k] = off, sum_
            per_sum = 1 / sum_
            for i in range(states):
                own = total[i * SIDE_BY_SIDE + k] * per_sum
                state[i * SIDE_BY_SIDE + k] += own * off
                for j in range(states):
                    gain[i, j * SIDE_BY_SIDE + k] = own


@njit(cache=True, nogil=True, fastmath=True)
def _begin(start, variance, covariance, state, total):  # type: ignore[no-untyped-def]
    covariance[:] = 0.0
    state[:] = 0.0
    for k in range(SIDE_BY_SIDE):
        covariance[0, k] = total[k] = start[k]
        for i in range(1, covariance.shape[0]):
            covariance[i, i * SIDE_BY_SIDE + k] = total[i * SIDE_BY_SIDE + k] = variance[i - 1, k]


@njit(cache=True, nogil=True, fastmath=True)
def _prepare(step, walk, decay, variance, shrink, fade, grow):  # type: ignore[no-untyped-def]
    """Set what a number of blocks multiplies covariance and states by, and what it adds to the variances."""
    for i in range(decay.size + 1):
        for k in range(SIDE_BY_SIDE):
            factor = 1.0 if i == 0 else decay[i - 1] ** step
            fade[i * SIDE_BY_SIDE + k] = factor
            grow[i * SIDE_BY_SIDE + k] = walk[k] * step if i == 0 else variance[i - 1, k] * (1 - factor * factor)
    for i in range(decay.size + 1):
        for at in range(fade.size):
            shrink[i, at] = fade[i * SIDE_BY_SIDE] * fade[at]


@njit(cache=True, nogil=True, fastmath=True)
def _go_on(shrink, fade, grow, gain, covariance, state, total, before):  # type: ignore[no-untyped-def]
    """Correct the covariance by the last block, and predict states, covariance and its sums."""
    for at in range(state.size):
        before[at] = total[at]
        total[at] = grow[at]
        state[at] *= fade[at]
    for i in range(covariance.shape[0]):
        row, factor, own = covariance[i], shrink[i], gain[i]
        for at in range(state.size):
            row[at] = (row[at] - own[at] * before[at]) * factor[at]
            total[at] += row[at]
        for at in range(i * SIDE_BY_SIDE, (i + 1) * SIDE_BY_SIDE):
            row[at] += grow[at]
