"""Positions of messages in their streams: gaps, repetitions, and what a segment holds of each stream."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from storage.manifests.entries import SegmentEntry
from storage.segments.records import EVENTS, SAMPLES, LogRecord, SealedSegment
from stream.errors import GyrofleetError, StoreError
from stream.events import AnyDocument, RunEnded, RunStarted, decode_event
from stream.identity import SampleKey, parse_key
from stream.wire.acknowledgement import StreamId
from stream.wire.batches import RawBatch, read_raw_batch

DOCUMENTS = "documents"


class LogPlace(NamedTuple):
    """Position of a message in its stream: its numbers, its time, and its run."""

    stream: StreamId
    seq: int
    next_seq: int
    first_ns: int
    last_ns: int
    run: str
    is_end: bool = False
    is_start: bool = False

    @property
    def station(self) -> str:
        """The station, if samples or the start of a run show that the run is its own; else empty."""
        shows = self.is_start or _is_of_samples(self.stream.key)
        return parse_key(self.stream.key).place.station if shows else ""

    @property
    def samples(self) -> int:
        """How many samples it has."""
        return self.next_seq - self.seq if _is_of_samples(self.stream.key) else 0


@lru_cache(maxsize=200_000)
def _is_of_samples(key: str) -> bool:
    return isinstance(parse_key(key), SampleKey)


class ParsedRecord(NamedTuple):
    """A numbered message of the log, and its position."""

    place: LogPlace
    content: RawBatch | AnyDocument


@dataclass(frozen=True)
class LostStretch:
    """Missing numbers of one stream, and the source times around them; None where nothing is known on that side."""

    key: str
    epoch: str
    first_seq: int
    last_seq: int
    first_ns: int | None
    last_ns: int | None

    @property
    def unit(self) -> str:
        """Unit of the samples; of documents, their place."""
        parsed = parse_key(self.key)
        return parsed.unit if isinstance(parsed, SampleKey) else "/".join(parsed.place)

    @property
    def signal(self) -> str:
        """Signal of the samples; `DOCUMENTS` for documents."""
        parsed = parse_key(self.key)
        return parsed.signal if isinstance(parsed, SampleKey) else DOCUMENTS

    @property
    def count(self) -> int:
        """How many samples or documents."""
        return self.last_seq - self.first_seq + 1

    def __str__(self) -> str:
        """In words."""
        ends = [f"{at} ns" if at is not None else "an unknown moment" for at in (self.first_ns, self.last_ns)]
        what = "documents" if self.signal == DOCUMENTS else "samples"
        whose = f"of {self.key}" if self.signal == DOCUMENTS else f"of unit {self.unit}, signal {self.signal}"
        return (
            f"{self.count:,} {what} {whose} (numbers {self.first_seq} to "
            f"{self.last_seq} of epoch {self.epoch}) between {ends[0]} and {ends[1]}"
        )


class SequenceCheck:
    """Finds `lost` and `repeated` messages of a log read in its order; `next_seq` is what each stream expects next."""

    def __init__(self) -> None:
        self.next_seq: dict[StreamId, int] = {}
        self.lost: list[LostStretch] = []
        self.repeated: list[LogPlace] = []
        self._last_ns: dict[StreamId, int] = {}

    def follow(self, place: LogPlace) -> bool:
        """Take the next message; whether it is new."""
        stream = place.stream
        expected = self.next_seq.get(stream, 0)
        if place.next_seq <= expected:
            self.repeated.append(place)
            return False
        if place.seq > expected:
            self._miss(stream, expected, place.seq, place.first_ns)
        self.next_seq[stream] = place.next_seq
        self._last_ns[stream] = place.last_ns
        return True

    def skip_to(self, stream: StreamId, next_seq: int, last_ns: int) -> None:
        """Take that messages, each the next one, have been followed up to a number and the time of its last sample."""
        self.next_seq[stream] = next_seq
        self._last_ns[stream] = last_ns

    def reach(self, stream: StreamId, next_seq: int) -> None:
        """Take from another source that a stream has reached a number."""
        expected = self.next_seq.get(stream, 0)
        if next_seq > expected:
            self._miss(stream, expected, next_seq, None)
            self.next_seq[stream] = next_seq

    def _miss(self, stream: StreamId, expected: int, seq: int, until_ns: int | None) -> None:
        self.lost.append(LostStretch(stream.key, stream.epoch, expected, seq - 1, self._last_ns.get(stream), until_ns))


class SegmentTally:
    """Counts of one segment and the positions of its streams, for its manifest entry and its marks."""

    def __init__(self) -> None:
        self.messages = self.samples = self.arrival_first_ns = self.arrival_last_ns = 0
        self.positions: dict[StreamId, int] = {}
        self._runs: dict[str, str] = {}
        self._ended: dict[str, None] = {}

    def add(self, record: LogRecord, place: LogPlace | None) -> None:
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
            if not self._runs.get(place.run):
                self._runs[place.run] = place.station
            if place.is_end:
                self._ended[place.run] = None

    @property
    def marks(self) -> dict[str, str]:
        """The positions in the form in which a segment stores them."""
        return {f"{stream.key} {stream.epoch}": str(next_seq) for stream, next_seq in self.positions.items()}

    def entry(self, sealed: SealedSegment, origin: str) -> SegmentEntry:
        """Its entry in the manifest."""
        return SegmentEntry(
            segment=sealed.path.name, size=sealed.size, sha256=sealed.sha256, messages=self.messages,
            samples=self.samples, arrival_first_ns=self.arrival_first_ns, arrival_last_ns=self.arrival_last_ns,
            runs=tuple(self._runs), stations=tuple(self._runs.values()), ended=tuple(self._ended), origin=origin,
        )  # fmt: skip


def parse_record(record: LogRecord) -> ParsedRecord | None:
    """Parse a message of the log; None if it is not numbered, as a preview."""
    if record.schema == SAMPLES:
        batch = read_raw_batch(record.data)
        message, seq = batch.message, batch.message.seq
        stream = StreamId(record.topic, message.epoch.hex())
        place = LogPlace(stream, seq, seq + message.samples, message.t0_ns, batch.last_ns, message.run)
        return ParsedRecord(place, batch)
    if record.schema == EVENTS:
        numbered = decode_event(record.data)
        document = numbered.document
        stream = StreamId(record.topic, numbered.epoch)
        place = LogPlace(
            stream, numbered.seq, numbered.seq + 1, document.t_ns, document.t_ns, document.run,
            is_end=isinstance(document, RunEnded), is_start=isinstance(document, RunStarted),
        )  # fmt: skip
        return ParsedRecord(place, document)
    return None


def place_of(record: LogRecord) -> LogPlace | None:
    """Position of a message of the log in its stream; None if it is not numbered."""
    parsed = parse_record(record)
    return None if parsed is None else parsed.place


def placed(path: Path, records: Iterable[LogRecord]) -> Iterator[tuple[LogRecord, LogPlace | None]]:
    """Messages of a segment with their positions; an error of one that cannot be read names the segment."""
    for record in records:
        try:
            place = place_of(record)
            if place is not None:
                parse_key(place.stream.key)
        except GyrofleetError as error:
            raise type(error)(f"segment {path} holds a message that cannot be read: {error}") from error
        yield record, place


def positions_of(marks: dict[str, str]) -> dict[StreamId, int]:
    """Positions of streams from the marks of a segment."""
    found = {}
    for text, next_seq in marks.items():
        key, separator, epoch = text.rpartition(" ")
        if not separator:
            raise StoreError(f"stream position {text!r} in the log cannot be read; was it written by gyrofleet?")
        found[StreamId(key, epoch)] = int(next_seq)
    return found


def raise_positions(positions: dict[StreamId, int], reached: dict[StreamId, int]) -> None:
    """Raise positions to those that streams have reached."""
    for stream, next_seq in reached.items():
        positions[stream] = max(positions.get(stream, 0), next_seq)
