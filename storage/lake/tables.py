"""The tables of a part of the lake: columns, encoding, reading and writing."""

import hashlib
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import pyarrow as pa

from storage.manifests.part import PartFile
from stream.errors import StoreError

if TYPE_CHECKING:
    import pyarrow.parquet as pq

ROW_GROUP = 1_000_000
_DIGEST_DIGITS = 16  # enough against accidents
# who asks for one channel reads its row groups whole, as do a hundred channels' rollups of some minutes
_ROLLUP_ROWS = 16_384
# pages of 20,000 rows, the library's choice, make a file of noise 4 % larger: zstd takes 128 KiB at once, in which
# planes of bytes stand one after the other; level 5 splits them
_PAGE_ROWS, _LEVELS = 262_144, {"samples": 5}
# a row group costs 0.3 ms and kilobytes of memory: channels of few samples share one
SMALL_ROWS, SHARED_ROWS = 4096, 65_536


def _schema(*groups: tuple[pa.DataType, str]) -> pa.Schema:
    return pa.schema([(name, kind) for kind, names in groups for name in names.split()])


# one more with each column that is added: parts of an earlier version have null there
COLUMNS_VERSION = 1
_INT, _FLOAT, _TEXT, _BOOL = pa.int64(), pa.float64(), pa.string(), pa.bool_()
# counts are base + above, which takes less space than the counts themselves
SAMPLE_COLUMNS = _schema(
    (_INT, "channel seq t_ns"), (pa.int32(), "base above"), (_FLOAT, "value"), (pa.uint8(), "flags")
)
# overlapping: stretches that were joined here overlap in time
CHANNEL_COLUMNS = _schema(
    (_INT, "channel"),
    (_TEXT, "site station unit signal run epoch unit_of_measure"),
    (_BOOL, "is_counts"),
    (_FLOAT, "scale offset"),
    (_INT, "dt_ns"),
    (_BOOL, "irregular"),
    (_INT, "samples seq_first seq_next t_first_ns t_last_ns arrival_first_ns arrival_last_ns"),
    (_BOOL, "overlapping"),
)
EVENT_COLUMNS = _schema((_TEXT, "site station kind run unit uid"), (_INT, "t_ns arrival_ns"), (_TEXT, "document"))
ESTIMATE_COLUMNS = _schema(
    (_TEXT, "site station run unit signal estimator"),
    (_INT, "t_ns arrival_ns"),
    (_BOOL, "final"),
    (_FLOAT, "tau_s value lo hi confidence edf"),
    (_INT, "n"),
    (_TEXT, "unit_of_measure"),
    (_INT, "samples missing"),
    (_FLOAT, "sample_interval_s"),
    (_TEXT, "reason uid"),
)
# edge: first or last bucket of its channel in a segment, which may continue in another one
ROLLUP_COLUMNS = _schema((_INT, "channel bucket n"), (_FLOAT, "mean m2 lo hi"), (_BOOL, "edge"))
CLOCK_COLUMNS = _schema(
    (_INT, "channel seq_first messages t_first_ns t_last_ns arrival_first_ns arrival_last_ns"),
    (_INT, "t_least_ns delay_least_ns backward_inside backward_most_ns"),
)
# samples in memory, a row for each message; of the lists those that a message has
MESSAGE_COLUMNS = pa.schema(
    [
        *((name, _INT) for name in ("channel", "seq", "t0_ns", "dt_ns", "n")),
        ("counts", pa.list_(pa.int32())), ("vals", pa.list_(_FLOAT)), ("times_ns", pa.list_(_INT)),
        ("flags", pa.list_(pa.uint8())),
    ]
)  # fmt: skip
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
_FLOATS = ("value", "mean", "m2")  # not lo and hi: of counts they have few values, and a dictionary is 40 % smaller
_SPLIT_TABLES = {"samples", "rollup_1s", "rollup_10s", "clocks"}
# Never null: written in two thirds of the time, since no definition levels are.
_REQUIRED = {"samples": ("channel", "seq", "t_ns")}
# Statistics that prune row groups; others would only lengthen the footers.
_STATISTICS = ["channel", "seq", "t_ns", "bucket"]


def statistics_columns(table: str) -> list[str]:
    """Columns of one of `TABLES` whose least and greatest values its files have.

    >>> statistics_columns("rollup_1s")
    ['channel', 'bucket']
    """
    names = TABLES[table].names
    return [name for name in names if name in _STATISTICS] if table in _SPLIT_TABLES else names


