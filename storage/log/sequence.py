"""Whether the numbers of every stream in the log go on without a gap, and what is missing where they do not."""

from dataclasses import dataclass
from typing import NamedTuple

from storage.segments.records import EVENTS, SAMPLES, LogRecord
from stream.delivery.publisher import StreamId
from stream.errors import StoreError
from stream.events import RunEnded, decode_event
from stream.identity import SampleKey, parse_key
from stream.wire.batches import read_batch_head

DOCUMENTS = "documents"


class Place(NamedTuple):
    """Where a message stands in its stream: its numbers, its time, and the run it belongs to."""

    stream: StreamId
    seq: int
    next_seq: int
    first_ns: int
    last_ns: int
    run: str
    is_end: bool = False

    @property
    def samples(self) -> int:
        """How many samples it has."""
        return self.next_seq - self.seq if isinstance(parse_key(self.stream.key), SampleKey) else 0


@dataclass(frozen=True)
class LostStretch:
    """Numbers of one stream that are not there, and between which moments of the source's clock they lay.

    `first_ns` or `last_ns` is None where nothing of the stream is known before or behind.
    """

    key: str
    epoch: str
    first_seq: int
    last_seq: int
    first_ns: int | None
    last_ns: int | None

    @property
    def unit(self) -> str:
        """Whose samples they are; of documents, where they come from."""
        parsed = parse_key(self.key)
        return parsed.unit if isinstance(parsed, SampleKey) else "/".join(parsed.place)

    @property
    def signal(self) -> str:
        """Which signal; of documents, that they are documents."""
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
    """Follows the streams of a log in its order.

    Attributes
    ----------
    next_seq: Number that each stream expects.
    lost: Numbers that were passed over.
    repeated: Messages whose numbers were there before.
    """

    def __init__(self) -> None:
        self.next_seq: dict[StreamId, int] = {}
        self.lost: list[LostStretch] = []
        self.repeated: list[Place] = []
        self._last_ns: dict[StreamId, int] = {}

    def follow(self, place: Place) -> bool:
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

    def reach(self, stream: StreamId, next_seq: int) -> None:
        """Something says that the stream has come so far."""
        expected = self.next_seq.get(stream, 0)
        if next_seq > expected:
            self._miss(stream, expected, next_seq, None)
            self.next_seq[stream] = next_seq

    def _miss(self, stream: StreamId, expected: int, seq: int, until_ns: int | None) -> None:
        self.lost.append(LostStretch(stream.key, stream.epoch, expected, seq - 1, self._last_ns.get(stream), until_ns))


def place_of(record: LogRecord) -> Place | None:
    """Where a message of the log stands in its stream; None for one that is not numbered.

    Raises
    ------
    WireError: If it cannot be read.
    """
    if record.schema == SAMPLES:
        head = read_batch_head(record.data, bounded=False)
        return Place(StreamId(record.topic, head.epoch), head.seq, head.next_seq, head.t0_ns, head.last_ns, head.run)
    if record.schema == EVENTS:
        message = decode_event(record.data)
        document = message.document
        stream = StreamId(record.topic, message.epoch)
        is_end = isinstance(document, RunEnded)
        return Place(stream, message.seq, message.seq + 1, document.t_ns, document.t_ns, document.run, is_end)
    return None


def stream_of(text: str) -> StreamId:
    """Read a stream as it stands in the marks of a segment.

    Raises
    ------
    StoreError: If it is none.
    """
    key, separator, epoch = text.rpartition(" ")
    if not separator:
        raise StoreError(f"stream position {text!r} in the log cannot be read; was it written by gyrofleet?")
    return StreamId(key, epoch)


def position_of(record: LogRecord) -> tuple[StreamId | None, int]:
    """Return the stream of a message and the number that follows it; None for one that is not numbered."""
    place = place_of(record)
    return (None, 0) if place is None else (place.stream, place.next_seq)
