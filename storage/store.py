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
    MARKER,
    alone_in,
    identity_of_copy,
    identity_of_segments,
    is_repairable,
    is_unfinished,
    read_marker,
    write_markers,
)
from stream.errors import StoreError

_LOCK = "writer.lock"
_LOCK_ATTEMPTS = 5


class Store:
    """The folders of a store.

    ``store.json`` marks it; ``log/`` holds MCAP segments (the record), ``lake/`` one folder of Parquet files for
    each sealed segment (derived, can be rebuilt), ``tmp/`` what is being written.

    Parameters
    ----------
    folder: Where it is.
    identity: Its own, whatever the folder is called.
    """

    def __init__(self, folder: Path, identity: str) -> None:
        self.folder = folder
        self.identity = identity
        self.log = folder / "log"
        self.aside = folder / "log" / "aside"
        self.lake = folder / "lake"
        self.tmp = folder / "tmp"

    @classmethod
    def open(cls, folder: Path) -> Self:
        """Open a store that exists.

        Raises
        ------
        StoreError: If the folder is missing, is no store, or was made by a newer gyrofleet.
        """
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
                    f"`gyrofleet recover --store {folder}` makes it anew"
                ) from error
            if not is_missing:
                raise StoreError(f"{marker} cannot be read ({error}); is {folder} a gyrofleet store?") from error
            what = "there is no such folder" if not folder.exists() else f"it holds no {MARKER}"
            raise StoreError(
                f"{folder} is not a gyrofleet store ({what}); import or record something first, or give --store DIR"
            ) from None
        except OSError as error:
            raise StoreError(f"{marker} cannot be read ({error}); is {folder} a gyrofleet store?") from error

    @classmethod
    def create(cls, folder: Path) -> Self:
        """Open a store for writing, made now if the folder is empty or missing, or if its making was cut short.

        Raises
        ------
        StoreError: If the folder holds other things, or cannot be written.
        """
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
        """Open a store; if its ``store.json`` is missing or damaged it is rebuilt, and what was done is told.

        Its identity comes from the copy in the log. Where that is gone as well the store gets another: its log is as
        good as before, but sources that had begun to send to it will not go on by themselves.

        Raises
        ------
        StoreError: If there is nothing to make it anew from, or it cannot be written.
        """
        marker = folder / MARKER
        try:
            read_marker(marker)
        except (FileNotFoundError, ValueError) as error:
            if is_repairable(folder):
                return cls._repaired(folder, "it was missing" if not marker.exists() else f"it was damaged: {error}")
        except OSError:
            pass  # said by `open`
        return cls.open(folder), None

    @classmethod
    def _repaired(cls, folder: Path, why: str) -> tuple[Self, str]:
        marker, identity = folder / MARKER, identity_of_copy(folder) or identity_of_segments(folder)
        told = f"written anew, {why}"
        if identity is None:
            if writer_is_active(folder):
                raise StoreError(f"a process writes {folder}, whose identity cannot be read any more; stop it first")
            identity = uuid4().hex
            told += f"; its identity could not be saved, it is now {identity}"
        store = cls(folder, identity)
        try:
            with alone_in(folder):
                for part in (store.aside, store.lake, store.tmp):
                    part.mkdir(exist_ok=True)
                if marker.exists():
                    aside = store.aside / f"{MARKER}.{time.time_ns()}"
                    marker.rename(aside)
                    told += f"; as it was: {aside}"
                write_markers(folder, identity)
        except OSError as error:
            raise StoreError(f"{marker} cannot be rebuilt: {error}; mend the disk and try again") from error
        return store, told


class WriterLock:
    """Held by the one process that writes a store: on ``writer.lock``, and on the folder of the log.

    The file says who writes. Whoever removes it lets nobody else write.

    Parameters
    ----------
    store: Which store.
    role: Who writes, for the message that others get.
    endpoint: Where the writer listens, if it does.

    Raises
    ------
    StoreError: If another process holds it; the message names it.
    """

    def __init__(self, store: Store, role: str, endpoint: str = "") -> None:
        path = store.folder / _LOCK
        store.log.mkdir(exist_ok=True)
        path.touch()
        self._file = path.open("r+")
        self._log = os.open(store.log, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        if not (_locked(self._file.fileno()) and _locked(self._log)):
            self._file.close()
            os.close(self._log)
            holder = _holder(store.folder)
            where = f" (--connect {holder['endpoint']})" if holder.get("endpoint") else ""
            raise StoreError(
                f"{store.folder} is being written by {holder.get('role', 'another process')}, process "
                f"{holder.get('process', '?')}; send to it{where}, or wait until it has ended"
            ) from None
        self._last_endpoint = endpoint or _holder(store.folder).get("last_endpoint", "")
        self._write({"role": role, "process": os.getpid(), "endpoint": endpoint})

    def release(self) -> None:
        """Let another process write."""
        self._write({})
        self._file.close()
        os.close(self._log)

    def _write(self, holder: dict[str, object]) -> None:
        content = (json.dumps({**holder, "last_endpoint": self._last_endpoint}) + "\n").encode()
        os.pwrite(self._file.fileno(), content, 0)  # in one go: whoever is killed here leaves the one or the other
        self._file.truncate(len(content))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()


@contextmanager
def only_one(path: Path, what: str) -> Iterator[None]:
    """Hold a lock file for as long as the context lasts; the system frees it if the process is killed.

    Raises
    ------
    StoreError: If another process holds it.
    """
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
    """Whether a process writes the store in `folder` now."""
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
    """Where the process listens that writes the store in `folder` now; None if there is none."""
    return (_holder(folder).get("endpoint") or None) if writer_is_active(folder) else None


def recorder_endpoint(folder: Path) -> str | None:
    """Like `writer_endpoint`; where no process writes the store now, where the last one listened that did."""
    if writer_is_active(folder):
        return writer_endpoint(folder)
    return _holder(folder).get("last_endpoint") or None


def _locked(descriptor: int) -> bool:
    """Take a lock; who only looks whether it is held (`writer_is_active`) holds it for a moment."""
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
    except (OSError, ValueError, AttributeError):
        return {}


def sync_folder(folder: Path) -> None:
    """Make the names in a folder durable."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
