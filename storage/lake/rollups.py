"""Rollups: count, mean, M2, minimum and maximum of each second and each ten seconds of the source's clock."""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from storage.lake.tables import ROLLUP_COLUMNS
from stream.batch import BoolArray, CountArray, FloatArray, IntArray
from stream.compiled import compiled, kernel_part

_SECOND_NS = 1_000_000_000
_LARGE_SUM = 1e150  # from which a sum may overflow, and the rounding error of a mean has squares that do
Buckets = tuple[IntArray, IntArray, FloatArray, FloatArray, FloatArray, FloatArray, IntArray]
_FROM_FIRST = np.zeros(1, np.int64)


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
    return roll_up_channels(t_ns, data, _FROM_FIRST, np.array([scale]), np.array([offset]))[1]


def roll_up_channels(
    t_ns: IntArray, data: CountArray | FloatArray, begins: IntArray, scales: FloatArray, offsets: FloatArray
) -> tuple[IntArray, Rollup]:
    """Buckets of the samples of several channels, one after another; `begins` is where each begins.

    Returns the place of its channel for each bucket, and the buckets: those of `roll_up` of each channel.

    >>> of, rollup = roll_up_channels(np.zeros(3, np.int64), np.array([1.0, 3.0, 5.0]), np.array([0, 2]),
    ...                               np.array([1.0, 2.0]), np.zeros(2))
    >>> of.tolist(), rollup.mean.tolist()
    ([0, 1], [2.0, 10.0])
    """
    bucket, n, mean, m2, lo, hi, of = _buckets(t_ns, data, begins)
    scale, offset = (float(scales[0]), float(offsets[0])) if len(begins) == 1 else (scales[of], offsets[of])
    lo, hi = lo * scale + offset, hi * scale + offset
    rollup = Rollup(bucket, n, mean * scale + offset, m2 * (scale * scale), np.minimum(lo, hi), np.maximum(lo, hi))
    is_next = bucket[1:] > bucket[:-1]
    if len(begins) > 1:
        is_next |= of[1:] != of[:-1]
    if np.all(is_next):
        return of, rollup
    edges = np.searchsorted(of, np.arange(len(begins) + 1))
    each = [merge(_part(rollup, begin, end)) for begin, end in pairwise(edges.tolist())]
    whole = _each(lambda *columns: np.concatenate(columns), *each)
    return np.repeat(np.arange(len(begins)), [len(own.bucket) for own in each]), whole


def _part(rollup: Rollup, begin: int, end: int) -> Rollup:
    return _each(lambda column: column[begin:end], rollup)


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


def rollup_tables(channels: Iterable[tuple[int | IntArray, Rollup]]) -> tuple[pa.Table, pa.Table]:
    """Rows of the files of 1 s and of 10 s, from the buckets of a second of channels, each in the order of time.

    Of several channels in one rollup there is the number of each bucket. All channels at once: a segment of many short
    signals takes four times as long one by one.
    """
    filled = [(number, rollup) for number, rollup in channels if len(rollup.bucket)]
    if not filled:
        return ROLLUP_COLUMNS.empty_table(), ROLLUP_COLUMNS.empty_table()
    numbers, rollups = zip(*filled, strict=True)
    channel = of_rows(numbers, [len(each.bucket) for each in rollups])
    seconds = _each(lambda *columns: np.concatenate(columns), *rollups)
    bucket = seconds.bucket // 10
    is_first = _begins(channel) | (np.diff(bucket, prepend=bucket[0]) != 0)
    of_seconds = _table(channel, seconds)
    if is_first.all():  # slower signals: each second is its ten seconds
        place = ROLLUP_COLUMNS.get_field_index("bucket")
        return of_seconds, of_seconds.set_column(place, ROLLUP_COLUMNS.field(place), pa.array(bucket))
    return of_seconds, _table(channel[is_first], _merged(seconds, bucket, is_first))


