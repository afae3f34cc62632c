"""Divisions of a series into levels by least squares: candidates for changes that only together explain it."""

import numpy as np

from analytics.trends.levels.change_search import LEAST_SEGMENT
from stream.batch import FloatArray, IntArray

_MOST_BLOCKS = 300
_AT_ONCE = 256


def divisions(values: FloatArray, most: int) -> list[tuple[int, ...]]:
    """The division with the least sum of squares for each number of changes, 1 to `most`.

    Exact (Auger and Lawrence 1989, doi:10.1007/BF02458835) in blocks of points, 300 at most.

    >>> divisions(np.repeat([0.0, 3.0, 1.0], 8), 2)[1]
    (8, 16)
    """
    size = -(-values.size // _MOST_BLOCKS)
    blocks = np.add.reduceat(values, np.arange(0, values.size, size)) / size
    starts = _starts(blocks, most)
    return [tuple(size * at for at in _moments(starts[:k], blocks.size)) for k in range(1, len(starts) + 1)]


def _starts(values: FloatArray, most: int) -> list[IntArray]:
    """For 1, 2, ... changes the start of the last segment of the best division before each point."""
    n = values.size
    centred = values - values.mean()
    sums = np.concatenate([[0.0], np.cumsum(centred)])
    squares = np.concatenate([[0.0], np.cumsum(centred**2)])
    best = squares - sums**2 / np.maximum(np.arange(n + 1), 1)
    best[1:LEAST_SEGMENT] = np.inf
    starts = []
    for k in range(1, min(most, n // LEAST_SEGMENT - 1) + 1):
        fresh, start = np.full(n + 1, np.inf), np.zeros(n + 1, np.int64)
        for first in range((k + 1) * LEAST_SEGMENT, n + 1, _AT_ONCE):
            end = np.arange(first, min(first + _AT_ONCE, n + 1))
            at = np.arange(k * LEAST_SEGMENT, end[-1] - LEAST_SEGMENT + 1)[:, None]
            length = end - at
            cost = best[at] + squares[end] - squares[at] - (sums[end] - sums[at]) ** 2 / np.maximum(length, 1)
            cost[length < LEAST_SEGMENT] = np.inf
            where = cost.argmin(axis=0)
            fresh[end], start[end] = cost[where, np.arange(end.size)], at[where, 0]
        best = fresh
        starts.append(start)
    return starts


def _moments(starts: list[IntArray], n: int) -> list[int]:
    edges = [n]
    for start in reversed(starts):
        edges.append(int(start[edges[-1]]))
    return edges[:0:-1]
