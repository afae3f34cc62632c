"""Machine code for the deviations with full overlap (``full_overlap``).

Windows move over a record as long as their ends stay in the same blocks of prefix sums: so far a difference of means
is one of adjacent views of the blocks, and what the blocks between them add is the same throughout.
"""

import numpy as np
import numpy.typing as npt

from stream.batch import FloatArray, IntArray
from stream.compiled import kernel, kernel_part
from stream.estimators.full_overlap.prefix_record import PrefixSums

SUM_ROW, COUNT_ROW, WITHIN, BLOCK = 0, 1, 2, 3
_VIEWS = 4


@kernel_part()
def _place(
    record: PrefixSums, first: int, stop: int, factor: int, windows: int, place: IntArray, base: FloatArray,
    held: IntArray,
) -> int:  # fmt: skip
    """Place adjacent windows at slot `first`; returns how many slots they can move within the same blocks.

    Writes where their ends lie, and for each window what the blocks between its ends add to its sum and its count.
    """
    width = record.sums.shape[1]
    length = stop - first
    for j in range(windows + 1):
        at = first + j * factor
        block = at // width
        place[j, SUM_ROW] = record.rows[block, 0]
        place[j, COUNT_ROW] = record.rows[block, 1]
        place[j, WITHIN] = at - block * width
        place[j, BLOCK] = block
        length = min(length, width - place[j, WITHIN])
    for j in range(windows):
        early, late = place[j, BLOCK], place[j + 1, BLOCK]
        base[j] = (record.high[late] - record.high[early]) + (record.low[late] - record.low[early])
        held[j] = record.before[late] - record.before[early]
    return length


@kernel_part()
def _is_full(record: PrefixSums, place: IntArray, windows: int, length: int, factor: int) -> bool:
    """Whether no slot is missing in any of the windows while they move on by `length`."""
    last = place[windows, WITHIN] + length - 1
    held = record.before[place[windows, BLOCK]] - record.before[place[0, BLOCK]]
    held += np.int64(record.counts[place[windows, COUNT_ROW], last])
    held -= np.int64(record.counts[place[0, COUNT_ROW], place[0, WITHIN]])
    return bool(held == length - 1 + windows * factor)


@kernel_part()
def _full_base(record: PrefixSums, place: IntArray, base: FloatArray, weights: FloatArray) -> float:
    """What the blocks, and the mean within them, add to a difference of full windows: constant while they move."""
    total = 0.0
    for j in range(weights.shape[0]):
        found = np.int64(record.counts[place[j + 1, COUNT_ROW], place[j + 1, WITHIN]])
        found -= np.int64(record.counts[place[j, COUNT_ROW], place[j, WITHIN]])
        total += weights[j] * (base[j] - record.mean * found)
    return total


@kernel_part()
def _means(
    early: FloatArray, late: FloatArray, early_counts: npt.NDArray[np.uint16], late_counts: npt.NDArray[np.uint16],
    base: float, held: float, mean: float, needed: float, out: FloatArray,
) -> None:  # fmt: skip
    """Means of a window as it moves on, over `PrefixSums.mean`; NaN where it holds too few samples."""
    for i in range(early.shape[0]):
        found = np.float64(np.int32(late_counts[i]) - np.int32(early_counts[i]))
        count = held + found
        total = (late[i] - early[i]) - mean * found + base
        out[i] = total / count if count >= needed else np.nan


@kernel_part()
def _all_means(
    record: PrefixSums, place: IntArray, base: FloatArray, held: IntArray, length: int, needed: float, out: FloatArray
) -> None:
    """Means of all windows, a row each."""
    for j in range(out.shape[0]):
        early, late = place[j], place[j + 1]
        _means(
            _view(record, place, j, length), _view(record, place, j + 1, length),
            record.counts[early[COUNT_ROW], early[WITHIN] : early[WITHIN] + length],
            record.counts[late[COUNT_ROW], late[WITHIN] : late[WITHIN] + length], base[j], float(held[j]),
            record.mean, needed, out[j],
        )  # fmt: skip


@kernel_part()
def _view(record: PrefixSums, place: IntArray, j: int, length: int) -> FloatArray:
    start = place[j, WITHIN]
    return record.sums[place[j, SUM_ROW], start : start + length]


@kernel_part("reassoc", "contract")
def _sums_of_second(a: FloatArray, b: FloatArray, c: FloatArray, base: float) -> tuple[float, float]:
    """Sum of the second differences, and of their squares."""
    total = squares = 0.0
    for i in range(a.shape[0]):
        difference = (c[i] - b[i]) - (b[i] - a[i]) + base
        total += difference
        squares += difference * difference
    return total, squares


@kernel_part("reassoc", "contract")
def _squares_of_third(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray, base: float) -> float:
    squares = 0.0
    for i in range(a.shape[0]):
        difference = (d[i] - c[i]) - 2.0 * (c[i] - b[i]) + (b[i] - a[i]) + base
        squares += difference * difference
    return squares


