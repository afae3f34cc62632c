"""Counts on the wire: planes of bytes, as few as hold all counts.

Most gyros use 16 bits or fewer of the 32 of a count. Only significant bytes are sent, those of equal weight beside each
other: half the traffic, and a compressor needs an eighth of the time for a tenth less.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
import numpy.typing as npt

from stream.batch import CountArray, IntArray
from stream.compiled import compiled

Planes = npt.NDArray[np.uint8]


def split_counts(counts: CountArray) -> bytes:
    """Split counts, at least one, into 1 to 4 planes of a byte a sample, the lowest byte first; two's complement.

    >>> split_counts(np.array([1, -2], np.int32)).hex(" ")
    '01 fe'
    >>> split_counts(np.array([1, 300, -2], np.int32)).hex(" ")
    '01 2c fe 00 01 ff'
    """
    return _split(np.ascontiguousarray(counts, np.int32)).tobytes()


def join_counts(planes: bytes, n: int) -> CountArray:
    """The `n` counts of planes; their length must be 1 to 4 times n."""
    return _join(np.frombuffer(planes, np.uint8), n)


def join_batches(planes: Sequence[bytes], sizes: IntArray) -> CountArray:
    """The counts of many batches one after another; batches of equal form are joined together.

    >>> batches = [np.array([1, -2]), np.array([1, 300, -2])]
    >>> join_batches([split_counts(each) for each in batches], np.array([2, 3])).tolist()
    [1, -2, 1, 300, -2]
    """
    out = np.empty(int(sizes.sum()), np.int32)
    begins = np.cumsum(sizes) - sizes
    widths = np.array([len(each) for each in planes]) // sizes
    for n, width in np.unique(np.stack([sizes, widths]), axis=1).T.tolist():
        which = np.flatnonzero((sizes == n) & (widths == width))
        together = np.frombuffer(b"".join([planes[i] for i in which.tolist()]), np.uint8)
        joined = _join_arrays(together.reshape(-1, width, n))
        if len(which) == len(sizes):
            return joined.reshape(-1)
        for row, begin in zip(joined, begins[which].tolist(), strict=True):
            out[begin : begin + n] = row
    return out


def planes_of(counts: bytes) -> bytes:
    """Four planes of counts that are 32 bits each, as older versions sent them."""
    return np.frombuffer(counts, np.uint8).reshape(-1, 4).T.tobytes()


def _join_arrays(planes: Planes) -> CountArray:
    """The counts, shape (..., n), of planes, shape (..., planes, n)."""
    out = planes[..., -1, :].view(np.int8).astype(np.int32)
    for lower in range(planes.shape[-2] - 2, -1, -1):
        out <<= 8
        out |= planes[..., lower, :]
    return out


@compiled
def _split(counts: CountArray) -> Planes:
    n = counts.shape[0]
    used = np.int32(0)
    for i in range(n):
        used |= counts[i] ^ (counts[i] >> 31)
    planes = 1 if used < 1 << 7 else 2 if used < 1 << 15 else 3 if used < 1 << 23 else 4
    out = np.empty(planes * n, np.uint8)
    for k in range(planes):
        for i in range(n):
            out[k * n + i] = np.uint8((counts[i] >> (8 * k)) & 255)
    return out


@partial(compiled, instead=lambda planes, n: _join_arrays(planes.reshape(-1, n)))
def _join(planes: Planes, n: int) -> CountArray:
    top = planes.shape[0] // n - 1
    out = np.empty(n, np.int32)
    for i in range(n):
        out[i] = np.int8(planes[top * n + i])
    for k in range(top - 1, -1, -1):
        for i in range(n):
            out[i] = (out[i] << 8) | planes[k * n + i]
    return out
