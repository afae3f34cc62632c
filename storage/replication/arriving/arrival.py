"""Arrival of a segment or file: fetched in ranges, verified, and visible only then.

What has arrived of it waits under ``replica/arriving`` and is resumed at its length. A kill at any moment leaves the
file whole under its name, or not at all.
"""

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from storage.replication.arriving.bandwidth import Bandwidth
from storage.replication.sources.source import CHUNK_BYTES, SegmentSource
from storage.segments.disk import DISK, Disk, OpenFile
from stream.errors import StoreError

_RESERVE_BYTES = 256 << 20
_RESERVE_SHARE = 0.05


class ArrivalRefused(StoreError):
    """What arrived is not what was listed; `kind` is one word."""

    def __init__(self, kind: str, what: str) -> None:
        super().__init__(what)
        self.kind = kind


class Wanted(NamedTuple):
    """A segment or file as it is listed."""

    name: str
    size: int
    sha256: str


class Arrivals:
    """Fetches into a store.

    Parameters
    ----------
    folder : Path
        Where unfinished files wait, on the file system of the store.
    bandwidth : Bandwidth
        The limit for everything that is read.
    on_bytes : callable
        Gets the number of bytes of each range that arrives.
    """

    def __init__(
        self, folder: Path, bandwidth: Bandwidth, on_bytes: Callable[[int], object] = lambda _size: None,
        disk: Disk = DISK,
    ) -> None:  # fmt: skip
        self._folder, self._bandwidth, self._on_bytes, self._disk = folder, bandwidth, on_bytes, disk
        folder.mkdir(parents=True, exist_ok=True)

    def fetch(self, source: SegmentSource, wanted: Wanted, target: Path, check: Callable[[Path], None]) -> None:
        """Fetch a file to `target`, which does not exist; durable with its name when this returns.

        `check` may raise ArrivalRefused for a file with the right hash. Raises ArrivalRefused if the content is not
        what was listed, SegmentMissing and SourceGone as the source does, StoreError if the disk is nearly full.
        """
        self._check_room(wanted)
        part = self._folder / f"{wanted.name.replace('/', '+')}.{wanted.sha256[:16]}"
        for attempt in (1, 2):
            is_resumed = part.exists() and part.stat().st_size > 0
            found = self._filled(source, wanted, part)
            if found == wanted.sha256:
                break
            part.unlink()
            if attempt == 2 or not is_resumed:  # what was left of an earlier attempt may be the damage
                raise ArrivalRefused(
                    "bad_hash",
                    f"{wanted.name} arrived with SHA-256 {found[:12]}, it is listed with {wanted.sha256[:12]}",
                )
        try:
            check(part)
        except ArrivalRefused:
            part.unlink()
            raise
        self._disk.rename(part, target)
        self._disk.sync_folder(target.parent)

    def _filled(self, source: SegmentSource, wanted: Wanted, part: Path) -> str:
        """Complete an unfinished file, durably; its SHA-256."""
        begun = part.stat().st_size if part.exists() else 0
        if begun > wanted.size:
            part.unlink()
            begun = 0
        digest = hashlib.sha256()
        if begun:
            with part.open("rb") as file:
                while piece := file.read(CHUNK_BYTES):
                    digest.update(piece)
            file_now = OpenFile(part, os.open(part, os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC))
        else:
            part.unlink(missing_ok=True)
            file_now = self._disk.create(part)
        try:
            at = begun
            while at < wanted.size:
                length = min(CHUNK_BYTES, wanted.size - at, self._bandwidth.most_at_once or CHUNK_BYTES)
                self._bandwidth.take(length)
                piece = source.read(wanted.name, at, length)
                if not 0 < len(piece) <= length:
                    kind, more = ("too_short", "ends") if not piece else ("too_long", "returns more than was asked for")
                    raise ArrivalRefused(kind, f"{wanted.name} {more} at byte {at:,} of {wanted.size:,}")
                self._disk.write(file_now, piece)
                digest.update(piece)
                at += len(piece)
                self._on_bytes(len(piece))
            self._disk.sync(file_now)
        finally:
            self._disk.close(file_now)
        return digest.hexdigest()

    def _check_room(self, wanted: Wanted) -> None:
        free, total = self._disk.space(self._folder)
        reserve = min(_RESERVE_BYTES, int(_RESERVE_SHARE * total))
        if free - wanted.size < reserve:
            raise StoreError(
                f"{free >> 20:,} MB are free on the disk of {self._folder}, {wanted.name} has {wanted.size >> 20:,} MB "
                f"and {reserve >> 20:,} MB are kept in reserve: free space, the next pass resumes"
            )
