"""Disk operations of the log: write, make durable, rename. Tests inject faults here.

A write is durable after `sync_data` or `sync`, a name after `sync_folder`; before that a power loss may leave any part
of it, in any order.
"""

import ctypes
import errno
import hashlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from stream.files.atomic_file import sync_folder

_AT_FDCWD = -100
_NOREPLACE = 1
_NOT_HERE = {errno.ENOSYS, errno.EINVAL, errno.ENOTSUP}  # kernel or file system without that flag
HASHED_AT_ONCE = max(2, len(os.sched_getaffinity(0)))
"""Files that are hashed at the same time: hashing leaves the interpreter to others."""

_library = ctypes.CDLL(None, use_errno=True)


class Space(NamedTuple):
    """Bytes of a file system, free for this user and in total."""

    free: int
    total: int


@dataclass(frozen=True)
class OpenFile:
    """A file that is being written."""

    path: Path
    descriptor: int


class Disk:
    """Unbuffered files of the operating system. Every method raises OSError as the system does."""

    def create(self, path: Path) -> OpenFile:
        """Create an empty file; FileExistsError if it exists."""
        return OpenFile(path, os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644))

    def reopen(self, path: Path, length: int) -> OpenFile:
        """Open an existing file, truncated to `length` bytes, for appending."""
        file = OpenFile(path, os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC))
        os.ftruncate(file.descriptor, length)
        return file

    def write(self, file: OpenFile, content: bytes) -> None:
        """Append all of `content`."""
        view = memoryview(content)
        while view:
            view = view[os.write(file.descriptor, view) :]

    def sync_data(self, file: OpenFile) -> None:
        """Make what was written durable."""
        os.fdatasync(file.descriptor)

    def sync(self, file: OpenFile) -> None:
        """Make what was written and the file's metadata durable."""
        os.fsync(file.descriptor)

    def write_whole(self, file: OpenFile, content: bytes) -> None:
        """Append all of `content`, durably, and close."""
        try:
            self.write(file, content)
            self.sync(file)
        finally:
            self.close(file)

    def close(self, file: OpenFile) -> None:
        """Close; what is not durable may be lost."""
        os.close(file.descriptor)

    def rename(self, path: Path, target: Path) -> None:
        """Rename a file; FileExistsError if the name is taken."""
        if not _renamed(path, target):
            if target.exists():
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(target))
            path.rename(target)

    def replace(self, path: Path, target: Path) -> None:
        """Rename a file over another."""
        path.replace(target)

    def link(self, path: Path, target: Path) -> None:
        """Create a hard link."""
        target.hardlink_to(path)

    def remove(self, path: Path) -> None:
        """Remove a file."""
        path.unlink()

    def sync_folder(self, folder: Path) -> None:
        """Make the names in a folder durable."""
        sync_folder(folder)

    def space(self, folder: Path) -> Space:
        """Free and total space of a folder's file system."""
        found = os.statvfs(folder)
        return Space(found.f_bavail * found.f_frsize, found.f_blocks * found.f_frsize)


def _renamed(path: Path, target: Path) -> bool:
    """Rename without replacing, atomically; False where the system cannot."""
    rename = getattr(_library, "renameat2", None)
    if rename is None:
        return False
    if rename(_AT_FDCWD, os.fsencode(path), _AT_FDCWD, os.fsencode(target), _NOREPLACE) == 0:
        return True
    number = ctypes.get_errno()
    if number in _NOT_HERE:
        return False
    raise OSError(number, os.strerror(number), str(path), None, str(target))


def sha256_of(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


DISK = Disk()
