"""A signal's samples, buffered and cut into pieces whose borders are a function of the samples alone.

The last bits of a result depend on where the pieces were cut, and a call costs as much for a hundred samples as for a
thousand. So batches are buffered, however they were cut and whenever they came, and cut again.
"""

from typing import Any, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from stream.batch import IntArray, SampleBatch, checked_batch
from stream.wire.batches import WireBatch, epoch_of

# a call costs more than a thousand samples; longer pieces gain little and cost memory
PIECE_SAMPLES = 8192

_COUNTS, _VALUES = "<i4", "<f8"
_COUNT_BYTES = 4


class BufferedPiece(NamedTuple):
    """Samples that are processed together; whether documents are due after them, and the latest time in them."""

    batch: SampleBatch
    is_due: bool
    last_ns: int


class PieceBuffer(msgspec.Struct, dict=True):
    """Joins the batches of one signal of one run and cuts them into pieces; stored as it is in a checkpoint.

    A piece ends before each sample whose number, counted from the epoch's first in the run, is a multiple of
    8192; before a sample of another epoch, interval, unit of measure or scale, or whose number is not the next; and
    with the first sample at or after a time when documents are due. Exact times and equal explicit times give the same
    pieces.

    `name` is unit, signal and run; documents are due every `every_ns` of the signal's own time from its first sample
    on.
    """

    name: tuple[str, str, str]
    every_ns: int
    due_ns: int = 0
    origin: int = 0
    next_seq: int = 0
    next_ns: int = 0
    t0_ns: int = 0
    meaning: tuple[bytes, int, str, bool, float, float] | None = None
    dtype: str = _VALUES
    data: bytearray = msgspec.field(default_factory=bytearray)
    times: bytearray | None = None

    def __post_init__(self) -> None:
        """Derive the item size and the next border."""
        self._item_bytes = np.dtype(self.dtype).itemsize
        self._set_border()

    def take(self, batch: WireBatch) -> list[BufferedPiece]:
        """Take in the next batch; returns the pieces that it completes."""
        _, _, _, seq, next_seq, t0_ns, last_ns, meaning, counts, values, times_ns = batch
        # nearly every batch only continues the piece: this costs a microsecond, the general case ten
        if (
            seq == self.next_seq
            and next_seq < self._border
            and t0_ns == self.next_ns
            and last_ns < self.due_ns
            and meaning == self.meaning
            and not times_ns
            and self.times is None
            and self.data
            and (self._item_bytes == 4) is bool(counts)
        ):
            self.data += counts or values
            self.next_seq = next_seq
            self.next_ns = last_ns + meaning[1]
            return []
        return self._cut(batch)

    @property
    def border(self) -> int:
        """Number before which the piece ends."""
        return self._border

    @property
    def interval_ns(self) -> int:
        """Nominal interval of the samples, 0 before the first."""
        return 0 if self.meaning is None else self.meaning[1]

    @property
    def is_plain(self) -> bool:
        """Whether exact continuations can be appended as they are: it holds counts on a grid."""
        is_regular = self.meaning is not None and not self.meaning[3]
        return is_regular and self.times is None and self._item_bytes == _COUNT_BYTES

    def append(self, counts: memoryview, next_seq: int, next_ns: int) -> None:
        """Append counts that continue a plain piece exactly and end before its border and the time that is due."""
        if not self.data:
            self.t0_ns = self.next_ns
        self.data += counts
        self.next_seq = next_seq
        self.next_ns = next_ns

    def continuation(self, counts: bytes) -> WireBatch:
        """The batch of counts that continue a plain piece exactly."""
        assert self.meaning is not None
        n = len(counts) // _COUNT_BYTES
        last_ns = self.next_ns + (n - 1) * self.meaning[1]
        ends = self.next_seq, self.next_seq + n, self.next_ns, last_ns
        unit, signal, run = self.name
        return WireBatch(unit, signal, run, *ends, self.meaning, counts, b"", b"")

    def rest(self) -> list[BufferedPiece]:
        """The samples after the last border as a piece; none if there are none."""
        return [self._flush(is_due=False)] if self.data else []

    def _cut(self, batch: WireBatch) -> list[BufferedPiece]:
        pieces: list[BufferedPiece] = []
        n = batch.next_seq - batch.seq
        times = np.frombuffer(batch.times_ns, "<i8") if batch.times_ns else None
        dtype = _COUNTS if batch.counts else _VALUES
        if self.meaning is None:
            self.due_ns = _time_of(batch, times, 0) + self.every_ns
        if batch.meaning != self.meaning or batch.seq != self.next_seq or dtype != self.dtype:
            pieces += self.rest()
            self._begin(batch, dtype)
        at = 0
        while at < n:
            stop = min(n, at + self._border - self.next_seq)
            due = _first_at(batch, times, at, stop, self.due_ns)
            stop = stop if due is None else due + 1
            self._append(batch, times, at, stop)
            if due is not None:
                passed = (_time_of(batch, times, due) - self.due_ns) // self.every_ns + 1
                self.due_ns += passed * self.every_ns
            if due is not None or self.next_seq == self._border:
                pieces.append(self._flush(is_due=due is not None))
            at = stop
        return pieces

    def _begin(self, batch: WireBatch, dtype: str) -> None:
        if self.meaning is None or self.meaning[0] != batch.meaning[0]:
            self.origin = batch.seq
        self.meaning = batch.meaning
        self.dtype, self._item_bytes = dtype, np.dtype(dtype).itemsize
        self.next_seq = batch.seq
        self._set_border()

    def _set_border(self) -> None:
        self._border = self.next_seq + PIECE_SAMPLES - (self.next_seq - self.origin) % PIECE_SAMPLES

    def _append(self, batch: WireBatch, times: IntArray | None, start: int, stop: int) -> None:
        dt_ns = batch.meaning[1]
        first_ns = _time_of(batch, times, start)
        held = len(self.data) // self._item_bytes
        if held == 0:
            self.t0_ns = first_ns
        elif self.times is None and (times is not None or first_ns != self.next_ns):
            self.times = bytearray(_grid(self.t0_ns, dt_ns, held).tobytes())
        if self.times is not None or times is not None:
            if self.times is None:
                self.times = bytearray()
            fresh = times[start:stop] if times is not None else _grid(first_ns, dt_ns, stop - start)
            self.times += fresh.tobytes()
        item_bytes = self._item_bytes
        self.data += memoryview(batch.counts or batch.values)[start * item_bytes : stop * item_bytes]
        self.next_seq += stop - start
        self.next_ns = _time_of(batch, times, stop - 1) + dt_ns

    def _flush(self, *, is_due: bool) -> BufferedPiece:
        assert self.meaning is not None
        epoch, dt_ns, unit_of_measure, irregular, scale, offset = self.meaning
        samples: npt.NDArray[Any] = np.frombuffer(self.data, self.dtype)
        times = None if self.times is None else np.frombuffer(self.times, "<i8")
        if times is not None and np.array_equal(times, _grid(self.t0_ns, dt_ns, len(times))):
            times = None
        last_ns = self.next_ns - dt_ns if times is None else int(times.max())
        unit, signal, run = self.name
        piece = checked_batch(
            unit=unit, signal=signal, run=run, epoch=epoch_of(epoch), seq=self.next_seq - len(samples),
            t0_ns=self.t0_ns, dt_ns=dt_ns, unit_of_measure=unit_of_measure,
            counts=samples if self.dtype == _COUNTS else None, values=samples if self.dtype == _VALUES else None,
            times_ns=times, irregular=irregular, scale=scale, offset=offset,
        )  # fmt: skip
        self.data, self.times = bytearray(), None
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
