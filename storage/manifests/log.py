"""The log's manifest: what every sealed segment is, one line each, chained so that no line can be lost unseen.

A line is the entry as JSON and, after a tab, the SHA-256 of the line before and this entry. It is appended after the
segment is sealed; a segment that was sealed by a process that was killed before it could write the line is read
whole and taken in by the next.
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
    """What is known of a sealed segment.

    Parameters
    ----------
    segment: Name of its file.
    size, sha256: Its length in bytes and its hash.
    messages, samples: What it holds; samples are those of batches.
    arrival_first_ns, arrival_last_ns: Between which moments its messages came in, by the recorder's clock.
    runs, ended: Runs that it has samples or documents of, and those whose end it has.
    origin: How it came to be: recorded, recovered (left open by a process that ended), salvaged (around damage), found
        (sealed, without a line of its own); lost, where it is not there any more and the log says so.
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

    @property
    def is_lost(self) -> bool:
        """Whether only its number is kept."""
        return self.origin == LOST


class ManifestDamage(NamedTuple):
    """A line of the manifest that does not hold."""

    line: int
    reason: str


@dataclass
class LogManifest:
    """What the manifest says, and where it cannot be believed; the last entry of a segment counts.

    `lost` has those that are not there any more: their numbers are not given again.
    """

    entries: dict[str, SegmentEntry] = field(default_factory=dict)
    lost: dict[str, SegmentEntry] = field(default_factory=dict)
    damage: list[ManifestDamage] = field(default_factory=list)
    last: str = FIRST

    def take(self, entry: SegmentEntry) -> None:
        """Let an entry count."""
        mine, other = (self.lost, self.entries) if entry.is_lost else (self.entries, self.lost)
        other.pop(entry.segment, None)
        mine[entry.segment] = entry


_decoder = msgspec.json.Decoder(SegmentEntry)


def manifest_path(store: Store) -> Path:
    """Where the manifest is."""
    return store.log / _NAME


def read_log_manifest(store: Store) -> LogManifest:
    """Read what is there; a line that does not hold is noted, one at the end that was not finished is left out."""
    found = LogManifest()
    path = manifest_path(store)
    content = path.read_bytes() if path.exists() else b""
    lines = content.split(b"\n")
    lines.pop()  # empty, or a line that was not finished
    for number, line in enumerate(lines, 1):
        text, _, chained = line.rpartition(b"\t")
        # what follows is judged by what this line says of itself, so that one damaged line is not all of them
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
    """Appends to the manifest of a store whose log this process writes.

    Parameters
    ----------
    store: Whose.
    disk: Where to.
    """

    def __init__(self, store: Store, disk: Disk = DISK) -> None:
        self._path = manifest_path(store)
        self._disk = disk
        self.found = read_log_manifest(store)
        # what lies behind the last whole line was never finished, by a process before this or by a failed write
        self._whole_bytes = self._path.read_bytes().rfind(b"\n") + 1 if self._path.exists() else 0

    def add(self, entry: SegmentEntry) -> None:
        """Make an entry durable.

        Raises
        ------
        OSError: As the disk has it; the segment is then taken in at the next start.
        """
        text = msgspec.json.encode(entry)
        chained = _chain(self.found.last, text)
        line = text + b"\t" + chained.encode() + b"\n"
        is_new = not self._path.exists()
        file = self._disk.create(self._path) if is_new else self._disk.reopen(self._path, self._whole_bytes)
        try:
            self._disk.write(file, line)
            self._disk.sync(file)
        finally:
            self._disk.close(file)
        if is_new:
            self._disk.sync_folder(self._path.parent)
        self._whole_bytes += len(line)
        self.found.last = chained
        self.found.take(entry)


def rewrite_manifest(store: Store, entries: Iterable[SegmentEntry], disk: Disk = DISK) -> Path | None:
    """Write the manifest anew; what was there is quarantined, and its new place returned."""
    path = manifest_path(store)
    store.tmp.mkdir(exist_ok=True)
    fresh = store.tmp / _NAME
    fresh.unlink(missing_ok=True)
    last, lines = FIRST, []
    for entry in entries:
        text = msgspec.json.encode(entry)
        last = _chain(last, text)
        lines.append(text + b"\t" + last.encode() + b"\n")
    file = disk.create(fresh)
    try:
        disk.write(file, b"".join(lines))
        disk.sync(file)
    finally:
        disk.close(file)
    aside = None
    if path.exists():
        store.aside.mkdir(exist_ok=True)
        aside = store.aside / f"{_NAME}.{time.time_ns()}"
        disk.link(path, aside)  # at no moment is there none
        disk.sync_folder(store.aside)
    disk.replace(fresh, path)
    disk.sync_folder(path.parent)
    return aside


def _chain(last: str, text: bytes) -> str:
    return hashlib.sha256(last.encode() + text).hexdigest()
