"""Machine code for consecutive averages and their spread (``bias_stability``).

Means and sums of squares are updated by Welford's recurrence and merged by Chan's (DOI 10.1080/00031305.1983.10483115),
so that a large mean costs no digits. Averages of one sample each are computed many at a time (`take_samples`).
"""

from typing import NamedTuple

import numpy as np

from stream.batch import FloatArray, IntArray
from stream.compiled import kernel, kernel_part

BLOCK, COUNT, LAST, AVERAGES, PAIRS, BEGAN, HEAD_COUNT, FIRST_AVERAGE = range(8)
(
    SUM, MEAN, SQUARES, LAST_MEAN, EARLY_MEAN, LATE_MEAN,
    EARLY_SQUARES, LATE_SQUARES, COVARIANCE, HEAD_SUM, FIRST_MEAN,
) = range(11)  # fmt: skip
NEVER = -2


class AveragesState(NamedTuple):
    """What is kept of a signal's averages.

    places: shape (8,); block being filled and the samples in it; last block that became an average; averages; pairs of
    neighbouring averages; block within which a part began, and the samples it has of it; first block that became an
    average. numbers: shape (11,); sum of the block being filled; mean and sum of squares of the averages, and the last
    of them; over the pairs mean and sum of squares of the earlier and of the later average, and the sum of their
    products; sum of the block within which a part began; the first average. ring, ring_blocks: shape (W,); the averages
    of the last W blocks and their blocks, block b at place b modulo W; for
    a rolling window.
    """

    places: IntArray
    numbers: FloatArray
    ring: FloatArray
    ring_blocks: IntArray


def empty_averages(window: int) -> AveragesState:
    """State before the first sample, with a ring for `window` averages."""
    places = np.zeros(8, np.int64)
    places[LAST] = places[BEGAN] = places[FIRST_AVERAGE] = NEVER
    return AveragesState(places, np.zeros(11), np.zeros(window), np.full(window, NEVER))


def begin_at(places: IntArray, block: int, *, is_within: bool) -> None:
    """Set the first block of an empty state; if `is_within`, an earlier part may hold the beginning of the block."""
    places[BLOCK] = block
    places[BEGAN] = block if is_within else block - 1


@kernel_part()
def _pair(numbers: FloatArray, pairs: int, first: float, second: float) -> None:
    """Add the last of `pairs` pairs of neighbouring averages to their means and products."""
    early = first - numbers[EARLY_MEAN]
    late = second - numbers[LATE_MEAN]
    numbers[EARLY_MEAN] += early / pairs
    numbers[LATE_MEAN] += late / pairs
    numbers[EARLY_SQUARES] += early * (first - numbers[EARLY_MEAN])
    numbers[LATE_SQUARES] += late * (second - numbers[LATE_MEAN])
    numbers[COVARIANCE] += early * (second - numbers[LATE_MEAN])


@kernel_part()
def _close(
    places: IntArray, numbers: FloatArray, ring: FloatArray, ring_blocks: IntArray, expected: float, share: float
) -> None:
    """Close the block being filled; it becomes an average if it holds the `share` of its samples."""
    count = places[COUNT]
    if places[BLOCK] == places[BEGAN]:
        places[HEAD_COUNT] = count
        numbers[HEAD_SUM] = numbers[SUM]
    elif count > 0 and count >= share * expected:
        mean = numbers[SUM] / count
        places[AVERAGES] += 1
        step = mean - numbers[MEAN]
        numbers[MEAN] += step / places[AVERAGES]
        numbers[SQUARES] += step * (mean - numbers[MEAN])
        if places[LAST] == places[BLOCK] - 1:
            places[PAIRS] += 1
            _pair(numbers, places[PAIRS], numbers[LAST_MEAN], mean)
        if places[AVERAGES] == 1:
            places[FIRST_AVERAGE] = places[BLOCK]
            numbers[FIRST_MEAN] = mean
        numbers[LAST_MEAN] = mean
        places[LAST] = places[BLOCK]
        if ring.shape[0] > 0:
            at = places[BLOCK] % ring.shape[0]
            ring[at] = mean
            ring_blocks[at] = places[BLOCK]
    places[COUNT] = 0
    numbers[SUM] = 0.0


@kernel_part("reassoc")
def _sum_of_all(values: FloatArray, reference: float) -> tuple[float, float]:
    """Sum of values - reference, and a number that is 0 if all are finite, else NaN."""
    total = zero = 0.0
    for i in range(values.shape[0]):
        difference = values[i] - reference
        total += difference
        zero += difference * 0.0
    return total, zero


@kernel_part()
def _sum(values: FloatArray, reference: float) -> tuple[float, int]:
    """Sum of values - reference over those that are finite, and how many those are."""
    total, zero = _sum_of_all(values, reference)
    if zero == 0.0:
        return total, values.shape[0]
    total = 0.0
    count = 0
    for i in range(values.shape[0]):
        difference = values[i] - reference
        if difference - difference == 0.0:
            total += difference
            count += 1
    return total, count


@kernel
def first_slot_of(block: int, average_ns: int, dt_ns: int) -> int:
    """First slot of a block."""
    return (block * average_ns + dt_ns - 1) // dt_ns


