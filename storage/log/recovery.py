"""Recovery of unfinished and damaged segments: what they hold is sealed, what is lost is reported.

An undamaged file is finished in place, which needs no space on a full disk. Of a damaged one the readable part is
copied, and the whole file is quarantined.
"""

import mmap
import re
import time
from dataclasses import dataclass, field, replace
from pathlib import Path

from storage.log.files import is_own, next_free
from storage.log.sequence import LostStretch, SegmentTally, SequenceCheck, placed, positions_of, raise_positions
from storage.log.writer import SegmentWriter
from storage.manifests.entries import SegmentEntry
from storage.segments.disk import DISK, Disk, sha256_of
from storage.segments.reader import SegmentScan, read_marks, read_segment
from storage.segments.records import SealedSegment
from storage.store import Store
from stream.errors import StoreError
from stream.wire.acknowledgement import StreamId

_UNFINISHED = re.compile(r"(\d+\.mcap)\.(?:open|abandoned-(\d+))")
_COPY = ".recovering"


@dataclass(frozen=True)
class Recovery:
    """Result of recovering a segment that was left open, or was damaged.

    `segment` is the original name of the file, `records` are the messages that it has now, `positions` those that its
    streams have reached. `kept_aside` is the quarantined original, if anything of it was left out; `entry` is the
    sealed segment, None if there was no message.
    """

    segment: str
    records: int = 0
    damaged_bytes: int = 0
    damaged_chunks: int = 0
    lost: tuple[LostStretch, ...] = ()
    kept_aside: Path | None = None
    entry: SegmentEntry | None = None
    positions: dict[StreamId, int] = field(default_factory=dict)

    def __str__(self) -> str:
        """In words, with the first five losses."""
        text = f"{self.records:,} messages recovered of {self.segment}"
        if self.damaged_chunks:
            text += f", {self.damaged_bytes:,} bytes in {self.damaged_chunks} pieces could not be read"
        if self.lost:
            more = f" and {len(self.lost) - 5} more" if len(self.lost) > 5 else ""
            text += f"; lost: {'; '.join(str(each) for each in self.lost[:5])}{more}"
        return text


def left_open(store: Store) -> list[Path]:
    """Segments that are not sealed, in their order."""
    unfinished = (path for path in store.log.glob("*.mcap.*") if _UNFINISHED.fullmatch(path.name))
    return sorted(path for path in unfinished if is_own(store, path))


def abandoned_name(path: Path, durable_bytes: int) -> Path:
    """Name of an abandoned segment; only its durable bytes were ever acknowledged."""
    return path.with_name(f"{path.name}.abandoned-{durable_bytes}")


def recover_segment(store: Store, path: Path, known: dict[StreamId, int], disk: Disk = DISK) -> Recovery:
    """Seal an open segment, given the positions `known` before it; writer lock held; repeatable after an OSError."""
    match = _UNFINISHED.fullmatch(path.name)
    assert match is not None
    limit, sealed = int(match[2]) if match[2] else None, store.log / match[1]
    if sealed.exists():
        reached = reached_in(sealed)
        places = (place for _, place in placed(path, SegmentScan(path, limit)))
        if all(place is None or place.next_seq <= reached.get(place.stream, 0) for place in places):
            # it was copied by a process that ended before it could remove this one
            return Recovery(path.name, kept_aside=_quarantine(store, path, disk))
        sealed = next_free(sealed)  # another process sealed one of that number: both are kept
    return _seal(store, path, sealed, SegmentScan(path, limit), known, disk)


def salvage_segment(store: Store, path: Path, known: dict[StreamId, int]) -> Recovery:
    """Replace a damaged sealed segment by its readable part; the log must document its losses first."""
    aside = _aside(store, path)
    DISK.link(path, aside)
    DISK.sync_folder(store.aside)
    recovery = _copy(store, path, SegmentScan(aside, sealed=True), known, reached_in(aside), DISK, replaces=True)
    if recovery.entry is None:
        DISK.remove(path)
    return replace(recovery, kept_aside=aside)


def examine_segment(path: Path, known: dict[StreamId, int]) -> Recovery:
    """What can be salvaged of a damaged sealed segment, and what is lost; changes nothing."""
    scan = SegmentScan(path, sealed=True)
    tally, check = SegmentTally(), SequenceCheck()
    check.next_seq.update(known)
    for record, place in placed(path, scan):
        if place is None or check.follow(place):
            tally.add(record, place)
    for stream, next_seq in reached_in(path).items():
        check.reach(stream, next_seq)
    return _salvaged(path, scan, tally, check, None)


def reached_in(sealed: Path) -> dict[StreamId, int]:
    """Positions that streams reached in a sealed segment, whatever it still holds; empty if its marks are damaged."""
    try:
        return positions_of(read_marks(sealed))
    except (StoreError, ValueError):
        return {}


