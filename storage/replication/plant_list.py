"""A plant's chained list of segments as a fleet store has received it: only ever continued, never changed."""

import hashlib
import re
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

import msgspec

from storage.manifests.entries import SegmentEntry
from storage.manifests.log import FIRST, LOST
from storage.replication.sources.source import MAX_LINE_BYTES, MAX_SEGMENT_BYTES, is_segment
from storage.segments.disk import DISK, Disk
from stream.decoding import json_decoder
from stream.errors import StoreError
from stream.files.atomic_file import write_durably

SALVAGED = "salvaged"
_SHA256 = re.compile(r"[0-9a-f]{64}")
_decoder = json_decoder(SegmentEntry)


class ListRefused(StoreError):
    """A list that is not the continuation of what was received; `kind` is one word, `segment` may be empty."""

    def __init__(self, kind: str, segment: str, what: str) -> None:
        super().__init__(what)
        self.kind, self.segment = kind, segment


class Line(NamedTuple):
    """A line of a plant's list, checked by itself and against the one before it."""

    raw: bytes
    entry: SegmentEntry
    chained: str


class PlantList:
    """The lines received of a plant, in ``replica/segments.jsonl``.

    `entries` are the segments as they were first listed: what the plant lists later under a name that is taken never
    replaces it. `salvaged` are what the plant has left of damaged ones, `lost` those that it has lost.
    """

    def __init__(self, path: Path, disk: Disk = DISK) -> None:
        self.path, self._disk = path, disk
        content = path.read_bytes() if path.exists() else b""
        self._load(content[: content.rfind(b"\n") + 1])  # the rest is of an interrupted write

    def _load(self, content: bytes) -> None:
        self.entries: dict[str, SegmentEntry] = {}
        self.salvaged: dict[str, SegmentEntry] = {}
        self.lost: dict[str, SegmentEntry] = {}
        self.count, self.last, self.last_line, self._whole_bytes = 0, FIRST, b"", 0
        for raw in content.split(b"\n")[:-1]:
            try:
                self._apply(checked_line(raw, self.last))
            except ListRefused as error:
                raise StoreError(
                    f"{self.path} is damaged in line {self.count + 1}; delete it, the list is then received again"
                ) from error

    def check(self, raw: bytes) -> Line:
        """The next line, if it continues the list; ListRefused if it does not, or changes an earlier segment."""
        line = checked_line(raw, self.last)
        entry = line.entry
        known = self.entries.get(entry.segment)
        if known is not None and entry.origin not in (LOST, SALVAGED) and entry.sha256 != known.sha256:
            raise ListRefused(
                "changed_segment", entry.segment,
                f"segment {entry.segment} is listed with SHA-256 {entry.sha256[:12]}, it was listed before with "
                f"{known.sha256[:12]}: a sealed segment never changes",
            )  # fmt: skip
        return line

    def append(self, line: Line) -> None:
        """Take a line, durably."""
        is_new = not self.path.exists()
        file = self._disk.create(self.path) if is_new else self._disk.reopen(self.path, self._whole_bytes)
        self._disk.write_whole(file, line.raw + b"\n")
        if is_new:
            self._disk.sync_folder(self.path.parent)
        self._apply(line)

    def replace(self, lines: Iterable[bytes], is_held: Callable[[str], bool]) -> None:
        """Take a list that the plant has rewritten, as its `gyrofleet recover` does; the old one is kept beside it.

        ListRefused if it is not the same history: if it lacks or changes a segment that was listed.
        """
        fresh = PlantList(self.path.with_name("nothing"))
        content = []
        for raw in lines:
            fresh._apply(fresh.check(raw))
            content.append(raw + b"\n")
        for name, entry in self.entries.items():
            found = fresh.entries.get(name)
            if (found is None and name in fresh.lost) or (found is not None and found.sha256 == entry.sha256):
                continue
            if found is not None and found.origin == SALVAGED and is_held(name):
                continue
            what = "is not in it" if found is None else f"has another SHA-256 in it ({found.sha256[:12]})"
            raise ListRefused(
                "fork", name,
                f"the plant's list is another one since line {_first_difference(self.path, content) + 1}: segment "
                f"{name}, listed before with SHA-256 {entry.sha256[:12]}, {what}",
            )  # fmt: skip
        aside = self.path.with_name(f"{self.path.name}.{time.time_ns()}")
        self._disk.link(self.path, aside)
        write_durably(self.path, b"".join(content))
        self._load(b"".join(content))

    def _apply(self, line: Line) -> None:
        entry = line.entry
        name = entry.segment
        if entry.origin == LOST:
            self.lost[name] = entry
        elif name in self.entries:
            self.lost.pop(name, None)
            if entry.sha256 != self.entries[name].sha256:
                self.salvaged[name] = entry
            else:  # restored
                self.salvaged.pop(name, None)
        else:
            self.lost.pop(name, None)
            self.entries[name] = entry
        self.count, self.last, self.last_line = self.count + 1, line.chained, line.raw
        self._whole_bytes += len(line.raw) + 1


def checked_line(raw: bytes, last: str) -> Line:
    """A line of a list, given the hash of the line before it; ListRefused if it is not one."""
    if len(raw) > MAX_LINE_BYTES:
        raise ListRefused("line_too_long", "", f"a line of the list has {len(raw):,} bytes, at most {MAX_LINE_BYTES:,}")
    text, _, chained = raw.rpartition(b"\t")
    if hashlib.sha256(last.encode() + text).hexdigest().encode() != chained:
        raise ListRefused(
            "chain_broken", "", f"the line of the list is not the next one after {last[:12]}: {raw[:80]!r}"
        )
    try:
        entry = _decoder.decode(text)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise ListRefused("line_invalid", "", f"a line of the list cannot be read: {error}") from error
    if not is_segment(entry.segment):
        raise ListRefused("line_invalid", "", f"{entry.segment[:80]!r} is not the name of a segment")
    if entry.size > MAX_SEGMENT_BYTES:
        what = f"segment {entry.segment} has {entry.size:,} bytes, at most {MAX_SEGMENT_BYTES:,} are taken"
        raise ListRefused("segment_too_long", entry.segment, what)
    numbers = (entry.size, entry.messages, entry.samples, entry.arrival_first_ns, entry.arrival_last_ns)
    if entry.origin != LOST and (_SHA256.fullmatch(entry.sha256) is None or min(numbers[:3]) < 0):
        raise ListRefused("line_invalid", entry.segment, f"segment {entry.segment} is listed without size or SHA-256")
    return Line(raw, entry, chained.decode())


def segment_named(raw: bytes) -> str:
    """The segment of a line that was received."""
    return _decoder.decode(raw.rpartition(b"\t")[0]).segment


def _first_difference(path: Path, lines: list[bytes]) -> int:
    received = path.read_bytes().splitlines(keepends=True)
    pairs = zip(received, lines, strict=False)
    return next((number for number, (mine, other) in enumerate(pairs) if mine != other), min(len(received), len(lines)))