def of_rows(numbers: Sequence[int | IntArray], rows: Sequence[int]) -> IntArray:
    """A column of channels, from the number of each stretch of rows or those of its rows."""
    return np.concatenate([np.broadcast_to(number, n) for number, n in zip(numbers, rows, strict=True)])


def _begins(channel: IntArray) -> BoolArray:
    return np.asarray(np.diff(channel, prepend=channel[0] - 1) != 0, np.bool_)


def _table(channel: IntArray, rollup: Rollup) -> pa.Table:
    """Rows of a file; an edge is the first or last row of a channel."""
    edge = _begins(channel) | _begins(channel[::-1])[::-1]
    return pa.Table.from_arrays([pa.array(column) for column in (channel, *rollup, edge)], schema=ROLLUP_COLUMNS)


def _bucket_arrays(t_ns: IntArray, data: CountArray | FloatArray, begins: IntArray) -> Buckets:
    """The buckets of `_buckets`, to the last bit: `bincount` adds in the order of the samples."""
    second = t_ns // _SECOND_NS
    is_finite = np.isfinite(data)
    is_start = np.diff(second, prepend=second[:1] - 1) != 0
    is_start[begins[begins < len(second)]] = True
    starts = np.flatnonzero(is_start)
    of = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(second)))[is_finite]
    x = data[is_finite].astype(np.float64)
    n = np.bincount(of, minlength=len(starts))
    rows = np.flatnonzero(n)
    firsts = np.cumsum(n[rows]) - n[rows]
    lo, hi = np.minimum.reduceat(x, firsts), np.maximum.reduceat(x, firsts)
    with np.errstate(all="ignore"):  # squares of more than 1e154 are infinite
        total = np.bincount(of, x, len(starts))
        middle = total / n
        is_large = ~(np.abs(total[rows]) <= _LARGE_SUM)
        if is_large.any():
            shares = np.bincount(of, x / n[of], len(starts))[rows]
            middle[rows] = np.where(is_large, np.where(lo < hi, shares, lo), middle[rows])
        squares = np.bincount(of, (x - middle[of]) ** 2, len(starts))
    channel = np.searchsorted(begins, starts[rows], side="right") - 1
    return second[starts[rows]], n[rows], middle[rows], squares[rows].astype(np.float64), lo, hi, channel


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
def _buckets(t_ns: IntArray, data: CountArray | FloatArray, begins: IntArray) -> Buckets:
    """Buckets of consecutive samples of one channel within one second, and the place of each one's channel.

    M2 takes a second pass, sums of integers are exact. Channels begin at `begins`, the first of them 0.
    """
    runs = len(begins)
    begin_ns = np.int64(0)
    for at, t in enumerate(t_ns):
        if at == 0 or t < begin_ns or t - begin_ns >= _SECOND_NS:
            begin_ns = t // _SECOND_NS * _SECOND_NS
            runs += 1
    bucket, count, channel = np.empty(runs, np.int64), np.empty(runs, np.int64), np.empty(runs, np.int64)
    mean, m2 = np.empty(runs), np.empty(runs)
    lo, hi = np.empty(runs), np.empty(runs)
    row = i = of = 0
    while i < len(t_ns):
        while of + 1 < len(begins) and i >= begins[of + 1]:
            of += 1
        end = begins[of + 1] if of + 1 < len(begins) else len(t_ns)
        second = t_ns[i] // _SECOND_NS
        begin_ns = second * _SECOND_NS
        start, n, total = i, 0, 0.0
        least, most = np.inf, -np.inf
        # the first sample always belongs, so that the loop ends; the last second of 64 bits would overflow
        while i < end and (i == start or (t_ns[i] >= begin_ns and t_ns[i] - begin_ns < _SECOND_NS)):
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
        bucket[row], count[row], channel[row] = second, n, of
        mean[row], m2[row], lo[row], hi[row] = middle, squares, least, most
        row += 1
    return bucket[:row], count[:row], mean[:row], m2[:row], lo[:row], hi[:row], channel[:row]
