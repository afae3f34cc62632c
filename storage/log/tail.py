"""What a store's log holds beyond given positions: for whoever has to catch up with it."""

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Set
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from storage.log.files import is_own
from storage.log.recovery import left_open
from storage.log.runs import RunScan, first_to_read
from storage.log.sequence import place_of, position_of, stream_of
from storage.segments.reader import SegmentScan, read_marks, read_segment
from storage.segments.records import EVENTS, LogRecord
from storage.store import Store
from stream.delivery.publisher import StreamId
from stream.errors import BadInput, WireError
from stream.events import AnyDocument, decode_event
from stream.identity import EstimateKey, EventKey, parse_key


class LoggedMessage(NamedTuple):
    """A message of a numbered stream as it stands in the log, and the number that follows it."""

    stream: StreamId
    next_seq: int
    payload: bytes


class Beginning(NamedTuple):
    """Where to begin so that the runs that are to be estimated are taken whole, and the runs to be left out then."""

    positions: dict[StreamId, int]
    ended: frozenset[str]


class LogTail:
    """Reads the log of a store from given positions on, while another process may be writing it.

    Parameters
    ----------
    store: Which store.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._marks: dict[str, dict[StreamId, int]] = {}

    @property
    def identity(self) -> str:
        """Identity of the store."""
        return self._store.identity

    def beginning(self, *, thorough: bool = False) -> Beginning:
        """Where one begins who knows nothing: runs that go on from their first message, all else from its end.

        Parameters
        ----------
        thorough: Read the whole log, and begin also the runs that have ended while their last estimates are not there.

        Raises
        ------
        StoreError: If a sealed segment that is needed is damaged.
        """
        sealed = _sealed(self._store)
        start = 0 if thorough else first_to_read(self._store, sealed)
        positions: dict[StreamId, int] = {}
        for name in sealed[:start]:
            for stream, next_seq in self._marks_of(name).items():
                positions[stream] = max(positions.get(stream, 0), next_seq)
        scan = RunScan()
        for name in sealed[start:]:
            for record in read_segment(self._store.log / name):
                scan.follow(record, place_of(record))
        # what is sealed meanwhile is read as what lies beyond these positions
        for record in open_records(self._store):
            scan.follow(record, place_of(record))
        runs = scan.open_runs | (scan.unfinished_runs if thorough else set())
        return Beginning({**positions, **scan.positions(runs)}, frozenset(scan.runs - runs))

    def since(self, positions: Mapping[StreamId, int]) -> Iterator[LoggedMessage]:
        """Messages that lie beyond `positions`, in the order of the log; a stream not named counts from 0.

        Raises
        ------
        StoreError: If a sealed segment that is needed is damaged.
        """
        return self._since(positions, lambda _key: True)

    def published(self, positions: Mapping[StreamId, int]) -> Iterator[str]:
        """Identities of the estimates and decisions that lie beyond `positions`.

        Raises
        ------
        StoreError: If a sealed segment that is needed is damaged.
        """
        for message in self._since(positions, _is_estimate):
            yield decode_event(message.payload).document.uid

    def _since(self, positions: Mapping[StreamId, int], wanted: Callable[[str], bool]) -> Iterator[LoggedMessage]:
        def is_needed(segment: str) -> bool:
            marks = self._marks_of(segment).items()
            return any(next_seq > positions.get(stream, 0) and wanted(stream.key) for stream, next_seq in marks)

        for record in records_of(self._store, is_needed, wanted):
            stream, next_seq = position_of(record)
            if stream is not None and next_seq > positions.get(stream, 0):
                yield LoggedMessage(stream, next_seq, record.data)

    def _marks_of(self, name: str) -> dict[StreamId, int]:
        if name not in self._marks:
            written = read_marks(self._store.log / name)
            self._marks[name] = {stream_of(text): int(next_seq) for text, next_seq in written.items()}
        return self._marks[name]


def open_records(store: Store) -> Iterator[LogRecord]:
    """What can be read of the segments that are not sealed, in their order."""
    for path in left_open(store):
        yield from _open_segment(path)


def records_of(store: Store, is_needed: Callable[[str], bool], wanted: Callable[[str], bool]) -> Iterator[LogRecord]:
    """Messages of the log in their order, while another process may be writing it.

    Parameters
    ----------
    store: Whose log.
    is_needed: Whether a sealed segment of that name is to be read.
    wanted: Whether messages under that key expression are.

    Raises
    ------
    StoreError: If a sealed segment that is needed is damaged.
    """
    done: set[str] = set()
    begun: Counter[str] = Counter()  # what was read of a segment before it was sealed
    while True:
        fresh = [name for name in _sealed(store, done) if name not in done]
        for name in fresh:
            done.add(name)
            if is_needed(name):
                rest = islice(read_segment(store.log / name), begun[name], None)
                yield from (record for record in rest if wanted(record.topic))
        if fresh:
            continue
        for path in left_open(store):
            name = path.name.partition(".mcap")[0] + ".mcap"
            for record in islice(_open_segment(path), begun[name], None):
                begun[name] += 1
                if wanted(record.topic):
                    yield record
        if done.issuperset(_sealed(store, done)):  # none was sealed while it was read
            return


def documents_beyond(store: Store, in_lake: Set[str]) -> Iterator[tuple[AnyDocument, int]]:
    """Documents of the log that the lake does not have yet, each with the time of its arrival, ns.

    Parameters
    ----------
    store: Whose log.
    in_lake: Segments that the lake has.

    Raises
    ------
    StoreError: If a sealed segment that is needed is damaged.
    """
    for record in records_of(store, lambda segment: segment.removesuffix(".mcap") not in in_lake, _is_event):
        if record.schema != EVENTS:
            continue  # a rejected message stands under its key, too
        with suppress(WireError):  # `gyrofleet verify` reports it
            yield decode_event(record.data).document, record.arrival_ns


def _open_segment(path: Path) -> Iterator[LogRecord]:
    _, _, durable = path.name.partition(".abandoned-")
    with suppress(FileNotFoundError):  # sealed in between
        yield from SegmentScan(path, int(durable) if durable else None)


def _sealed(store: Store, known: Collection[str] = ()) -> list[str]:
    return sorted(path.name for path in store.log.glob("*.mcap") if path.name in known or is_own(store, path))


def _is_estimate(key: str) -> bool:
    return _is_of(key, EstimateKey)


def _is_event(key: str) -> bool:
    return _is_of(key, EventKey)


def _is_of(key: str, kind: type) -> bool:
    try:
        return isinstance(parse_key(key), kind)
    except BadInput:
        return False  # a rejected message, or a preview
