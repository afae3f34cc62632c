"""Backup of a store: a folder with its log and what cannot be computed from it; the next one adds what is new.

``backup.json`` says what is in force and is written last, so that an interrupted backup leaves the one before.
"""

import errno
import shlex
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec

from storage.backup.content import DATABASE, other_files, unlisted_segments
from storage.backup.copied_file import CopiedFile, copy_database, copy_file
from storage.manifests.entries import SegmentEntry
from storage.manifests.log import LogManifest, manifest_path, read_log_manifest
from storage.recording.disk_watch import format_bytes
from storage.segments.disk import DISK, sha256_of
from storage.store import Store, only_one
from storage.store_marker import BACKUP, MARKER, check_folder
from stream.decoding import decode_json
from stream.errors import BadInput, StoreError
from stream.files.atomic_file import write_durably

LOG, OPEN, FILES = "log", "open", "files"
_FORMAT = 1
_ATTEMPTS = 20
_WRITES = "`gyrofleet backup FOLDER --store STORE`"  # of another store than that of a restoration


class Backup(msgspec.Struct, frozen=True, kw_only=True):
    """What a backup holds. `lost` are segments that the store had and has no more; they stay in the backup."""

    format: int = _FORMAT
    store: str
    at_ns: int
    segments: tuple[SegmentEntry, ...]
    manifest: CopiedFile | None
    open: tuple[CopiedFile, ...] = ()
    files: tuple[CopiedFile, ...] = ()
    lost: tuple[SegmentEntry, ...] = ()

    @property
    def samples(self) -> int:
        """Samples of the sealed segments."""
        return sum(entry.samples for entry in self.segments)


class Written(NamedTuple):
    """A backup, and what this command added to it."""

    backup: Backup
    added_segments: int
    added_bytes: int
    rewritten: tuple[str, ...]  # segments that were damaged in the backup
    damaged: tuple[str, ...] = ()  # segments that are damaged in the store, and whole in the backup


def read_backup(folder: Path) -> Backup:
    """Read what a folder holds; StoreError if it is no backup."""
    try:
        found = decode_json((folder / BACKUP).read_bytes(), Backup)
    except FileNotFoundError:
        raise StoreError(_no_backup(folder)) from None
    except (OSError, msgspec.MsgspecError) as error:
        raise StoreError(
            f"{folder / BACKUP} cannot be read: {error}; restore from another backup, and back up into a new folder"
        ) from error
    if found.format > _FORMAT:
        raise StoreError(f"{folder / BACKUP} has a newer format than this gyrofleet reads: upgrade gyrofleet")
    return found


def _no_backup(folder: Path) -> str:
    """Why a folder is no backup, and what is one."""
    if not folder.exists():
        return f"the backup {folder} is not there: give a folder that {_WRITES} has written"
    if (folder / MARKER).exists():
        writes = f"`gyrofleet backup FOLDER --store {shlex.quote(str(folder))}` writes one"
        return f"{folder} is a store and no backup: {writes}"
    near = sorted(each for each in (folder.resolve().parent, *folder.iterdir()) if (each / BACKUP).is_file())
    one = f"; {near[0]} is one" if near else ""
    return f"{folder} is no backup: it holds no {BACKUP}{one}; give a folder that {_WRITES} has written"


