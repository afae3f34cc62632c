"""Footers of tables that are sorted by channel, kept for the next reader: a thousand row groups take 13 ms to parse."""

import os
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
import pyarrow as pa

from storage.lake.tables import damaged, footer_digest
from stream.batch import IntArray

if TYPE_CHECKING:
    import pyarrow.parquet as pq

# what a damaged file makes of pyarrow
UNREADABLE = (pa.ArrowException, OSError, ValueError)
_MOST_GROUPS = 16_384  # 75 MB of tables with seven columns
_NOTHING = (1, 0)  # least and greatest value of a row group without any


class Footer:
    """The footer of a table, and the least and greatest value of its columns in each row group."""

    def __init__(self, metadata: "pq.FileMetaData") -> None:
        self.metadata = metadata
        self._bounds: dict[str, tuple[IntArray, IntArray]] = {}  # found when they are first asked for

    @property
    def groups(self) -> int:
        """Number of row groups."""
        return int(self.metadata.num_row_groups)

    def bounds(self, column: str) -> tuple[IntArray, IntArray]:
        """Least and greatest value of a column of integers in each row group, both of shape (groups,)."""
        found = self._bounds.get(column)
        if found is None:
            at = self.metadata.schema.names.index(column)
            statistics = (self.metadata.row_group(group).column(at).statistics for group in range(self.groups))
            pairs = [_NOTHING if each is None else (each.min, each.max) for each in statistics]
            first, last = np.array(pairs, np.int64).reshape(-1, 2).T
            found = self._bounds[column] = first, last
        return found

    def groups_with(self, channel: int) -> list[tuple[int, bool]]:
        """Row groups that may have rows of a channel, and whether others' rows are in them too."""
        first, last = self.bounds("channel")
        found = np.flatnonzero((first <= channel) & (channel <= last))
        return [(int(group), bool(first[group] != last[group])) for group in found]

    def groups_between(self, channel: int, column: str, first: int, stop: int) -> list[int]:
        """Row groups that may have rows of a channel with ``first <= column < stop``."""
        least, most = self.bounds("channel")
        begin, end = self.bounds(column)
        found = (least <= channel) & (channel <= most) & (begin < stop) & (end >= first)
        return [int(group) for group in np.flatnonzero(found)]


class Footers:
    """Footers by the version of a file, the latest used of them; for several threads."""

    def __init__(self, most_groups: int = _MOST_GROUPS) -> None:
        self._most_groups = most_groups
        self._kept: OrderedDict[Hashable, Footer] = OrderedDict()
        self._groups = 0
        self._lock = threading.Lock()

    def open_table(
        self, version: Hashable, path: Path, source: Callable[[], Any], binary: Callable[[], BinaryIO], digest: str
    ) -> "tuple[pq.ParquetFile, Footer]":
        """A table, to read with page checksums, and its footer; StoreError if it is damaged.

        Parameters
        ----------
        version: Another one when the file is another one.
        source: Gives what pyarrow opens.
        binary: Opens the file, to check its footer before pyarrow reads it, which may end the process.
        digest: Of its footer; empty if it is not known.
        """
        import pyarrow.parquet as pq  # SQL reads tables without it

        with self._lock:
            known = self._kept.get(version)
            if known is not None:
                self._kept.move_to_end(version)
        metadata = None if known is None else known.metadata
        try:
            if known is None and digest:
                with binary() as file:
                    if footer_digest(file) != digest:
                        raise OSError("its footer is not the one that was written")
            table = pq.ParquetFile(source(), metadata=metadata, page_checksum_verification=True)
            footer = Footer(table.metadata) if known is None else known
        except UNREADABLE as error:
            raise damaged(path, error) from error
        if known is None:
            self._keep(version, footer)
        return table, footer

    def _keep(self, version: Hashable, footer: Footer) -> None:
        with self._lock:
            if version in self._kept or footer.groups > self._most_groups:
                return
            self._kept[version] = footer
            self._groups += footer.groups
            while self._groups > self._most_groups:
                _, oldest = self._kept.popitem(last=False)
                self._groups -= oldest.groups


_of_disk = Footers()


def open_local_table(path: Path, digest: str = "") -> "tuple[pq.ParquetFile, Footer]":
    """A table of a lake on the disk and its footer, which is parsed once as long as the file stays as it is."""
    try:
        status = path.stat()
    except OSError as error:
        raise damaged(path, error) from error
    version = (os.fspath(path), status.st_ino, status.st_size, status.st_mtime_ns)
    return _of_disk.open_table(version, path, lambda: path, lambda: path.open("rb"), digest)
