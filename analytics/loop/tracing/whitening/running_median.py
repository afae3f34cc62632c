"""Median over a window that runs along a series; importing that of scipy takes longer than most diagnoses run it."""

import numpy as np

from stream.batch import FloatArray
from stream.compiled import kernel


def running_median(values: FloatArray, width: int) -> FloatArray:
    """Median over an odd number of neighbours of each value; the first and last value are repeated beyond the ends.

    >>> running_median(np.array([1.0, 9.0, 2.0, 3.0, 8.0]), 3).tolist()
    [1.0, 2.0, 3.0, 3.0, 8.0]
    """
    return np.asarray(_running_median(np.ascontiguousarray(values, np.float64), width))


@kernel
def _running_median(values: FloatArray, width: int) -> FloatArray:
    size, half = values.size, width // 2
    medians = np.empty(size)
    if size == 0:
        return medians
    window = np.empty(width)  # in the order of size
    for place in range(width):
        window[place] = values[min(max(place - half, 0), size - 1)]
    window.sort()
    for place in range(size):
        medians[place] = window[half]
        leaving, entering = values[max(place - half, 0)], values[min(place + half + 1, size - 1)]
        at = np.searchsorted(window, leaving)
        while at + 1 < width and window[at + 1] < entering:
            window[at] = window[at + 1]
            at += 1
        while at > 0 and window[at - 1] > entering:
            window[at] = window[at - 1]
            at -= 1
        window[at] = entering
    return medians
