"""The status of every role of a store, each a small file in its folder `status`."""

import errno
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import msgspec

from storage.store import Store
from stream.errors import WireError
from stream.files.atomic_file import replacement
from stream.status.role_status import RoleStatus, boot, decode_status, encode_status, uptime_ns

FOLDER = "status"
_MOST_FILES = 2_000  # more roles than this are no station floor
_FORGET_AFTER_S = 7 * 86_400.0


class StatusBoard:
    """Keeps the newest status of every role of a store, on a full disk in the place of the old one."""

    def __init__(self, store: Store) -> None:
        self._folder = store.folder / FOLDER
        self._lock = threading.Lock()
        self._names: set[str] = set()

    def put(self, status: RoleStatus, by: str = "") -> None:
        """Keep a status in place of the role's last one; with security there is one of each certificate."""
        name = status.file_name_of(by) if by else status.file_name
        with self._lock, suppress(OSError):
            if not self._names:
                self._folder.mkdir(exist_ok=True)
                self._names = {path.name for path in _files(self._folder) if not _forgotten(path)}
            if name not in self._names and len(self._names) >= _MOST_FILES:
                return
            self._names.add(name)
            kept = msgspec.structs.replace(status, kept_ns=uptime_ns(), kept_boot=boot())
            _write(self._folder / name, encode_status(kept))
            if by and status.file_name in self._names:  # from before the recorder had security
                self._names.discard(status.file_name)
                (self._folder / status.file_name).unlink(missing_ok=True)


def read_statuses(store: Store) -> list[RoleStatus]:
    """The newest status of every role of a store, by role and name; unreadable files are left out."""
    found = []
    for path in _files(store.folder / FOLDER):
        with suppress(OSError, WireError):
            found.append(decode_status(path.read_bytes()))
    return sorted(found, key=lambda each: (each.role, each.name))


def _write(path: Path, content: bytes) -> None:
    """Replace a file; on a full disk write over it, as its block is there: a paused recorder says why."""
    try:
        with replacement(path) as fresh:
            fresh.write_bytes(content)
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        with path.open("r+b", buffering=0) as file:
            file.write(content)
            file.truncate(len(content))


def _files(folder: Path) -> Iterator[Path]:
    return folder.glob("*-*.json")


def _forgotten(path: Path) -> bool:
    """Remove the status of a role that has not reported for a week."""
    if time.time() - path.stat().st_mtime < _FORGET_AFTER_S:
        return False
    path.unlink(missing_ok=True)
    return True
