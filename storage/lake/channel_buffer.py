"""Samples of one channel, buffered from a segment's messages, and the columns of the lake that they fill."""

from array import array
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from storage.lake.channel_row import OF_FIRST
from storage.lake.clock_stretches import Messages, clock_rows
from storage.lake.rollups import Rollup, joined, roll_up
from storage.lake.tables import MESSAGE_COLUMNS, ROW_GROUP, SAMPLE_COLUMNS
from storage.log.follower import ContinuedBatch
from stream.batch import CountArray, FloatArray, IntArray, SampleBatch
from stream.identity import Place
from stream.wire.batches import RawBatch
from stream.wire.count_planes import residuals_of
from stream.wire.count_residuals import join_batches

ByteArray = npt.NDArray[np.uint8]

_FIELDS = 6  # of a message: seq, n, t0_ns, last_ns, dt_ns, arrival_ns
_BLOCK = 4096
_STRETCH = 256
_SMOOTH = 0.9
_INT32_MAX = 2**31 - 1


class Piece(NamedTuple):
    """At most a row group of samples of one channel; `data` are counts or values.

    `backward` are the steps back of time within messages: places in `Messages`, and how far (ns).
    """

    seq: IntArray
    t_ns: IntArray
    data: CountArray | FloatArray
    flags: ByteArray | None
    backward: IntArray


