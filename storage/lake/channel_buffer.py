"""A channel of a segment: its samples, buffered from the messages, or its row alone, counted from them."""

from array import array
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from storage.lake.clock_stretches import Messages
from storage.lake.tables import MESSAGE_COLUMNS, ROW_GROUP
from storage.log.follower import ContinuedBatch
from stream.batch import CountArray, FloatArray, IntArray, SampleBatch
from stream.identity import Place
from stream.wire.batches import RawBatch
from stream.wire.count_planes import residuals_of
from stream.wire.count_residuals import join_batches

ByteArray = npt.NDArray[np.uint8]

OF_FIRST = ("unit", "signal", "run", "unit_of_measure", "scale", "offset", "dt_ns")
_FIELDS = 6  # of a message: seq, n, t0_ns, last_ns, dt_ns, arrival_ns


class ChannelRow:
    """Counts the messages of a channel without keeping them; `first` is its first batch, already decoded."""

    __slots__ = ("_about", "_arrival_ns", "_irregular", "_samples", "_seq", "_t_ns")

    def __init__(self, identity: int, place: Place, first: SampleBatch) -> None:
        self._about: dict[str, Any] = {name: getattr(first, name) for name in OF_FIRST} | {
            "channel": identity, "site": place.site, "station": place.station, "epoch": str(first.epoch),
            "is_counts": first.counts is not None, "overlapping": False,
        }  # fmt: skip
        self._irregular, self._samples = False, 0
        self._seq: tuple[int, int] | None = None  # of the first sample, and after the last one
        self._t_ns = self._arrival_ns = (0, 0)  # first and last

    def add(self, batch: RawBatch, arrival_ns: int) -> None:
        """Count a message."""
        message, last_ns = batch
        self._irregular |= message.irregular
        self.add_regular(message.seq, message.seq + message.samples, message.t0_ns, last_ns, arrival_ns)

    def add_regular(self, seq: int, next_seq: int, t0_ns: int, last_ns: int, arrival_ns: int) -> None:
        """Count a message at the channel's interval, by its numbers and the times of its first and last sample."""
        self._samples += next_seq - seq
        if self._seq is None:
            self._seq, self._t_ns, self._arrival_ns = (seq, next_seq), (t0_ns, last_ns), (arrival_ns, arrival_ns)
            return
        self._seq = min(self._seq[0], seq), max(self._seq[1], next_seq)
        self._t_ns = min(self._t_ns[0], t0_ns), max(self._t_ns[1], last_ns)
        self._arrival_ns = min(self._arrival_ns[0], arrival_ns), max(self._arrival_ns[1], arrival_ns)

    def row(self) -> dict[str, Any]:
        """Its row in the table of channels."""
        assert self._seq is not None
        return self._about | {
            "irregular": self._irregular, "samples": self._samples, "seq_first": self._seq[0],
            "seq_next": self._seq[1], "t_first_ns": self._t_ns[0], "t_last_ns": self._t_ns[1],
            "arrival_first_ns": self._arrival_ns[0], "arrival_last_ns": self._arrival_ns[1],
        }  # fmt: skip


