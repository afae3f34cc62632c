"""Counts as older versions sent them: planes of bytes of two's complement numbers (schema 2), or 32 bits each (1)."""

import numpy as np

from stream.batch import CountArray
from stream.wire.count_residuals import split_counts


def join_planes(planes: bytes, n: int) -> CountArray:
    """The `n` counts of 1 to 4 planes of a byte a sample, the lowest first; the length must be 1 to 4 times n.

    >>> join_planes(bytes.fromhex("012cfe0001ff"), 3).tolist()
    [1, 300, -2]
    """
    rows = np.frombuffer(planes, np.uint8).reshape(-1, n)
    out: CountArray = rows[-1].view(np.int8).astype(np.int32)
    for lower in range(len(rows) - 2, -1, -1):
        out <<= 8
        out |= rows[lower]
    return out


def residuals_of(planes: bytes, counts: bytes, n: int) -> bytes:
    """Today's form of counts that have one of the older two; see `count_residuals`.

    >>> residuals_of(b"", bytes.fromhex("0700000005000000"), 2).hex(" ")
    '06 00 00 00 02 01'
    """
    return split_counts(join_planes(planes, n) if planes else np.frombuffer(counts, "<i4"))