class _HashingFile:
    """A file for pyarrow that hashes what is written."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file = path.open("wb")
        self._hash = hashlib.sha256()
        self._bytes = 0
        self.closed = False

    def write(self, data: bytes) -> int:
        size = memoryview(data).nbytes
        if not self._file.closed:  # pyarrow's writer ends its file also after `abandon`
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
        """Do nothing: `finish` closes the file."""

    def finish(self, rows: int) -> PartFile:
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()
        with self._path.open("rb") as written:
            footer = footer_digest(written)
        return PartFile(bytes=self._bytes, rows=rows, sha256=self._hash.hexdigest(), footer=footer)

    def abandon(self) -> None:
        with suppress(OSError):  # the disk is full
            self._file.close()


class TableWriter:
    """Writes one of `TABLES` into the folder of a part, piece by piece."""

    def __init__(self, folder: Path, table: str) -> None:
        import pyarrow.parquet as pq

        schema = TABLES[table]
        more: dict[str, Any] = {}
        if table in _SPLIT_TABLES:
            more["column_encoding"] = {
                **{name: "DELTA_BINARY_PACKED" for name in _INTEGERS if name in schema.names},
                **{name: "BYTE_STREAM_SPLIT" for name in (*_FLOATS, "above") if name in schema.names},
            }
            more["use_dictionary"] = [name for name in schema.names if name not in more["column_encoding"]]
            more["write_statistics"] = statistics_columns(table)
        self.schema = schema
        required = _REQUIRED.get(table, ())
        self._in_file = pa.schema([field.with_nullable(field.name not in required) for field in schema])
        self.rows = 0
        self._group_rows = _ROLLUP_ROWS if table.startswith("rollup") else ROW_GROUP
        self._small: list[pa.Table] = []
        self._small_rows = 0
        self._file = _HashingFile(folder / f"{table}.parquet")
        self._writer = pq.ParquetWriter(
            self._file, self._in_file, compression="zstd", compression_level=_LEVELS.get(table, 3),
            max_rows_per_page=_PAGE_ROWS, write_page_checksum=True, **more,
        )  # fmt: skip

    def write(self, table: pa.Table) -> None:
        """Add rows, as row groups of their own; small tables share row groups."""
        self.rows += table.num_rows
        if table.num_rows >= SMALL_ROWS:
            self._write_small()
            self._write(table)
            return
        self._small.append(table)
        self._small_rows += table.num_rows
        if self._small_rows >= SHARED_ROWS:
            self._write_small()

    def write_all(self, tables: Iterable[pa.Table]) -> PartFile:
        """Add all rows there are, and complete the file, durably."""
        for table in tables:
            self.write(table)
        return self.finish()

    def finish(self) -> PartFile:
        """Complete the file, durably."""
        self._write_small()
        self._writer.close()
        return self._file.finish(self.rows)

    def abandon(self) -> None:
        """Leave the file incomplete."""
        self._file.abandon()

    def _write_small(self) -> None:
        if self._small:
            table = pa.concat_tables(self._small).combine_chunks()
            self._small, self._small_rows = [], 0
            self._write(table)

    def _write(self, table: pa.Table) -> None:
        if (table.schema.names, table.schema.types) == (self._in_file.names, self._in_file.types):
            # as `cast` does, without the module that it imports, which takes a tenth of a second
            lacking = [each.name for each in self._in_file if not each.nullable and table.column(each.name).null_count]
            if lacking:
                raise ValueError(f"column {lacking[0]!r} is never null, and has a null")
            table = pa.Table.from_arrays(table.columns, schema=self._in_file)
        else:
            table = table.cast(self._in_file)
        self._writer.write_table(table, row_group_size=self._group_rows)


@contextmanager
def part_writers(folder: Path) -> Iterator[Callable[[str], TableWriter]]:
    """Writers of the tables of one part by name; after an error all are abandoned."""
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


def open_table(path: Path) -> "pq.ParquetFile":
    """Open a table of the lake for reading with page checksums; StoreError if it is damaged."""
    import pyarrow.parquet as pq  # SQL reads tables without it

    try:
        return pq.ParquetFile(path, page_checksum_verification=True)
    except (pa.ArrowException, OSError) as error:
        raise damaged(path, error) from error


def footer_digest(file: BinaryIO) -> str:
    """Digest of the footer of a Parquet file, which has no checksum of its own; OSError or ValueError if it has none.

    Its statistics say which row groups are read: damaged ones would leave rows out in silence.
    """
    file.seek(-8, os.SEEK_END)
    length = int.from_bytes(file.read(4), "little")
    file.seek(-8 - length, os.SEEK_END)
    return hashlib.sha256(file.read()).hexdigest()[:_DIGEST_DIGITS]


def damaged(path: Path, error: Exception) -> StoreError:
    """The error of a file of the lake that cannot be read."""
    reason = " ".join(str(error).split())
    return StoreError(
        f"{path} cannot be read ({reason}); `gyrofleet verify` lists the damage, `gyrofleet recover` rebuilds "
        f"it from the log"
    )
