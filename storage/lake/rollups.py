"""Rollups: count, mean, M2, minimum and maximum of each second and each ten seconds of the source's clock."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from storage.lake.tables import ROLLUP_COLUMNS
from stream.batch import BoolArray, CountArray, FloatArray, IntArray
from stream.compiled import compiled, kernel_part

_SECOND_NS = 1_000_000_000
_LARGE_SUM = 1e150  # from which a sum may overflow, and the rounding error of a mean has squares that do
Buckets = tuple[IntArray, IntArray, FloatArray, FloatArray, FloatArray, FloatArray]


class Rollup(NamedTuple):
    """Buckets of one channel; M2 is the sum of squares about the bucket's mean."""

    bucket: IntArray
    n: IntArray
    mean: FloatArray
    m2: FloatArray
    lo: FloatArray
    hi: FloatArray


def roll_up(t_ns: IntArray, data: CountArray | FloatArray, scale: float = 1.0, offset: float = 0.0) -> Rollup:
    """Buckets of one second, floor(t / 1 s), of the finite values.

    >>> half_seconds = np.arange(4) * 500_000_000
    >>> rollup = roll_up(half_seconds, np.array([1, 3, 5, 9], np.int32), scale=0.5)
    >>> rollup.bucket.tolist(), rollup.n.tolist(), rollup.mean.tolist(), rollup.m2.tolist()
    ([0, 1], [2, 2], [1.0, 3.5], [0.5, 2.0])
    """
    bucket, n, mean, m2, lo, hi = _buckets(t_ns, data)
    lo, hi = lo * scale + offset, hi * scale + offset
    rollup = Rollup(bucket, n, mean * scale + offset, m2 * (scale * scale), np.minimum(lo, hi), np.maximum(lo, hi))
    return rollup if np.all(np.diff(bucket) > 0) else merge(rollup)


def merge(rollup: Rollup, every: int = 1) -> Rollup:
    """Merge equal buckets, and each `every` buckets into one, by the formula of Chan, Golub and LeVeque.

    >>> seconds = roll_up(np.arange(20) * 1_000_000_000, np.arange(20.0))
    >>> tens = merge(seconds, every=10)
    >>> tens.bucket.tolist(), tens.n.tolist(), tens.mean.tolist(), tens.m2.tolist()
    ([0, 1], [10, 10], [4.5, 14.5], [82.5, 82.5])
    """
    bucket = rollup.bucket // every
    if len(bucket) == 0:
        return rollup
    if np.any(np.diff(bucket) < 0):
        order = np.argsort(bucket, kind="stable")
        bucket, rollup = bucket[order], _each(lambda column: column[order], rollup)
    return _merged(rollup, bucket, np.diff(bucket, prepend=bucket[0] - 1) != 0)


def _merged(rollup: Rollup, bucket: IntArray, is_first: BoolArray) -> Rollup:
    """Merge rows into new buckets, of which `is_first` marks the first row of each."""
    starts, of = np.flatnonzero(is_first), np.cumsum(is_first) - 1
    n = np.add.reduceat(rollup.n, starts)
    lo, hi = np.minimum.reduceat(rollup.lo, starts), np.maximum.reduceat(rollup.hi, starts)
    with np.errstate(over="ignore", invalid="ignore"):  # squares of more than 1e154 are infinite
        sums = np.add.reduceat(rollup.n * rollup.mean, starts)
        mean = np.where(np.diff(starts, append=len(bucket)) == 1, rollup.mean[starts], sums / n)
        is_large = ~(np.abs(sums) <= _LARGE_SUM)
        if is_large.any():
            shares = np.add.reduceat(rollup.mean * (rollup.n / n[of]), starts)
            mean = np.where(is_large, np.where(lo < hi, shares, lo), mean)
        m2 = np.add.reduceat(rollup.m2 + rollup.n * (rollup.mean - mean[of]) ** 2, starts)
    return Rollup(bucket[starts], n, mean, m2, lo, hi)


def _each(function: Callable[..., Any], *rollups: Rollup) -> Rollup:
    columns: list[Any] = list(map(function, *rollups))
    return Rollup(*columns)


def joined(rollups: list[Rollup]) -> Rollup:
    """Join rollups of successive stretches of one channel."""
    if len(rollups) == 1:
        return rollups[0]
    return merge(_each(lambda *columns: np.concatenate(columns), *rollups))


