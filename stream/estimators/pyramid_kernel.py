"""Machine code for the pyramid of block sums (``allan_variance``).

Block b of level k covers the slots [b 2**k, (b + 1) 2**k) and holds (sum of x - reference, count) over its valid
slots.
Prefix sums begin anew in every call, so that nothing large is ever subtracted from something large.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from stream.batch import FloatArray, IntArray

NEXT, FILLED, FULL, PENDING = 0, 1, 2, 3
SUM, COUNT = 0, 1
_CHUNK = 2048


class PyramidState(NamedTuple):
    """What is kept of K levels with a history of H blocks and L lags a level.

    Attributes
    ----------
    tails : ndarray, shape (K, 2, H)
        Sums and counts of the last blocks, oldest first; counts that were never written say "full".
    pending : ndarray, shape (K, 2)
        An even block that waits for its odd neighbour.
    squares, windows : ndarray, shape (K, L)
        Sum of D**2, and how many, for each lag n: D is the difference of two adjacent means of n blocks, times their
        slots.
    places : ndarray of int64, shape (K, 4)
        Index of the next block; blocks in the tail; whether they are all full; whether a block is pending.
    """

    tails: FloatArray
    pending: FloatArray
    squares: FloatArray
    windows: IntArray
    places: IntArray


def empty_state(levels: int, history: int, lags: int) -> PyramidState:
    """State before the first sample."""
    tails = np.zeros((levels, 2, history))
    tails[:, COUNT] = 2.0 ** np.arange(levels)[:, np.newaxis]
    places = np.zeros((levels, 4), np.int64)
    places[:, FULL] = 1
    return PyramidState(
        tails, np.zeros((levels, 2)), np.zeros((levels, lags)), np.zeros((levels, lags), np.int64), places
    )


@njit(cache=True, nogil=True, fastmath={"reassoc"})
def _subtract(values: FloatArray, reference: float, out: FloatArray) -> bool:
    """Write values - reference; whether all are finite (0 * NaN and 0 * inf are NaN)."""
    zero = 0.0
    for i in range(values.shape[0]):
        difference = values[i] - reference
        out[i] = difference
        zero += difference * 0.0
    return zero == 0.0


@njit(cache=True, nogil=True)
def _mask(sums: FloatArray, counts: FloatArray) -> None:
    """Turn values that are not finite into empty blocks."""
    for i in range(sums.shape[0]):
        if sums[i] - sums[i] == 0.0:
            counts[i] = 1.0
        else:
            sums[i] = 0.0
            counts[i] = 0.0


@njit(cache=True, nogil=True)
def _prefix(line: FloatArray, out: FloatArray) -> None:
    """Prefix sums, out[0] = 0; groups of four, so that one addition in four waits for the one before."""
    total = 0.0
    out[0] = 0.0
    whole = line.shape[0] - line.shape[0] % 4
    for i in range(0, whole, 4):
        two = line[i] + line[i + 1]
        out[i + 1] = total + line[i]
        out[i + 2] = total + two
        out[i + 3] = total + (two + line[i + 2])
        total += two + (line[i + 2] + line[i + 3])
        out[i + 4] = total
    for i in range(whole, line.shape[0]):
        total += line[i]
        out[i + 1] = total


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def _sum_of_squares(late: FloatArray, middle: FloatArray, early: FloatArray) -> float:
    total = 0.0
    for i in range(late.shape[0]):
        difference = (late[i] - middle[i]) - (middle[i] - early[i])
        total += difference * difference
    return total


@njit(cache=True, nogil=True)
def _sum_of_squares_with_gaps(
    sums: FloatArray, counts: FloatArray, lag: int, first: int, stop: int, needed: float, slots: float
) -> tuple[float, int]:
    """Differences of window means, times the slots of a window, where both windows hold enough samples."""
    total = 0.0
    windows = 0
    for i in range(first, stop):
        late = counts[i] - counts[i - lag]
        early = counts[i - lag] - counts[i - 2 * lag]
        if late >= needed and early >= needed:
            difference = (sums[i] - sums[i - lag]) / late - (sums[i - lag] - sums[i - 2 * lag]) / early
            difference *= slots
            total += difference * difference
            windows += 1
    return total, windows


@njit(cache=True, nogil=True)
def _accumulate(
    squares: FloatArray,
    windows: IntArray,
    lags: IntArray,
    prefix: FloatArray,
    filled: int,
    length: int,
    full: bool,
    share: float,
    width: float,
) -> None:
    """Add the windows of one level that end in a new block, those after the first `filled`."""
    for j in range(lags.shape[0]):
        lag = lags[j]
        first = max(filled + 1, 2 * lag)
        stop = length + 1
        if lag == 0 or first >= stop:
            continue
        sums = prefix[SUM]
        if full:
            squares[j] += _sum_of_squares(
                sums[first:stop], sums[first - lag : stop - lag], sums[first - 2 * lag : stop - 2 * lag]
            )
            windows[j] += stop - first
        else:
            slots = lag * width
            total, found = _sum_of_squares_with_gaps(sums, prefix[COUNT], lag, first, stop, share * slots, slots)
            squares[j] += total
            windows[j] += found


@njit(cache=True, nogil=True)
def _keep_tail(tail: FloatArray, place: IntArray, line: FloatArray, length: int, full: bool, width: float) -> None:
    """Keep the last blocks of a level."""
    kept = min(tail.shape[1], length)
    tail[SUM, :kept] = line[SUM, length - kept : length]
    place[FILLED] = kept
    if not full:
        tail[COUNT, :kept] = line[COUNT, length - kept : length]
        place[FULL] = 1
        for i in range(kept):
            if tail[COUNT, i] != width:
                place[FULL] = 0


@njit(cache=True, nogil=True)
def _pair(
    line: FloatArray,
    parents: FloatArray,
    pending: FloatArray,
    place: IntArray,
    given: int,
    total: int,
    full: bool,
    width: float,
    enough: int,
) -> tuple[int, int, bool]:
    """Sum pairs of blocks into parents; blocks `given` to `total` are empty and not written out."""
    if full and place[PENDING] == 1 and pending[COUNT] != width:
        line[COUNT, :given] = width
        full = False
    ends = place[PENDING] + total
    start = made = 0
    if place[PENDING] == 1:
        parents[SUM, 0] = pending[SUM] + line[SUM, 0]
        parents[COUNT, 0] = pending[COUNT] + (width if full else line[COUNT, 0])
        start = made = 1
    pairs = (given - start) // 2
    for which in range(1 if full else 2):
        below = line[which, start:]
        above = parents[which, made:]
        for i in range(pairs):
            above[i] = below[2 * i] + below[2 * i + 1]
    made += pairs
    single = start + 2 * pairs < given
    if total > given:
        if single:
            parents[:, made] = line[:, given - 1]
            made += 1
        wanted = min(ends // 2, enough)
        if made < wanted:
            parents[:, made:wanted] = 0.0
            made = wanted
    place[PENDING] = ends % 2
    is_empty = place[PENDING] == 0 or total > given
    pending[SUM] = 0.0 if is_empty else line[SUM, given - 1]
    pending[COUNT] = 0.0 if is_empty else (width if full else line[COUNT, given - 1])
    return made, ends // 2, full


@njit(cache=True, nogil=True)
def _climb(
    tails: FloatArray,
    pending: FloatArray,
    squares: FloatArray,
    windows: IntArray,
    places: IntArray,
    lags: IntArray,
    share: float,
    scratch: FloatArray,
    given: int,
    total: int,
    full: bool,
) -> None:
    """Push `total` blocks into level 0 and what becomes of them into all levels above.

    The first `given` stand in scratch[0] behind room for a tail; the rest are empty. More than a history of empty
    blocks changes nothing further in a level, so that a gap costs the same however long it is.
    """
    history = tails.shape[2]
    here, above, prefix = scratch[0], scratch[1], scratch[2]
    for level in range(tails.shape[0]):
        if total == 0:
            break
        width = 2.0**level
        place = places[level]
        filled = place[FILLED]
        length = filled + given
        if full and place[FULL] == 0:
            here[COUNT, history : history + given] = width
        all_full = full and place[FULL] == 1
        line = here[:, history - filled :]
        line[SUM, :filled] = tails[level, SUM, :filled]
        _prefix(line[SUM, :length], prefix[SUM])
        if not all_full:
            line[COUNT, :filled] = tails[level, COUNT, :filled]
            _prefix(line[COUNT, :length], prefix[COUNT])
        _accumulate(squares[level], windows[level], lags[min(level, 1)], prefix, filled, length, all_full, share, width)
        _keep_tail(tails[level], place, line, length, all_full, width)
        place[NEXT] += total
        new, parents = here[:, history:], above[:, history:]
        given, total, full = _pair(new, parents, pending[level], place, given, total, full, width, history + 1)
        here, above = above, here


@njit(cache=True, nogil=True)
def push(
    tails: FloatArray,
    pending: FloatArray,
    squares: FloatArray,
    windows: IntArray,
    places: IntArray,
    lags: IntArray,
    share: float,
    reference: float,
    first_slot: int,
    values: FloatArray,
) -> None:
    """Push values that lie on the slots from `first_slot` on; slots skipped before it are missing.

    `lags` holds the n of level 0 and those of all other levels, shape (2, L), 0 where unused; a window counts if it
    holds the `share` of its samples.
    """
    history = tails.shape[2]
    chunk = min(values.shape[0], _CHUNK)
    scratch = np.empty((3, 2, history + max(chunk, history) + 2))
    gap = first_slot - places[0, NEXT]
    if gap > 0:
        given = min(gap, history + 1)
        scratch[0, :, history : history + given] = 0.0
        _climb(tails, pending, squares, windows, places, lags, share, scratch, given, gap, False)
    for start in range(0, values.shape[0], _CHUNK):
        given = min(_CHUNK, values.shape[0] - start)
        sums = scratch[0, SUM, history : history + given]
        full = _subtract(values[start : start + given], reference, sums)
        if not full:
            _mask(sums, scratch[0, COUNT, history : history + given])
        _climb(tails, pending, squares, windows, places, lags, share, scratch, given, given, full)
