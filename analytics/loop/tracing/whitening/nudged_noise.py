"""What the likelihood and its expected curvature change by where noise coefficients change a little, in one pass.

The derivatives of a likelihood need the filter with each coefficient changed. Side by side the filters take half the
time of one after the other.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from analytics.loop.model.error_model import ModelNoise
from analytics.loop.tracing.whitening.stack import UnitRecord
from stream.batch import FloatArray, IntArray
from stream.compiled import fast_kernel, kernel_part

SIDE_BY_SIDE = 4  # as many as there are coefficients of noise, and numbers in a vector register


class Nudged(NamedTuple):
    """Sums over the blocks for noises that differ little from another, of which error and variance are known."""

    wider: FloatArray  # shape (noises,); of the logarithm of the ratio of the variances
    squares: FloatArray  # shape (noises,); of the squared whitened errors
    products: FloatArray  # shape (noises, noises); of the changes of the normal deviates, for the expected curvature


def nudged_sums(
    record: UnitRecord, column: FloatArray, noises: Sequence[ModelNoise], error: FloatArray, variance: FloatArray
) -> Nudged:
    """Filter a column with up to four noises, and compare with the prediction `error` of each block and its `variance`.

    The changes are those of log(variance)/sqrt(2) and of error/sqrt(variance). The noises are to differ by so little
    that the variances differ by 1 % at most.
    """
    spaces = [record.noise_model.space(noise) for noise in noises]
    spaces += spaces[-1:] * (SIDE_BY_SIDE - len(spaces))
    of_states = np.ascontiguousarray(np.array([space.variance for space in spaces]).T)
    wider, squares, products = np.zeros(SIDE_BY_SIDE), np.zeros(SIDE_BY_SIDE), np.zeros((SIDE_BY_SIDE, SIDE_BY_SIDE))
    _sum_up(
        np.ascontiguousarray(column), record.steps, record.white, np.array([space.white for space in spaces]),
        np.array([space.walk for space in spaces]), np.array([space.start for space in spaces]), spaces[0].decay,
        of_states, np.ascontiguousarray(error), variance, wider, squares, products,
    )  # fmt: skip
    kept = len(noises)
    return Nudged(wider[:kept], squares[:kept], products[:kept, :kept])


@fast_kernel("fast")
def _sum_up(
    column: FloatArray,
    steps: IntArray,
    relative: FloatArray,
    white: FloatArray,
    walk: FloatArray,
    start: FloatArray,
    decay: FloatArray,
    of_states: FloatArray,
    error: FloatArray,
    variance: FloatArray,
    wider: FloatArray,
    squares: FloatArray,
    products: FloatArray,
) -> None:
    states = decay.size + 1
    # rows of states with the noises side by side, long enough for the compiler to take several numbers at once
    width = states * SIDE_BY_SIDE
    covariance, shrink, gain = np.zeros((states, width)), np.ones((states, width)), np.zeros((states, width))
    state, fade, grow = np.zeros(width), np.ones(width), np.zeros(width)
    total, before = np.zeros(width), np.zeros(width)  # sums over the states of each column
    change = np.empty((2, SIDE_BY_SIDE))
    prepared = 0  # number of blocks that `shrink`, `fade` and `grow` are for
    for t in range(column.size):
        if steps[t] == 0:
            _begin(start, of_states, covariance, state, total)
        else:
            if steps[t] != prepared:
                prepared = steps[t]
                _prepare(prepared, walk, decay, of_states, shrink, fade, grow)
            _go_on(shrink, fade, grow, gain, covariance, state, total, before)
        per_variance = 1 / variance[t]
        for k in range(SIDE_BY_SIDE):
            off, expected = column[t], white[k] * relative[t]
            for i in range(states):
                off -= state[i * SIDE_BY_SIDE + k]
                expected += total[i * SIDE_BY_SIDE + k]
            per_expected = 1 / expected
            for i in range(states):
                own = total[i * SIDE_BY_SIDE + k] * per_expected
                state[i * SIDE_BY_SIDE + k] += own * off
                for j in range(states):
                    gain[i, j * SIDE_BY_SIDE + k] = own
            more = expected * per_variance - 1
            logarithm = more * (1 - more * (0.5 - more * (1 / 3 - 0.25 * more)))
            wider[k] += logarithm
            squares[k] += off * off * per_expected
            change[0, k] = logarithm
            change[1, k] = off - error[t]
        for k in range(SIDE_BY_SIDE):
            for other in range(k + 1):
                products[k, other] += (
                    0.5 * change[0, k] * change[0, other] + change[1, k] * change[1, other] * per_variance
                )
    for k in range(SIDE_BY_SIDE):
        for other in range(k):
            products[other, k] = products[k, other]


@kernel_part("fast")
def _begin(
    start: FloatArray, variance: FloatArray, covariance: FloatArray, state: FloatArray, total: FloatArray
) -> None:
    covariance[:] = 0.0
    state[:] = 0.0
    for k in range(SIDE_BY_SIDE):
        covariance[0, k] = total[k] = start[k]
        for i in range(1, covariance.shape[0]):
            covariance[i, i * SIDE_BY_SIDE + k] = total[i * SIDE_BY_SIDE + k] = variance[i - 1, k]


@kernel_part("fast")
def _prepare(
    step: int,
    walk: FloatArray,
    decay: FloatArray,
    variance: FloatArray,
    shrink: FloatArray,
    fade: FloatArray,
    grow: FloatArray,
) -> None:
    """Set what a number of blocks multiplies covariance and states by, and what it adds to the variances."""
    for i in range(decay.size + 1):
        for k in range(SIDE_BY_SIDE):
            factor = 1.0 if i == 0 else decay[i - 1] ** step
            fade[i * SIDE_BY_SIDE + k] = factor
            grow[i * SIDE_BY_SIDE + k] = walk[k] * step if i == 0 else variance[i - 1, k] * (1 - factor * factor)
    for i in range(decay.size + 1):
        for at in range(fade.size):
            shrink[i, at] = fade[i * SIDE_BY_SIDE] * fade[at]


@kernel_part("fast")
def _go_on(
    shrink: FloatArray,
    fade: FloatArray,
    grow: FloatArray,
    gain: FloatArray,
    covariance: FloatArray,
    state: FloatArray,
    total: FloatArray,
    before: FloatArray,
) -> None:
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
