"""The log's manifest: one line for each sealed segment, chained by hashes so that a lost line is noticed.

A line is the entry as JSON and, after a tab, the SHA-256 of the previous line and this entry. It is appended after the
segment is sealed; if the process is killed in between, the next one reads the segment and adds the line. Who writes the
log keeps a snapshot of a long manifest, bound to it by length and chain, so that others read only the lines after it.
"""

import hashlib
import re
import time
from collections.abc import Iterable, MutableMapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import msgspec

from storage.manifests.entries import SPAN, EntriesState, SegmentEntries, SegmentEntry
from storage.segments.disk import DISK, Disk
from storage.store import Store
from stream.decoding import decode_msgpack, json_decoder
from stream.files.atomic_file import write_durably

FIRST = "0" * 64
LOST = "lost"
_NAME = "manifest.jsonl"
SNAPSHOT = "log-manifest.snapshot"
_SEGMENT = re.compile(r"\d+\.mcap")


class ManifestDamage(NamedTuple):
    """A damaged line of the manifest."""

    line: int
    reason: str


@dataclass
class LogManifest:
    """Last entry of each segment, and damage; numbers of `lost` segments, which no longer exist, are not reused."""

    entries: MutableMapping[str, SegmentEntry] = field(default_factory=SegmentEntries)
    lost: dict[str, SegmentEntry] = field(default_factory=dict)
    damage: list[ManifestDamage] = field(default_factory=list)
    last: str = FIRST
    lines: int = 0
    whole_bytes: int = 0  # up to the end of the last whole line

    def take(self, entry: SegmentEntry) -> None:
        """Apply an entry."""
        if entry.origin == LOST:
            self.entries.pop(entry.segment, None)
            self.lost[entry.segment] = entry
        else:
            self.lost.pop(entry.segment, None)
            self.entries[entry.segment] = entry


class _Snapshot(msgspec.Struct, frozen=True):
    """A manifest as it was after some of its lines, undamaged."""

    whole_bytes: int
    lines: int
    last: str
    entries: EntriesState
    lost: list[SegmentEntry]


_decoder = json_decoder(SegmentEntry)


def manifest_path(store: Store) -> Path:
    """Path of the manifest."""
    return store.log / _NAME


def read_log_manifest(store: Store, *, whole: bool = False) -> LogManifest:
    """Read the manifest; damaged lines are reported in it, an unfinished last line is ignored.

    Lines before a snapshot are read only as a `whole`, which finds damage in them.
    """
    path = manifest_path(store)
    found = LogManifest() if whole else _from_snapshot(store)
    try:
        file = path.open("rb")
    except FileNotFoundError:
        return LogManifest()
    with file:
        file.seek(found.whole_bytes)
        for line in file:
            if line.endswith(b"\n"):
                _take_line(found, line[:-1])
                found.whole_bytes += len(line)
    return found


def _take_line(found: LogManifest, line: bytes) -> None:
    found.lines += 1
    text, _, chained = line.rpartition(b"\t")
    # the next line is checked against this line's own hash, so that one damaged line does not spoil the rest
    if not text or _chain(found.last, text) != chained.decode(errors="replace"):
        found.damage.append(ManifestDamage(found.lines, "the line or the one before it is not what was written"))
        found.last = chained.decode(errors="replace")
        return
    found.last = chained.decode()
    try:
        entry = _decoder.decode(text)
    except (
        msgspec.MsgspecError,
        UnicodeDecodeError,
        RecursionError,
    ) as error:  # its hash is right: somebody has computed it
        found.damage.append(ManifestDamage(found.lines, f"it is no entry of a segment: {error}"))
        return
    if _SEGMENT.fullmatch(entry.segment) is None:
        found.damage.append(ManifestDamage(found.lines, f"{entry.segment!r} is not the name of a segment"))
        return
    found.take(entry)


def _from_snapshot(store: Store) -> LogManifest:
    """The manifest as the snapshot has it; an empty one without a snapshot of this manifest."""
    try:
        content = (store.folder / SNAPSHOT).read_bytes()
        if hashlib.sha256(content[64:]).hexdigest().encode() != content[:64]:
            return LogManifest()
        snapshot = decode_msgpack(content[64:], _Snapshot)
        end = f"\t{snapshot.last}\n".encode()
        with manifest_path(store).open("rb") as file:
            file.seek(snapshot.whole_bytes - len(end))
            if file.read(len(end)) != end:
                return LogManifest()
    except (OSError, ValueError, msgspec.MsgspecError):
        return LogManifest()
    return LogManifest(
        SegmentEntries(snapshot.entries), {entry.segment: entry for entry in snapshot.lost}, [], snapshot.last,
        snapshot.lines, snapshot.whole_bytes,
    )  # fmt: skip


class ManifestWriter:
    """Appends to the manifest of a store whose log this process writes."""

    def __init__(self, store: Store, disk: Disk = DISK) -> None:
        self._path = manifest_path(store)
        self._disk = disk
        self._snapshot = store.folder / SNAPSHOT
        self.found = read_log_manifest(store)
        # the rest after the last whole line is of an interrupted or failed write
        self._whole_bytes = self.found.whole_bytes
        self._in_snapshot = _from_snapshot(store).lines if self.found.lines >= SPAN else 0
        self._keep_snapshot()

    def add(self, entry: SegmentEntry) -> None:
        """Append an entry, durably; after an OSError the next start adds the segment."""
        text = msgspec.json.encode(entry)
        chained = _chain(self.found.last, text)
        line = text + b"\t" + chained.encode() + b"\n"
        is_new = not self._path.exists()
        file = self._disk.create(self._path) if is_new else self._disk.reopen(self._path, self._whole_bytes)
        self._disk.write_whole(file, line)
        if is_new:
            self._disk.sync_folder(self._path.parent)
        self._whole_bytes += len(line)
        self.found.last = chained
        self.found.lines += 1
        self.found.whole_bytes = self._whole_bytes
        self.found.take(entry)
        self._keep_snapshot()

    def _keep_snapshot(self) -> None:
        """Write a snapshot once it saves reading many lines; without room on the disk there is none."""
        found = self.found
        if found.damage or found.lines - self._in_snapshot < SPAN or not isinstance(found.entries, SegmentEntries):
            return
        self._in_snapshot = found.lines
        snapshot = _Snapshot(
            found.whole_bytes, found.lines, found.last, found.entries.state(), list(found.lost.values())
        )
        content = msgspec.msgpack.encode(snapshot)
        with suppress(OSError):
            write_durably(self._snapshot, hashlib.sha256(content).hexdigest().encode() + content)


def rewrite_manifest(store: Store, entries: Iterable[SegmentEntry]) -> Path | None:
    """Replace the manifest; returns the path of the old one in the quarantine."""
    path = manifest_path(store)
    store.tmp.mkdir(exist_ok=True)
    fresh = store.tmp / _NAME
    fresh.unlink(missing_ok=True)
    last, lines = FIRST, []
    for entry in entries:
        text = msgspec.json.encode(entry)
        last = _chain(last, text)
        lines.append(text + b"\t" + last.encode() + b"\n")
    DISK.write_whole(DISK.create(fresh), b"".join(lines))
    aside = None
    if path.exists():
        store.aside.mkdir(exist_ok=True)
        aside = store.aside / f"{_NAME}.{time.time_ns()}"
        DISK.link(path, aside)  # there is a manifest at every moment
        DISK.sync_folder(store.aside)
    DISK.replace(fresh, path)
    DISK.sync_folder(path.parent)
    return aside


def _chain(last: str, text: bytes) -> str:
    return hashlib.sha256(last.encode() + text).hexdigest()
