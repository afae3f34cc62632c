"""Derived tables kept in the store, each with a hash beside it; a missing or damaged one is recomputed."""

import hashlib
import os
from contextlib import suppress
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from stream.atomic_file import replacement

_HASH = ".sha256"


def hash_path(path: Path) -> Path:
    """Where the hash of a kept file is."""
    return path.with_name(path.name + _HASH)


def read_kept(path: Path) -> pa.Table | None:
    """A kept table with its metadata; None where there is none, or it disagrees with its hash."""
    with suppress(OSError, pa.ArrowException):
        content = path.read_bytes()
        if hash_path(path).read_text() == hashlib.sha256(content).hexdigest():
            return pq.read_table(pa.BufferReader(content))
    return None


def write_kept(path: Path, table: pa.Table) -> None:
    """Keep a table; if that fails it is recomputed the next time."""
    with suppress(OSError):
        path.parent.mkdir(exist_ok=True)
        sink = pa.BufferOutputStream()
        pq.write_table(table, sink, compression="zstd")
        content = sink.getvalue().to_pybytes()
        # a reader in between finds the hash of another file, and recomputes
        _write(path, content)
        _write(hash_path(path), hashlib.sha256(content).hexdigest().encode())


def _write(path: Path, content: bytes) -> None:
    with replacement(path, path.with_name(f"{path.name}.{os.getpid()}.part")) as fresh:
        fresh.write_bytes(content)
