"""Machine code for the pyramid of block sums (``allan_variance``).

Block b of level k covers the slots [b 2**k, (b + 1) 2**k) and holds (sum of x - reference, count) over its valid
slots. Prefix sums restart in every call, so that nothing large is ever subtracted from something large.
"""

from typing import NamedTuple

import numpy as np

from stream.batch import FloatArray, IntArray
from stream.compiled import kernel, kernel_part
from stream.estimators.kernels import pyramid_loops as loops
from stream.estimators.kernels.pyramid_loops import COUNT, SUM

FIRST, NEXT, FILLED, HEADED, FULL = 0, 1, 2, 3, 4
_CHUNK = 2048
_FEW = 32
_OCTAVES = 5  # lags 1, 2, 4, 8, 16 of level 0 at one point per octave


class PyramidState(NamedTuple):
    """What is kept of K levels with a history of H blocks and L lags a level.

    tails, heads: shape (K, 2, H); sums and counts of the last and of the first blocks, oldest first; counts that were
    never written are those of full blocks. An even block at the end of a tail waits for its odd neighbour; an odd first
    block of a level has none. squares, windows: shape (K, L); sum of D**2, and how many, for each lag n: D is the
    difference of two adjacent means of n blocks, times their slots. places: shape (K, 5); index of the first block and
    of the next; blocks in the tail and in the head; whether the tail's are all full.
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
        place[FULL] = loops.are_full(tail[COUNT], kept, width)


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
        loops.add_pairs(line[which, start:], parents[which], pairs)
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
    loops.prefix_sums(scratch[now, SUM, :length], scratch[2, SUM])
    row = min(level, 1)
    begin = 0
    if level == 0 and given >= _FEW and lags.shape[1] == _OCTAVES:
        p = scratch[2, SUM, history - 31 : length + 1]
        loops.sums_of_squares(p[32:], p[31:-1], p[30:-2], p[28:-4], p[24:-8], p[16:-16], p[:-32], squares[0])
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
            total = loops.sum_of_squares(sums[2 * lag :], sums[lag : lag + given], sums[:given])
        squares[level, j] += total
        windows[level, j] += given
    for i in range(history):
        tails[level, SUM, i] = scratch[now, SUM, given + i]
    start = history - places[level, NEXT] % 2
    places[level, NEXT] += given
    parents: int = (length - start) // 2
    loops.add_pairs(scratch[now, SUM, start:length], scratch[1 - now, SUM, history:], parents)
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
            loops.prefix_sums(line[which, :length], prefix[which])
        loops.accumulate(
            squares[level], windows[level], lags[min(level, 1)], prefix, filled, length, length, all_full, share, width
        )
        _keep_ends(tails[level], heads[level], place, line, length, all_full, width)
        made, parents = _pair(line, above[:, history:], place, filled, given, total, all_full, history + 1)
        place[NEXT] += total
        given, total, full = made, parents, all_full


@kernel
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
            full = loops.subtract(values[start : start + given], reference, sums)
            if not full:
                loops.mask(sums, scratch[0, COUNT, history : history + given])
            start += given
        _climb(state, lags, share, scratch, given, total, full)


@kernel
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
        loops.copy(tail, 0, filled, line, 0)
        if is_across:
            line[SUM, own], line[COUNT, own] = across[SUM], across[COUNT]
            own += 1
        loops.copy(later_heads[level], 0, later[HEADED], line, own)
        length = own + later[HEADED]
        if length > filled and own > 0:
            for which in range(2):
                loops.prefix_sums(line[which, :length], prefix[which])
            # windows within the earlier or the later part are counted already
            loops.accumulate(
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
        loops.copy(line, filled, more, head, headed)
        place[HEADED] = headed + more
        if later[FILLED] < history:
            # the later head holds all its blocks
            kept = min(history, length)
            loops.copy(line, length - kept, kept, tail, 0)
        else:
            kept = history
            loops.copy(later_tails[level], 0, kept, tail, 0)
        place[FILLED] = kept
        place[NEXT] = max(place[FIRST], stop >> level)
        place[FULL] = loops.are_full(tail[COUNT], kept, width)
