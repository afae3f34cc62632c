"""Segments that no process finished, or that are damaged: what they hold is sealed, what is lost is said.

A file without damage is finished where it lies, which takes no room on a full disk. Of a damaged one a copy is made of
what can be read, and the file itself is quarantined, whole.
"""

import hashlib
import mmap
import re
import time
from dataclasses import dataclass, replace
from pathlib import Path

from storage.log.files import is_own
from storage.log.numbers import next_free
from storage.log.sequence import LostStretch, SequenceCheck, place_of, stream_of
from storage.log.tally import SegmentTally
from storage.log.writer import SegmentWriter
from storage.manifests.log import SegmentEntry
from storage.segments.disk import DISK, Disk
from storage.segments.reader import SegmentScan, read_marks, read_segment
from storage.segments.records import SealedSegment
from storage.store import Store
from stream.delivery.publisher import StreamId
from stream.errors import StoreError

_ABANDONED = re.compile(r"(\d+\.mcap)\.abandoned-(\d+)")
_OPEN = re.compile(r"(\d+\.mcap)\.open")
_COPY = ".recovering"


@dataclass(frozen=True)
class Recovery:
    """What became of a segment that was left open, or was damaged.

    Parameters
    ----------
    segment: The file as it was called.
    records: Messages that it has now.
    damaged_bytes, damaged_chunks: What could not be read, and in how many pieces.
    lost: Samples and documents that are missing for it, as far as the numbers tell.
    kept_aside: The file as it was, where anything of it was left out.
    entry: The sealed segment; None if there was no message.
    positions: How far its streams have come.
    """

    segment: str
    records: int
    damaged_bytes: int
    damaged_chunks: int
    lost: tuple[LostStretch, ...]
    kept_aside: Path | None
    entry: SegmentEntry | None
    positions: dict[StreamId, int]


def left_open(store: Store) -> list[Path]:
    """Segments that are not sealed, in their order."""
    found = [
        path
        for path in store.log.glob("*.mcap.*")
        if (_ABANDONED.fullmatch(path.name) or _OPEN.fullmatch(path.name)) and is_own(store, path)
    ]
    return sorted(found)


def abandoned_name(path: Path, durable_bytes: int) -> Path:
    """Name of a segment that could not be written on: only so much of it was ever acknowledged."""
    return path.with_name(f"{path.name}.abandoned-{durable_bytes}")


def recover_segment(store: Store, path: Path, known: dict[StreamId, int], disk: Disk = DISK) -> Recovery:
    """Seal what a segment that was left open holds.

    Parameters
    ----------
    store: Whose; the caller holds its writer lock.
    path: The segment.
    known: How far the streams had come in the segments before.
    disk: Where to.

    Raises
    ------
    OSError: As the disk has it; it can be tried again.
    """
    match = _ABANDONED.fullmatch(path.name)
    limit = int(match[2]) if match else None
    sealed = store.log / (match[1] if match else path.name.removesuffix(".open"))
    if sealed.exists():
        if _is_copied(path, limit, sealed):  # by a process that ended before it could move this one
            return Recovery(path.name, 0, 0, 0, (), _keep_aside(store, path, disk), None, {})
        sealed = next_free(sealed)  # another process has sealed one of that number: both are kept
    return _seal(store, path, sealed, SegmentScan(path, limit), known, disk)


def salvage_segment(store: Store, path: Path, known: dict[StreamId, int], disk: Disk = DISK) -> Recovery:
    """Put in the place of a damaged sealed segment what can be read of it; parameters as of `recover_segment`.

    What `examine_segment` says is lost must be in the log before.
    """
    aside = _aside(store, path)
    disk.link(path, aside)
    disk.sync_folder(store.aside)
    recovery = _copy(store, path, SegmentScan(aside, sealed=True), known, reached_in(aside), disk, replaces=True)
    if recovery.entry is None:
        disk.remove(path)
    return replace(recovery, kept_aside=aside)


def examine_segment(path: Path, known: dict[StreamId, int]) -> Recovery:
    """What can be saved of a damaged sealed segment, and what is lost; nothing is changed."""
    scan = SegmentScan(path, sealed=True)
    tally, check = SegmentTally(), SequenceCheck()
    check.next_seq.update(known)
    for record in scan:
        place = place_of(record)
        if place is None or check.follow(place):
            tally.add(record, place)
    for stream, next_seq in reached_in(path).items():
        check.reach(stream, next_seq)
    damaged = sum(span.end - span.begin for span in scan.damaged)
    return Recovery(
        path.name, tally.messages, damaged, len(scan.damaged), tuple(check.lost), None, None, tally.positions
    )