def rollup_tables(channels: Sequence[tuple[int, Rollup]]) -> tuple[pa.Table, pa.Table]:
    """Rows of the files of 1 s and of 10 s, from the buckets of a second of channels, each in the order of time.

    All channels at once: a segment of many short signals takes four times as long one by one.
    """
    filled = [(number, rollup) for number, rollup in channels if len(rollup.bucket)]
    if not filled:
        return ROLLUP_COLUMNS.empty_table(), ROLLUP_COLUMNS.empty_table()
    numbers, rollups = zip(*filled, strict=True)
    channel = np.repeat(np.array(numbers, np.int64), [len(each.bucket) for each in rollups])
    seconds = _each(lambda *columns: np.concatenate(columns), *rollups)
    bucket = seconds.bucket // 10
    is_first = _begins(channel) | (np.diff(bucket, prepend=bucket[0]) != 0)
    return _table(channel, seconds), _table(channel[is_first], _merged(seconds, bucket, is_first))


def _begins(channel: IntArray) -> BoolArray:
    return np.asarray(np.diff(channel, prepend=channel[0] - 1) != 0, np.bool_)


def _table(channel: IntArray, rollup: Rollup) -> pa.Table:
    """Rows of a file; an edge is the first or last row of a channel."""
    edge = _begins(channel) | _begins(channel[::-1])[::-1]
    return pa.Table.from_arrays([pa.array(column) for column in (channel, *rollup, edge)], schema=ROLLUP_COLUMNS)


def _bucket_arrays(t_ns: IntArray, data: CountArray | FloatArray) -> Buckets:
    """The buckets of `_buckets`, to the last bit: `bincount` adds in the order of the samples."""
    second = t_ns // _SECOND_NS
    is_finite = np.isfinite(data)
    starts = np.flatnonzero(np.diff(second, prepend=second[:1] - 1) != 0)
    of = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(second)))[is_finite]
    x = data[is_finite].astype(np.float64)
    n = np.bincount(of, minlength=len(starts))
    rows = np.flatnonzero(n)
    begins = np.cumsum(n[rows]) - n[rows]
    lo, hi = np.minimum.reduceat(x, begins), np.maximum.reduceat(x, begins)
    with np.errstate(all="ignore"):  # squares of more than 1e154 are infinite
        total = np.bincount(of, x, len(starts))
        middle = total / n
        is_large = ~(np.abs(total[rows]) <= _LARGE_SUM)
        if is_large.any():
            shares = np.bincount(of, x / n[of], len(starts))[rows]
            middle[rows] = np.where(is_large, np.where(lo < hi, shares, lo), middle[rows])
        squares = np.bincount(of, (x - middle[of]) ** 2, len(starts))
    return second[starts[rows]], n[rows], middle[rows], squares[rows].astype(np.float64), lo, hi


@kernel_part()
def _mean_of_shares(data: CountArray | FloatArray, first: int, end: int, n: int) -> float:
    """Mean of the `n` finite ones of some samples, whose sum may overflow."""
    middle = 0.0
    for j in range(first, end):
        x = float(data[j])
        if x - x == 0.0:
            middle += x / n
    return middle


@partial(compiled, instead=_bucket_arrays)
def _buckets(t_ns: IntArray, data: CountArray | FloatArray) -> Buckets:
    """Buckets of consecutive samples within one second; M2 takes a second pass, sums of integers are exact."""
    runs = 0
    begin_ns = np.int64(0)
    for t in t_ns:
        if runs == 0 or t < begin_ns or t - begin_ns >= _SECOND_NS:
            begin_ns = t // _SECOND_NS * _SECOND_NS
            runs += 1
    bucket, count = np.empty(runs, np.int64), np.empty(runs, np.int64)
    mean, m2 = np.empty(runs), np.empty(runs)
    lo, hi = np.empty(runs), np.empty(runs)
    row = i = 0
    while i < len(t_ns):
        second = t_ns[i] // _SECOND_NS
        begin_ns = second * _SECOND_NS
        start, n, total = i, 0, 0.0
        least, most = np.inf, -np.inf
        # the first sample always belongs, so that the loop ends; the last second of 64 bits would overflow
        while i < len(t_ns) and (i == start or (t_ns[i] >= begin_ns and t_ns[i] - begin_ns < _SECOND_NS)):
            x = float(data[i])
            if x - x == 0.0:
                n += 1
                total += x
                least = min(least, x)
                most = max(most, x)
            i += 1
        if n == 0:
            continue
        middle, squares = total / n, 0.0
        if not abs(total) <= _LARGE_SUM:
            middle = least if least == most else _mean_of_shares(data, start, i, n)
        for j in range(start, i):
            x = float(data[j])
            if x - x == 0.0:
                squares += (x - middle) ** 2
        bucket[row], count[row], mean[row], m2[row], lo[row], hi[row] = second, n, middle, squares, least, most
        row += 1
    return bucket[:row], count[:row], mean[:row], m2[:row], lo[:row], hi[:row]
