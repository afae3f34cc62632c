"""Reading a store's log from given positions, to catch up with it, and where each run begins in every stream."""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Set
from contextlib import suppress
from functools import partial
from itertools import islice
from pathlib import Path

from storage.log.files import is_own
from storage.log.recovery import left_open
from storage.log.sealed_documents import documents_of_sealed, is_of_documents
from storage.log.sequence import LogPlace, place_of, positions_of, raise_positions
from storage.manifests.log import read_log_manifest
from storage.segments.reader import SegmentScan, read_marks, read_segment
from storage.segments.records import EVENTS, LogRecord
from storage.store import Store
from stream.delivery.recorded_log import LogBeginning, LoggedMessage
from stream.errors import BadInput, WireError
from stream.events import AnyDocument, SpectralLinesFound, decode_event
from stream.identity import EstimateKey, SampleKey, parse_key
from stream.wire.acknowledgement import StreamId


def first_to_read(store: Store, sealed: list[str]) -> int:
    """Index of the first sealed segment that may hold an unfinished run; the number of segments if none may.

    The last estimates of a run may be in the segment after its end; anything later resumes the run.
    """
    entries = read_log_manifest(store).entries
    first: dict[str, int] = {}
    ended: dict[str, int] = {}
    unlisted = len(sealed)
    for number, name in enumerate(sealed):
        entry = entries.get(name)
        if entry is None:
            unlisted = min(unlisted, number)
            continue
        for run in entry.runs:
            first.setdefault(run, number)
            if number > ended.get(run, number) + 1:
                del ended[run]
        ended.update((run, number) for run in entry.ended)
    return min([unlisted, *(number for run, number in first.items() if run not in ended)])


class RunScan:
    """Finds where runs begin; `open_runs` have samples or documents other than estimates after their last end."""

    def __init__(self) -> None:
        self.runs: set[str] = set()
        self.open_runs: set[str] = set()
        self._first: dict[tuple[StreamId, str], int] = {}
        self._next: dict[StreamId, int] = {}
        self._signals: set[tuple[str, str, str]] = set()
        self._estimated: set[tuple[str, str, str]] = set()
        self._finished: set[tuple[str, str, str]] = set()

    def follow(self, record: LogRecord, place: LogPlace | None) -> None:
        """Take the next message."""
        if place is None:
            return
        stream, run = place.stream, place.run
        self._next[stream] = max(place.next_seq, self._next.get(stream, 0))
        if not run:
            return
        self.runs.add(run)
        self._first.setdefault((stream, run), place.seq)
        key = parse_key(stream.key)
        if isinstance(key, EstimateKey):
            name = (run, key.unit, key.signal)
            self._estimated.add(name)
            if isinstance(decode_event(record.data).document, SpectralLinesFound):
                self._finished.add(name)
            return
        if isinstance(key, SampleKey):
            self._signals.add((run, key.unit, key.signal))
        if place.is_end:
            self.open_runs.discard(run)
        else:
            self.open_runs.add(run)

    @property
    def unfinished_runs(self) -> set[str]:
        """Estimated runs of which a signal lacks its final document."""
        estimated = {run for run, _, _ in self._estimated}
        return {name[0] for name in self._signals - self._finished if name[0] in estimated}

    def positions(self, runs: set[str]) -> dict[StreamId, int]:
        """Position of the first message of any of `runs` in each stream, else the end of the stream."""
        found = dict(self._next)
        for (stream, run), first in self._first.items():
            if run in runs:
                found[stream] = min(found[stream], first)
        return found


