"""What the log asks of a disk: write, make durable, rename. The one place where it does, and where faults are put in.

A write is durable after `sync_data` or `sync`, a name after `sync_folder`; before that a power loss may leave any part
of it, in any order.
"""

import ctypes
import errno
import os
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

_AT_FDCWD = -100
_NOREPLACE = 1
_NOT_HERE = {errno.ENOSYS, errno.EINVAL, errno.ENOTSUP}  # kernel or file system without that flag
_library = ctypes.CDLL(None, use_errno=True)


class Space(NamedTuple):
    """Bytes of a file system: free for us, and in all."""

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
        """A new, empty file; one that exists is refused."""
        return OpenFile(path, os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644))

    def reopen(self, path: Path, length: int) -> OpenFile:
        """An existing file, cut to its first `length` bytes, to be written on."""
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
        """Make what was written durable, with the file's own data."""
        os.fsync(file.descriptor)

    def close(self, file: OpenFile) -> None:
        """Close; what was not made durable may be lost."""
        os.close(file.descriptor)

    def rename(self, path: Path, target: Path) -> None:
        """Give a file another name, that no file has; one that exists is refused."""
        if not _renamed(path, target):
            if target.exists():
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(target))
            path.rename(target)

    def replace(self, path: Path, target: Path) -> None:
        """Put a file in the place of another."""
        path.replace(target)

    def link(self, path: Path, target: Path) -> None:
        """Give a file a second name."""
        target.hardlink_to(path)

    def remove(self, path: Path) -> None:
        """Remove a file."""
        path.unlink()

    def sync_folder(self, folder: Path) -> None:
        """Make the names in a folder durable."""
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

    def space(self, folder: Path) -> Space:
        """Room on the file system of a folder."""
        found = os.statvfs(folder)
        return Space(found.f_bavail * found.f_frsize, found.f_blocks * found.f_frsize)


def _renamed(path: Path, target: Path) -> bool:
    """Rename in one step where nothing has the new name; False where the system cannot.

    Raises
    ------
    OSError: As the system has it; FileExistsError where the name is taken.
    """
    rename = getattr(_library, "renameat2", None)
    if rename is None:
        return False
    if rename(_AT_FDCWD, os.fsencode(path), _AT_FDCWD, os.fsencode(target), _NOREPLACE) == 0:
        return True
    number = ctypes.get_errno()
    if number in _NOT_HERE:
        return False
    raise OSError(number, os.strerror(number), str(path), None, str(target))


DISK = Disk()
