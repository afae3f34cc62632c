"""The log's manifest: one line for each sealed segment, chained by hashes so that a lost line is noticed.

A line is the entry as JSON and, after a tab, the SHA-256 of the previous line and this entry. It is appended after the
segment is sealed; if the process is killed in between, the next one reads the segment and adds the line.
"""

import hashlib
import re
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import msgspec

from storage.segments.disk import DISK, Disk
from storage.store import Store

FIRST = "0" * 64
LOST = "lost"
_NAME = "manifest.jsonl"
_SEGMENT = re.compile(r"\d+\.mcap")


class SegmentEntry(msgspec.Struct, frozen=True, omit_defaults=True):
    """A sealed segment: name, bytes and SHA-256 of its file, and what it holds.

    Arrivals are by the recorder's clock. `runs` are those that it has samples or documents of, `ended` those whose end
    it has. `origin` is recorded, recovered (was left open), salvaged (readable part of a damaged one), found (sealed,
    without a line), or lost (documented in the log).
    """

    segment: str
    size: int
    sha256: str
    messages: int
    samples: int
    arrival_first_ns: int
    arrival_last_ns: int
    runs: tuple[str, ...] = ()
    ended: tuple[str, ...] = ()
    origin: str = "recorded"


class ManifestDamage(NamedTuple):
    """A damaged line of the manifest."""

    line: int
    reason: str


@dataclass
class LogManifest:
    """Last entry of each segment, and damage; numbers of `lost` segments, which no longer exist, are not reused."""

    entries: dict[str, SegmentEntry] = field(default_factory=dict)
    lost: dict[str, SegmentEntry] = field(default_factory=dict)
    damage: list[ManifestDamage] = field(default_factory=list)
    last: str = FIRST

    def take(self, entry: SegmentEntry) -> None:
        """Apply an entry."""
        mine, other = (self.lost, self.entries) if entry.origin == LOST else (self.entries, self.lost)
        other.pop(entry.segment, None)
        mine[entry.segment] = entry


_decoder = msgspec.json.Decoder(SegmentEntry)


def manifest_path(store: Store) -> Path:
    """Path of the manifest."""
    return store.log / _NAME


def read_log_manifest(store: Store) -> LogManifest:
    """Read the manifest; damaged lines are reported in it, an unfinished last line is ignored."""
    found = LogManifest()
    path = manifest_path(store)
    content = path.read_bytes() if path.exists() else b""
    lines = content.split(b"\n")
    lines.pop()  # empty, or an unfinished line
    for number, line in enumerate(lines, 1):
        text, _, chained = line.rpartition(b"\t")
        # the next line is checked against this line's own hash, so that one damaged line does not spoil the rest
        if not text or _chain(found.last, text) != chained.decode(errors="replace"):
            found.damage.append(ManifestDamage(number, "the line or the one before it is not what was written"))
            found.last = chained.decode(errors="replace")
            continue
        found.last = chained.decode()
        entry = _decoder.decode(text)
        if _SEGMENT.fullmatch(entry.segment) is None:
            found.damage.append(ManifestDamage(number, f"{entry.segment!r} is not the name of a segment"))
            continue
        found.take(entry)
    return found


class ManifestWriter:
    """Appends to the manifest of a store whose log this process writes."""

    def __init__(self, store: Store, disk: Disk = DISK) -> None:
        self._path = manifest_path(store)
        self._disk = disk
        self.found = read_log_manifest(store)
        # the rest after the last whole line is of an interrupted or failed write
        self._whole_bytes = self._path.read_bytes().rfind(b"\n") + 1 if self._path.exists() else 0

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
        self.found.take(entry)


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
