"""The event log: append-only segments, and the position that each stream has reached.

Everything appended before a `sync` that has returned is on disk. After a disk error the open segment is abandoned under
a name that says how much of it is durable, positions fall back to that, and the next message starts a new segment.
"""

import time
from contextlib import suppress
from pathlib import Path

from storage.log.files import highest_number, sealed_segments, unknown_files
from storage.log.recovery import Recovery, abandoned_name, left_open, reached_in, recover_segment, unlisted_entry
from storage.log.sequence import LogPlace, SegmentTally, placed, positions_of, raise_positions
from storage.log.writer import SegmentWriter
from storage.manifests.entries import SegmentEntry
from storage.manifests.log import ManifestWriter
from storage.segments.disk import DISK, Disk
from storage.segments.reader import SegmentScan, read_marks
from storage.segments.records import LogRecord
from storage.store import Store
from stream.errors import StoreError
from stream.wire.acknowledgement import StreamId

DEFAULT_ROTATE_BYTES = 128 << 20
DEFAULT_ROTATE_S = 300.0
_MOST_CHANNELS = 60_000  # of 65,535 that a segment has room for


class EventLog:
    """The log of one store, open for appending; the caller holds its writer lock.

    A segment is sealed at a payload of `rotate_bytes` or an age of `rotate_s`. `marks` are the numbers that the streams
    expect next, from the log itself, `recovered` the segments that an earlier process left open, `listed` those that
    were sealed and not in the manifest, and `warnings` irregularities that do not prevent recording.
    """

    def __init__(
        self, store: Store, *, rotate_bytes: int = DEFAULT_ROTATE_BYTES, rotate_s: float = DEFAULT_ROTATE_S,
        disk: Disk = DISK,
    ) -> None:  # fmt: skip
        self._store, self._disk, self._rotate_bytes = store, disk, rotate_bytes
        self._rotate_s = rotate_s
        self._segment: SegmentWriter | None = None
        self._tally = SegmentTally()
        self._opened_at = 0.0
        self._unsynced: dict[StreamId, int] = {}  # streams with messages that are not durable, and their positions
        self._unnamed: tuple[Path, Path] | None = None
        self._unlisted: list[SegmentEntry] = []
        self.marks: dict[StreamId, int] = {}
        self.recovered: list[Recovery] = []
        self.listed: list[SegmentEntry] = []
        self.warnings: list[str] = []
        self._manifest = ManifestWriter(store, disk)
        if self._manifest.found.damage:
            lines = ", ".join(str(each.line) for each in self._manifest.found.damage)
            self.warnings.append(f"the log's manifest is damaged in line {lines}; see `gyrofleet verify`")
        self._number = highest_number(store)
        for sealed in sealed_segments(store):
            self._read_marks(sealed)
        if unknown := [each.path.name for each in unknown_files(store)]:
            self.warnings.append(
                f"files in {store.log} that are not the store's are ignored: {', '.join(unknown[:5])}; see "
                "`gyrofleet verify`"
            )
        gone = sorted(name for name in self._manifest.found.entries if not (store.log / name).exists())
        if gone:
            names = ", ".join(gone[:5]) + (f" and {len(gone) - 5} more" if len(gone) > 5 else "")
            self.warnings.append(f"segments that were sealed are not in {store.log}: {names}; see `gyrofleet verify`")
        self.recover()

    @property
    def entries(self) -> list[SegmentEntry]:
        """What sealed segments hold."""
        return [*self._manifest.found.entries.values(), *self._unlisted]

    def append(self, place: LogPlace, record: LogRecord) -> None:
        """Append a numbered message; durable after the next `sync`."""
        self._writer().append(record)
        stream = place.stream
        before = self.marks.get(stream, 0)
        self._unsynced.setdefault(stream, before)
        self.marks[stream] = max(before, place.next_seq)
        self._tally.add(record, place)

    def append_aside(self, record: LogRecord) -> None:
        """Append a message without a number."""
        self._writer().append(record)
        self._tally.add(record, None)

    def sync(self) -> None:
        """Make everything appended durable."""
        if self._segment is not None:
            self._segment.sync()
        self._unsynced.clear()

    @property
    def due(self) -> bool:
        """Whether the open segment has reached its size or age."""
        segment = self._segment
        return segment is not None and (
            segment.payload_bytes >= self._rotate_bytes
            or segment.channels >= _MOST_CHANNELS
            or time.monotonic() - self._opened_at >= self._rotate_s
        )

    def seal(self) -> Path | None:
        """Seal the open segment, if there is one; its content is durable even if sealing fails."""
        if self._segment is None:
            return None
        self.sync()
        wanted = self._segment.path
        sealed = self._segment.seal(self._tally.marks)
        self._segment = None
        if sealed.path != wanted:
            self.warnings.append(
                f"{wanted} exists already, written by another process; what was recorded meanwhile is sealed as "
                f"{sealed.path.name}; stop that process and run `gyrofleet verify`"
            )
            self._number = int(sealed.path.stem)
        self._list(self._tally.entry(sealed, "recorded"))
        return sealed.path

    def abandon(self) -> dict[StreamId, int]:
        """Abandon the open segment after a disk error; returns by how many numbers each stream falls back."""
        before, self._unsynced = self._unsynced, {}
        undone = {stream: self.marks[stream] - next_seq for stream, next_seq in before.items()}
        self.marks.update(before)
        segment, self._segment = self._segment, None
        if segment is None:
            return undone
        with suppress(OSError):
            segment.abandon()
        self._unnamed = (segment.open_path, abandoned_name(segment.path, segment.durable_bytes))
        with suppress(OSError):
            self._name_abandoned()
        return undone

    def recover(self) -> list[Recovery]:
        """Seal unfinished segments, of an earlier process or after a disk error; can be repeated after an OSError."""
        found = []
        self._name_abandoned()
        mine = None if self._segment is None else self._segment.open_path
        for path in left_open(self._store):
            if path == mine:
                continue
            recovery = recover_segment(self._store, path, dict(self.marks), self._disk)
            raise_positions(self.marks, recovery.positions)
            found.append(recovery)
            if recovery.entry is not None:
                self._list(recovery.entry)
        self.recovered += found
        return found

    def _writer(self) -> SegmentWriter:
        if self._segment is None:
            self._name_abandoned()
            segment = SegmentWriter(
                self._store.log / f"{self._number + 1:08d}.mcap", disk=self._disk, store=self._store.identity
            )
            self._number += 1
            self._tally = SegmentTally()
            self._opened_at = time.monotonic()
            self._segment = segment
            self._disk.sync_folder(self._store.log)
        return self._segment

    def _name_abandoned(self) -> None:
        """Name an abandoned segment before anything new is written: the name says how much of it is durable."""
        if self._unnamed is None:
            return
        path, name = self._unnamed
        if path.exists():  # else it was sealed before its name was durable
            self._disk.rename(path, name)
        self._disk.sync_folder(self._store.log)
        self._unnamed = None

    def _list(self, entry: SegmentEntry) -> None:
        """Add an entry to the manifest; one that cannot be written now is written with the next."""
        self._unlisted.append(entry)
        with suppress(OSError):
            self._disk.sync_folder(self._store.log)
            while self._unlisted:
                self._manifest.add(self._unlisted[0])
                self._unlisted.pop(0)

    def _read_marks(self, sealed: Path) -> None:
        try:
            found = positions_of(read_marks(sealed))
            if sealed.name not in self._manifest.found.entries:
                entry, found = unlisted_entry(self._store, sealed)
                self._list(entry)
                self.listed.append(entry)
        except StoreError as error:
            self.warnings.append(str(error))
            found = reached_in(sealed)
            for _, place in placed(sealed, SegmentScan(sealed, sealed=True)):
                if place is not None:
                    raise_positions(found, {place.stream: place.next_seq})
        raise_positions(self.marks, found)
