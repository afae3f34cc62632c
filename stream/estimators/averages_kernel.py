"""Machine code for consecutive averages and their spread (``bias_stability``).

Means and sums of squares are updated by Welford's recurrence, so that a large mean costs no digits.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from stream.batch import FloatArray, IntArray

BLOCK, COUNT, LAST, AVERAGES, PAIRS = 0, 1, 2, 3, 4
SUM, MEAN, SQUARES, LAST_MEAN, EARLY_MEAN, LATE_MEAN, EARLY_SQUARES, LATE_SQUARES, COVARIANCE = range(9)


class AveragesState(NamedTuple):
    """What is kept of a signal's averages.

    Attributes
    ----------
    places : ndarray of int64, shape (5,)
        Block being filled and the samples in it; the last block that became an average; averages; pairs of
        neighbouring averages.
    numbers : ndarray, shape (9,)
        Sum of the block being filled; mean and sum of squares of the averages, and the last of them; over the pairs
        mean and sum of squares of the earlier and of the later average, and the sum of their products.
    """

    places: IntArray
    numbers: FloatArray


def empty_averages() -> AveragesState:
    """State before the first sample."""
    places = np.zeros(5, np.int64)
    places[LAST] = -2
    return AveragesState(places, np.zeros(9))


@njit(cache=True, nogil=True)
def _close(places: IntArray, numbers: FloatArray, expected: float, share: float) -> None:
    """End the block being filled; it becomes an average if it holds the `share` of its samples."""
    count = places[COUNT]
    if count > 0 and count >= share * expected:
        mean = numbers[SUM] / count
        places[AVERAGES] += 1
        step = mean - numbers[MEAN]
        numbers[MEAN] += step / places[AVERAGES]
        numbers[SQUARES] += step * (mean - numbers[MEAN])
        if places[LAST] == places[BLOCK] - 1:
            places[PAIRS] += 1
            early = numbers[LAST_MEAN] - numbers[EARLY_MEAN]
            late = mean - numbers[LATE_MEAN]
            numbers[EARLY_MEAN] += early / places[PAIRS]
            numbers[LATE_MEAN] += late / places[PAIRS]
            numbers[EARLY_SQUARES] += early * (numbers[LAST_MEAN] - numbers[EARLY_MEAN])
            numbers[LATE_SQUARES] += late * (mean - numbers[LATE_MEAN])
            numbers[COVARIANCE] += early * (mean - numbers[LATE_MEAN])
        numbers[LAST_MEAN] = mean
        places[LAST] = places[BLOCK]
    places[COUNT] = 0
    numbers[SUM] = 0.0


@njit(cache=True, nogil=True)
def _first_slot(block: int, average_ns: int, dt_ns: int) -> int:
    return (block * average_ns + dt_ns - 1) // dt_ns


@njit(cache=True, nogil=True)
def average_grid(
    places: IntArray,
    numbers: FloatArray,
    reference: float,
    average_ns: int,
    share: float,
    dt_ns: int,
    first_slot: int,
    values: FloatArray,
) -> None:
    """Take in values that lie on the slots from `first_slot` on; NaN is missing."""
    slot = first_slot
    stop = first_slot + values.shape[0]
    while slot < stop:
        block = slot * dt_ns // average_ns
        if block > places[BLOCK]:
            previous = places[BLOCK]
            slots = _first_slot(previous + 1, average_ns, dt_ns) - _first_slot(previous, average_ns, dt_ns)
            _close(places, numbers, slots, share)
            places[BLOCK] = block
        end = _first_slot(block + 1, average_ns, dt_ns)
        until = min(end, stop)
        total = numbers[SUM]
        count = 0
        for i in range(slot - first_slot, until - first_slot):
            difference = values[i] - reference
            if difference - difference == 0.0:
                total += difference
                count += 1
        numbers[SUM] = total
        places[COUNT] += count
        if until == end:
            _close(places, numbers, end - _first_slot(block, average_ns, dt_ns), share)
            places[BLOCK] = block + 1
        slot = until


@njit(cache=True, nogil=True)
def average_times(
    places: IntArray,
    numbers: FloatArray,
    reference: float,
    average_ns: int,
    share: float,
    dt_ns: int,
    origin_ns: int,
    times_ns: IntArray,
    values: FloatArray,
) -> None:
    """Take in values at increasing times that lie on no grid; blocks are counted from `origin_ns`."""
    expected = average_ns / dt_ns
    for i in range(values.shape[0]):
        since = times_ns[i] - origin_ns
        if since >= (places[BLOCK] + 1) * average_ns:
            _close(places, numbers, expected, share)
            places[BLOCK] = since // average_ns
        difference = values[i] - reference
        if difference - difference == 0.0:
            numbers[SUM] += difference
            places[COUNT] += 1