@kernel
def average_grid(
    places: IntArray, numbers: FloatArray, ring: FloatArray, ring_blocks: IntArray, reference: float, average_ns: int,
    share: float, dt_ns: int, first_slot: int, values: FloatArray,
) -> None:  # fmt: skip
    """Take in values that lie on the slots from `first_slot` on; NaN is missing."""
    slot = first_slot
    stop = first_slot + values.shape[0]
    while slot < stop:
        block = slot * dt_ns // average_ns
        if block > places[BLOCK]:
            previous = places[BLOCK]
            slots = first_slot_of(previous + 1, average_ns, dt_ns) - first_slot_of(previous, average_ns, dt_ns)
            _close(places, numbers, ring, ring_blocks, slots, share)
            places[BLOCK] = block
        end = first_slot_of(block + 1, average_ns, dt_ns)
        until = min(end, stop)
        total, count = _sum(values[slot - first_slot : until - first_slot], reference)
        numbers[SUM] += total
        places[COUNT] += count
        if until == end:
            _close(places, numbers, ring, ring_blocks, end - first_slot_of(block, average_ns, dt_ns), share)
            places[BLOCK] = block + 1
        slot = until


@kernel
def average_times(
    places: IntArray, numbers: FloatArray, ring: FloatArray, ring_blocks: IntArray, reference: float, average_ns: int,
    share: float, dt_ns: int, origin_ns: int, times_ns: IntArray, values: FloatArray,
) -> None:  # fmt: skip
    """Take in values at increasing times on no grid; blocks are counted from `origin_ns`."""
    expected = average_ns / dt_ns
    for i in range(values.shape[0]):
        since = times_ns[i] - origin_ns
        if since >= (places[BLOCK] + 1) * average_ns:
            _close(places, numbers, ring, ring_blocks, expected, share)
            places[BLOCK] = since // average_ns
        difference = values[i] - reference
        if difference - difference == 0.0:
            numbers[SUM] += difference
            places[COUNT] += 1


@kernel
def merge_averages(
    places: IntArray, numbers: FloatArray, ring: FloatArray, ring_blocks: IntArray, later: IntArray,
    later_numbers: FloatArray, later_ring: FloatArray, later_blocks: IntArray, expected: float, share: float,
) -> None:  # fmt: skip
    """Append the later averages; `expected` samples make up the block across the seam."""
    if later[BEGAN] == NEVER or later[BLOCK] == later[BEGAN]:
        # all of the later part lies within the block being filled, or there was nothing before it
        if later[BEGAN] == NEVER:
            # element by element: assigning whole arrays takes ten times as long to compile
            for i in range(places.shape[0]):
                places[i] = later[i]
            for i in range(numbers.shape[0]):
                numbers[i] = later_numbers[i]
            for i in range(ring.shape[0]):
                ring[i], ring_blocks[i] = later_ring[i], later_blocks[i]
        else:
            places[COUNT] += later[COUNT]
            numbers[SUM] += later_numbers[SUM]
        return
    places[COUNT] += later[HEAD_COUNT]
    numbers[SUM] += later_numbers[HEAD_SUM]
    _close(places, numbers, ring, ring_blocks, expected, share)
    n, m = places[AVERAGES], later[AVERAGES]
    if m > 0:
        step = later_numbers[MEAN] - numbers[MEAN]
        numbers[MEAN] += step * m / (n + m)
        numbers[SQUARES] += later_numbers[SQUARES] + step * step * n * m / (n + m)
        places[AVERAGES] = n + m
        if places[LAST] == later[FIRST_AVERAGE] - 1 and n > 0:
            places[PAIRS] += 1
            _pair(numbers, places[PAIRS], numbers[LAST_MEAN], later_numbers[FIRST_MEAN])
        if n == 0:
            places[FIRST_AVERAGE] = later[FIRST_AVERAGE]
            numbers[FIRST_MEAN] = later_numbers[FIRST_MEAN]
        places[LAST] = later[LAST]
        numbers[LAST_MEAN] = later_numbers[LAST_MEAN]
    n, m = places[PAIRS], later[PAIRS]
    if m > 0:
        early = later_numbers[EARLY_MEAN] - numbers[EARLY_MEAN]
        late = later_numbers[LATE_MEAN] - numbers[LATE_MEAN]
        weight = n * m / (n + m)
        numbers[EARLY_MEAN] += early * m / (n + m)
        numbers[LATE_MEAN] += late * m / (n + m)
        numbers[EARLY_SQUARES] += later_numbers[EARLY_SQUARES] + early * early * weight
        numbers[LATE_SQUARES] += later_numbers[LATE_SQUARES] + late * late * weight
        numbers[COVARIANCE] += later_numbers[COVARIANCE] + early * late * weight
        places[PAIRS] = n + m
    for i in range(ring.shape[0]):
        if later_blocks[i] != NEVER:
            ring[i] = later_ring[i]
            ring_blocks[i] = later_blocks[i]
    places[BLOCK] = later[BLOCK]
    places[COUNT] = later[COUNT]
    numbers[SUM] = later_numbers[SUM]


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


@kernel
def take_samples(
    places: IntArray, numbers: FloatArray, ring: FloatArray, ring_blocks: IntArray, reference: float, first_slot: int,
    values: FloatArray,
) -> None:  # fmt: skip
    """Take in values on the slots from `first_slot` on, each an average of its own; NaN is missing."""
    # the first by the general way, which closes the open block
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
