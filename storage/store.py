"""A store: one folder that holds the event log and the lake derived from it."""

import fcntl
import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Self
from uuid import uuid4

from storage.store_marker import (
    BACKUP,
    FLEET_MARKER,
    MARKER,
    alone_in,
    check_folder,
    identity_of_copy,
    identity_of_segments,
    is_repairable,
    is_replica,
    is_unfinished,
    read_marker,
    write_markers,
)
from stream.closing import Closing
from stream.errors import BadInput, StoreError

_LOCK = "writer.lock"
_LOCK_ATTEMPTS = 5
_LOOKS_EVERY_S = 0.02
REPLICATION = "gyrofleet replicate"
"""Role of the only writer of the copies in a fleet store."""
_OUTPUT_FOLDERS = {"plots", "reports"}  # within a store, for files that commands write for people


class Store:
    """The folders of a store, and its identity, which does not depend on the folder's name.

    ``store.json`` marks it; ``log/`` holds MCAP segments (the record), ``lake/`` Parquet files derived from them,
    ``tmp/`` what is being written.
    """

    def __init__(self, folder: Path, identity: str) -> None:
        self.folder, self.identity = folder, identity
        self.label = str(folder)  # what messages call it
        self.is_local = True  # its log and files are at hand
        self.log = folder / "log"
        self.aside = folder / "log" / "aside"
        self.lake = folder / "lake"
        self.tmp = folder / "tmp"

    @classmethod
    def open(cls, folder: Path) -> Self:
        """Open an existing store; StoreError if the folder is none, or was written by a newer gyrofleet."""
        marker = folder / MARKER
        try:
            return cls(folder, read_marker(marker))
        except NotADirectoryError:
            raise StoreError(f"{folder} is a file, not a store; give --store a folder") from None
        except (FileNotFoundError, ValueError) as error:
            is_missing = isinstance(error, FileNotFoundError)
            if is_repairable(folder):
                raise StoreError(
                    f"{marker} is {'missing' if is_missing else f'damaged ({error})'}, but the store's log is there: "
                    f"`gyrofleet recover --store {folder}` rebuilds it"
                ) from error
            if not is_missing:
                raise StoreError(f"{marker} cannot be read ({error}); is {folder} a gyrofleet store?") from error
            if (folder / BACKUP).exists():
                raise StoreError(
                    f"{folder} is a backup, not a store: `gyrofleet restore {folder} --store NEW` makes a store of it"
                ) from None
            if (folder / FLEET_MARKER).exists():
                raise StoreError(
                    f"{folder} is a fleet store of many plants; this command asks one: --store {folder}/plants/NAME"
                ) from None
            what = "there is no such folder" if not folder.exists() else f"it holds no {MARKER}"
            raise StoreError(
                f"{folder} is not a gyrofleet store ({what}); import or record something first, or give --store DIR"
            ) from None
        except OSError as error:
            raise StoreError(f"{marker} cannot be read ({error}); is {folder} a gyrofleet store?") from error

    @classmethod
    def create(cls, folder: Path) -> Self:
        """Open a store for writing, or create it in an empty or missing folder; StoreError if that cannot be done."""
        check_folder(folder)
        marker = folder / MARKER
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with alone_in(folder):
                if marker.exists() or is_repairable(folder):
                    store = cls.open(folder)
                elif is_unfinished(folder):
                    store = cls(folder, uuid4().hex)
                else:
                    raise StoreError(
                        f"{folder} holds other files and no {MARKER}, so it is not a gyrofleet store; "
                        f"give --store an empty or a new folder"
                    )
                for part in (store.log, store.lake, store.tmp):
                    part.mkdir(exist_ok=True)
                write_markers(folder, store.identity)
            if not os.access(store.log, os.W_OK):
                raise PermissionError(f"no permission to write in {store.log}")
        except OSError as error:
            raise StoreError(
                f"cannot write the store {folder}: {error}; give --store a folder you can write"
            ) from error
        return store

    @classmethod
    def open_or_repair(cls, folder: Path) -> tuple[Self, str | None]:
        """Open a store, and rebuild its ``store.json`` if that is missing or damaged; returns what was done.

        The identity comes from the copy in the log, else from its segments. If both are lost the store gets a new
        one: its log stays valid, but sources that were sending to it do not resume by themselves.
        """
        marker = folder / MARKER
        try:
            read_marker(marker)
        except (FileNotFoundError, ValueError) as error:
            if is_repairable(folder):
                return cls._repaired(folder, "it was missing" if not marker.exists() else f"it was damaged: {error}")
        except OSError:
            pass  # reported by `open`
        return cls.open(folder), None

    @classmethod
    def _repaired(cls, folder: Path, why: str) -> tuple[Self, str]:
        marker, identity = folder / MARKER, identity_of_copy(folder) or identity_of_segments(folder)
        text = f"rebuilt, {why}"
        if identity is None:
            if writer_is_active(folder):
                raise StoreError(f"a process writes {folder}, whose identity cannot be read any more; stop it first")
            identity = uuid4().hex
            text += f"; its identity could not be recovered, it is now {identity}"
        store = cls(folder, identity)
        try:
            with alone_in(folder):
                for part in (store.aside, store.lake, store.tmp):
                    part.mkdir(exist_ok=True)
                if marker.exists():
                    aside = store.aside / f"{MARKER}.{time.time_ns()}"
                    marker.rename(aside)
                    text += f"; the old file: {aside}"
                write_markers(folder, identity)
        except OSError as error:
            raise StoreError(f"{marker} cannot be rebuilt: {error}; repair the disk and try again") from error
        return store, text