class LogTail:
    """Reads the log of a store from given positions on, while another process may be writing it."""

    def __init__(self, store: Store) -> None:
        self.identity = store.identity
        self._store = store
        self._marks: dict[str, dict[StreamId, int]] = {}

    def beginning(self, *, thorough: bool = False) -> LogBeginning:
        """Where to begin without a checkpoint; `thorough` reads the whole log for ended runs without last estimates."""
        sealed = _sealed(self._store)
        start = 0 if thorough else first_to_read(self._store, sealed)
        positions: dict[StreamId, int] = {}
        for name in sealed[:start]:
            raise_positions(positions, self._marks_of(name))
        scan = RunScan()
        for name in sealed[start:]:
            for record in read_segment(self._store.log / name):
                scan.follow(record, place_of(record))
        # what is sealed meanwhile lies beyond these positions and is read later
        for record in open_records(self._store):
            scan.follow(record, place_of(record))
        runs = scan.open_runs | (scan.unfinished_runs if thorough else set())
        return LogBeginning({**positions, **scan.positions(runs)}, frozenset(scan.runs - runs))

    def since(self, positions: Mapping[StreamId, int]) -> Iterator[LoggedMessage]:
        """Messages beyond `positions`, in the order of the log; streams not named count from 0."""
        return self._since(positions, lambda _key: True)

    def published(self, positions: Mapping[StreamId, int]) -> Iterator[str]:
        """Identities of the estimates and decisions beyond `positions`."""
        for message in self._since(positions, partial(_is_of, EstimateKey)):
            yield decode_event(message.payload).document.uid

    def _since(self, positions: Mapping[StreamId, int], wanted: Callable[[str], bool]) -> Iterator[LoggedMessage]:
        def is_needed(segment: str) -> bool:
            marks = self._marks_of(segment).items()
            return any(next_seq > positions.get(stream, 0) and wanted(stream.key) for stream, next_seq in marks)

        for record in records_of(self._store, is_needed, wanted):
            place = place_of(record)
            if place is not None and place.next_seq > positions.get(place.stream, 0):
                yield LoggedMessage(place.stream, place.next_seq, record.data)

    def _marks_of(self, name: str) -> dict[StreamId, int]:
        if name not in self._marks:
            self._marks[name] = positions_of(read_marks(self._store.log / name))
        return self._marks[name]


def open_records(store: Store) -> Iterator[LogRecord]:
    """Readable messages of the segments that are not sealed, in their order."""
    for path in left_open(store):
        yield from _open_segment(path)


def records_of(
    store: Store, is_needed: Callable[[str], bool], wanted: Callable[[str], bool],
    sealed: Callable[[Path], Iterable[LogRecord]] = read_segment,
) -> Iterator[LogRecord]:  # fmt: skip
    """Messages of a log in their order, of the segments needed and the keys wanted; the log may be being written.

    `sealed` reads a sealed segment, at least the messages wanted.
    """
    done: set[str] = set()
    begun: Counter[str] = Counter()  # messages wanted that were read of a segment before it was sealed
    while True:
        fresh = [name for name in _sealed(store, done) if name not in done]
        for name in fresh:
            done.add(name)
            if is_needed(name):
                found = (record for record in sealed(store.log / name) if wanted(record.topic))
                yield from islice(found, begun[name], None)
        if fresh:
            continue
        for path in left_open(store):
            name = path.name.partition(".mcap")[0] + ".mcap"
            found = (record for record in _open_segment(path, wanted) if wanted(record.topic))
            for record in islice(found, begun[name], None):
                begun[name] += 1
                yield record
        if done.issuperset(_sealed(store, done)):  # none was sealed meanwhile
            return


def documents_beyond(store: Store, in_lake: Set[str]) -> Iterator[tuple[AnyDocument, int]]:
    """Documents of the log that are not in the lake yet, each with its arrival time in ns."""

    def is_beyond(segment: str) -> bool:
        return segment.removesuffix(".mcap") not in in_lake

    for record in records_of(store, is_beyond, is_of_documents, documents_of_sealed):
        if record.schema != EVENTS:
            continue  # rejected messages keep their key
        with suppress(WireError):  # `gyrofleet verify` reports it
            yield decode_event(record.data).document, record.arrival_ns


def _open_segment(path: Path, is_wanted: Callable[[str], bool] | None = None) -> Iterator[LogRecord]:
    _, _, durable = path.name.partition(".abandoned-")
    with suppress(FileNotFoundError):  # sealed in between
        yield from SegmentScan(path, int(durable) if durable else None, is_wanted=is_wanted)


def _sealed(store: Store, known: Collection[str] = ()) -> list[str]:
    return sorted(path.name for path in store.log.glob("*.mcap") if path.name in known or is_own(store, path))


def _is_of(kind: type, key: str) -> bool:
    try:
        return isinstance(parse_key(key), kind)
    except BadInput:
        return False  # a rejected message, or a preview