class ChannelBuffer:
    """Samples of one channel within a segment as its messages have them; `first` is of its first batch.

    A count takes the 1 to 4 bytes that it has on the wire, until its piece is joined.
    """

    def __init__(self, identity: int, place: Place, first: SampleBatch) -> None:
        self.identity, self.place = identity, place
        self.first = first.part(0, 1)
        self.irregular = False
        self.samples = 0
        self._messages = array("q")
        self._data: list[bytes] = []  # of each message
        self._times: dict[int, bytes] = {}  # by message
        self._flags: dict[int, bytes] = {}

    def add(self, batch: RawBatch, arrival_ns: int) -> None:
        """Add a batch."""
        message, last_ns = batch
        n, at = message.samples, len(self._data)
        self.samples += n
        data = message.values or message.count_residuals
        self._data.append(data or residuals_of(message.count_planes, message.counts, n))
        if times_ns := message.times_ns:
            self._times[at] = times_ns
        if flags := message.flags:
            self._flags[at] = flags
        self.irregular |= message.irregular
        self._messages.extend((message.seq, n, message.t0_ns, last_ns, message.dt_ns, arrival_ns))

    def add_continued(self, batch: ContinuedBatch, arrival_ns: int) -> None:
        """Add a batch that continues one that was added."""
        _, seq, next_seq, t0_ns, last_ns, *_ = batch.place
        self.samples += next_seq - seq
        self._data.append(batch.payload[batch.begin : batch.end])
        self._messages.extend((seq, next_seq - seq, t0_ns, last_ns, batch.like.message.dt_ns, arrival_ns))

    def row(self) -> dict[str, Any]:
        """Its row in the table of channels."""
        first, messages = self.first, self._matrix()
        return {name: getattr(first, name) for name in OF_FIRST} | {
            "channel": self.identity, "site": self.place.site, "station": self.place.station,
            "epoch": str(first.epoch), "is_counts": first.counts is not None, "irregular": self.irregular,
            "samples": self.samples, "seq_first": int(messages.seq.min()),
            "seq_next": int((messages.seq + messages.n).max()), "t_first_ns": int(messages.t0_ns.min()),
            "t_last_ns": int(messages.last_ns.max()), "arrival_first_ns": int(messages.arrival_ns.min()),
            "arrival_last_ns": int(messages.arrival_ns.max()), "overlapping": False,
        }  # fmt: skip

    def message_tables(self) -> Iterator[pa.Table]:
        """All samples as `MESSAGE_COLUMNS`, a row a message, in tables of at most a row group of samples."""
        messages = self._matrix()
        for begin_at, end_at in self._stretches(messages):
            rows = slice(begin_at, end_at)
            sizes = messages.n[rows]
            offsets = pa.array(np.append(0, np.cumsum(sizes)).astype(np.int32))
            data = pa.ListArray.from_arrays(offsets, pa.array(self._joined(begin_at, end_at, sizes)))
            times_ns = [self._times.get(at) for at in range(begin_at, end_at)]
            flags = [self._flags.get(at, bytes(n)) for at, n in enumerate(sizes, begin_at)] if self._flags else [None]
            numbers = (
                np.full(len(sizes), self.identity),
                messages.seq[rows],
                messages.t0_ns[rows],
                messages.dt_ns[rows],
            )
            is_counts = self.first.counts is not None
            yield pa.Table.from_arrays(
                [
                    *(pa.array(each) for each in (*numbers, sizes)),
                    data if is_counts else pa.nulls(len(sizes), MESSAGE_COLUMNS.field("counts").type),
                    pa.nulls(len(sizes), MESSAGE_COLUMNS.field("vals").type) if is_counts else data,
                    _lists(times_ns, np.int64, len(sizes)),
                    _lists(flags, np.uint8, len(sizes)),
                ],
                schema=MESSAGE_COLUMNS,
            )

    def _table(self, piece: Piece) -> pa.Table:
        """Rows of a piece."""
        n = len(piece.seq)
        columns = [pa.array(np.full(n, self.identity, np.int64)), pa.array(piece.seq), pa.array(piece.t_ns)]
        if self.first.counts is None:
            columns += [pa.nulls(n, pa.int32()), pa.nulls(n, pa.int32()), pa.array(piece.data)]
        else:
            columns += [*counts_columns(piece.data.view(np.int32)), pa.nulls(n, pa.float64())]
        columns.append(pa.nulls(n, pa.uint8()) if piece.flags is None else pa.array(piece.flags))
        return pa.Table.from_arrays(columns, schema=SAMPLE_COLUMNS)

    def seconds_and_clock(self, write: Callable[[pa.Table], None] | None = None) -> tuple[Rollup, tuple[IntArray, ...]]:
        """Its buckets of a second, and columns of its clock stretches; `write` gets the samples on the way."""
        messages = self._matrix()
        rollups: list[Rollup] = []
        count, most_ns = np.zeros((2, len(messages.seq)), np.int64)
        for begin_at, end_at in self._stretches(messages):
            piece = self._piece(messages, begin_at, end_at)
            if write is not None:
                write(self._table(piece))
            rollups.append(roll_up(piece.t_ns, piece.data, self.first.scale, self.first.offset))
            at, back_ns = piece.backward
            np.add.at(count, at, 1)
            np.maximum.at(most_ns, at, back_ns)
        return joined(rollups), clock_rows(messages, count, most_ns, irregular=self.irregular)

    def _matrix(self) -> Messages:
        return Messages(np.frombuffer(self._messages, np.int64).reshape(-1, _FIELDS))

    def _stretches(self, messages: Messages) -> Iterator[tuple[int, int]]:
        """Messages from one to another, of at most a row group of samples, or one."""
        ends = np.cumsum(messages.n)
        begin_at = 0
        while begin_at < len(ends):
            begin = int(ends[begin_at - 1]) if begin_at else 0
            end_at = max(begin_at + 1, int(np.searchsorted(ends, begin + ROW_GROUP, side="right")))
            yield begin_at, end_at
            begin_at = end_at

    def _joined(self, begin_at: int, end_at: int, sizes: IntArray) -> CountArray | FloatArray:
        data = self._data[begin_at:end_at]
        if self.first.counts is None:
            return np.frombuffer(bytearray().join(data), np.float64)  # writeable, see `stream.batch.writable`
        return join_batches(data, sizes)

    def _piece(self, messages: Messages, begin_at: int, end_at: int) -> Piece:
        sizes = messages.n[begin_at:end_at]
        starts = np.cumsum(sizes) - sizes
        n = int(sizes.sum())
        index = np.arange(n)
        dt_ns = messages.dt_ns[begin_at:end_at]
        step = dt_ns[0] if np.all(dt_ns == dt_ns[0]) else np.repeat(dt_ns, sizes)
        seq = _repeated(messages.seq[begin_at:end_at] - starts, sizes) + index
        t_ns = _repeated(messages.t0_ns[begin_at:end_at] - dt_ns * starts, sizes) + step * index
        backward = np.empty((2, 0), np.int64)
        if self._times:
            for begin, times_ns in _placed(self._times, starts, begin_at, np.int64):
                t_ns[begin : begin + len(times_ns)] = times_ns
            back = np.flatnonzero(np.diff(t_ns) <= 0) + 1
            back = back[~np.isin(back, starts)]
            where = begin_at + np.searchsorted(starts, back, side="right") - 1
            backward = np.stack([where, t_ns[back - 1] - t_ns[back]])
        flags: ByteArray | None = None
        if self._flags:
            flags = np.zeros(n, np.uint8)
            for begin, own in _placed(self._flags, starts, begin_at, np.uint8):
                flags[begin : begin + len(own)] = own
        return Piece(seq, t_ns, self._joined(begin_at, end_at, sizes), flags, backward)


def _lists(arrays: Sequence[bytes | None], kind: type[np.generic], n: int) -> pa.Array:
    """A column of `n` lists; all null if none is there."""
    of = pa.list_(pa.from_numpy_dtype(kind))
    if not any(arrays):
        return pa.nulls(n, of)
    return pa.array([None if each is None else np.frombuffer(each, kind) for each in arrays], of)


def _placed(
    arrays: dict[int, bytes], starts: IntArray, begin_at: int, kind: type[np.generic]
) -> Iterator[tuple[int, npt.NDArray[Any]]]:
    """Arrays of some messages of a piece, each with the place of its first sample."""
    for at, content in arrays.items():
        if begin_at <= at < begin_at + len(starts):
            yield int(starts[at - begin_at]), np.frombuffer(content, kind)


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


def _repeated(of_message: IntArray, sizes: IntArray) -> IntArray:
    """A message's number for each of its samples; one number where all are equal, as nearly always."""
    return of_message[:1] if np.all(of_message == of_message[0]) else np.repeat(of_message, sizes)