class WriterLock(Closing):
    """Lock of the one process that writes a store: on ``writer.lock``, which names the holder, and on the log folder.

    `role` is who writes, for the error message of other processes; `endpoint` is where, empty if it does not listen,
    `security` the folder of its certificate, empty if its bus has no security. Who is `brief` enters some documents
    and has done; with `patience_s` that is waited for.
    """

    def __init__(
        self, store: Store, role: str, endpoint: str = "", security: str = "", *, is_brief: bool = False,
        patience_s: float = 0.0,
    ) -> None:  # fmt: skip
        if is_replica(store.folder) and role != REPLICATION:
            raise StoreError(
                f"{store.folder} is a fleet store's copy of a plant, which `gyrofleet replicate` alone writes: record, "
                "enter and repair at the plant; what the copy has lost comes back by `gyrofleet replicate --recall`"
            )
        path = store.folder / _LOCK
        store.log.mkdir(exist_ok=True)
        path.touch()
        self._file = path.open("r+")
        self._log = os.open(store.log, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        until = time.monotonic() + patience_s
        while not (is_mine := _locked(self._file.fileno()) and _locked(self._log)):
            holder = _holder(store.folder)  # without a role: it has just begun, or ended
            if time.monotonic() >= until or not (holder.get("is_brief") or "role" not in holder):
                break
            fcntl.flock(self._file.fileno(), fcntl.LOCK_UN)
            time.sleep(_LOOKS_EVERY_S)
        if not is_mine:
            self._file.close()
            os.close(self._log)
            what = "wait until it has ended; for several at once, start `gyrofleet record`, and give them --connect"
            if holder.get("endpoint"):
                what = f"send to it (--connect {holder['endpoint']}), or wait until it has ended"
            raise StoreError(
                f"{store.folder} is being written by {holder.get('role', 'another process')}, process "
                f"{holder.get('process', '?')}; {what}"
            ) from None
        self._last_endpoint = endpoint or _holder(store.folder).get("last_endpoint", "")
        self._write(
            {"role": role, "process": os.getpid(), "endpoint": endpoint}
            | ({"security": security} if security else {})
            | ({"is_brief": True} if is_brief else {})
        )

    def close(self) -> None:
        """Let another process write."""
        self._write({})
        self._file.close()
        os.close(self._log)

    def _write(self, holder: dict[str, object]) -> None:
        content = (json.dumps({**holder, "last_endpoint": self._last_endpoint}) + "\n").encode()
        os.pwrite(self._file.fileno(), content, 0)  # one call: a kill leaves the old or the new content
        self._file.truncate(len(content))


@contextmanager
def only_one(path: Path, what: str) -> Iterator[None]:
    """Hold a lock file; the system frees it if the process is killed."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open("a")
    except OSError as error:
        raise StoreError(f"cannot write {path}: {error}") from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise StoreError(f"another {what} is at work on this store ({path} is held); stop it first") from None
        yield


def writer_is_active(folder: Path) -> bool:
    """Whether a process writes the store now."""
    return any(_is_locked(path) for path in (folder / _LOCK, folder / "log"))


def _is_locked(path: Path) -> bool:
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    finally:
        os.close(descriptor)
    return False


def writer_endpoint(folder: Path) -> str | None:
    """Endpoint of the process that writes the store now; None if there is none."""
    return (_holder(folder).get("endpoint") or None) if writer_is_active(folder) else None


def writer_security(folder: Path) -> Path | None:
    """Folder of the certificate of the process that writes the store now; None if its bus has no security."""
    found = _holder(folder).get("security") if writer_is_active(folder) else None
    return Path(found) if found else None


def recorder_endpoint(folder: Path) -> str | None:
    """Endpoint of the process that writes the store now, else of the last one that did."""
    if writer_is_active(folder):
        return writer_endpoint(folder)
    return _holder(folder).get("last_endpoint") or None


def _locked(descriptor: int) -> bool:
    """Take a lock; retried, since a process that only looks (`writer_is_active`) holds it for a moment."""
    for attempt in range(_LOCK_ATTEMPTS):
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(0.02 if attempt + 1 < _LOCK_ATTEMPTS else 0.0)
        else:
            return True
    return False


def _holder(folder: Path) -> dict[str, str]:
    try:
        return {name: str(value) for name, value in json.loads((folder / _LOCK).read_text()).items()}
    except (OSError, ValueError, AttributeError, RecursionError):
        return {}


def check_outside(store: Store, path: Path) -> None:
    """Refuse an output file that would lie among a store's own files."""
    folder, target = store.folder.resolve(), path.resolve()
    if target.is_relative_to(folder):
        inside = target.relative_to(folder).parts
        if len(inside) < 2 or inside[0] not in _OUTPUT_FOLDERS:
            raise BadInput(f"{path} would lie among the files of the store {store.folder}; give a file elsewhere")
