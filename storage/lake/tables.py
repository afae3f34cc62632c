"""The tables of a part of the lake: their columns, how they are encoded, and how they are brought to the disk."""

import hashlib
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from storage.manifests.lake import PartFile
from stream.errors import StoreError

ROW_GROUP = 1_000_000
# a row group costs 0.3 ms and kilobytes of memory: channels of few samples share them
_SMALL_ROWS, _SHARED_ROWS = 4096, 65_536

SAMPLE_COLUMNS = pa.schema(
    [
        ("channel", pa.int64()),
        ("seq", pa.int64()),
        ("t_ns", pa.int64()),
        # counts are base + above, which takes less room than the counts themselves
        ("base", pa.int32()),
        ("above", pa.int32()),
        ("value", pa.float64()),
        ("flags", pa.uint8()),
    ]
)
CHANNEL_COLUMNS = pa.schema(
    [
        ("channel", pa.int64()),
        ("site", pa.string()),
        ("station", pa.string()),
        ("unit", pa.string()),
        ("signal", pa.string()),
        ("run", pa.string()),
        ("epoch", pa.string()),
        ("unit_of_measure", pa.string()),
        ("is_counts", pa.bool_()),
        ("scale", pa.float64()),
        ("offset", pa.float64()),
        ("dt_ns", pa.int64()),
        ("irregular", pa.bool_()),
        ("samples", pa.int64()),
        ("seq_first", pa.int64()),
        ("seq_next", pa.int64()),
        ("t_first_ns", pa.int64()),
        ("t_last_ns", pa.int64()),
        ("arrival_first_ns", pa.int64()),
        ("arrival_last_ns", pa.int64()),
        # stretches put together here overlap in time
        ("overlapping", pa.bool_()),
    ]
)
EVENT_COLUMNS = pa.schema(
    [
        ("site", pa.string()),
        ("station", pa.string()),
        ("kind", pa.string()),
        ("run", pa.string()),
        ("unit", pa.string()),
        ("uid", pa.string()),
        ("t_ns", pa.int64()),
        ("arrival_ns", pa.int64()),
        ("document", pa.string()),
    ]
)
ESTIMATE_COLUMNS = pa.schema(
    [
        ("site", pa.string()),
        ("station", pa.string()),
        ("run", pa.string()),
        ("unit", pa.string()),
        ("signal", pa.string()),
        ("estimator", pa.string()),
        ("t_ns", pa.int64()),
        ("arrival_ns", pa.int64()),
        ("final", pa.bool_()),
        ("tau_s", pa.float64()),
        ("value", pa.float64()),
        ("lo", pa.float64()),
        ("hi", pa.float64()),
        ("confidence", pa.float64()),
        ("edf", pa.float64()),
        ("n", pa.int64()),
        ("unit_of_measure", pa.string()),
        ("samples", pa.int64()),
        ("missing", pa.int64()),
        ("sample_interval_s", pa.float64()),
        ("reason", pa.string()),
        ("uid", pa.string()),
    ]
)
ROLLUP_COLUMNS = pa.schema(
    [
        ("channel", pa.int64()),
        ("bucket", pa.int64()),
        ("n", pa.int64()),
        ("mean", pa.float64()),
        ("m2", pa.float64()),
        ("lo", pa.float64()),
        ("hi", pa.float64()),
        # first or last of its channel in a segment: the bucket may go on in another one
        ("edge", pa.bool_()),
    ]
)
CLOCK_COLUMNS = pa.schema(
    [
        ("channel", pa.int64()),
        ("seq_first", pa.int64()),
        ("messages", pa.int64()),
        ("t_first_ns", pa.int64()),
        ("t_last_ns", pa.int64()),
        ("arrival_first_ns", pa.int64()),
        ("arrival_last_ns", pa.int64()),
        ("t_least_ns", pa.int64()),
        ("delay_least_ns", pa.int64()),
        ("backward_inside", pa.int64()),
        ("backward_most_ns", pa.int64()),
    ]
)
TABLES = {
    "samples": SAMPLE_COLUMNS,
    "channels": CHANNEL_COLUMNS,
    "events": EVENT_COLUMNS,
    "estimates": ESTIMATE_COLUMNS,
    "rollup_1s": ROLLUP_COLUMNS,
    "rollup_10s": ROLLUP_COLUMNS,
    "clocks": CLOCK_COLUMNS,
}
SAMPLES_FILE = "samples.parquet"

