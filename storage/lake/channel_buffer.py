"""Samples of one channel, buffered from a segment's messages, their columns, and the stretches of its clock.

Clock stretches have the least delay of a source's messages, arrival minus source time, per minute of arrival. A delay
is at least the clock offset plus the least travel time, so that the least of a stretch is the lower envelope. A stretch
ends with the minute of the recorder's clock, and where the source's time leaps.
"""

from array import array
from collections.abc import Iterator
from typing import Any

import numpy as np
import pyarrow as pa

from storage.lake.rollups import Rollup, joined, roll_up
from storage.lake.tables import CLOCK_COLUMNS, ROW_GROUP, SAMPLE_COLUMNS
from stream.batch import BoolArray, CountArray, FloatArray, IntArray, SampleBatch
from stream.identity import Place

STRETCH_NS = 60_000_000_000
_LEAP_NS = 1_000_000
_IRREGULAR_LEAP_NS = 10_000_000_000
_FIELDS = 6  # of a message: seq, n, t0_ns, last_ns, dt_ns, arrival_ns
_OF_FIRST = ("unit", "signal", "run", "unit_of_measure", "scale", "offset", "dt_ns")
_BLOCK = 4096
_STRETCH = 256
_SMOOTH = 0.9
_INT32_MAX = 2**31 - 1


class Messages:
    """Numbers, times and arrivals of the messages of one channel in a segment, in the order of arrival."""

    def __init__(self, rows: IntArray) -> None:
        self.seq, self.n, self.t0_ns, self.last_ns, self.dt_ns, self.arrival_ns = rows.T


def leaps(messages: Messages, *, irregular: bool) -> BoolArray:
    """Whether the source's time leaps before each message: backwards, or beyond what the numbers imply."""
    step_ns = np.zeros(len(messages.seq), np.int64)
    step_ns[1:] = (
        messages.t0_ns[1:]
        - messages.last_ns[:-1]
        - messages.dt_ns[:-1] * (messages.seq[1:] - messages.seq[:-1] - messages.n[:-1] + 1)
    )
    if irregular:
        leaps_at = (step_ns > _IRREGULAR_LEAP_NS) | (step_ns <= -messages.dt_ns - _LEAP_NS)
    else:
        leaps_at = np.abs(step_ns) > messages.dt_ns // 2 + _LEAP_NS
    return np.asarray(leaps_at, np.bool_)


def clock_table(
    channel: int, messages: Messages, backward: IntArray, backward_most_ns: IntArray, *, irregular: bool
) -> pa.Table:
    """Rows of one channel's stretches; `irregular` samples are on no grid.

    `backward` and `backward_most_ns` are, per message, the number of samples not later than the one before, and the
    largest step.
    """
    delay_ns = messages.arrival_ns - messages.last_ns
    minute = messages.arrival_ns // STRETCH_NS
    begins = leaps(messages, irregular=irregular) | (np.diff(minute, prepend=minute[0] - 1) != 0)
    starts = np.flatnonzero(begins)
    ends = np.append(starts[1:], len(minute)) - 1
    least_ns = np.minimum.reduceat(delay_ns, starts)
    index = np.arange(len(minute))
    at = np.minimum.reduceat(np.where(delay_ns == least_ns[np.cumsum(begins) - 1], index, len(index)), starts)
    columns = [
        np.full(len(starts), channel, np.int64), messages.seq[starts], ends - starts + 1, messages.t0_ns[starts],
        messages.last_ns[ends], messages.arrival_ns[starts], messages.arrival_ns[ends], messages.last_ns[at],
        least_ns, np.add.reduceat(backward, starts), np.maximum.reduceat(backward_most_ns, starts),
    ]  # fmt: skip
    return pa.Table.from_arrays([pa.array(column) for column in columns], schema=CLOCK_COLUMNS)


