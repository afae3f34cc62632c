"""Following a log while another process writes it: what is new since the last look, each message once."""

import os
import re
import time
from collections.abc import Callable, Collection, Iterator
from typing import NamedTuple

from storage.log.files import is_own
from storage.log.message_form import MessageForms
from storage.log.recovery import reached_in
from storage.log.sequence import LogPlace, parse_record
from storage.segments.growing import GrowingSegment
from storage.segments.records import LogRecord
from storage.store import Store
from stream.batch import SampleBatch
from stream.bounds import MAX_MOMENT_NS, MAX_SEQ, MIN_MOMENT_NS
from stream.closing import Closing
from stream.errors import GyrofleetError
from stream.events import AnyDocument
from stream.wire.acknowledgement import StreamId
from stream.wire.batches import RawBatch, decode_batch, read_raw_batch

_FILE = re.compile(r"(\d+)\.mcap(\.open|\.abandoned-(\d+))?")
_TICK_NS = 100_000_000  # within which two changes of a folder may have the same time


class ContinuedBatch(NamedTuple):
    """A sample batch as logged, unread: all but its number, its times and its samples is that of `like`.

    `place` is where it is in its stream, `begin` and `end` where the bytes of its samples are in the payload.
    """

    payload: bytes
    like: RawBatch
    place: LogPlace
    begin: int
    end: int

    @property
    def t0_ns(self) -> int:
        """Time of its first sample."""
        return self.place.first_ns

    @property
    def last_ns(self) -> int:
        """Time of its last sample."""
        return self.place.last_ns

    def read(self) -> RawBatch:
        """The batch, read in full."""
        return read_raw_batch(self.payload)

    def decoded(self) -> SampleBatch:
        """The batch with its arrays."""
        return decode_batch(self.payload)


class FollowedMessage(NamedTuple):
    """A numbered message of the log; one that cannot be read has an error as its content, and no place."""

    segment: str
    record: LogRecord
    place: LogPlace | None
    content: RawBatch | ContinuedBatch | AnyDocument | GyrofleetError