def unlisted_entry(store: Store, path: Path) -> tuple[SegmentEntry, dict[StreamId, int]]:
    """The entry and positions of a sealed segment that the manifest does not list."""
    tally = SegmentTally()
    for record, place in placed(path, read_segment(path)):
        tally.add(record, place)
    # a quarantined original beside it means that it is a salvaged copy
    beside = [*store.log.glob(f"{path.name}.*"), *store.aside.glob(f"{path.name}.*")]
    is_copy = any(".tail." not in each.name and not each.name.endswith(_COPY) for each in beside)
    positions = dict(tally.positions)
    raise_positions(positions, reached_in(path))
    origin = "salvaged" if is_copy else "found"
    return tally.entry(SealedSegment(path, path.stat().st_size, sha256_of(path)), origin), positions


def _seal(
    store: Store, path: Path, sealed: Path, scan: SegmentScan, known: dict[StreamId, int], disk: Disk
) -> Recovery:
    tally = SegmentTally()
    for record, place in placed(path, scan):
        tally.add(record, place)
    if scan.damaged:
        recovery = _copy(store, sealed, SegmentScan(path, scan.limit), known, {}, disk)
        return replace(recovery, segment=path.name, kept_aside=_quarantine(store, path, disk))
    if not tally.messages:
        if scan.torn is not None:
            return Recovery(path.name, kept_aside=_quarantine(store, path, disk))
        disk.remove(path)  # created, and nothing was written
        return Recovery(path.name)
    aside = None if scan.torn is None else _keep_tail(store, path, scan.whole_bytes, disk)
    suffix = path.name.removeprefix(sealed.name)
    with (
        path.open("rb") as file,
        mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content,
        memoryview(content) as view,
        view[: scan.whole_bytes] as whole,
    ):
        writer = SegmentWriter(sealed, suffix, disk, found=(whole, scan.summary), open_path=path)
    entry = tally.entry(writer.seal(tally.marks), "recovered")
    disk.sync_folder(sealed.parent)
    return Recovery(path.name, tally.messages, kept_aside=aside, entry=entry, positions=tally.positions)


def _copy(
    store: Store, sealed: Path, scan: SegmentScan, known: dict[StreamId, int], reached: dict[StreamId, int],
    disk: Disk, *, replaces: bool = False,
) -> Recovery:  # fmt: skip
    copy = sealed.with_name(sealed.name + _COPY)
    copy.unlink(missing_ok=True)
    tally = SegmentTally()
    check = SequenceCheck()
    check.next_seq.update(known)
    writer: SegmentWriter | None = None
    for record, place in placed(scan.path, scan):
        if place is not None and not check.follow(place):
            continue
        if writer is None:
            writer = SegmentWriter(sealed, _COPY, disk, store=store.identity)
        tally.add(record, place)
        writer.append(record)
    for stream, next_seq in reached.items():
        check.reach(stream, next_seq)
    raise_positions(tally.positions, reached)  # lost messages stay known
    if writer is None and tally.positions:
        writer = SegmentWriter(sealed, _COPY, disk, store=store.identity)
    entry = None
    if writer is not None:
        entry = tally.entry(writer.seal(tally.marks, replaces=replaces), "salvaged")
        disk.sync_folder(sealed.parent)
    return _salvaged(sealed, scan, tally, check, entry)


def _salvaged(
    path: Path, scan: SegmentScan, tally: SegmentTally, check: SequenceCheck, entry: SegmentEntry | None
) -> Recovery:
    damaged = sum(span.end - span.begin for span in scan.damaged)
    lost = tuple(check.lost)
    return Recovery(path.name, tally.messages, damaged, len(scan.damaged), lost, None, entry, tally.positions)


def _aside(store: Store, path: Path) -> Path:
    """A unique name in the quarantine folder."""
    store.aside.mkdir(exist_ok=True)
    return store.aside / f"{path.name}.{time.time_ns()}"


def _quarantine(store: Store, path: Path, disk: Disk) -> Path | None:
    """Quarantine a file; remove an empty one."""
    if path.stat().st_size == 0:
        disk.remove(path)
        return None
    aside = _aside(store, path)
    disk.rename(path, aside)
    disk.sync_folder(store.aside)
    disk.sync_folder(path.parent)
    return aside


def _keep_tail(store: Store, path: Path, begin: int, disk: Disk) -> Path:
    """Keep the tail that is cut off: an incomplete record, which was never acknowledged."""
    aside = _aside(store, path.with_name(f"{path.name}.tail"))
    with path.open("rb") as file:
        file.seek(begin)
        rest = file.read()
    disk.write_whole(disk.create(aside), rest)
    return aside
