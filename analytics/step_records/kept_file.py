"""Tables that are computed from the lake and kept in the store: written with a hash of the file beside it.

They are derived: what is missing, damaged or of another version is computed anew.
"""

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
    """A table as it was kept, with its metadata; None where there is none, or it is not what was written."""
    with suppress(OSError, pa.ArrowException):
        content = path.read_bytes()
        if hash_path(path).read_text() == hashlib.sha256(content).hexdigest():
            return pq.read_table(pa.BufferReader(content))
    return None


def write_kept(path: Path, table: pa.Table) -> None:
    """Keep a table; where that fails it is computed anew the next time."""
    with suppress(OSError):
        path.parent.mkdir(exist_ok=True)
        sink = pa.BufferOutputStream()
        pq.write_table(table, sink, compression="zstd")
        content = sink.getvalue().to_pybytes()
        # a reader in between finds a hash of another file, and computes
        _write(path, content)
        _write(hash_path(path), hashlib.sha256(content).hexdigest().encode())


def _write(path: Path, content: bytes) -> None:
    with replacement(path, path.with_name(f"{path.name}.{os.getpid()}.part")) as fresh:
        fresh.write_bytes(content)