_INTEGERS = (
    *("seq", "t_ns", "base", "bucket", "n", "seq_first", "messages", "t_first_ns", "t_last_ns"),
    *("arrival_first_ns", "arrival_last_ns", "t_least_ns", "delay_least_ns"),
)
_FLOATS = ("value", "mean", "m2")
_SPLIT_TABLES = {"samples", "rollup_1s", "rollup_10s", "clocks"}
# Statistics that prune row groups; those of the others would only make the footers long.
_STATISTICS = ["channel", "seq", "t_ns", "bucket"]


class _HashingFile:
    """A file as pyarrow writes it; what was written is hashed on its way."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb")
        self._hash = hashlib.sha256()
        self._bytes = 0
        self.closed = False

    def write(self, data: bytes) -> int:
        size = memoryview(data).nbytes
        if not self._file.closed:  # else it is given up, and pyarrow's writer ends its file all the same
            self._hash.update(data)
            self._bytes += size
            self._file.write(data)
        return size

    def tell(self) -> int:
        return self._bytes

    def flush(self) -> None:
        if not self._file.closed:
            self._file.flush()

    def close(self) -> None:
        """Do nothing: the file is closed when it is on the disk."""

    def finish(self, rows: int) -> PartFile:
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()
        return PartFile(bytes=self._bytes, rows=rows, sha256=self._hash.hexdigest())

    def abandon(self) -> None:
        with suppress(OSError):  # of a full disk, once more
            self._file.close()


class TableWriter:
    """Writes one table of a part, piece by piece.

    Parameters
    ----------
    folder: Of the part.
    table: One of `TABLES`.
    """

    def __init__(self, folder: Path, table: str) -> None:
        schema = TABLES[table]
        more: dict[str, Any] = {}
        if table in _SPLIT_TABLES:
            more["column_encoding"] = {
                **{name: "DELTA_BINARY_PACKED" for name in _INTEGERS if name in schema.names},
                **{name: "BYTE_STREAM_SPLIT" for name in (*_FLOATS, "above") if name in schema.names},
            }
            more["use_dictionary"] = [name for name in schema.names if name not in more["column_encoding"]]
            more["write_statistics"] = [name for name in schema.names if name in _STATISTICS]
        self.schema = schema
        self.rows = 0
        self._small: list[pa.Table] = []
        self._small_rows = 0
        self._file = _HashingFile(folder / f"{table}.parquet")
        self._writer = pq.ParquetWriter(
            self._file, schema, compression="zstd", compression_level=3, write_page_checksum=True, **more
        )

    def write(self, table: pa.Table) -> None:
        """Add rows, in row groups of their own; few rows share one with those before and after them."""
        self.rows += table.num_rows
        if table.num_rows >= _SMALL_ROWS:
            self._write_small()
            self._writer.write_table(table, row_group_size=ROW_GROUP)
            return
        self._small.append(table)
        self._small_rows += table.num_rows
        if self._small_rows >= _SHARED_ROWS:
            self._write_small()

    def finish(self) -> PartFile:
        """Bring the file to the disk."""
        self._write_small()
        self._writer.close()
        return self._file.finish(self.rows)

    def abandon(self) -> None:
        """Leave the file as it is."""
        self._file.abandon()

    def _write_small(self) -> None:
        if self._small:
            table = pa.concat_tables(self._small).combine_chunks()
            self._small, self._small_rows = [], 0
            self._writer.write_table(table, row_group_size=ROW_GROUP)


@contextmanager
def part_writers(folder: Path) -> Iterator[Callable[[str], TableWriter]]:
    """Writers of the tables of one part by name; each is left as it is where an error comes."""
    opened: list[TableWriter] = []

    def writer(table: str) -> TableWriter:
        opened.append(TableWriter(folder, table))
        return opened[-1]

    try:
        yield writer
    except BaseException:
        for each in opened:
            each.abandon()
        raise


def open_table(path: Path) -> pq.ParquetFile:
    """A table of the lake for reading, its pages checked.

    Raises
    ------
    StoreError: If it cannot be read.
    """
    try:
        return pq.ParquetFile(path, page_checksum_verification=True)
    except (pa.ArrowException, OSError) as error:
        raise damaged(path, error) from error


def damaged(path: Path, error: Exception) -> StoreError:
    """The error for a file of the lake that cannot be read."""
    reason = " ".join(str(error).split())
    return StoreError(
        f"{path} cannot be read ({reason}); `gyrofleet verify` says what else is damaged, `gyrofleet recover` makes "
        f"it anew from the log"
    )
