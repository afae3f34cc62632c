"""A signal's samples, buffered and cut into pieces whose borders are a function of the samples alone.

The last bits of a result depend on where the pieces were cut, and a call costs as much for a hundred samples as for a
thousand. So batches are buffered, however they were cut and whenever they came, and cut again.
"""

from typing import Any, NamedTuple, Self

import msgspec
import numpy as np
import numpy.typing as npt

from stream.batch import IntArray, SampleBatch, checked_batch
from stream.wire.batches import WireBatch, epoch_of

# a call costs more than a thousand samples; longer pieces gain little and cost memory
PIECE_SAMPLES = 8192

_COUNTS, _VALUES = "<i4", "<f8"


class BufferedPiece(NamedTuple):
    """Samples that are processed together; whether documents are due after them, and the latest time in them."""

    batch: SampleBatch
    is_due: bool
    last_ns: int


class PieceBufferState(msgspec.Struct, frozen=True):
    """State of a buffer in a checkpoint."""

    name: tuple[str, str, str]
    every_ns: int
    due_ns: int
    origin: int
    next_seq: int
    next_ns: int
    t0_ns: int
    meaning: tuple[bytes, int, str, bool, float, float] | None
    dtype: str
    data: bytes
    times: bytes | None


class PieceBuffer:
    """Joins the batches of one signal of one run and cuts them into pieces.

    A piece ends before each sample whose number, counted from the epoch's first in the run, is a multiple of
    8192; before a sample of another epoch, interval, unit of measure or scale, or whose number is not the next; and
    with the first sample at or after a time when documents are due. Exact times and equal explicit times give the same
    pieces.

    Parameters
    ----------
    name: Unit, signal and run.
    every_ns: Interval of documents in the signal's own time from its first sample on, nanoseconds.

    Examples
    --------
    >>> from stream.wire.batches import encode_batch, read_wire_batch
    >>> from uuid import UUID
    >>> buffer = PieceBuffer(("FOG-1", "rate", "r1"), every_ns=30)
    >>> for seq in (0, 2, 4):
    ...     batch = SampleBatch("FOG-1", "rate", "r1", UUID(int=1), seq, 10 * seq, 10, "deg/s", values=np.zeros(2))
    ...     for piece in buffer.take(read_wire_batch(encode_batch(batch))):
    ...         print(len(piece.batch), piece.is_due, piece.last_ns)
    4 True 30
    """

    __slots__ = (
        "_border", "_data", "_dtype", "_due_ns", "_every_ns", "_is_begun", "_item_bytes", "_meaning", "_name",
        "_next_ns", "_next_seq", "_origin", "_t0_ns", "_times",
    )  # fmt: skip

    def __init__(self, name: tuple[str, str, str], every_ns: int) -> None:
        self._name = name
        self._every_ns = every_ns
        self._is_begun = False
        self._due_ns = self._origin = self._next_seq = self._border = self._next_ns = self._t0_ns = 0
        self._meaning: tuple[bytes, int, str, bool, float, float] | None = None
        self._dtype, self._item_bytes = _VALUES, 8
        self._data = bytearray()
        self._times: bytearray | None = None

    def take(self, batch: WireBatch) -> list[BufferedPiece]:
        """Take in the next batch; returns the pieces that it completes."""
        _, _, _, seq, next_seq, t0_ns, last_ns, meaning, counts, values, times_ns = batch
        # nearly every batch only continues the piece: this costs a microsecond, the general case ten
        if (
            seq == self._next_seq
            and next_seq < self._border
            and t0_ns == self._next_ns
            and last_ns < self._due_ns
            and meaning == self._meaning
            and not times_ns
            and self._times is None
            and self._data
            and (self._item_bytes == 4) is bool(counts)
        ):
            self._data += counts or values
            self._next_seq = next_seq
            self._next_ns = last_ns + meaning[1]
            return []
        return self._cut(batch)

    def rest(self) -> list[BufferedPiece]:
        """The samples after the last border as a piece; none if there are none."""
        return [self._flush(is_due=False)] if self._data else []

    def export_state(self) -> PieceBufferState:
        """The state."""
        return PieceBufferState(
            name=self._name,
            every_ns=self._every_ns,
            due_ns=self._due_ns,
            origin=self._origin,
            next_seq=self._next_seq,
            next_ns=self._next_ns,
            t0_ns=self._t0_ns,
            meaning=self._meaning,
            dtype=self._dtype,
            data=bytes(self._data),
            times=None if self._times is None else bytes(self._times),
        )

    @classmethod
    def from_state(cls, state: PieceBufferState) -> Self:
        """Resume from the state of another one."""
        buffer = cls(state.name, state.every_ns)
        buffer._is_begun = state.meaning is not None
        buffer._due_ns, buffer._origin, buffer._next_seq = state.due_ns, state.origin, state.next_seq
        buffer._next_ns, buffer._t0_ns, buffer._meaning = state.next_ns, state.t0_ns, state.meaning
        buffer._dtype, buffer._item_bytes = state.dtype, np.dtype(state.dtype).itemsize
        buffer._data = bytearray(state.data)
        buffer._times = None if state.times is None else bytearray(state.times)
        buffer._set_border()
        return buffer

    def _cut(self, batch: WireBatch) -> list[BufferedPiece]:
        pieces: list[BufferedPiece] = []
        n = batch.next_seq - batch.seq
        times = np.frombuffer(batch.times_ns, "<i8") if batch.times_ns else None
        dtype = _COUNTS if batch.counts else _VALUES
        if not self._is_begun:
            self._is_begun = True
            self._due_ns = _time_of(batch, times, 0) + self._every_ns
        if batch.meaning != self._meaning or batch.seq != self._next_seq or dtype != self._dtype:
            pieces += self.rest()
            self._begin(batch, dtype)
        at = 0
        while at < n:
            stop = min(n, at + self._border - self._next_seq)
            due = _first_at(batch, times, at, stop, self._due_ns)
            stop = stop if due is None else due + 1
            self._append(batch, times, at, stop)
            if due is not None:
                passed = (_time_of(batch, times, due) - self._due_ns) // self._every_ns + 1
                self._due_ns += passed * self._every_ns
            if due is not None or self._next_seq == self._border:
                pieces.append(self._flush(is_due=due is not None))
            at = stop
        return pieces

    def _begin(self, batch: WireBatch, dtype: str) -> None:
        if self._meaning is None or self._meaning[0] != batch.meaning[0]:
            self._origin = batch.seq
        self._meaning = batch.meaning
        self._dtype, self._item_bytes = dtype, np.dtype(dtype).itemsize
        self._next_seq = batch.seq
        self._set_border()

    def _set_border(self) -> None:
        self._border = self._next_seq + PIECE_SAMPLES - (self._next_seq - self._origin) % PIECE_SAMPLES

    def _append(self, batch: WireBatch, times: IntArray | None, start: int, stop: int) -> None:
        dt_ns = batch.meaning[1]
        first_ns = _time_of(batch, times, start)
        held = len(self._data) // self._item_bytes
        if held == 0:
            self._t0_ns = first_ns
        elif self._times is None and (times is not None or first_ns != self._next_ns):
            self._times = bytearray(_grid(self._t0_ns, dt_ns, held).tobytes())
        if self._times is not None or times is not None:
            if self._times is None:
                self._times = bytearray()
            fresh = times[start:stop] if times is not None else _grid(first_ns, dt_ns, stop - start)
            self._times += fresh.tobytes()
        item_bytes = self._item_bytes
        self._data += memoryview(batch.counts or batch.values)[start * item_bytes : stop * item_bytes]
        self._next_seq += stop - start
        self._next_ns = _time_of(batch, times, stop - 1) + dt_ns

    def _flush(self, *, is_due: bool) -> BufferedPiece:
        assert self._meaning is not None
        epoch, dt_ns, unit_of_measure, irregular, scale, offset = self._meaning
        samples: npt.NDArray[Any] = np.frombuffer(self._data, self._dtype)
        times = None if self._times is None else np.frombuffer(self._times, "<i8")
        if times is not None and np.array_equal(times, _grid(self._t0_ns, dt_ns, len(times))):
            times = None
        last_ns = self._next_ns - dt_ns if times is None else int(times.max())
        unit, signal, run = self._name
        piece = checked_batch(
            unit=unit,
            signal=signal,
            run=run,
            epoch=epoch_of(epoch),
            seq=self._next_seq - len(samples),
            t0_ns=self._t0_ns,
            dt_ns=dt_ns,
            unit_of_measure=unit_of_measure,
            counts=samples if self._dtype == _COUNTS else None,
            values=samples if self._dtype == _VALUES else None,
            times_ns=times,
            irregular=irregular,
            scale=scale,
            offset=offset,
        )
        self._data, self._times = bytearray(), None
        self._set_border()
        return BufferedPiece(piece, is_due, last_ns)


def _grid(t0_ns: int, dt_ns: int, n: int) -> IntArray:
    return t0_ns + dt_ns * np.arange(n, dtype=np.int64)


def _time_of(batch: WireBatch, times: IntArray | None, at: int) -> int:
    return batch.t0_ns + at * batch.meaning[1] if times is None else int(times[at])


def _first_at(batch: WireBatch, times: IntArray | None, start: int, stop: int, moment_ns: int) -> int | None:
    """The first of the samples start:stop at or after a time."""
    if times is not None:
        found = np.flatnonzero(times[start:stop] >= moment_ns)
        return start + int(found[0]) if len(found) else None
    at = max(start, -((batch.t0_ns - moment_ns) // batch.meaning[1]))
    return at if at < stop else None
