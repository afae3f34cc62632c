"""Rows of the lake from buffered channels: samples, buckets of a second, stretches of clocks.

Small channels are read together: each operation on arrays takes some microseconds, as much as hundreds of samples do.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from storage.lake.channel_buffer import ByteArray, ChannelBuffer, join_samples, stretches
from storage.lake.clock_stretches import Messages, clock_rows
from storage.lake.rollups import Rollup, joined, roll_up_channels
from storage.lake.tables import SAMPLE_COLUMNS, SHARED_ROWS, SMALL_ROWS
from stream.batch import CountArray, FloatArray, IntArray

_BLOCK = 4096
_STRETCH = 256
_SMOOTH = 0.9
_INT32_MAX = 2**31 - 1


class BufferedRows(NamedTuple):
    """Buckets of a second and clock stretches of some channels, each with the numbers of their channels."""

    seconds: tuple[IntArray, Rollup]
    clocks: tuple[IntArray, tuple[IntArray, ...]]


class Piece(NamedTuple):
    """Samples of some channels, one after another; `data` are counts or values.

    `begins` is where each channel begins. `backward` are the steps back of time within messages: places in `Messages`,
    and how far (ns).
    """

    begins: IntArray
    seq: IntArray
    t_ns: IntArray
    data: CountArray | FloatArray
    flags: ByteArray | None
    backward: IntArray


def together(channels: Iterable[ChannelBuffer]) -> Iterator[list[ChannelBuffer]]:
    """Channels to read at once: a large one alone, small ones until they fill a row group."""
    small: list[ChannelBuffer] = []
    samples = 0
    for channel in channels:
        is_large = channel.samples >= SMALL_ROWS
        if small and (is_large or samples >= SHARED_ROWS):
            yield small
            small, samples = [], 0
        if is_large:
            yield [channel]
        else:
            small.append(channel)
            samples += channel.samples
    if small:
        yield small


def buffered_rows(channels: Sequence[ChannelBuffer], write: Callable[[pa.Table], None] | None = None) -> BufferedRows:
    """Rows of channels that `together` gives; `write` gets the samples on the way."""
    kinds: dict[tuple[bool, bool], list[ChannelBuffer]] = {}
    for each in channels:
        kinds.setdefault((each.is_counts, bool(each.flags)), []).append(each)
    if len(kinds) == 1:
        return _Buffers(channels).rows(write)
    tables: list[pa.Table] = []
    found = [_Buffers(own).rows(None if write is None else tables.append) for own in kinds.values()]
    if write is not None:
        table = pa.concat_tables(tables).combine_chunks()
        write(table.take(pa.array(np.argsort(table.column("channel").to_numpy(), kind="stable"))))
    number, *seconds = _by_channel([(each.seconds[0], *each.seconds[1]) for each in found])
    of, *clocks = _by_channel([(each.clocks[0], *each.clocks[1]) for each in found])
    return BufferedRows((number, Rollup(*seconds)), (of, tuple(clocks)))


def _by_channel(parts: Sequence[Sequence[npt.NDArray[Any]]]) -> list[npt.NDArray[Any]]:
    """Columns of several parts in the order of the first, which are the numbers of channels."""
    columns = [np.concatenate(each) for each in zip(*parts, strict=True)]
    order = np.argsort(columns[0], kind="stable")
    return [column[order] for column in columns]


class _Buffers:
    """Channels of one kind as one: of values or of counts, with or without flags."""

    def __init__(self, channels: Sequence[ChannelBuffer]) -> None:
        self._is_counts = channels[0].is_counts
        self._messages = Messages(np.concatenate([each.messages.rows for each in channels]))
        sizes = np.array([len(each.data) for each in channels])
        self._begins = np.cumsum(sizes) - sizes  # of each channel its first message
        self._of = np.repeat(np.arange(len(channels)), sizes)
        self._numbers = np.array([each.identity for each in channels])
        self._scales = np.array([each.first.scale for each in channels])
        self._offsets = np.array([each.first.offset for each in channels])
        self._irregular = np.array([each.irregular for each in channels])[self._of]
        self._data = list(chain.from_iterable(each.data for each in channels))
        placed = list(zip(self._begins.tolist(), channels, strict=True))
        self._times = {begin + at: own for begin, each in placed for at, own in each.times.items()}
        self._flags = {begin + at: own for begin, each in placed for at, own in each.flags.items()}

    def rows(self, write: Callable[[pa.Table], None] | None) -> BufferedRows:
        """Their rows; `write` gets the samples on the way."""
        messages = self._messages
        seconds: list[tuple[IntArray, Rollup]] = []
        count, most_ns = np.zeros((2, len(messages.seq)), np.int64)
        for begin_at, end_at in stretches(messages):
            piece = self._piece(begin_at, end_at)
            which = np.unique(self._of[begin_at:end_at])
            if write is not None:
                write(self._table(piece, which))
            scales, offsets = self._scales[which], self._offsets[which]
            of, rollup = roll_up_channels(piece.t_ns, piece.data, piece.begins, scales, offsets)
            seconds.append((self._numbers[which[of]], rollup))
            at, back_ns = piece.backward
            np.add.at(count, at, 1)
            np.maximum.at(most_ns, at, back_ns)
        of, clocks = clock_rows(messages, count, most_ns, self._begins, self._irregular)
        return BufferedRows(_one_after_another(seconds), (self._numbers[of], clocks))

    def _piece(self, begin_at: int, end_at: int) -> Piece:
        messages = Messages(self._messages.rows[begin_at:end_at])
        sizes, dt_ns = messages.n, messages.dt_ns
        starts = np.cumsum(sizes) - sizes
        n = int(sizes.sum())
        index = np.arange(n)
        step = dt_ns[0] if np.all(dt_ns == dt_ns[0]) else np.repeat(dt_ns, sizes)
        seq = _repeated(messages.seq - starts, sizes) + index
        t_ns = _repeated(messages.t0_ns - dt_ns * starts, sizes) + step * index
        backward = np.empty((2, 0), np.int64)
        if self._times:
            for begin, times_ns in _placed(self._times, starts, begin_at, np.int64):
                t_ns[begin : begin + len(times_ns)] = times_ns
            back = np.flatnonzero(t_ns[1:] <= t_ns[:-1]) + 1
            back = back[~np.isin(back, starts)]
            where = begin_at + np.searchsorted(starts, back, side="right") - 1
            backward = np.stack([where, t_ns[back - 1] - t_ns[back]])
        flags: ByteArray | None = None
        if self._flags:
            flags = np.zeros(n, np.uint8)
            for begin, own in _placed(self._flags, starts, begin_at, np.uint8):
                flags[begin : begin + len(own)] = own
        of = self._of[begin_at:end_at]
        begins = starts[np.flatnonzero(np.diff(of, prepend=of[0] - 1))]
        data = join_samples(self._data[begin_at:end_at], sizes, is_counts=self._is_counts)
        return Piece(begins, seq, t_ns, data, flags, backward)

    def _table(self, piece: Piece, which: IntArray) -> pa.Table:
        """Rows of a piece."""
        n = len(piece.seq)
        channel = np.repeat(self._numbers[which], np.diff(piece.begins, append=n))
        columns = [pa.array(channel), pa.array(piece.seq), pa.array(piece.t_ns)]
        if self._is_counts:
            each = np.split(piece.data.view(np.int32), piece.begins[1:])
            columns += [pa.concat_arrays(of) for of in zip(*map(counts_columns, each), strict=True)]
            columns.append(pa.nulls(n, pa.float64()))
        else:
            columns += [pa.nulls(n, pa.int32()), pa.nulls(n, pa.int32()), pa.array(piece.data)]
        columns.append(pa.nulls(n, pa.uint8()) if piece.flags is None else pa.array(piece.flags))
        return pa.Table.from_arrays(columns, schema=SAMPLE_COLUMNS)


def _one_after_another(seconds: list[tuple[IntArray, Rollup]]) -> tuple[IntArray, Rollup]:
    """Buckets of one piece, or of all pieces of one channel."""
    if len(seconds) == 1:
        return seconds[0]
    rollup = joined([each for _, each in seconds])
    return np.repeat(np.concatenate([number[:1] for number, _ in seconds])[:1], len(rollup.bucket)), rollup


def _placed(
    arrays: dict[int, bytes], starts: IntArray, begin_at: int, kind: type[np.generic]
) -> Iterator[tuple[int, npt.NDArray[Any]]]:
    """Arrays of some messages of a piece, each with the place of its first sample."""
    for at, content in arrays.items():
        if begin_at <= at < begin_at + len(starts):
            yield int(starts[at - begin_at]), np.frombuffer(content, kind)


def _repeated(of_message: IntArray, sizes: IntArray) -> IntArray:
    """A message's number for each of its samples; one number where all are equal, as nearly always."""
    return of_message[:1] if np.all(of_message == of_message[0]) else np.repeat(of_message, sizes)


