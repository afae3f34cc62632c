"""Where a catalogue reads the files of a lake: in the folder of a store, or by ranges of a published lake."""

import io
from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, datetime
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Protocol, cast

from storage.manifests.lake import read_manifest
from storage.manifests.part import Part
from storage.store import Store
from stream.errors import StoreError

if TYPE_CHECKING:  # what asks a process for rows starts it before it loads libraries
    import duckdb
    import pyarrow.parquet as pq

    from storage.object_lake.published_store import PublishedStore
    from storage.sql.footers import Footer, Footers

_SCHEME = "gyrolake"
_FIRST_NS = datetime.fromtimestamp(0, UTC)  # files of a published lake never change


class LakeSource(Protocol):
    """The files of the parts in force."""

    @property
    def parts(self) -> tuple[Part, ...]:
        """Parts in force when the source was opened."""

    @property
    def root(self) -> str:
        """Where all paths begin."""

    def path(self, part: str, file: str) -> str:
        """Path of a file, for DuckDB."""

    def attach(self, connection: "duckdb.DuckDBPyConnection") -> None:
        """Let a connection read its paths."""

    def bring(self, paths: Iterable[str]) -> None:
        """Prepare to read small files, of which all are needed soon."""

    def open_table(self, path: str) -> "tuple[pq.ParquetFile, Footer]":
        """A table of channels with page checksums, and its footer; StoreError if it is damaged."""

    def check(self, paths: Iterable[str]) -> None:
        """Compare files with what was written, once each, since DuckDB checks no page; StoreError if one differs."""


class LocalLake:
    """The lake in a store's folder."""

    def __init__(self, store: Store, parts: Iterable[Part] | None = None) -> None:
        self._folder = store.lake.resolve()
        self.parts = read_manifest(store).parts if parts is None else tuple(parts)
        self.root = str(self._folder)
        self._checked: set[str] = set()

    @cached_property
    def _digests(self) -> dict[str, str]:
        return _digests_of(self.parts)

    @cached_property
    def _hashes(self) -> dict[str, str]:
        return {self.path(part.name, name): file.sha256 for part in self.parts for name, file in part.files.items()}

    def path(self, part: str, file: str) -> str:
        """Path of a file."""
        return str(self._folder / part / file)

    def check(self, paths: Iterable[str]) -> None:
        """As of `LakeSource`."""
        from storage.lake.tables import damaged
        from storage.segments.disk import sha256_of

        for path in set(paths) - self._checked:
            try:
                if path in self._hashes and sha256_of(Path(path)) != self._hashes[path]:
                    raise damaged(Path(path), ValueError("its content does not match its hash"))
            except OSError as error:
                raise damaged(Path(path), error) from error
            self._checked.add(path)

    def attach(self, connection: "duckdb.DuckDBPyConnection") -> None:
        """Nothing to do."""

    def bring(self, paths: Iterable[str]) -> None:
        """Nothing to do."""

    def open_table(self, path: str) -> "tuple[pq.ParquetFile, Footer]":
        """A table of channels with page checksums, and its footer; StoreError if it is damaged."""
        from storage.sql.footers import open_local_table

        whole = Path(path)
        return open_local_table(whole, self._digests.get(f"{whole.parent.name}/{whole.name}", ""))


class RangeLake:
    """A published lake: `read` gives bytes of a file ``PART/FILE`` from an offset on."""

    root = f"{_SCHEME}://"

    def __init__(
        self, parts: Sequence[Part], read: Callable[[str, int, int], bytes],
        bring: Callable[[list[str]], None] = lambda _: None,
    ) -> None:  # fmt: skip
        self.parts = tuple(parts)
        self._read, self._bring = read, bring
        self._bytes = {f"{part.name}/{name}": file.bytes for part in parts for name, file in part.files.items()}

    @cached_property
    def _footers(self) -> "Footers":
        from storage.sql.footers import Footers

        return Footers()

    @cached_property
    def _digests(self) -> dict[str, str]:
        return _digests_of(self.parts)

    def path(self, part: str, file: str) -> str:
        """Path of a file."""
        return f"{self.root}{part}/{file}"

    def attach(self, connection: "duckdb.DuckDBPyConnection") -> None:
        """Register the file system of the lake."""
        from fsspec import AbstractFileSystem

        lake = self

        class LakeFileSystem(AbstractFileSystem):
            """Reads files of one lake."""

            protocol = _SCHEME
            cachable = False

            def open(self, path: str, *_: Any, **__: Any) -> "_RangeFile":
                return lake.open(path)

            def glob(self, path: str, **_: Any) -> list[str]:
                return [path]

            def exists(self, path: str, **_: Any) -> bool:
                return lake.name(path) in lake._bytes

            def info(self, path: str, **_: Any) -> dict[str, Any]:
                return {"name": path, "size": lake.open(path).size, "type": "file"}

            def modified(self, _: str) -> datetime:
                return _FIRST_NS

        connection.register_filesystem(LakeFileSystem())

    def check(self, paths: Iterable[str]) -> None:
        """Nothing to do: files are fetched by ranges."""

    def bring(self, paths: Iterable[str]) -> None:
        """Fetch small files, several at a time."""
        self._bring([self.name(path) for path in paths])

    def open_table(self, path: str) -> "tuple[pq.ParquetFile, Footer]":
        """A table of channels with page checksums, and its footer; StoreError if it is damaged."""
        import pyarrow as pa

        name = self.name(path)
        binary = partial(self.open, path)
        return self._footers.open_table(
            name, Path(name), lambda: pa.PythonFile(binary(), mode="r"), lambda: cast("BinaryIO", binary()),
            self._digests.get(name, ""),
        )  # fmt: skip

    def open(self, path: str) -> "_RangeFile":
        """A file, to read."""
        name = self.name(path)
        if name not in self._bytes:
            raise FileNotFoundError(path)
        return _RangeFile(name, self._bytes[name], self._read)

    def name(self, path: str) -> str:
        """``PART/FILE`` of a path."""
        return path.removeprefix(self.root)


def _digests_of(parts: Iterable[Part]) -> dict[str, str]:
    """Digests of the footers of files ``PART/FILE``, where they are known."""
    return {f"{part.name}/{name}": file.footer for part in parts for name, file in part.files.items() if file.footer}


class _RangeFile(io.RawIOBase):
    """A file that is read by ranges."""

    def __init__(self, name: str, size: int, read: Callable[[str, int, int], bytes]) -> None:
        self._name, self.size, self._read = name, size, read
        self._at = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._at

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        self._at = offset + {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self.size}[whence]
        return self._at

    def read(self, size: int = -1) -> bytes:
        length = self.size - self._at if size is None or size < 0 else size
        try:
            content = self._read(self._name, self._at, length)
        except StoreError as error:
            raise OSError(str(error)) from error
        self._at += len(content)
        return content

    def readinto(self, buffer: Any) -> int:
        content = self.read(len(buffer))
        buffer[: len(content)] = content
        return len(content)


def source_of(store: "Store | PublishedStore", parts: Iterable[Part] | None = None) -> LakeSource:
    """The lake of a store, with the parts in force now unless others are given."""
    parts_published = getattr(store, "parts", None)
    if parts_published is None:
        return LocalLake(store, parts)
    from storage.object_lake.published_store import PublishedStore

    assert isinstance(store, PublishedStore)
    return RangeLake(store.parts if parts is None else tuple(parts), store.read, store.bring)
