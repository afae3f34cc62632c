"""Machine code for the prefix sums of a whole record (``prefix_record``).

A record of N slots is kept as its prefix sums, N + 1 of them, in blocks of B: within a block relative to its first,
and the first of each block as the unevaluated sum of two numbers. What is subtracted from each other is therefore never
larger than what B samples add up to, however long the record is.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from stream.batch import FloatArray, IntArray


class Record(NamedTuple):
    """Prefix sums of a record, relative to a reference; slots that hold no sample add nothing.

    Attributes
    ----------
    sums: shape (R, B); sums from the first slot of a block to each of its slots, that one excluded.
    counts: shape (C, B); how many samples they hold.
    rows: shape (blocks, 2); rows of `sums` and `counts` that belong to a block.
    before: shape (blocks,); samples before a block.
    high, low: shape (blocks,); sum before a block, `mean` taken off every sample; the second is what the first has lost
        by rounding.
    mean: About the mean of the record over its reference; NaN if the sums are too large for a number.
    slots: N.
    """

    sums: FloatArray
    counts: npt.NDArray[np.uint16]
    rows: IntArray
    before: IntArray
    high: FloatArray
    low: FloatArray
    mean: float
    slots: int


@njit(cache=True, nogil=True)
def extend(sums: FloatArray, counts: IntArray, first: int, values: FloatArray, reference: float) -> None:
    """Add values behind slot `first` of a block, whose prefix sums and counts are known up to there."""
    for i in range(values.shape[0]):
        value = values[i]
        is_finite = value - value == 0.0
        sums[first + i + 1] = sums[first + i] + (value - reference if is_finite else 0.0)
        counts[first + i + 1] = counts[first + i] + (1 if is_finite else 0)


@njit(cache=True, nogil=True)
def add(high: float, low: float, term: float) -> tuple[float, float]:
    """Sum of high + low and `term`, with what rounding loses (D. E. Knuth, TAOCP 4.2.2 theorem B)."""
    total = high + term
    shadow = total - high
    return total, low + ((high - (total - shadow)) + (term - shadow))


@njit(cache=True, nogil=True)
def take_off(high: FloatArray, low: FloatArray, before: IntArray, mean: float) -> None:
    """Take `mean` off every sample; mean * before must be exact: a mean of 20 bits."""
    for i in range(high.shape[0]):
        high[i], low[i] = add(high[i], low[i], -mean * before[i])
