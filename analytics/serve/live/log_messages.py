"""New messages of the log since the last look."""

from collections.abc import Iterator
from contextlib import suppress
from typing import NamedTuple

from storage.log.files import sealed_segments
from storage.log.recovery import left_open
from storage.log.sequence import LogPlace, place_of
from storage.log.tail import records_of
from storage.segments.records import EVENTS
from storage.store import Store
from stream.errors import WireError
from stream.events import AnyDocument, decode_event
from stream.wire.acknowledgement import StreamId


class LogMessage(NamedTuple):
    """A message of the log: key, arrival, position, and the document if it is one."""

    key: str
    arrival_ns: int
    place: LogPlace
    document: AnyDocument | None


class LogMessages:
    """Messages of a log's segments but those in the lake, each once; reads what is open again when it has grown."""

    def __init__(self, store: Store, without: set[str]) -> None:
        self._store, self._without = store, without
        self._reached: dict[StreamId, int] = {}
        self._seen: set[tuple[str, int]] = set()

    def poll(self) -> Iterator[LogMessage]:
        """Messages that are new since the last time."""
        files = {(path.name, path.stat().st_size) for path in (*sealed_segments(self._store), *left_open(self._store))}
        if files == self._seen:
            return
        changed = {name.partition(".")[0] for name, _ in files - self._seen}
        for record in records_of(self._store, lambda name: self._is_new(name, changed), lambda _key: True):
            with suppress(WireError):  # `gyrofleet verify` reports it
                place = place_of(record)
                if place is None or place.next_seq <= self._reached.get(place.stream, 0):
                    continue
                self._reached[place.stream] = place.next_seq
                document = decode_event(record.data).document if record.schema == EVENTS else None
                yield LogMessage(record.topic, record.arrival_ns, place, document)
        self._seen = files

    def _is_new(self, name: str, changed: set[str]) -> bool:
        number = name.partition(".")[0]
        return number in changed and number not in self._without
