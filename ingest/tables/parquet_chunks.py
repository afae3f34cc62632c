"""Parquet files, some rows at a time."""

from collections.abc import Callable, Iterator, Sequence
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from ingest.tables.columns import Columns
from ingest.tables.parquet_pages import check_pages
from ingest.tables.rows import BadRow, CellBlock, NumberCells, Sieve, TextCells
from ingest.tables.times import decimal_places, ns_from_decimals, ns_from_floats, ns_from_integers, ns_from_timestamps
from ingest.tables.units import COUNT_UNITS
from stream.batch import BoolArray, IntArray
from stream.errors import BadInput

if TYPE_CHECKING:
    import pyarrow.parquet as pq

BLOCK_ROWS = 131_072
_BLOCK_CELLS = 1_000_000
_PAGE_BYTES = 1 << 18


class ParquetTable:
    """A Parquet file as blocks of rows."""

    def __init__(self, path: Path, block_rows: int = BLOCK_ROWS) -> None:
        self._path = path
        try:
            check_pages(path)
            with self._open() as file:
                schema: pa.Schema = file.schema_arrow
                self._rows: int = file.metadata.num_rows
            self.titles = tuple(str(name) for name in schema.names)
            self._types = {name: _plain(schema.field(i).type) for i, name in enumerate(self.titles)}
        except Exception as error:  # the decoder raises whatever a damaged file makes it meet
            raise self._damaged(error) from error
        if self._rows == 0:
            raise BadInput(f"{path}: no rows; nothing to import")
        self.first_cells: dict[str, str] = {}  # text is no time in these files
        self.blank_titles: frozenset[str] = frozenset()
        self.sample_cells: Callable[[str], Sequence[str]] = lambda _: ()
        self._time_zone = "UTC"
        self._block_rows = max(1, min(block_rows, _BLOCK_CELLS // max(len(self.titles), 1)))
        whole = (title for title, kind in self._types.items() if pa.types.is_integer(kind) or pa.types.is_boolean(kind))
        self.integer_titles = frozenset(whole)
        self.stamp_titles = frozenset(title for title, kind in self._types.items() if pa.types.is_timestamp(kind))
        self.duration_units = {
            title: str(kind.unit) for title, kind in self._types.items() if pa.types.is_duration(kind)
        }
        self.unsuited = {title: held for title, kind in self._types.items() if (held := _unsuited(kind))}

    @property
    def local_zone(self) -> str | None:
        """Zone of time stamps that name none; None if there are none."""
        time = self._columns.time
        lacks_zone = time is not None and time.is_stamp and self._types[time.title].tz is None
        return self._time_zone if lacks_zone else None

    @property
    def remarks(self) -> list[str]:
        """What was interpreted."""
        zone = self.local_zone
        found = [] if zone is None else [f"time stamps without a zone are taken as {zone}"]
        titles = [signal.title for signal in self._columns.signals]
        logical = [title for title in titles if pa.types.is_boolean(self._types[title])]
        return found + [f"column {title!r}: true is taken as 1, false as 0" for title in logical]

    def bind(self, columns: Columns, time_zone: str = "UTC") -> None:
        """Set the meaning of the columns."""
        self._columns, self._time_zone = columns, time_zone
        time = None if columns.time is None else columns.time.title
        logical = {each.title for each in columns.signals if each.unit_of_measure in {"1", *COUNT_UNITS}}
        for title in columns.numeric_titles:
            kind = self._types[title]
            is_typed = pa.types.is_duration(kind) if title == time else title in logical and pa.types.is_boolean(kind)
            if not (_is_numeric(kind) or pa.types.is_null(kind) or is_typed):
                hint = "" if title == time else f", or leave it out: --rename '{title}='"
                raise BadInput(f"{self._path}: column {title!r} holds {kind}, expected numbers; convert it{hint}")
        for title in columns.text_titles:
            if not _is_word(self._types[title]):
                raise BadInput(f"{self._path}: column {title!r} holds {self._types[title]}, expected text; convert it")

    def blocks(self) -> Iterator[CellBlock]:
        """Read the rows from the beginning."""
        first = 0
        for batch in self._batches():
            try:
                block = self._block(batch, first)
            except (pa.ArrowException, UnicodeDecodeError, ValueError) as error:
                raise self._damaged(error) from error
            first += batch.num_rows
            yield block
        if first != self._rows:
            raise BadInput(f"{self._path}: {first} rows could be read of {self._rows}; the file is damaged")

    def _batches(self) -> Iterator[pa.RecordBatch]:
        try:
            with self._open() as file:
                # many small row groups give as many small batches: they are put together
                pending: list[pa.RecordBatch] = []
                for batch in file.iter_batches(self._block_rows):
                    pending.append(batch)
                    if sum(part.num_rows for part in pending) >= self._block_rows:
                        yield _joined(pending)
                        pending = []
                if pending:
                    yield _joined(pending)
        except Exception as error:  # the decoder raises whatever a damaged file makes it meet
            raise self._damaged(error) from error

    def _open(self) -> "pq.ParquetFile":
        import pyarrow.parquet as pq

        return pq.ParquetFile(
            self._path, buffer_size=_PAGE_BYTES, pre_buffer=False, memory_map=False, page_checksum_verification=True
        )

    def _damaged(self, error: Exception) -> BadInput:
        if isinstance(error, BadInput):
            return error
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        return BadInput(f"{self._path}: not a Parquet file, or a damaged one ({reason}); write it again")

    def _block(self, batch: pa.RecordBatch, first: int) -> CellBlock:
        sieve = Sieve(batch.num_rows)
        times_ns = None
        if self._columns.time is not None:
            times_ns = self._times(batch.column(self._columns.time.title), first, sieve)
        signals: dict[str, NumberCells] = {}
        for signal in self._columns.signals:
            signals[signal.name] = cells = NumberCells.of(_float64(_decoded(batch.column(signal.title))))
            wrong = ~np.isfinite(cells.values)
            if wrong.any():
                expected = "a finite number (null for no sample)"
                self._refuse(sieve, first, signal.title, wrong, batch.column(signal.title), expected)
        texts = {title: _texts(batch.column(title)) for title in self._columns.text_titles}
        numbers = np.arange(first + 1, first + 1 + batch.num_rows, dtype=np.int64)
        done = (first + batch.num_rows) / self._rows
        return CellBlock("row", numbers, times_ns, signals, texts, sieve, done)

    def _times(self, array: pa.Array, first: int, sieve: Sieve) -> IntArray:
        assert self._columns.time is not None
        title, ns_per_unit = self._columns.time.title, self._columns.time.ns_per_unit
        kind = _plain(array.type)
        if array.null_count:
            empty = array.is_null().to_numpy(zero_copy_only=False)
            self._refuse(sieve, first, title, empty, array, "a time")
        if pa.types.is_null(kind):
            return np.zeros(len(array), np.int64)
        filled = _decoded(array)
        if array.null_count:  # without nulls it would import a module that takes a tenth of a second
            filled = filled.fill_null(pa.scalar(Decimal(0) if pa.types.is_decimal(kind) else 0, kind))
        if pa.types.is_timestamp(kind):
            times_ns, wrong = ns_from_timestamps(filled, self._time_zone)
        elif pa.types.is_decimal(kind) and (places := decimal_places(ns_per_unit)) is not None:
            times_ns, wrong = ns_from_decimals(filled, places)
        elif pa.types.is_uint64(kind):
            unsigned = filled.to_numpy()
            times_ns, wrong = ns_from_integers(np.minimum(unsigned, 2**63 - 1).astype(np.int64), ns_per_unit)
        elif pa.types.is_integer(kind) or pa.types.is_duration(kind):
            times_ns, wrong = ns_from_integers(filled.cast(pa.int64()).to_numpy(), ns_per_unit)
        else:
            times_ns, wrong = ns_from_floats(_float64(filled).to_numpy(), ns_per_unit)
        if wrong.any():
            self._refuse(sieve, first, title, wrong, array, "a finite time within 146 years of 1970")
        return times_ns

    def _refuse(self, sieve: Sieve, first: int, title: str, wrong: BoolArray, array: pa.Array, expected: str) -> None:
        def why(row: int) -> BadRow:
            try:
                value = array[row].as_py()
            except (OverflowError, ValueError):  # beyond what Python's dates hold
                value = f"{array[row].cast(pa.int64()).as_py()} ({array.type})"
            return BadRow("row", first + row + 1, title, "null" if value is None else str(value), expected)

        sieve.refuse(np.flatnonzero(wrong), why)


def _joined(batches: list[pa.RecordBatch]) -> pa.RecordBatch:
    if len(batches) == 1:
        return batches[0]
    return pa.Table.from_batches(batches).unify_dictionaries().combine_chunks().to_batches()[0]


def _plain(kind: Any) -> Any:
    return kind.value_type if pa.types.is_dictionary(kind) else kind


def _is_numeric(kind: Any) -> bool:
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind))


