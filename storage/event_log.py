"""The event log: append-only segments, and how far every stream has come in it."""

import time
from dataclasses import dataclass
from pathlib import Path

from storage.mcap_segments import (
    EVENTS,
    SAMPLES,
    LogRecord,
    SegmentWriter,
    read_marks,
    salvage_segment,
)
from storage.store import Store, sync_folder
from stream.delivery import StreamId
from stream.errors import StoreError
from stream.events import decode_event
from stream.wire import decode_batch

DEFAULT_ROTATE_BYTES = 128 << 20
DEFAULT_ROTATE_S = 300.0


@dataclass(frozen=True)
class Recovery:
    """What was found of a segment that an earlier process left open."""

    segment: str
    records: int
    damaged_chunks: int
    kept_aside: Path


class EventLog:
    """The log of one store, open for appending.

    Parameters
    ----------
    store : Store
        Whose log; the caller holds its writer lock.
    rotate_bytes : int
        Payload after which a segment is sealed.
    rotate_s : float
        Age after which a segment is sealed, in seconds.

    Attributes
    ----------
    marks : dict of StreamId to int
        Number that each stream expects next, from the log itself.
    recovered : list of Recovery
        Segments that an earlier process had left open.
    """

    def __init__(
        self, store: Store, *, rotate_bytes: int = DEFAULT_ROTATE_BYTES, rotate_s: float = DEFAULT_ROTATE_S
    ) -> None:
        self._store = store
        self._rotate_bytes = rotate_bytes
        self._rotate_s = rotate_s
        self._segment: SegmentWriter | None = None
        self._segment_streams: set[StreamId] = set()
        self._opened_at = 0.0
        self.marks: dict[StreamId, int] = {}
        self.recovered: list[Recovery] = []
        for sealed in sorted(store.log.glob("*.mcap")):
            for stream, next_seq in read_marks(sealed).items():
                self._advance(stream_of(stream), int(next_seq))
        for left_open in sorted(store.log.glob("*.mcap.open")):
            self._recover(left_open)

    def append(self, stream: StreamId, next_seq: int, record: LogRecord) -> None:
        """Append a message that takes `stream` to `next_seq`; durable after the next `sync`."""
        self._writer().append(record)
        self._advance(stream, next_seq)
        self._segment_streams.add(stream)

    def append_aside(self, record: LogRecord) -> None:
        """Append a message that belongs to no numbered stream."""
        self._writer().append(record)

    def sync(self) -> None:
        """Bring everything appended to the disk."""
        if self._segment is not None:
            self._segment.sync()

    @property
    def due(self) -> bool:
        """Whether the open segment has reached its size or age."""
        segment = self._segment
        return segment is not None and (
            segment.payload_bytes >= self._rotate_bytes or time.monotonic() - self._opened_at >= self._rotate_s
        )

    def seal(self) -> Path | None:
        """Seal the open segment; None where there is none."""
        if self._segment is None:
            return None
        segment, self._segment = self._segment, None
        marks = {f"{s.key} {s.epoch}": str(self.marks[s]) for s in self._segment_streams}
        self._segment_streams = set()
        return segment.seal(marks)

    def abandon(self) -> None:
        """Leave the open segment for recovery at the next start."""
        if self._segment is not None:
            self._segment.abandon()
            self._segment = None

    def _writer(self) -> SegmentWriter:
        if self._segment is None:
            taken = [int(path.name.split(".")[0]) for path in self._store.log.glob("*.mcap*")]
            self._segment = SegmentWriter(self._store.log / f"{max(taken, default=0) + 1:08d}.mcap")
            self._opened_at = time.monotonic()
            sync_folder(self._store.log)
        return self._segment

    def _advance(self, stream: StreamId, next_seq: int) -> None:
        self.marks[stream] = max(self.marks.get(stream, 0), next_seq)

    def _recover(self, left_open: Path) -> None:
        # The copy is sealed before the original is moved, so that a crash in between loses nothing.
        salvage = salvage_segment(left_open)
        sealed = left_open.with_suffix("")
        if salvage.records and not sealed.exists():
            sealed.with_name(sealed.name + ".recovering").unlink(missing_ok=True)
            self._segment = SegmentWriter(sealed, ".recovering")
            for record in salvage.records:
                stream, next_seq = position_of(record)
                if stream is None:
                    self.append_aside(record)
                elif next_seq > self.marks.get(stream, 0):
                    self.append(stream, next_seq, record)
            self.seal()
        self._store.aside.mkdir(exist_ok=True)
        aside = self._store.aside / f"{left_open.name}.{time.time_ns()}"
        left_open.rename(aside)
        self.recovered.append(Recovery(left_open.name, len(salvage.records), salvage.damaged_chunks, aside))


def stream_of(text: str) -> StreamId:
    """Read a stream as it stands in the marks of a segment."""
    key, separator, epoch = text.rpartition(" ")
    if not separator:
        raise StoreError(f"stream position {text!r} in the log cannot be read; was it written by gyrofleet?")
    return StreamId(key, epoch)


def position_of(record: LogRecord) -> tuple[StreamId | None, int]:
    """Return the stream of a message and the number that follows it; None for one that is not numbered."""
    if record.schema == SAMPLES:
        batch = decode_batch(record.data)
        return StreamId(record.topic, batch.epoch.hex), batch.next_seq
    if record.schema == EVENTS:
        message = decode_event(record.data)
        return StreamId(record.topic, message.epoch), message.seq + 1
    return None, 0