class ChannelBuffer:
    """Samples of one channel within a segment as its messages have them; `first` is of its first batch.

    A count takes the 1 to 4 bytes that it has on the wire, until its piece is joined.
    """

    def __init__(self, identity: int, place: Place, first: SampleBatch) -> None:
        self.identity, self.place = identity, place
        self.first = first.part(0, 1)
        self.irregular = False
        self.samples = 0
        self.is_counts = first.counts is not None
        self._messages = array("q")
        self.data: list[bytes] = []  # of each message
        self.times: dict[int, bytes] = {}  # by message
        self.flags: dict[int, bytes] = {}

    @property
    def messages(self) -> Messages:
        """Its messages so far."""
        return Messages(np.frombuffer(self._messages, np.int64).reshape(-1, _FIELDS))

    def add(self, batch: RawBatch, arrival_ns: int) -> None:
        """Add a batch."""
        message, last_ns = batch
        n, at = message.samples, len(self.data)
        self.samples += n
        data = message.values or message.count_residuals
        self.data.append(data or residuals_of(message.count_planes, message.counts, n))
        if times_ns := message.times_ns:
            self.times[at] = times_ns
        if flags := message.flags:
            self.flags[at] = flags
        self.irregular |= message.irregular
        self._messages.extend((message.seq, n, message.t0_ns, last_ns, message.dt_ns, arrival_ns))

    def add_continued(self, batch: ContinuedBatch, arrival_ns: int) -> None:
        """Add a batch that continues one that was added."""
        _, seq, next_seq, t0_ns, last_ns, *_ = batch.place
        self.samples += next_seq - seq
        self.data.append(batch.payload[batch.begin : batch.end])
        self._messages.extend((seq, next_seq - seq, t0_ns, last_ns, batch.like.message.dt_ns, arrival_ns))

    def row(self) -> dict[str, Any]:
        """Its row in the table of channels."""
        first, messages = self.first, self.messages
        seq_first, _, t_first_ns, _, _, arrival_first_ns = messages.rows.min(axis=0).tolist()
        _, _, _, t_last_ns, _, arrival_last_ns = messages.rows.max(axis=0).tolist()
        return {name: getattr(first, name) for name in OF_FIRST} | {
            "channel": self.identity, "site": self.place.site, "station": self.place.station,
            "epoch": str(first.epoch), "is_counts": self.is_counts, "irregular": self.irregular,
            "samples": self.samples, "seq_first": seq_first, "seq_next": int((messages.seq + messages.n).max()),
            "t_first_ns": t_first_ns, "t_last_ns": t_last_ns, "arrival_first_ns": arrival_first_ns,
            "arrival_last_ns": arrival_last_ns, "overlapping": False,
        }  # fmt: skip

    def message_tables(self) -> Iterator[pa.Table]:
        """All samples as `MESSAGE_COLUMNS`, a row a message, in tables of at most a row group of samples."""
        messages = self.messages
        for begin_at, end_at in stretches(messages):
            rows = slice(begin_at, end_at)
            sizes = messages.n[rows]
            offsets = pa.array(np.append(0, np.cumsum(sizes)).astype(np.int32))
            samples = join_samples(self.data[rows], sizes, is_counts=self.is_counts)
            data = pa.ListArray.from_arrays(offsets, pa.array(samples))
            times_ns = [self.times.get(at) for at in range(begin_at, end_at)]
            flags = [self.flags.get(at, bytes(n)) for at, n in enumerate(sizes, begin_at)] if self.flags else [None]
            numbers = (
                np.full(len(sizes), self.identity),
                messages.seq[rows],
                messages.t0_ns[rows],
                messages.dt_ns[rows],
            )
            yield pa.Table.from_arrays(
                [
                    *(pa.array(each) for each in (*numbers, sizes)),
                    data if self.is_counts else pa.nulls(len(sizes), MESSAGE_COLUMNS.field("counts").type),
                    pa.nulls(len(sizes), MESSAGE_COLUMNS.field("vals").type) if self.is_counts else data,
                    _lists(times_ns, np.int64, len(sizes)),
                    _lists(flags, np.uint8, len(sizes)),
                ],
                schema=MESSAGE_COLUMNS,
            )


def stretches(messages: Messages) -> Iterator[tuple[int, int]]:
    """Messages from one to another, of at most a row group of samples, or one."""
    ends = np.cumsum(messages.n)
    begin_at = 0
    while begin_at < len(ends):
        begin = int(ends[begin_at - 1]) if begin_at else 0
        end_at = max(begin_at + 1, int(np.searchsorted(ends, begin + ROW_GROUP, side="right")))
        yield begin_at, end_at
        begin_at = end_at


def join_samples(data: Sequence[bytes], sizes: IntArray, *, is_counts: bool) -> CountArray | FloatArray:
    """Counts or values of messages."""
    if is_counts:
        return join_batches(data, sizes)
    return np.frombuffer(bytearray().join(data), np.float64)  # writeable, see `stream.batch.writable`


def _lists(arrays: Sequence[bytes | None], kind: type[np.generic], n: int) -> pa.Array:
    """A column of `n` lists; all null if none is there."""
    of = pa.list_(pa.from_numpy_dtype(kind))
    if not any(arrays):
        return pa.nulls(n, of)
    return pa.array([None if each is None else np.frombuffer(each, kind) for each in arrays], of)