@kernel_part("reassoc", "contract")
def _sums_with_gaps(
    means: FloatArray, weights: FloatArray, length: int, step: int, factor: float
) -> tuple[float, float, int]:
    """Sum of the differences of means times `factor`, sum of their squares, and their number; NaN are left out."""
    first, second, third = weights[0], weights[1], weights[-1] if weights.shape[0] == 3 else 0.0
    a, b, c = means[0], means[1], means[-1]
    total = squares = 0.0
    found = 0
    for i in range(0, length, step):
        difference = first * a[i] + second * b[i]
        if third != 0.0:
            difference += third * c[i]
        is_there = difference == difference
        difference = difference * factor if is_there else 0.0
        total += difference
        squares += difference * difference
        found += is_there
    return total, squares, found


@kernel
def differences(
    record: PrefixSums, factor: int, weights: FloatArray, share: float, first: int, stop: int, step: int
) -> tuple[float, float, int]:
    """Differences of adjacent windows of `factor` slots that begin at slots from `first` to `stop`, times `factor`.

    The means are weighted by -1, 1 for Allan and by 1, -2, 1 for Hadamard; a window counts if it holds the `share` of
    its samples. Returns the sum of the differences (of two windows only), that of their squares, and their number.
    """
    windows = weights.shape[0]
    place, base, held = np.empty((_VIEWS, 4), np.int64), np.empty(_VIEWS - 1), np.empty(_VIEWS - 1, np.int64)
    means = np.empty((windows, record.sums.shape[1]))
    total = squares = 0.0
    found = 0
    at = first
    while at < stop:
        length = _place(record, at, stop, factor, windows, place, base, held)
        steps = (length + step - 1) // step
        if _is_full(record, place, windows, length, factor):
            shift = _full_base(record, place, base, weights)
            a, b = _view(record, place, 0, length), _view(record, place, 1, length)
            c, d = _view(record, place, 2, length), _view(record, place, windows, length)
            if windows == 2 and step == 1:
                more, more_squares = _sums_of_second(a, b, c, shift)
                total += more
            elif windows == 2:
                more, more_squares = _sums_of_second(a[::step], b[::step], c[::step], shift)
                total += more
            elif step == 1:
                more_squares = _squares_of_third(a, b, c, d, shift)
            else:
                more_squares = _squares_of_third(a[::step], b[::step], c[::step], d[::step], shift)
            squares += more_squares
            found += steps
        else:
            _all_means(record, place, base, held, length, share * factor, means)
            more, more_squares, steps_there = _sums_with_gaps(means, weights, length, step, factor)
            total += more
            squares += more_squares
            found += steps_there
        at += steps * step
    return total, squares, found


@kernel_part()
def _run_full(
    a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray, base: float, total: float, scale: float
) -> tuple[float, float]:
    """Move the sum of differences over full windows; the sum, and the sum of its squares on the way."""
    squares = 0.0
    for i in range(a.shape[0]):
        total += (d[i] - c[i]) - 2.0 * (c[i] - b[i]) + (b[i] - a[i]) + base
        scaled = total * scale
        squares += scaled * scaled
    return total, squares


@kernel
def modified(record: PrefixSums, factor: int, share: float, restart: int) -> tuple[float, int]:
    """Sum of squares of the sums of `factor` neighbouring differences of two windows, and how many there are.

    The sum runs: the incoming difference is added, the outgoing one subtracted. It restarts every `restart` slots, or
    every `factor` where that is more, so that rounding does not accumulate. Where differences are missing, the mean of
    the others stands for all, if they are the `share` of all.
    """
    weights, allan = np.array([1.0, -2.0, 1.0]), np.array([-1.0, 1.0])
    place, base, held = np.empty((_VIEWS, 4), np.int64), np.empty(_VIEWS - 1), np.empty(_VIEWS - 1, np.int64)
    means = np.empty((3, record.sums.shape[1]))
    needed = share * factor
    squares = 0.0
    found = 0
    end = record.slots - 3 * factor + 2
    stride = max(factor, restart)
    for first in range(0, end, stride):
        stop = min(first + stride, end)
        total, _, valid = differences(record, factor, allan, share, first, first + factor, 1)
        if valid > 0 and valid >= needed:
            squares += (total * factor / valid) ** 2
            found += 1
        at = first
        while at < stop - 1:
            length = _place(record, at, stop - 1, factor, 3, place, base, held)
            if _is_full(record, place, 3, length, factor):
                is_counted = valid > 0 and valid >= needed
                views = (_view(record, place, 0, length), _view(record, place, 1, length))
                later = (_view(record, place, 2, length), _view(record, place, 3, length))
                scale = factor / valid if is_counted else 0.0
                shift = _full_base(record, place, base, weights)
                total, more = _run_full(views[0], views[1], later[0], later[1], shift, total, scale)
                squares += more
                found += length if is_counted else 0
            else:
                _all_means(record, place, base, held, length, needed, means)
                for k in range(length):
                    outgoing, incoming = means[1, k] - means[0, k], means[2, k] - means[1, k]
                    if not np.isnan(outgoing):
                        total -= outgoing * factor
                        valid -= 1
                    if valid == 0:
                        total = 0.0
                    if not np.isnan(incoming):
                        total += incoming * factor
                        valid += 1
                    if valid > 0 and valid >= needed:
                        squares += (total * factor / valid) ** 2
                        found += 1
            at += length
    return squares, found
