"""Machine code for the pyramid of block sums (``allan_variance``).

Block b of level k covers the slots [b 2**k, (b + 1) 2**k) and holds (sum of x - reference, count) over its valid
slots. Prefix sums restart in every call, so that nothing large is ever subtracted from something large.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from stream.batch import FloatArray, IntArray
from stream.estimators.kernels import kernel_part

FIRST, NEXT, FILLED, HEADED, FULL = 0, 1, 2, 3, 4
SUM, COUNT = 0, 1
_CHUNK = 2048
_FEW = 32
_OCTAVES = 5  # lags 1, 2, 4, 8, 16 of level 0 at one point per octave


class PyramidState(NamedTuple):
    """What is kept of K levels with a history of H blocks and L lags a level.

    tails, heads: shape (K, 2, H); sums and counts of the last and of the first blocks, oldest first; counts that were
    never written are those of full blocks. An even block at the end of a tail waits for its odd neighbour; an odd first
    block of a level has none. squares, windows: shape (K, L); sum of D**2, and how many, for each lag n: D is the
    difference of two adjacent means of n blocks, times their slots. places: shape (K, 5); index of the first block and
    of the next; blocks in the tail and in the head; whether the
        tail's are all full.
    """

    tails: FloatArray
    heads: FloatArray
    squares: FloatArray
    windows: IntArray
    places: IntArray


def empty_state(levels: int, history: int, lags: int) -> PyramidState:
    """State before the first sample."""
    tails = np.zeros((levels, 2, history))
    tails[:, COUNT] = 2.0 ** np.arange(levels)[:, np.newaxis]
    places = np.zeros((levels, 5), np.int64)
    places[:, FULL] = 1
    return PyramidState(tails, tails.copy(), np.zeros((levels, lags)), np.zeros((levels, lags), np.int64), places)


def begin_at(state: PyramidState, slot: int) -> None:
    """Set the first slot of an empty state."""
    levels = np.arange(len(state.places))
    state.places[:, FIRST] = state.places[:, NEXT] = -(-slot >> levels)


@kernel_part("reassoc")
def _subtract(values: FloatArray, reference: float, out: FloatArray) -> bool:
    """Write values - reference; whether all are finite (0 * NaN and 0 * inf are NaN)."""
    zero = 0.0
    for i in range(values.shape[0]):
        difference = values[i] - reference
        out[i] = difference
        zero += difference * 0.0
    return zero == 0.0


@kernel_part()
def _mask(sums: FloatArray, counts: FloatArray) -> None:
    """Replace values that are not finite by empty blocks."""
    for i in range(sums.shape[0]):
        if sums[i] - sums[i] == 0.0:
            counts[i] = 1.0
        else:
            sums[i] = 0.0
            counts[i] = 0.0


@kernel_part()
def _prefix_sums(line: FloatArray, out: FloatArray) -> None:
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


@kernel_part("reassoc", "contract")
def _sum_of_squares(late: FloatArray, middle: FloatArray, early: FloatArray) -> float:
    """Sum of the squared differences of adjacent windows, from three stretches of the prefix sums."""
    total = 0.0
    for i in range(late.shape[0]):
        difference = (late[i] + early[i]) - 2.0 * middle[i]
        total += difference * difference
    return total


@kernel_part("reassoc", "contract")
def _sums_of_squares(
    p0: FloatArray, p1: FloatArray, p2: FloatArray, p4: FloatArray, p8: FloatArray, p16: FloatArray, p32: FloatArray,
    out: FloatArray,
) -> None:  # fmt: skip
    """Add those of the lags 1, 2, 4, 8 and 16 at once; p_n is the prefix n blocks before p0."""
    by_1 = by_2 = by_4 = by_8 = by_16 = 0.0
    for i in range(p0.shape[0]):
        last = p0[i]
        difference = (last + p2[i]) - 2.0 * p1[i]
        by_1 += difference * difference
        difference = (last + p4[i]) - 2.0 * p2[i]
        by_2 += difference * difference
        difference = (last + p8[i]) - 2.0 * p4[i]
        by_4 += difference * difference
        difference = (last + p16[i]) - 2.0 * p8[i]
        by_8 += difference * difference
        difference = (last + p32[i]) - 2.0 * p16[i]
        by_16 += difference * difference
    out[0] += by_1
    out[1] += by_2
    out[2] += by_4
    out[3] += by_8
    out[4] += by_16


@kernel_part()
def _add_pairs(line: FloatArray, out: FloatArray, pairs: int) -> None:
    """Write the sums of neighbours."""
    for i in range(pairs):
        out[i] = line[2 * i] + line[2 * i + 1]


@kernel_part()
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


@kernel_part()
def _accumulate(
    squares: FloatArray, windows: IntArray, lags: IntArray, prefix: FloatArray, after: int, length: int, until: int,
    full: bool, share: float, width: float,
) -> None:  # fmt: skip
    """Add the windows of a level that end after the first `after` of `length` blocks and begin before `until`."""
    sums = prefix[SUM]
    for j in range(lags.shape[0]):
        lag = lags[j]
        first = max(after + 1, 2 * lag)
        stop = min(length + 1, until + 2 * lag)
        if lag == 0 or first >= stop:
            continue
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


@kernel_part()
def _are_full(counts: FloatArray, number: int, width: float) -> bool:
    """Whether each of the first `number` counts is `width`."""
    others = 0
    for i in range(number):
        others += counts[i] != width
    return others == 0


@kernel_part()
def _keep_ends(
    tail: FloatArray, head: FloatArray, place: IntArray, line: FloatArray, length: int, full: bool, width: float
) -> None:
    """Store the last blocks of a level, and its first until there are enough; the line begins with the tail."""
    history = tail.shape[1]
    first = place[FILLED]
    kept = min(history, length)
    headed = place[HEADED]
    more = min(history - headed, length - first)
    for which in range(1 if full else 2):
        for i in range(kept):
            tail[which, i] = line[which, length - kept + i]
        for i in range(more):
            head[which, headed + i] = line[which, first + i]
    place[HEADED] = headed + more
    place[FILLED] = kept
    if not full:
        place[FULL] = _are_full(tail[COUNT], kept, width)


@kernel_part()
def _pair(
    line: FloatArray, parents: FloatArray, place: IntArray, filled: int, given: int, total: int, full: bool, enough: int
) -> tuple[int, int]:
    """Sum pairs of blocks into parents: how many are written, and how many there are.

    The `given` new blocks stand in the line behind those of the tail, of which the last may wait for its neighbour.
    `total - given` empty blocks follow that are not written out; of their parents at most `enough` are.
    """
    start = filled
    if place[NEXT] % 2 == 1:
        # an odd first block of the level has no neighbour and gets no parent
        start += -1 if place[NEXT] > place[FIRST] else 1
    pairs = max(0, (filled + given - start) // 2)
    for which in range(1 if full else 2):
        _add_pairs(line[which, start:], parents[which], pairs)
    made = pairs
    all_parents = max(0, (filled + total - start) // 2)
    if total > given:
        if start + 2 * pairs < filled + given:
            for which in range(2):
                parents[which, made] = line[which, filled + given - 1]
            made += 1
        wanted = min(all_parents, enough)
        for i in range(made, wanted):
            parents[SUM, i] = parents[COUNT, i] = 0.0
        made = max(made, wanted)
    return made, all_parents


@kernel_part()
def _climb_a_level(state: PyramidState, lags: IntArray, scratch: FloatArray, level: int, now: int, given: int) -> int:
    """Push a few full blocks from scratch[now] into a level that is full, their parents into the other; how many.

    The same as the general case, without views of arrays: views cost more than the few numbers in them, and in a batch
    of 1000 nine levels in ten get only a few blocks.
    """
    tails, _, squares, windows, places = state
    history = tails.shape[2]
    for i in range(history):
        scratch[now, SUM, i] = tails[level, SUM, i]
    length = history + given
    _prefix_sums(scratch[now, SUM, :length], scratch[2, SUM])
    row = min(level, 1)
    begin = 0
    if level == 0 and given >= _FEW and lags.shape[1] == _OCTAVES:
        p = scratch[2, SUM, history - 31 : length + 1]
        _sums_of_squares(p[32:], p[31:-1], p[30:-2], p[28:-4], p[24:-8], p[16:-16], p[:-32], squares[0])
        for j in range(_OCTAVES):
            windows[0, j] += given
        begin = _OCTAVES
    for j in range(begin, lags.shape[1]):
        lag = lags[row, j]
        if lag == 0:
            break
        total = 0.0
        if given < _FEW:
            for i in range(history + 1, length + 1):
                difference = scratch[2, SUM, i] - 2.0 * scratch[2, SUM, i - lag] + scratch[2, SUM, i - 2 * lag]
                total += difference * difference
        else:
            sums = scratch[2, SUM, history + 1 - 2 * lag : length + 1]
            total = _sum_of_squares(sums[2 * lag :], sums[lag : lag + given], sums[:given])
        squares[level, j] += total
        windows[level, j] += given
    for i in range(history):
        tails[level, SUM, i] = scratch[now, SUM, given + i]
    start = history - places[level, NEXT] % 2
    places[level, NEXT] += given
    parents: int = (length - start) // 2
    _add_pairs(scratch[now, SUM, start:length], scratch[1 - now, SUM, history:], parents)
    return parents


@kernel_part()
def _climb(
    state: PyramidState, lags: IntArray, share: float, scratch: FloatArray, given: int, total: int, full: bool
) -> None:
    """Push `total` blocks into level 0 and their parents into all levels above.

    The first `given` stand in scratch[0] behind room for a tail; the rest are empty. More than a history of empty
    blocks changes nothing in a level, so that a gap costs the same however long it is.
    """
    tails, heads, squares, windows, places = state
    history = tails.shape[2]
    prefix = scratch[2]
    now = 0
    for level in range(tails.shape[0]):
        if total == 0:
            break
        width = 2.0**level
        if full and total == given and places[level, FULL] == 1 and places[level, HEADED] == history:
            given = _climb_a_level(state, lags, scratch, level, now, given)
            total = given
            now = 1 - now
            continue
        here = scratch[now]
        above = scratch[1 - now]
        now = 1 - now
        place = places[level]
        filled = place[FILLED]
        length = filled + given
        line = here[:, history - filled :]
        all_full = full and place[FULL] == 1
        if full and not all_full:
            for i in range(filled, length):
                line[COUNT, i] = width
        for which in range(1 if all_full else 2):
            for i in range(filled):
                line[which, i] = tails[level, which, i]
            _prefix_sums(line[which, :length], prefix[which])
        _accumulate(
            squares[level], windows[level], lags[min(level, 1)], prefix, filled, length, length, all_full, share, width
        )
        _keep_ends(tails[level], heads[level], place, line, length, all_full, width)
        made, parents = _pair(line, above[:, history:], place, filled, given, total, all_full, history + 1)
        place[NEXT] += total
        given, total, full = made, parents, all_full


@njit(cache=True, nogil=True)
def push(
    tails: FloatArray, heads: FloatArray, squares: FloatArray, windows: IntArray, places: IntArray, lags: IntArray,
    share: float, reference: float, first_slot: int, values: FloatArray,
) -> None:  # fmt: skip
    """Push values that lie on the slots from `first_slot` on; slots skipped before it are missing.

    `lags` holds the n of level 0 and those of all other levels, shape (2, L), 0 where unused; a window counts if it
    holds the `share` of its samples.
    """
    state = PyramidState(tails, heads, squares, windows, places)
    history = tails.shape[2]
    chunk = min(values.shape[0], _CHUNK)
    scratch = np.empty((3, 2, history + max(chunk, history) + 2))
    gap = first_slot - places[0, NEXT]
    start = 0
    while start < values.shape[0]:
        # one call for gap and values: every call site compiles the machine code again
        if gap > 0:
            given, total, full = min(gap, history + 1), gap, False
            for i in range(history, history + given):
                scratch[0, SUM, i] = scratch[0, COUNT, i] = 0.0
            gap = 0
        else:
            given = total = min(_CHUNK, values.shape[0] - start)
            sums = scratch[0, SUM, history : history + given]
            full = _subtract(values[start : start + given], reference, sums)
            if not full:
                _mask(sums, scratch[0, COUNT, history : history + given])
            start += given
        _climb(state, lags, share, scratch, given, total, full)


@kernel_part()
def _copy(source: FloatArray, start: int, number: int, line: FloatArray, at: int) -> None:
    for which in range(2):
        for i in range(number):
            line[which, at + i] = source[which, start + i]


@njit(cache=True, nogil=True)
def merge(
    tails: FloatArray, heads: FloatArray, squares: FloatArray, windows: IntArray, places: IntArray, lags: IntArray,
    share: float, later_tails: FloatArray, later_heads: FloatArray, later_squares: FloatArray,
    later_windows: IntArray, later_places: IntArray,
) -> None:  # fmt: skip
    """Append a later pyramid to an earlier one, which becomes that of both.

    At each level at most one block lies across the seam. Its part before the seam consists of the blocks that wait for
    a neighbour at the levels below in the earlier pyramid, its part after it of those that have no neighbour there in
    the later one. The windows across the seam are counted from the earlier tail, that block and the later head.
    """
    history = tails.shape[2]
    line = np.empty((2, 3 * history + 1))
    prefix = np.empty((2, 3 * history + 2))
    seam, stop = places[0, NEXT], later_places[0, NEXT]
    # sum and count of the block across the seam, and whether both pyramids reach to its ends
    across = np.zeros(2)
    reaches_back = reaches_on = True
    for level in range(tails.shape[0]):
        width = 2.0**level
        place, later = places[level], later_places[level]
        tail, head = tails[level], heads[level]
        filled, headed = place[FILLED], place[HEADED]
        is_across = seam & ((1 << level) - 1) != 0 and reaches_back and reaches_on
        own = filled
        _copy(tail, 0, filled, line, 0)
        if is_across:
            line[SUM, own], line[COUNT, own] = across[SUM], across[COUNT]
            own += 1
        _copy(later_heads[level], 0, later[HEADED], line, own)
        length = own + later[HEADED]
        if length > filled and own > 0:
            for which in range(2):
                _prefix_sums(line[which, :length], prefix[which])
            # windows within the earlier or the later part are counted already
            _accumulate(
                squares[level], windows[level], lags[min(level, 1)], prefix, filled, length, own, False, share, width
            )
        for j in range(lags.shape[1]):
            squares[level, j] += later_squares[level, j]
            windows[level, j] += later_windows[level, j]
        # blocks without a neighbour on either side of the seam make up the block across at the next level
        if seam >> level & 1 and reaches_back:
            if filled > 0:
                across[SUM] += tail[SUM, filled - 1]
                across[COUNT] += tail[COUNT, filled - 1]
            else:
                reaches_back = False
        behind = -(-seam >> level)
        if behind & 1 and reaches_on:
            if later[HEADED] > 0:
                across[SUM] += later_heads[level, SUM, 0]
                across[COUNT] += later_heads[level, COUNT, 0]
            else:
                reaches_on = False
        more = min(history - headed, length - filled)
        _copy(line, filled, more, head, headed)
        place[HEADED] = headed + more
        if later[FILLED] < history:
            # the later head holds all its blocks
            kept = min(history, length)
            _copy(line, length - kept, kept, tail, 0)
        else:
            kept = history
            _copy(later_tails[level], 0, kept, tail, 0)
        place[FILLED] = kept
        place[NEXT] = max(place[FIRST], stop >> level)
        place[FULL] = _are_full(tail[COUNT], kept, width)
