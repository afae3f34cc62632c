"""What is counted of a segment while its messages pass: for its line in the manifest and its marks."""

from storage.log.sequence import Place
from storage.manifests.log import SegmentEntry
from storage.segments.records import LogRecord, SealedSegment
from stream.delivery.publisher import StreamId


class SegmentTally:
    """Counts of one segment, and how far its streams have come in it."""

    def __init__(self) -> None:
        self.messages = 0
        self.samples = 0
        self.arrival_first_ns = 0
        self.arrival_last_ns = 0
        self.positions: dict[StreamId, int] = {}
        self._runs: dict[str, None] = {}
        self._ended: dict[str, None] = {}

    def add(self, record: LogRecord, place: Place | None) -> None:
        """Count a message."""
        if not self.messages:
            self.arrival_first_ns = record.arrival_ns
        self.messages += 1
        self.arrival_last_ns = max(self.arrival_last_ns, record.arrival_ns)
        if place is None:
            return
        self.positions[place.stream] = place.next_seq
        self.samples += place.samples
        if place.run:
            self._runs[place.run] = None
            if place.is_end:
                self._ended[place.run] = None

    @property
    def marks(self) -> dict[str, str]:
        """The positions as they stand in a segment."""
        return {f"{stream.key} {stream.epoch}": str(next_seq) for stream, next_seq in self.positions.items()}

    def entry(self, sealed: SealedSegment, origin: str) -> SegmentEntry:
        """Its line in the manifest."""
        return SegmentEntry(
            segment=sealed.path.name,
            size=sealed.size,
            sha256=sealed.sha256,
            messages=self.messages,
            samples=self.samples,
            arrival_first_ns=self.arrival_first_ns,
            arrival_last_ns=self.arrival_last_ns,
            runs=tuple(self._runs),
            ended=tuple(self._ended),
            origin=origin,
        )
