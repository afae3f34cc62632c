"""Which files in a log are the store's own segments, and which somebody else has put there.

A segment says in its head which store wrote it and under which name; those of older versions say nothing and are taken
by their names. What the manifest lists counts in any case: its hash says whether it is what was written.
"""

import filecmp
import re
import time
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from storage.manifests.log import manifest_path, read_log_manifest
from storage.segments.disk import DISK
from storage.segments.reader import read_origin
from storage.store import Store
from storage.store_marker import MARKER

_SEALED = re.compile(r"\d+\.mcap")
# left open, given up, or being saved
_UNSEALED = re.compile(r"\d+\.mcap\.(open|recovering|abandoned-\d+)")


class UnknownFile(NamedTuple):
    """A file or folder in the log that is not the store's, and why it is not."""

    path: Path
    why: str


def sealed_segments(store: Store) -> list[Path]:
    """The store's own sealed segments, in their order."""
    return sorted(path for path in store.log.glob("*.mcap") if is_own(store, path))


def is_own(store: Store, path: Path) -> bool:
    """Whether a file in the log is a segment that the store has written, sealed or not."""
    return (_SEALED.fullmatch(path.name) or _UNSEALED.fullmatch(path.name)) is not None and _wrong(store, path) is None


def unknown_files(store: Store) -> list[UnknownFile]:
    """Everything in the log that is not the store's own; it is neither read nor brought to the lake."""
    found = []
    for path in sorted(store.log.iterdir()) if store.log.is_dir() else []:
        if path in {manifest_path(store), store.aside, store.log / MARKER}:
            continue
        if _SEALED.fullmatch(path.name) or _UNSEALED.fullmatch(path.name):
            why = _wrong(store, path)
        else:
            why = "it does not have the name of a segment"
        if why is not None and path.exists():  # else it was sealed meanwhile
            found.append(UnknownFile(path, why))
    return found


def quarantine_unknown(store: Store) -> list[tuple[UnknownFile, Path]]:
    """Move what is not the store's out of its log to ``log/aside``; each with where it is then."""
    moved = []
    for each in unknown_files(store):
        store.aside.mkdir(exist_ok=True)
        target = store.aside / f"{each.path.name}.unknown-{time.time_ns()}"
        DISK.rename(each.path, target)
        moved.append((each, target))
    if moved:
        DISK.sync_folder(store.aside)
        DISK.sync_folder(store.log)
    return moved


def _wrong(store: Store, path: Path) -> str | None:
    """Why what has the name of a segment is not one of the store's."""
    try:
        status = path.stat()
    except OSError:
        return "it is no file"
    if not path.is_file():
        return "it is no file"
    origin = _origin(str(path), status.st_ino, status.st_mtime_ns)
    name = path.name.partition(".")[0]
    if origin is None or origin == (store.identity, name) or f"{name}.mcap" in read_log_manifest(store).entries:
        return None
    if origin[0] != store.identity:
        return f"it is of another store ({origin[0]})"
    # a segment gets another number where its own was taken when it was sealed: only the same content is a copy
    first = store.log / f"{origin[1]}.mcap"
    try:
        is_copy = filecmp.cmp(first, path, shallow=False)
    except OSError:  # there is no such segment
        is_copy = False
    return f"it is a copy of segment {origin[1]}" if is_copy else None


@lru_cache(maxsize=100_000)
def _origin(path: str, _number: int, _mtime_ns: int) -> tuple[str, str] | None:
    return read_origin(Path(path))
