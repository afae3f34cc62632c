"""``store.json``: the marker of a store with its identity, and a copy of it in the log."""

import fcntl
import hashlib
import json
import os
import re
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from storage.segments.disk import DISK
from stream.errors import BadInput, StoreError
from stream.files.atomic_file import write_durably

STORE_FORMAT = 1
MARKER = "store.json"
FLEET_MARKER = "fleet.json"
BACKUP = "backup.json"
"""What a backup holds: a folder with it is no store, though it has the store's log."""
REPLICA = "replica"
"""Folder in the copy of a plant's store that a fleet store holds; such a store is written by replication alone."""
RECEIVED = "segments.jsonl"
"""In that folder, the plant's list of its segments as it was received."""
_SEGMENT = re.compile(r"\d{8}\.mcap(\..*)?")
_IDENTITY = re.compile(r"[0-9a-f]{32}")
_CHECKSUM = "sha256"
_WITHOUT_CHECKSUM = {"format", "id", "created_ns"}  # of the oldest stores


def check_folder(folder: Path) -> None:
    """Raise BadInput for an address on an object store where a folder is meant: it would become a folder ``s3:`` here.

    >>> check_folder(Path("s3://gyros/backup"))
    Traceback (most recent call last):
    ...
    stream.errors.BadInput: s3:/gyros/backup looks like an address on an object store, and a folder is meant here
    """
    if re.match(r"s3:(/|$)", str(folder), re.IGNORECASE):
        raise BadInput(f"{folder} looks like an address on an object store, and a folder is meant here")


def read_marker(marker: Path) -> str:
    """Identity of a store."""
    try:
        written = json.loads(marker.read_text())
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    if not isinstance(written, dict):
        raise ValueError("it is not a JSON object")
    checksum = written.pop(_CHECKSUM, None)
    if checksum is not None and checksum != _checksum(written):
        raise ValueError("its checksum does not match")
    found, identity = written.get("format"), written.get("id")
    if isinstance(found, int) and found > STORE_FORMAT:
        raise StoreError(
            f"{marker} has store format {found}, this gyrofleet reads up to {STORE_FORMAT}: upgrade gyrofleet"
        )
    if checksum is None and written.keys() != _WITHOUT_CHECKSUM:
        raise ValueError("it has no checksum")
    if found != STORE_FORMAT or not isinstance(identity, str) or _IDENTITY.fullmatch(identity) is None:
        raise ValueError("format or identity is missing")
    return identity


def write_markers(folder: Path, identity: str) -> None:
    """Write a store's marker if it is missing, and its copy in the log if it differs; both durably."""
    marker = folder / MARKER
    if not marker.exists():
        content: dict[str, object] = {"format": STORE_FORMAT, "id": identity, "created_ns": time.time_ns()}
        line = json.dumps(content | {_CHECKSUM: _checksum(content)}) + "\n"
        write_durably(marker, line.encode(), fresh=folder / "tmp" / MARKER)
        DISK.sync_folder(folder.parent)
    copy, content_now = folder / "log" / MARKER, marker.read_bytes()
    if (not copy.exists() or copy.read_bytes() != content_now) and os.access(copy.parent, os.W_OK):
        write_durably(copy, content_now, fresh=folder / "tmp" / MARKER)


def copy_fault(folder: Path) -> str | None:
    """What is wrong with the copy of a store's marker in its log; None if nothing is."""
    copy = folder / "log" / MARKER
    try:
        return None if copy.read_bytes() == (folder / MARKER).read_bytes() else f"it differs from {folder / MARKER}"
    except FileNotFoundError:
        return "it is missing"


def is_replica(folder: Path) -> bool:
    """Whether a store is a fleet store's copy of a plant."""
    return (folder / REPLICA).is_dir()


def identity_of_copy(folder: Path) -> str | None:
    """Identity in the copy of the marker; None if that is missing or damaged."""
    try:
        return read_marker(folder / "log" / MARKER)
    except (OSError, ValueError):
        return None


def identity_of_segments(folder: Path) -> str | None:
    """Identity that most segments of the log name; None if none does."""
    from storage.segments.reader import read_origin

    found = Counter(origin[0] for path in (folder / "log").glob("*.mcap") if (origin := read_origin(path)) is not None)
    return next((identity for identity, _ in found.most_common(1) if _IDENTITY.fullmatch(identity)), None)


def is_repairable(folder: Path) -> bool:
    """Whether a folder without a valid marker holds a store's log."""
    if (folder / BACKUP).exists():
        return False
    try:
        return identity_of_copy(folder) is not None or any(
            _SEGMENT.fullmatch(path.name) for path in (folder / "log").iterdir()
        )
    except OSError:
        return False


def is_unfinished(folder: Path) -> bool:
    """Whether a folder is empty, or holds only what an interrupted creation of a store leaves."""
    left = {path.relative_to(folder).as_posix() for path in folder.rglob("*")}
    return left <= {"log", "lake", "tmp", f"tmp/{MARKER}"}


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Lock a folder while a store is created in it; leaves no file."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _checksum(content: dict[str, object]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
