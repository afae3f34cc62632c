"""Restoration of a backup into a new folder: verified, repaired as after a kill, its lake built from the log."""

import fcntl
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

from storage.backup.backup import FILES, Backup, read_backup
from storage.backup.copied_file import CopiedFile, copy_file
from storage.check.recover import Action, recover
from storage.store import Store
from storage.store_marker import BACKUP, FLEET_MARKER, MARKER, check_folder, write_markers
from stream.errors import BadInput, StoreError
from stream.files.atomic_file import write_durably

_RESTORING, _MARK = "restoring", "of.txt"
_KINDS = {MARKER: "is a store already", BACKUP: "is itself a backup", FLEET_MARKER: "is a fleet store"}
_GIVE = "give a new folder as --store"


def restore(
    source: Path, folder: Path, progress: Callable[[float], object] = lambda _share: None
) -> tuple[Backup, list[Action]]:
    """Restore a backup into an empty or missing folder; the store has the identity of the one that was backed up.

    StoreError if a file of the backup is damaged; the folder is a store only once everything is verified. The same
    call repeats a restoration that was interrupted.
    """
    check_folder(source)
    check_folder(folder)
    backup = read_backup(source)
    if folder.resolve().is_relative_to(source.resolve()):
        raise BadInput(f"{folder} lies within the backup {source}: give a new folder elsewhere as --store")
    copies = [*_of_log(backup), *backup.open, *backup.files]
    total = max(1, sum(each.size for each in copies))
    fresh = folder / _RESTORING  # not yet where a store's log is: what is incomplete is no store
    try:
        folder.mkdir(parents=True, exist_ok=True)
        held = _held(folder)
    except FileExistsError as error:
        raise StoreError(f"{error.filename} is a file: nothing can be restored into {folder}; {_GIVE}") from error
    except OSError as error:
        raise StoreError(f"cannot restore into {folder}: {error}; {_GIVE}") from error
    try:
        _check_empty(folder, backup)
        done = 0
        for each in copies:
            target = _place(each.path)
            if copy_file(source / each.path, fresh, target) != CopiedFile(target, each.size, each.sha256):
                raise StoreError(
                    f"{source / each.path} is damaged: its SHA-256 is not the one in {source / BACKUP}; restore from "
                    "another backup; if the store is still there, the option --check of its next backup mends this one"
                )
            done += each.size
            progress(done / total)
        for name in ("lake", "tmp", "log"):
            (fresh / name).mkdir(exist_ok=True)
        for path in sorted(fresh.iterdir(), key=lambda path: path.name == "log"):
            if path.name != _MARK:
                path.rename(folder / path.name)
        write_markers(folder, backup.store)
        done_here = list(recover(Store.open(folder)))
        shutil.rmtree(fresh)  # until now the same command begins again
    except OSError as error:
        raise StoreError(_failure(source, folder, error)) from error
    finally:
        os.close(held)
    return backup, done_here


def _failure(source: Path, folder: Path, error: OSError) -> str:
    """What fails, by the file that the system names: the backup, the new folder, or either."""
    name = Path(os.fsdecode(error.filename)) if isinstance(error.filename, str | bytes) else Path()
    if name.is_relative_to(source):
        what = "is incomplete" if isinstance(error, FileNotFoundError) else "cannot be read"
        return f"the backup {source} {what}: {error}; restore from another one"
    way = "restore into" if name.is_relative_to(folder) else f"copy the backup {source} into"
    return f"cannot {way} {folder}: {error}; the same command goes on"


def _held(folder: Path) -> int:
    """Hold a folder for one restoration; the system frees it if the process is killed."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        raise StoreError(f"another `gyrofleet restore` is at work in {folder}; wait for it") from None
    return descriptor


def _of_log(backup: Backup) -> Iterator[CopiedFile]:
    yield from (CopiedFile(f"log/{entry.segment}", entry.size, entry.sha256) for entry in backup.segments)
    if backup.manifest is not None:
        yield backup.manifest


def _place(path: str) -> str:
    """Path in the store of a file of a backup; what is no path within is refused."""
    top, _, rest = path.partition("/")
    place = rest.partition("/")[2] if top == "open" else rest
    whole = Path(path)
    if not Path(place).parts or ".." in whole.parts or whole.is_absolute() or Path(place).is_absolute() or "\0" in path:
        raise StoreError(f"{path!r} is no path of a backup; its {BACKUP} is not to be trusted")
    return place if top == FILES else f"log/{place}"


def _check_empty(folder: Path, backup: Backup) -> None:
    """Take an empty folder, or one in which a restoration of the same store was interrupted."""
    mark = folder / _RESTORING / _MARK
    if folder.exists() and any(folder.iterdir()):
        if not mark.exists() or mark.read_text() != backup.store:
            what = next((text for name, text in _KINDS.items() if (folder / name).exists()), "is not empty")
            raise StoreError(f"{folder} {what}, and nothing was restored into it: {_GIVE}")
        for path in folder.iterdir():
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    mark.parent.mkdir(parents=True, exist_ok=True)
    write_durably(mark, backup.store.encode())