class ChannelBuffer:
    """Samples of one channel within a segment, copied from its messages; `first` is its first batch."""

    def __init__(self, identity: int, place: Place, first: SampleBatch) -> None:
        self.identity, self.place = identity, place
        self.first = first.part(0, 1)
        self.irregular = False
        self.samples = 0
        room = 4 * len(first)
        self._data: CountArray | FloatArray = (
            np.empty(room, np.float64) if first.counts is None else np.empty(room, np.int32)
        )
        self._messages = array("q")
        self._times: list[tuple[int, IntArray]] = []
        self._flags: list[tuple[int, bytes]] = []

    def add(self, batch: SampleBatch, arrival_ns: int) -> None:
        """Add a batch."""
        data = batch.values if batch.counts is None else batch.counts
        assert data is not None
        begin, n = self.samples, len(data)
        self.samples = end = begin + n
        if end > len(self._data):
            self._data = np.concatenate([self._data[:begin], np.empty(max(begin, n), self._data.dtype)])
        self._data[begin:end] = data
        if batch.times_ns is None:
            last_ns = batch.t0_ns + (n - 1) * batch.dt_ns
        else:
            last_ns = int(batch.times_ns[-1])
            self._times.append((begin, batch.times_ns.copy()))
        if batch.flags is not None:
            self._flags.append((begin, batch.flags.tobytes()))
        self.irregular |= batch.irregular
        self._messages.extend((batch.seq, n, batch.t0_ns, last_ns, batch.dt_ns, arrival_ns))

    def row(self) -> dict[str, Any]:
        """Its row in the table of channels."""
        first, messages = self.first, self._matrix()
        return {name: getattr(first, name) for name in _OF_FIRST} | {
            "channel": self.identity, "site": self.place.site, "station": self.place.station,
            "epoch": str(first.epoch), "is_counts": first.counts is not None, "irregular": self.irregular,
            "samples": self.samples, "seq_first": int(messages.seq.min()),
            "seq_next": int((messages.seq + messages.n).max()), "t_first_ns": int(messages.t0_ns.min()),
            "t_last_ns": int(messages.last_ns.max()), "arrival_first_ns": int(messages.arrival_ns.min()),
            "arrival_last_ns": int(messages.arrival_ns.max()), "overlapping": False,
        }  # fmt: skip

    def tables(self) -> Iterator[tuple[pa.Table, Rollup, IntArray]]:
        """Pieces of at most a row group: rows, 1 s buckets, steps back of time as places in `Messages` and how far."""
        messages = self._matrix()
        ends = np.cumsum(messages.n)
        begin_at = 0
        while begin_at < len(ends):
            begin = int(ends[begin_at - 1]) if begin_at else 0
            end_at = max(begin_at + 1, int(np.searchsorted(ends, begin + ROW_GROUP, side="right")))
            yield self._piece(messages, ends, begin_at, end_at)
            begin_at = end_at

    def rollup_and_clock(self, rollups: list[Rollup], backward: list[IntArray]) -> tuple[Rollup, pa.Table]:
        """1 s buckets and clock stretches of the channel, from its pieces."""
        messages = self._matrix()
        count, most_ns = np.zeros((2, len(messages.seq)), np.int64)
        for at, back_ns in backward:
            np.add.at(count, at, 1)
            np.maximum.at(most_ns, at, back_ns)
        return joined(rollups), clock_table(self.identity, messages, count, most_ns, irregular=self.irregular)

    def _matrix(self) -> Messages:
        return Messages(np.frombuffer(self._messages, np.int64).reshape(-1, _FIELDS))

    def _piece(
        self, messages: Messages, ends: IntArray, begin_at: int, end_at: int
    ) -> tuple[pa.Table, Rollup, IntArray]:
        sizes = messages.n[begin_at:end_at]
        starts = ends[begin_at:end_at] - sizes
        begin, end = int(starts[0]), int(ends[end_at - 1])
        index = np.arange(end - begin)
        from_start = starts - begin
        dt_ns = messages.dt_ns[begin_at:end_at]
        step = dt_ns[0] if np.all(dt_ns == dt_ns[0]) else np.repeat(dt_ns, sizes)
        seq = _repeated(messages.seq[begin_at:end_at] - from_start, sizes) + index
        t_ns = _repeated(messages.t0_ns[begin_at:end_at] - dt_ns * from_start, sizes) + step * index
        backward = np.empty((2, 0), np.int64)
        if self._times:
            for at, times_ns in self._times:
                if begin <= at < end:
                    t_ns[at - begin : at - begin + len(times_ns)] = times_ns
            back = np.flatnonzero(np.diff(t_ns) <= 0) + 1
            back = back[~np.isin(back, from_start)]
            where = begin_at + np.searchsorted(from_start, back, side="right") - 1
            backward = np.stack([where, t_ns[back - 1] - t_ns[back]])
        data = self._data[begin:end]
        n = end - begin
        columns = [pa.array(np.full(n, self.identity, np.int64)), pa.array(seq), pa.array(t_ns)]
        if self.first.counts is None:
            columns += [pa.nulls(n, pa.int32()), pa.nulls(n, pa.int32()), pa.array(data)]
        else:
            columns += [*counts_columns(data.view(np.int32)), pa.nulls(n, pa.float64())]
        columns.append(self._flag_column(begin, end))
        table = pa.Table.from_arrays(columns, schema=SAMPLE_COLUMNS)
        return table, roll_up(t_ns, data, self.first.scale, self.first.offset), backward

    def _flag_column(self, begin: int, end: int) -> pa.Array:
        if not self._flags:
            return pa.nulls(end - begin, pa.uint8())
        flags = np.zeros(end - begin, np.uint8)
        for at, data in self._flags:
            if begin <= at < end:
                flags[at - begin : at - begin + len(data)] = np.frombuffer(data, np.uint8)
        return pa.array(flags)


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
