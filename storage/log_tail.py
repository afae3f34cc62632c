"""What a store's log holds beyond given positions: for whoever has to catch up with it."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from storage.event_log import position_of, stream_of
from storage.mcap_segments import LogRecord, read_marks, read_segment, salvage_segment
from storage.store import Store
from stream.delivery import StreamId


class LoggedMessage(NamedTuple):
    """A message of a numbered stream as it stands in the log, and the number that follows it."""

    stream: StreamId
    next_seq: int
    payload: bytes


class LogTail:
    """Reads the log of a store from given positions on, while another process may be writing it.

    Parameters
    ----------
    store : Store
        Which store.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._marks: dict[str, dict[StreamId, int]] = {}

    @property
    def identity(self) -> str:
        """Identity of the store."""
        return self._store.identity

    def positions(self) -> dict[StreamId, int]:
        """How far every stream has come in what is on disk.

        Raises
        ------
        StoreError
            If a sealed segment is damaged.
        """
        found: dict[StreamId, int] = {}
        for name in self._sealed():
            for stream, next_seq in self._marks_of(name).items():
                found[stream] = max(found.get(stream, 0), next_seq)
        for message in self._numbered(self._open_records()):
            found[message.stream] = max(found.get(message.stream, 0), message.next_seq)
        return found

    def since(self, positions: Mapping[StreamId, int]) -> Iterator[LoggedMessage]:
        """Messages that lie beyond `positions`, in the order of the log; a stream not named counts from 0.

        Raises
        ------
        StoreError
            If a sealed segment that is needed is damaged.
        """
        done: set[str] = set()
        while True:
            fresh = [name for name in self._sealed() if name not in done]
            for name in fresh:
                done.add(name)
                if any(next_seq > positions.get(stream, 0) for stream, next_seq in self._marks_of(name).items()):
                    yield from self._beyond(read_segment(self._store.log / name), positions)
            if fresh:
                continue
            left_open = list(self._open_records())
            if done.issuperset(self._sealed()):  # none was sealed while it was read
                yield from self._beyond(iter(left_open), positions)
                return

    def _sealed(self) -> list[str]:
        return sorted(path.name for path in self._store.log.glob("*.mcap"))

    def _marks_of(self, name: str) -> dict[StreamId, int]:
        if name not in self._marks:
            written = read_marks(self._store.log / name)
            self._marks[name] = {stream_of(text): int(next_seq) for text, next_seq in written.items()}
        return self._marks[name]

    def _open_records(self) -> Iterator[LogRecord]:
        for path in sorted(self._store.log.glob("*.mcap.open")):
            try:
                salvage = salvage_segment(path)
            except FileNotFoundError:
                continue  # sealed in between
            yield from salvage.records

    def _beyond(self, records: Iterator[LogRecord], positions: Mapping[StreamId, int]) -> Iterator[LoggedMessage]:
        for message in self._numbered(records):
            if message.next_seq > positions.get(message.stream, 0):
                yield message

    @staticmethod
    def _numbered(records: Iterator[LogRecord]) -> Iterator[LoggedMessage]:
        for record in records:
            stream, next_seq = position_of(record)
            if stream is not None:
                yield LoggedMessage(stream, next_seq, record.data)
