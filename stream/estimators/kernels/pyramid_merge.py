"""Machine code that puts two pyramids of block sums together, one of them going on where the other ends."""

import numpy as np
from numba import njit

from stream.batch import FloatArray, IntArray
from stream.estimators.kernels.kernel_part import kernel_part
from stream.estimators.kernels.pyramid_kernel import COUNT, FILLED, FIRST, FULL, HEADED, NEXT, SUM, accumulate, are_full
from stream.estimators.kernels.pyramid_sums import prefix_sums


@kernel_part()
def _copy(source: FloatArray, start: int, number: int, line: FloatArray, at: int) -> None:
    for which in range(2):
        for i in range(number):
            line[which, at + i] = source[which, start + i]


@njit(cache=True, nogil=True)
def merge(
    tails: FloatArray,
    heads: FloatArray,
    squares: FloatArray,
    windows: IntArray,
    places: IntArray,
    lags: IntArray,
    share: float,
    later_tails: FloatArray,
    later_heads: FloatArray,
    later_squares: FloatArray,
    later_windows: IntArray,
    later_places: IntArray,
) -> None:
    """Put a later pyramid behind an earlier one, which becomes that of both.

    At each level at most one block lies across the seam. Its part before the seam is what waits for a neighbour at
    the levels below in the earlier pyramid, its part behind it what has no neighbour there in the later one. The
    windows that reach over the seam are counted from the earlier tail, that block and the later head.
    """
    history = tails.shape[2]
    line = np.empty((2, 3 * history + 1))
    prefix = np.empty((2, 3 * history + 2))
    seam, stop = places[0, NEXT], later_places[0, NEXT]
    # of the block across the seam: its sum and count, and whether both pyramids reach to its ends
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
                prefix_sums(line[which, :length], prefix[which])
            # those that lie in the earlier one are counted already, and those that begin in the later one
            accumulate(
                squares[level], windows[level], lags[min(level, 1)], prefix, filled, length, own, False, share, width
            )
        for j in range(lags.shape[1]):
            squares[level, j] += later_squares[level, j]
            windows[level, j] += later_windows[level, j]
        # what waits before the seam and what has no neighbour behind it make up the block across at the next level
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
        place[FULL] = are_full(tail[COUNT], kept, width)
