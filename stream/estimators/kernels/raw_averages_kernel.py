"""Machine code for averages of one sample each: what ``averages_kernel`` does, many at a time."""

import numpy as np
from numba import njit

from stream.batch import FloatArray, IntArray
from stream.estimators.kernels.averages_kernel import (
    AVERAGES,
    BEGAN,
    BLOCK,
    COVARIANCE,
    EARLY_MEAN,
    EARLY_SQUARES,
    FIRST_AVERAGE,
    FIRST_MEAN,
    HEAD_COUNT,
    LAST,
    LAST_MEAN,
    LATE_MEAN,
    LATE_SQUARES,
    MEAN,
    NEVER,
    PAIRS,
    SQUARES,
    average_grid,
    merge_averages,
)
from stream.estimators.kernels.kernel_part import kernel_part


@kernel_part("reassoc", "contract")
def _moments(values: FloatArray, reference: float) -> tuple[float, float]:
    """Mean of values - reference, and the sum of squares about it."""
    total = 0.0
    for i in range(values.shape[0]):
        total += values[i] - reference
    mean = total / max(values.shape[0], 1)
    squares = 0.0
    for i in range(values.shape[0]):
        difference = (values[i] - reference) - mean
        squares += difference * difference
    return mean, squares


@kernel_part("reassoc", "contract")
def _products(early: FloatArray, late: FloatArray, reference: float, early_mean: float, late_mean: float) -> float:
    total = 0.0
    for i in range(early.shape[0]):
        total += ((early[i] - reference) - early_mean) * ((late[i] - reference) - late_mean)
    return total


@njit(cache=True, nogil=True)
def take_samples(
    places: IntArray,
    numbers: FloatArray,
    ring: FloatArray,
    ring_blocks: IntArray,
    reference: float,
    first_slot: int,
    values: FloatArray,
) -> None:
    """Take in values on the slots from `first_slot` on, each an average of its own; NaN is missing."""
    # the first by the general way, which closes what stands open
    average_grid(places, numbers, ring, ring_blocks, reference, 1, 1.0, 1, first_slot, values[:1])
    rest = values[1:]
    n = rest.shape[0]
    mean, squares = _moments(rest, reference)
    if n < 2 or squares - squares != 0.0:
        average_grid(places, numbers, ring, ring_blocks, reference, 1, 1.0, 1, first_slot + 1, rest)
        return
    later, found = np.zeros(places.shape[0], np.int64), np.zeros(numbers.shape[0])
    later[BLOCK] = first_slot + 1 + n
    later[BEGAN], later[HEAD_COUNT] = NEVER - 1, 0
    later[AVERAGES], later[PAIRS] = n, n - 1
    later[FIRST_AVERAGE], later[LAST] = first_slot + 1, first_slot + n
    found[MEAN], found[SQUARES] = mean, squares
    found[FIRST_MEAN], found[LAST_MEAN] = rest[0] - reference, rest[n - 1] - reference
    found[EARLY_MEAN], found[EARLY_SQUARES] = _moments(rest[:-1], reference)
    found[LATE_MEAN], found[LATE_SQUARES] = _moments(rest[1:], reference)
    found[COVARIANCE] = _products(rest[:-1], rest[1:], reference, found[EARLY_MEAN], found[LATE_MEAN])
    merge_averages(places, numbers, ring, ring_blocks, later, found, ring, ring_blocks, 1.0, 1.0)
