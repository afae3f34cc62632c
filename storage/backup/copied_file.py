"""Copies of files that are durable and verified when they have their names."""

import errno
import hashlib
import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import msgspec

from storage.segments.disk import sha256_of
from stream.files.atomic_file import sync_folder

_PIECE_BYTES = 8 << 20


class CopiedFile(msgspec.Struct, frozen=True):
    """A file of a backup: its path there, bytes and SHA-256."""

    path: str
    size: int
    sha256: str

    def is_intact(self, folder: Path) -> bool:
        """Whether the file is there as it was written; every byte is read."""
        path = folder / self.path
        try:
            return path.stat().st_size == self.size and sha256_of(path) == self.sha256
        except OSError:
            return False


def copy_file(source: Path, folder: Path, path: str, size: int | None = None) -> CopiedFile:
    """Copy a file, or its first `size` bytes, to a path in a folder; one that is there is replaced whole.

    FileNotFoundError if the source is gone.
    """
    target = folder / path
    target.parent.mkdir(parents=True, exist_ok=True)
    part = target.with_name(f"{target.name}.part")
    digest, copied = hashlib.sha256(), 0
    with source.open("rb") as reader:
        length = os.fstat(reader.fileno()).st_size if size is None else size
        with _unless_it_fails(part), part.open("wb") as writer:
            while copied < length and (piece := reader.read(min(_PIECE_BYTES, length - copied))):
                writer.write(piece)
                digest.update(piece)
                copied += len(piece)
            writer.flush()
            os.fsync(writer.fileno())
    part.chmod(source.stat().st_mode & 0o777)  # of a key nobody else may read
    _put(part, target)
    return CopiedFile(path, copied, digest.hexdigest())


def copy_database(source: Path, folder: Path, path: str) -> CopiedFile:
    """Copy an SQLite database that may be written meanwhile, as of one moment."""
    target = folder / path
    target.parent.mkdir(parents=True, exist_ok=True)
    part = target.with_name(f"{target.name}.part")
    part.unlink(missing_ok=True)
    address = f"{source.resolve().as_uri()}?mode=ro"
    with (
        _unless_it_fails(part),
        closing(sqlite3.connect(address, uri=True)) as reader,
        closing(sqlite3.connect(part)) as writer,
    ):
        reader.backup(writer)
    with part.open("rb") as written:
        os.fsync(written.fileno())
    size, sha256 = part.stat().st_size, sha256_of(part)
    _put(part, target)
    return CopiedFile(path, size, sha256)


@contextmanager
def _unless_it_fails(part: Path) -> Iterator[None]:
    """Keep a part that is written within; where the disk refuses it takes no room there."""
    try:
        yield
    except (OSError, sqlite3.Error) as error:
        with suppress(OSError):
            part.unlink()
        if getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(part)) from error
        raise


def _put(part: Path, target: Path) -> None:
    part.replace(target)
    sync_folder(target.parent)