def _is_word(kind: Any) -> bool:
    is_text = pa.types.is_string(kind) or pa.types.is_large_string(kind) or pa.types.is_string_view(kind)
    return bool(is_text or pa.types.is_null(kind) or pa.types.is_boolean(kind) or _is_numeric(kind))


def _unsuited(kind: Any) -> str:
    """What a column holds that is neither a time nor a number; empty for others."""
    if pa.types.is_time(kind):
        return f"times of day without a date ({kind}), which begin again at midnight"
    if pa.types.is_date(kind):
        return f"dates without a time of day ({kind})"
    is_text = pa.types.is_string(kind) or pa.types.is_large_string(kind) or pa.types.is_string_view(kind)
    if is_text or pa.types.is_nested(kind) or pa.types.is_binary(kind) or pa.types.is_large_binary(kind):
        return f"text ({kind})" if is_text else f"{kind}"
    return ""


def _decoded(array: pa.Array) -> pa.Array:
    return array.dictionary_decode() if pa.types.is_dictionary(array.type) else array


def _float64(array: pa.Array) -> pa.Array:
    if pa.types.is_decimal(array.type):  # by way of its text: Arrow's cast is not rounded to the nearest
        array = array.cast(pa.string())
    return array if pa.types.is_float64(array.type) else array.cast(pa.float64(), safe=False)


def _texts(array: pa.Array) -> TextCells:
    if pa.types.is_null(array.type):
        return TextCells(np.full(len(array), -1, np.int32), [])
    encoded = array if pa.types.is_dictionary(array.type) else array.dictionary_encode()
    codes = encoded.indices.cast(pa.int32()).fill_null(-1).to_numpy()
    return TextCells(codes, encoded.dictionary.to_pylist())
