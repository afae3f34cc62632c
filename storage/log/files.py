"""The files of a log: which are the store's own segments, and which numbers are taken.

A segment names in its head the store that wrote it and its number; those of older versions are recognised by their
file names. A segment that the manifest lists is the store's own in any case: its hash tells whether it is intact.
"""

import filecmp
import re
import time
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from storage.manifests.lake import NEW_LAKE, LakeManifestDamaged, found_parts, read_manifest
from storage.manifests.log import manifest_path, read_log_manifest
from storage.segments.disk import DISK
from storage.segments.reader import read_origin
from storage.store import Store
from storage.store_marker import MARKER

# sealed; or open, being salvaged, or abandoned
_SEGMENT = re.compile(r"\d+\.mcap(\.(open|recovering|abandoned-\d+))?")


class UnknownFile(NamedTuple):
    """A file or folder in the log that does not belong to the store, and why."""

    path: Path
    why: str


def sealed_segments(store: Store) -> list[Path]:
    """The store's own sealed segments, in their order."""
    return sorted(path for path in store.log.glob("*.mcap") if is_own(store, path))


def is_own(store: Store, path: Path) -> bool:
    """Whether a file in the log is a segment of the store, sealed or not."""
    return _SEGMENT.fullmatch(path.name) is not None and _foreign_reason(store, path) is None


def unknown_files(store: Store) -> list[UnknownFile]:
    """Everything in the log that is not the store's own; it is neither read nor brought to the lake."""
    found = []
    for path in sorted(store.log.iterdir()) if store.log.is_dir() else []:
        if path in {manifest_path(store), store.aside, store.log / MARKER}:
            continue
        is_named = _SEGMENT.fullmatch(path.name) is not None
        why = _foreign_reason(store, path) if is_named else "it does not have the name of a segment"
        if why is not None and path.exists():  # else it has been sealed meanwhile
            found.append(UnknownFile(path, why))
    return found


def quarantine_unknown(store: Store) -> list[tuple[UnknownFile, Path]]:
    """Move unknown files from the log to ``log/aside``; each with its new path."""
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


def highest_number(store: Store) -> int:
    """The highest number that a segment of the log has or ever had; 0 for none.

    Lost segments are known from the manifest, the lake and the quarantine. Their numbers are not reused, since the lake
    would take new segments for those it already has.
    """
    return max((int(name) for name in _known_names(store) if name.isdecimal()), default=0)


def next_free(path: Path) -> Path:
    """The name after all segments beside `path`, open and abandoned ones included.

    >>> next_free(Path("/nowhere/00000041.mcap")).name
    '00000042.mcap'
    """
    taken = [each.name.partition(".")[0] for each in (*path.parent.glob("*.mcap*"), path)]
    return path.with_name(f"{max(int(name) for name in taken if name.isdecimal()) + 1:08d}.mcap")


def _known_names(store: Store) -> Iterator[str]:
    for folder in (store.log, store.aside, store.folder / "lake-aside"):
        yield from (path.name.partition(".")[0] for path in folder.glob("*"))
    manifest = read_log_manifest(store)
    yield from (name.partition(".")[0] for name in (*manifest.entries, *manifest.lost))
    for folder in (store.lake, store.folder / NEW_LAKE):
        lake = Store(store.folder, store.identity)
        lake.lake = folder
        try:
            in_force = read_manifest(lake)
        except LakeManifestDamaged:
            parts = tuple(found_parts(lake))
        else:
            parts = in_force.parts
            yield from in_force.dropped
        yield from (segment for part in parts for segment in part.segments)


def _foreign_reason(store: Store, path: Path) -> str | None:
    """Why a file with the name of a segment is not one of the store's; None if it is."""
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
    # a segment whose number was taken when it was sealed has another one: only equal content is a copy
    try:
        is_copy = filecmp.cmp(store.log / f"{origin[1]}.mcap", path, shallow=False)
    except OSError:  # there is no such segment
        is_copy = False
    return f"it is a copy of segment {origin[1]}" if is_copy else None


@lru_cache(maxsize=100_000)
def _origin(path: str, _number: int, _mtime_ns: int) -> tuple[str, str] | None:
    return read_origin(Path(path))