def reached_in(sealed: Path) -> dict[StreamId, int]:
    """How far the streams of a sealed segment had come in it, whatever it still holds; empty if that is damaged."""
    try:
        return {stream_of(text): int(next_seq) for text, next_seq in read_marks(sealed).items()}
    except (StoreError, ValueError):
        return {}


def take_in(store: Store, path: Path) -> tuple[SegmentEntry, dict[StreamId, int]]:
    """The entry of a sealed segment that the manifest does not list, and its positions.

    Raises
    ------
    StoreError: If it is damaged.
    """
    tally = SegmentTally()
    for record in read_segment(path):
        tally.add(record, place_of(record))
    with path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    # where the file that it was made of was kept whole, it is what could be saved of that
    beside = [*store.log.glob(f"{path.name}.*"), *store.aside.glob(f"{path.name}.*")]
    is_copy = any(".tail." not in each.name and not each.name.endswith(_COPY) for each in beside)
    positions = dict(tally.positions)
    for stream, next_seq in reached_in(path).items():
        positions[stream] = max(positions.get(stream, 0), next_seq)
    origin = "salvaged" if is_copy else "found"
    return tally.entry(SealedSegment(path, path.stat().st_size, sha256), origin), positions


def _is_copied(path: Path, limit: int | None, sealed: Path) -> bool:
    """Whether a sealed segment has all the numbered messages that one which was left open has."""
    reached = reached_in(sealed)
    places = (place_of(record) for record in SegmentScan(path, limit))
    return all(place is None or place.next_seq <= reached.get(place.stream, 0) for place in places)


def _seal(
    store: Store, path: Path, sealed: Path, scan: SegmentScan, known: dict[StreamId, int], disk: Disk
) -> Recovery:
    tally = SegmentTally()
    for record in scan:
        tally.add(record, place_of(record))
    if scan.damaged:
        recovery = _copy(store, sealed, SegmentScan(path, scan.limit), known, {}, disk)
        return replace(recovery, segment=path.name, kept_aside=_keep_aside(store, path, disk))
    if not tally.messages and scan.torn is None:
        disk.remove(path)  # begun, and nothing was written
        return Recovery(path.name, 0, 0, 0, (), None, None, {})
    if not tally.messages:
        return Recovery(path.name, 0, 0, 0, (), _keep_aside(store, path, disk), None, {})
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
    return Recovery(path.name, tally.messages, 0, 0, (), aside, entry, tally.positions)


def _copy(
    store: Store,
    sealed: Path,
    scan: SegmentScan,
    known: dict[StreamId, int],
    reached: dict[StreamId, int],
    disk: Disk,
    *,
    replaces: bool = False,
) -> Recovery:
    copy = sealed.with_name(sealed.name + _COPY)
    copy.unlink(missing_ok=True)
    tally = SegmentTally()
    check = SequenceCheck()
    check.next_seq.update(known)
    writer: SegmentWriter | None = None
    for record in scan:
        place = place_of(record)
        if place is not None and not check.follow(place):
            continue
        if writer is None:
            writer = SegmentWriter(sealed, _COPY, disk, store=store.identity)
        tally.add(record, place)
        writer.append(record)
    for stream, next_seq in reached.items():
        check.reach(stream, next_seq)
        # that there was more stays known
        tally.positions[stream] = max(tally.positions.get(stream, 0), next_seq)
    if writer is None and tally.positions:
        writer = SegmentWriter(sealed, _COPY, disk, store=store.identity)
    damaged = sum(span.end - span.begin for span in scan.damaged)
    entry = None
    if writer is not None:
        entry = tally.entry(writer.seal(tally.marks, replaces=replaces), "salvaged")
        disk.sync_folder(sealed.parent)
    return Recovery(
        sealed.name, tally.messages, damaged, len(scan.damaged), tuple(check.lost), None, entry, tally.positions
    )


def _aside(store: Store, path: Path) -> Path:
    """A name to keep a file under that is never used again."""
    store.aside.mkdir(exist_ok=True)
    return store.aside / f"{path.name}.{time.time_ns()}"


def _keep_aside(store: Store, path: Path, disk: Disk) -> Path | None:
    """Move a file out of the way; an empty one is removed."""
    if path.stat().st_size == 0:
        disk.remove(path)
        return None
    aside = _aside(store, path)
    disk.rename(path, aside)
    disk.sync_folder(store.aside)
    disk.sync_folder(path.parent)
    return aside


def _keep_tail(store: Store, path: Path, begin: int, disk: Disk) -> Path:
    """Keep what is to be cut off: a record that was not written to its end, which nobody was told is safe."""
    aside = _aside(store, path.with_name(f"{path.name}.tail"))
    with path.open("rb") as file:
        file.seek(begin)
        rest = file.read()
    copy = disk.create(aside)
    try:
        disk.write(copy, rest)
        disk.sync(copy)
    finally:
        disk.close(copy)
    return aside