class LogFollower(Closing):
    """Reads the samples and documents of a log as they are written.

    What is acknowledged is read by the next `poll`, whether its segment is open, sealed, abandoned or recovered by
    then; a message may also come a moment before it is acknowledged. Messages come in the order of the log, each once,
    by their numbers. The follower takes no lock and needs no recorder; it is for one thread at a time.

    Parameters
    ----------
    without: Segments that are not read, such as those in the lake.
    wanted: Which keys are read; all if left out.
    unread: Give batches that continue their streams as a `ContinuedBatch`: a quarter less time for a follower.

    >>> with LogFollower(Store.open(Path("night"))) as follower:  # doctest: +SKIP
    ...     while True:
    ...         for message in follower.poll():
    ...             print(message.segment, message.place)
    ...         time.sleep(0.2)
    """

    def __init__(
        self, store: Store, without: Collection[str] = (), *, wanted: Callable[[str], bool] | None = None,
        unread: bool = False,
    ) -> None:  # fmt: skip
        self.damaged_bytes: dict[str, int] = {}  # by segment
        self._store, self._without, self._wanted = store, frozenset(without), wanted
        self._names: set[str] = set()
        self._changed_ns: int | None = None
        self._files: dict[str, GrowingSegment | None] = {}  # to be read; a sealed one is opened then
        self._reached: dict[StreamId, int] = {}
        self._copied: dict[str, dict[StreamId, int]] = {}  # by segment: what its sealed copy has, which is not read
        self._forms = MessageForms() if unread else None
        self._like: dict[str, RawBatch] = {}  # by topic: the batch that its form was learnt of

    def poll(self) -> Iterator[FollowedMessage]:
        """Messages that are new since the last time; those that are not taken come again."""
        self._look()
        for name in sorted(self._files):
            segment = self._files[name] or self._opened(name)
            if segment is None:
                continue
            number = name.partition(".")[0]
            for record in segment.records():
                message = self._new(number, record)
                if message is not None:
                    yield message
            if segment.damaged:
                self.damaged_bytes[number] = sum(each.end - each.begin for each in segment.damaged)
            if segment.is_read and segment.is_finished:  # not before it has its last name, else it would be read again
                del self._files[name]
                segment.close()

    def close(self) -> None:
        """Close the segments."""
        for segment in self._files.values():
            if segment is not None:
                segment.close()
        self._files.clear()

    def _new(self, number: str, record: LogRecord) -> FollowedMessage | None:
        """The message, if it is numbered, wanted, and beyond what has been read of its stream."""
        if self._wanted is not None and not self._wanted(record.topic):
            return None
        if self._forms is not None and not self._copied:
            if (continued := self._continued(record)) is not None:
                return FollowedMessage(number, record, continued.place, continued)
            self._forms.forget(record.topic)
        try:
            parsed = parse_record(record)
        except GyrofleetError as error:
            return FollowedMessage(number, record, None, error)
        if parsed is None:
            return None
        stream, next_seq = parsed.place.stream, parsed.place.next_seq
        if next_seq <= self._reached.get(stream, 0):
            return None  # of a segment's copy, or written again because it was not durable
        if self._copied and next_seq <= self._copied.get(number, {}).get(stream, 0):
            return None
        self._reached[stream] = next_seq
        if self._forms is not None and isinstance(parsed.content, RawBatch):
            self._forms.learn(record, parsed.place)
            self._like[record.topic] = parsed.content
        return FollowedMessage(number, record, *parsed)

    def _continued(self, record: LogRecord) -> ContinuedBatch | None:
        """The batch that continues the one before it of its topic; None if it is to be read."""
        assert self._forms is not None
        form = self._forms.by_topic.get(record.topic)
        if form is None or not form.follow(record.data, 0, len(record.data)):
            return None
        stream, next_seq, t0_ns = form.stream, form.next_seq, form.t0_ns
        last_ns = t0_ns + form.span_ns
        if next_seq > MAX_SEQ or t0_ns < MIN_MOMENT_NS or last_ns > MAX_MOMENT_NS:
            return None  # beyond its bounds: left to be read, and judged, alone
        self._reached[stream] = next_seq
        like = self._like[record.topic]
        place = LogPlace(stream, next_seq - form.samples, next_seq, t0_ns, last_ns, like.message.run)
        return ContinuedBatch(record.data, like, place, *form.data)

    def _look(self) -> None:
        """Take up new segments, and what has become of the others."""
        while (changed_ns := self._store.log.stat().st_mtime_ns) != self._changed_ns:
            names = self._listed()
            try:
                self._take_up(names)
            except FileNotFoundError:
                continue  # renamed meanwhile
            self._names = names
            # later changes within the tick would not be noticed by the folder's time
            self._changed_ns = changed_ns if time.time_ns() - changed_ns > _TICK_NS else None
            return

    def _listed(self) -> set[str]:
        """Names in the log; listed until they agree, since a file that is renamed meanwhile may be left out."""
        before: set[str] | None = None
        while True:
            names = set(os.listdir(self._store.log))  # noqa: PTH208  names alone, perhaps 100,000
            if names == before:
                return names
            before = names

    def _take_up(self, names: set[str]) -> None:
        held = {segment.inode: name for name, segment in self._files.items() if segment is not None}
        for name in sorted(names - self._names - self._files.keys()):
            match = _FILE.fullmatch(name)
            is_sealed = match is not None and match[2] is None
            if match is None or (is_sealed and match[1] in self._without):
                continue
            path = self._store.log / name
            status = path.stat()
            before = held.get((status.st_dev, status.st_ino))
            if before is None and not is_own(self._store, path):
                path.stat()  # not renamed, hence not the store's
                continue
            segment = self._files.pop(before) if before is not None else None
            if not is_sealed:
                segment = segment or GrowingSegment(path)
                if match[1] in self._without:  # sealed as a copy, and not quarantined yet
                    self._copied[match[1]] = reached_in(self._store.log / f"{match[1]}.mcap")
            if segment is not None:
                segment.limit = None if match[3] is None else int(match[3])
                segment.is_finished = match[2] != ".open"
            self._files[name] = segment
        for name, segment in self._files.items():
            if segment is not None and name not in names:
                segment.is_finished = True  # quarantined, or removed

    def _opened(self, name: str) -> GrowingSegment | None:
        """A sealed segment; None if it has been quarantined meanwhile."""
        try:
            segment = GrowingSegment(self._store.log / name)
        except FileNotFoundError:
            del self._files[name]
            return None
        segment.is_finished = True
        self._files[name] = segment
        return segment
