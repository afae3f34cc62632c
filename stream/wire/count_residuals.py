"""Counts on the wire: differences from their mean, in planes of bytes, as few as hold all of them.

Most gyros use 16 bits or fewer of the 32 of a count, about a bias that says nothing. Sent are the mean, four bytes, and
the differences from it, zigzag: 0, -1, 1, -2, ... become 0, 1, 2, 3. Bytes of equal weight stand beside each other, the
lowest first: half the traffic, and a compressor comes within 5 % of the entropy of white noise, since the sign does not
fill a byte of its own. Differences are taken modulo 2**32.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
import numpy.typing as npt

from stream.batch import CountArray, IntArray
from stream.compiled import compiled, kernel_part

Bytes = npt.NDArray[np.uint8]

MEAN_BYTES = 4


def split_counts(counts: CountArray) -> bytes:
    """Split counts, at least one, into their mean and 1 to 4 planes of a byte a sample.

    >>> split_counts(np.array([7, 5], np.int32)).hex(" ")
    '06 00 00 00 02 01'
    >>> split_counts(np.array([1, 601, -2], np.int32)).hex(" ")
    'c8 00 00 00 8d 22 93 01 03 01'
    """
    return _split(np.ascontiguousarray(counts, np.int32)).tobytes()


def join_counts(residuals: bytes, n: int) -> CountArray:
    """The `n` counts; the length of the bytes must be 4 and 1 to 4 times n."""
    return _join(np.frombuffer(residuals, np.uint8), n)


def first_count(residuals: bytes, n: int) -> int:
    """The first of `n` counts, without arrays, which would take ten times as long.

    >>> first_count(split_counts(np.array([-700, 2, 5], np.int32)), 3)
    -700
    """
    zigzag = int.from_bytes(residuals[MEAN_BYTES::n], "little")
    count = int.from_bytes(residuals[:MEAN_BYTES], "little") + (zigzag >> 1 ^ -(zigzag & 1))
    return (count + 2**31) % 2**32 - 2**31


def join_batches(residuals: Sequence[bytes], sizes: IntArray) -> CountArray:
    """The counts of many batches one after another; batches of equal form are joined together.

    >>> batches = [np.array([1, -2]), np.array([1, 300, -2])]
    >>> join_batches([split_counts(each) for each in batches], np.array([2, 3])).tolist()
    [1, -2, 1, 300, -2]
    """
    out = np.empty(int(sizes.sum()), np.int32)
    begins = np.cumsum(sizes) - sizes
    widths = (np.array([len(each) for each in residuals]) - MEAN_BYTES) // sizes
    for n, width in np.unique(np.stack([sizes, widths]), axis=1).T.tolist():
        which = np.flatnonzero((sizes == n) & (widths == width))
        together = np.frombuffer(b"".join([residuals[i] for i in which.tolist()]), np.uint8)
        joined = _join_arrays(together.reshape(len(which), -1), n)
        if len(which) == len(sizes):
            return joined.reshape(-1)
        for row, begin in zip(joined, begins[which].tolist(), strict=True):
            out[begin : begin + n] = row
    return out


def _join_arrays(residuals: Bytes, n: int) -> CountArray:
    """The counts, shape (..., n), of bytes, shape (..., 4 + planes * n)."""
    mean = np.ascontiguousarray(residuals[..., :MEAN_BYTES]).view("<i4")
    planes = residuals[..., MEAN_BYTES:]
    planes = planes.reshape(*planes.shape[:-1], -1, n)
    zigzag = planes[..., -1, :].astype(np.uint32)
    for lower in range(planes.shape[-2] - 2, -1, -1):
        zigzag <<= np.uint32(8)
        zigzag |= planes[..., lower, :]
    signs = -(zigzag & np.uint32(1)).view(np.int32)
    zigzag >>= np.uint32(1)
    out: CountArray = zigzag.view(np.int32)
    out ^= signs
    out += mean
    return out


def _split_arrays(counts: CountArray) -> Bytes:
    n = len(counts)
    mean = (2 * int(counts.sum(dtype=np.int64)) + n) // (2 * n)
    difference = (counts - np.int64(mean)).astype(np.int32)
    zigzag = np.ascontiguousarray(((difference << 1) ^ (difference >> 31)).view(np.uint32), "<u4")
    planes = max(1, (int(zigzag.max()).bit_length() + 7) // 8)
    rows = zigzag.view(np.uint8).reshape(n, 4)[:, :planes].T
    return np.concatenate([np.array([mean], "<i4").view(np.uint8), rows.reshape(-1)])


@partial(compiled, instead=_split_arrays)
def _split(counts: CountArray) -> Bytes:
    n = counts.shape[0]
    total = 0
    for i in range(n):
        total += counts[i]
    mean = np.int32((2 * total + n) // (2 * n))
    zigzag = np.empty(n, np.uint32)
    used = np.uint32(0)
    for i in range(n):
        difference = np.int32(counts[i] - mean)
        each = np.uint32(difference << 1) ^ np.uint32(difference >> 31)
        zigzag[i] = each
        used |= each
    planes = 1 if used < 1 << 8 else 2 if used < 1 << 16 else 3 if used < 1 << 24 else 4
    out = np.empty(MEAN_BYTES + planes * n, np.uint8)
    for k in range(MEAN_BYTES):
        out[k] = np.uint8((mean >> (8 * k)) & 255)
    for k in range(planes):
        plane = out[MEAN_BYTES + k * n : MEAN_BYTES + (k + 1) * n]
        for i in range(n):
            plane[i] = np.uint8((zigzag[i] >> np.uint32(8 * k)) & np.uint32(255))
    return out


@kernel_part()
def expand(data: Bytes, at: int, out: CountArray, planes: int) -> None:
    """Write the counts whose mean and planes begin at a place of some bytes."""
    n = out.shape[0]
    mean = np.int32(0)
    for k in range(MEAN_BYTES):
        mean |= np.int32(data[at + k]) << np.int32(8 * k)
    at += MEAN_BYTES
    plane = data[at + (planes - 1) * n : at + planes * n]
    for i in range(n):
        out[i] = plane[i]
    for k in range(planes - 2, -1, -1):
        plane = data[at + k * n : at + (k + 1) * n]
        for i in range(n):
            out[i] = (out[i] << np.int32(8)) | np.int32(plane[i])
    for i in range(n):
        zigzag = np.uint32(out[i])
        out[i] = np.int32(mean + np.int32((zigzag >> np.uint32(1)) ^ (np.uint32(0) - (zigzag & np.uint32(1)))))


@partial(compiled, instead=_join_arrays)
def _join(residuals: Bytes, n: int) -> CountArray:
    out = np.empty(n, np.int32)
    expand(residuals, 0, out, (residuals.shape[0] - MEAN_BYTES) // n)
    return out