def counts_columns(counts: CountArray) -> list[pa.Array]:
    """Columns base and above, whose sum the counts are.

    Noise is smallest as offsets from a base of its block, split into bytes, nearly all below 256. A smooth ramp is
    smallest as a base of its own for each sample, stored as differences.
    """
    n = len(counts)
    starts = np.arange(0, n, _BLOCK)
    sizes = np.diff(starts, append=n)
    base = np.add.reduceat(counts, starts, dtype=np.int64) // sizes - 128
    spread = int(counts.max()) - int(counts.min()) + 128
    if spread > _INT32_MAX or base.min() < -_INT32_MAX or _is_smooth(counts):
        return [pa.array(counts), pa.array(np.zeros(n, np.int32))]
    bases = np.repeat(base.astype(np.int32), sizes)
    return [pa.array(bases), pa.array(counts - bases)]


def _is_smooth(counts: CountArray) -> bool:
    """Whether neighbours differ less than distant samples, judged by four stretches."""
    begins = np.linspace(0, max(0, len(counts) - _STRETCH), 4).astype(np.int64)
    spread = steps = 0.0
    for begin in begins.tolist():
        stretch = counts[begin : begin + _STRETCH].astype(np.float64)
        spread += float(np.std(stretch))
        steps += float(np.std(stretch[1:] - stretch[:-1])) if len(stretch) > 1 else 0.0
    return steps < _SMOOTH * spread
