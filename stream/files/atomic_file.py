"""Files that appear whole or not at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


def write_durably(
    path: Path, content: bytes, *, fresh: Path | None = None, mode: int | None = None, previous: Path | None = None,
    overwrite: bool = True,
) -> None:  # fmt: skip
    """Write a file that is on disk, with its name, when this returns; a crash leaves the old file or the new one.

    It is written to `fresh` on the same file system, by default ``PATH.part``, with the permissions `mode`. The file
    that is replaced is kept as `previous`; a crash may leave it there alone. Unless `overwrite`, a file that exists
    is a FileExistsError. After an OSError the old file is still there, under its name or `previous`.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "state.json"
    ...     write_durably(path, b"1")
    ...     write_durably(path, b"2", previous=path.with_suffix(".previous"))
    ...     [(each.name, each.read_bytes()) for each in sorted(Path(folder).iterdir())]
    [('state.json', b'2'), ('state.previous', b'1')]
    """
    fresh = _beside(path) if fresh is None else fresh
    try:
        with fresh.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        if mode is not None:
            fresh.chmod(mode)
        if previous is not None and path.exists():
            path.replace(previous)
        if overwrite:
            fresh.replace(path)
        else:
            os.link(fresh, path)
            with suppress(OSError):
                fresh.unlink()
    except Exception:
        with suppress(OSError):
            fresh.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


@contextmanager
def replacement(path: Path, fresh: Path | None = None) -> Iterator[Path]:
    """A temporary path to write to, which replaces `path` unless the block raises; not synced to disk.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with replacement(Path(folder) / "table.csv") as fresh:
    ...         _ = fresh.write_text("a,b")
    ...     [each.name for each in Path(folder).iterdir()]
    ['table.csv']
    """
    fresh = _beside(path) if fresh is None else fresh
    try:
        yield fresh
        fresh.replace(path)
    finally:
        fresh.unlink(missing_ok=True)


def sync_folder(folder: Path) -> None:
    """Make the names in a folder durable."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _beside(path: Path) -> Path:
    return path.with_name(f"{path.name}.part")