def back_up(
    store: Store, folder: Path, *, is_checked: bool = False, progress: Callable[[float], object] = lambda _share: None
) -> Written:
    """Bring a backup up to date while the store may be written; StoreError if the folder is of another store.

    With `is_checked` every segment that is in the backup already is read, there and in the store, and copied again if
    the backup's is damaged. What was acknowledged before the call is in the backup.
    """
    for link in (folder, *folder.parents):
        if not link.is_symlink() or link.exists():
            continue
        raise BadInput(
            f"{link} is a symbolic link to {link.readlink()}, and that is not there: mount or make it, or give another "
            "folder"
        )
    check_folder(folder)
    if folder.resolve().is_relative_to(store.folder.resolve()):
        raise BadInput(f"{folder} lies within {store.folder}: a backup there would hold itself; give another folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with only_one(folder / "backup.lock", "gyrofleet backup"):
            return _Writer(store, folder, is_checked=is_checked, progress=progress).written()
    except OSError as error:
        left = "the one before is as it was" if (folder / BACKUP).exists() else "there is no backup yet"
        why = _full_disk(store, folder) if error.errno in {errno.ENOSPC, errno.EDQUOT} else str(error)
        raise StoreError(f"cannot write the backup {folder}: {why or error}; {left}") from error


def _full_disk(store: Store, folder: Path) -> str:
    """How much is still to be copied, and how much room there is; empty if that cannot be known."""
    try:
        listed = read_log_manifest(store, whole=True).entries.values()
        waiting = sum(each.size for each in listed if not (folder / LOG / each.segment).exists())
        others = [*unlisted_segments(store, {each.segment for each in listed}), *other_files(store)]
        needed, free = waiting + sum(path.stat().st_size for path in others), DISK.space(folder).free
    except (OSError, StoreError):
        return ""
    return (
        f"the disk is full, or its quota used up: {format_bytes(needed)} are still to be copied, {format_bytes(free)} "
        "are free; make room there and repeat the command, which goes on where it was, or give another folder"
    )


class _Writer:
    def __init__(self, store: Store, folder: Path, *, is_checked: bool, progress: Callable[[float], object]) -> None:
        self._store, self._folder, self._is_checked, self._progress = store, folder, is_checked, progress
        self._before = self._known()
        self._added = self._added_bytes = 0
        self._rewritten: list[str] = []
        self._damaged: list[str] = []

    def _known(self) -> Backup | None:
        if not (self._folder / BACKUP).exists():
            # an interrupted first backup has left only these
            others = {path.name for path in self._folder.iterdir()} - {LOG, OPEN, FILES, "backup.lock"}
            if others:
                raise StoreError(f"{self._folder} holds other files and is no backup; give an empty or a new folder")
            return None
        before = read_backup(self._folder)
        if before.store != self._store.identity:
            raise StoreError(
                f"{self._folder} is a backup of the store {before.store}, not of {self._store.identity}; give another "
                "folder"
            )
        return before

    def written(self) -> Written:
        for _ in range(_ATTEMPTS):
            found = read_log_manifest(self._store, whole=True)
            if found.damage:
                raise StoreError(
                    f"{manifest_path(self._store)} is damaged in line {found.damage[0].line}: `gyrofleet recover` "
                    f"first; {self._state}"
                )
            try:
                backup = self._copied(found)
            except FileNotFoundError:  # the open segment was sealed meanwhile
                continue
            write_durably(self._folder / BACKUP, msgspec.json.encode(backup))
            self._remove_old(backup)
            return Written(backup, self._added, self._added_bytes, tuple(self._rewritten), tuple(self._damaged))
        raise StoreError(f"segments of {self._store.log} are sealed faster than they are copied; try again")

    @property
    def _state(self) -> str:
        return f"{self._folder} is no backup yet" if self._before is None else "the backup is as it was"

    def _copied(self, found: LogManifest) -> Backup:
        entries = sorted(found.entries.values(), key=lambda entry: entry.segment)
        self._check_kept(entries)
        total, done = max(1, sum(entry.size for entry in entries)), 0
        for entry in entries:
            self._bring(entry)
            done += entry.size
            self._progress(done / total)
        listing = manifest_path(self._store)
        manifest = None
        if entries or found.lost:
            # of the lines that were read: one that came meanwhile belongs to a segment that is copied as unlisted
            manifest = copy_file(listing, self._folder, f"{LOG}/{listing.name}", self._bytes_of(found))
        at = f"{time.time_ns()}"
        opened = tuple(
            copy_file(path, self._folder, f"{OPEN}/{at}/{path.name}", path.stat().st_size)
            for path in unlisted_segments(self._store, set(found.entries))
        )
        here = {entry.segment for entry in entries}
        before = () if self._before is None else (*self._before.segments, *self._before.lost)
        return Backup(
            store=self._store.identity, at_ns=time.time_ns(), segments=tuple(entries), manifest=manifest, open=opened,
            files=tuple(self._files()), lost=tuple(entry for entry in before if entry.segment not in here),
        )  # fmt: skip

    def _bytes_of(self, found: LogManifest) -> int:
        """Length of the manifest up to the line that was read last."""
        content = manifest_path(self._store).read_bytes()
        end = content.find(found.last.encode() + b"\n")
        return end + len(found.last) + 1

    def _check_kept(self, entries: Sequence[SegmentEntry]) -> None:
        """Refuse to replace an intact segment of the backup by another one, as by the part of it that was salvaged."""
        known = {each.segment: each for each in self._before.segments} if self._before else {}
        for entry in entries:
            kept = known.get(entry.segment, entry)
            if kept.sha256 == entry.sha256:
                continue
            if not CopiedFile(f"{LOG}/{entry.segment}", kept.size, kept.sha256).is_intact(self._folder):
                continue
            part = "the part of it that was salvaged" if entry.origin == "salvaged" else "another one"
            raise StoreError(
                f"{self._folder} has segment {entry.segment} whole, {kept.samples:,} samples, the store has {part}, "
                f"{entry.samples:,} samples; the backup is as it was. "
                f"`gyrofleet restore {shlex.quote(str(self._folder))} --store NEW` makes a store that has the whole "
                "one; to go on with the store as it is, back up into a new folder"
            )

    def _bring(self, entry: SegmentEntry) -> None:
        path = f"{LOG}/{entry.segment}"
        copy = CopiedFile(path, entry.size, entry.sha256)
        target = self._folder / path
        if target.exists():
            known = {each.segment: each.sha256 for each in self._before.segments} if self._before else {}
            is_listed = known.get(entry.segment) == entry.sha256 and target.stat().st_size == entry.size
            if (is_listed and not self._is_checked) or copy.is_intact(self._folder):
                self._look_at_source(entry)
                return
            self._rewritten.append(entry.segment)
        source, is_there = self._store.log / entry.segment, target.exists()
        state = self._state + ", its copy of the segment damaged as well" * is_there
        if not source.exists():
            remedy = "`gyrofleet verify` says what is lost, `gyrofleet recover` notes it"
            raise StoreError(f"{source} is not there: {remedy}; {state}")
        if is_there and not CopiedFile(entry.segment, entry.size, entry.sha256).is_intact(self._store.log):
            raise self._unsealed(entry, sha256_of(source), state)
        fresh = copy_file(source, self._folder, path)
        if fresh != copy:
            target.unlink()
            raise self._unsealed(entry, fresh.sha256, state)
        self._added += 1
        self._added_bytes += entry.size

    def _look_at_source(self, entry: SegmentEntry) -> None:
        """Note a segment that is whole in the backup and damaged in the store, without a check by its length."""
        path = self._store.log / entry.segment
        if self._is_checked:
            is_well = CopiedFile(entry.segment, entry.size, entry.sha256).is_intact(self._store.log)
        else:
            is_well = path.exists() and path.stat().st_size == entry.size
        if not is_well:
            self._damaged.append(entry.segment)

    def _unsealed(self, entry: SegmentEntry, sha256: str, state: str) -> StoreError:
        return StoreError(
            f"{self._store.log / entry.segment} is not as it was sealed (SHA-256 {sha256[:12]}, listed "
            f"{entry.sha256[:12]}): `gyrofleet verify` says what is damaged; {state}"
        )

    def _files(self) -> list[CopiedFile]:
        found = []
        for source in other_files(self._store):
            path = f"{FILES}/{source.relative_to(self._store.folder).as_posix()}"
            copied = copy_database if source.suffix == DATABASE else copy_file
            found.append(copied(source, self._folder, path))
        return found

    def _remove_old(self, backup: Backup) -> None:
        """Remove earlier copies of open segments."""
        kept = {self._folder / each.path for each in backup.open}
        for path in (self._folder / OPEN).glob("*/*"):
            if path not in kept:
                path.unlink()
        for path in (self._folder / OPEN).glob("*"):
            if path.is_dir() and not any(path.iterdir()):
                path.rmdir()
