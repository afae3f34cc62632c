"""The result of a statement in the form that was asked for, encoded piece by piece: a server has many readers."""

import io
import math
from collections.abc import Iterator
from typing import Any

import msgspec
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from analytics.serve.answer_cache import Answer
from analytics.serve.api.encoding import Form
from storage.sql.door import Result
from storage.sql.printable import csv_lines, distinct_names, printable_batches
from stream.errors import QueryError
from stream.terminal.console import json_text

MOST_TEXT_BYTES = 256 << 20
_MOST_VALUES = 20_000_000  # in text each is a Python object for a moment, and some bytes of the answer
_VALUES_AT_ONCE = 100_000
_VALUE_BYTES = 8
_NOT_FINITE = {"nan": "NaN", "inf": "Infinity", "-inf": "-Infinity"}


class SqlColumn(msgspec.Struct, frozen=True):
    """A column of a result."""

    name: str
    type: str


class SqlRows(msgspec.Struct, frozen=True, kw_only=True):
    """A result: its columns, its rows, how many they are, whether there were more, and the time it took."""

    columns: list[SqlColumn]
    rows: list[Any]
    count: int
    truncated: bool
    seconds: float


class SqlResult:
    """A result in the form that was asked for; `shape` of rows in JSON is ``objects``, ``arrays`` or ``shown``."""

    def __init__(self, table: pa.Table, shape: str, seconds: float, *, is_truncated: bool) -> None:
        self._table, self._shape, self._seconds, self._is_truncated = table, shape, seconds, is_truncated

    def encoded(self, form: Form, most_bytes: int = MOST_TEXT_BYTES) -> Answer:
        """The answer; QueryError if its text would have more than `most_bytes`, or too many values."""
        sink = io.BytesIO()
        names = distinct_names(self._table.schema.names)
        if form is Form.ARROW:
            with pa.ipc.new_stream(sink, self._table.schema) as writer:
                writer.write_table(self._table)
        elif form is Form.PARQUET:
            try:
                pq.write_table(self._table.rename_columns(names), sink, compression="zstd")
            except pa.ArrowNotImplementedError as error:
                raise QueryError(f"{error}; cast such a column with COLUMN::varchar in the statement") from error
        else:
            for piece in self._csv(names) if form is Form.CSV else self._json(names):
                if sink.tell() + len(piece) > most_bytes:
                    raise QueryError(
                        f"the result has more than {most_bytes >> 20} MiB as {form}; ask for fewer rows or columns, or "
                        "for Arrow or Parquet"
                    )
                sink.write(piece)
        return Answer(sink.getvalue(), form.media_type, (("X-Truncated", str(self._is_truncated).lower()),))

    def _csv(self, names: list[str]) -> Iterator[bytes]:
        yield csv_lines(pa.array([name], pa.string()) for name in names).encode()
        for batch in self._pieces():
            yield csv_lines(batch.columns).encode()

    def _json(self, names: list[str]) -> Iterator[bytes]:
        columns = [SqlColumn(name, str(kind)) for name, kind in zip(names, self._table.schema.types, strict=True)]
        about = SqlRows(
            columns=columns, rows=[], count=self._table.num_rows, truncated=self._is_truncated,
            seconds=round(self._seconds, 4),
        )  # fmt: skip
        before, rows, after = json_text(about).partition('"rows":[')
        yield (before + rows).encode()
        comma = ""
        for batch in self._pieces():
            if self._shape == "objects":
                found: list[Any] = batch.to_pylist()
            else:
                values_of = _shown if self._shape == "shown" else pa.Array.to_pylist
                found = list(map(list, zip(*map(values_of, batch.columns), strict=True)))
            yield (comma + json_text(found)[1:-1]).encode()
            comma = ","
        yield after.encode()

    def _pieces(self) -> Iterator[pa.RecordBatch]:
        """Some rows at a time, in types that can be read; QueryError if there are too many values."""
        total = 0
        for batch in self._table.to_batches():
            values = sum(map(_values, batch.columns))
            total += values
            if total > _MOST_VALUES:
                raise QueryError(
                    f"the result has more than {_MOST_VALUES:,} values, which is too much as text; ask for fewer rows "
                    "or columns, or for Arrow or Parquet"
                )
            rows = max(1, batch.num_rows * _VALUES_AT_ONCE // max(values, expanded_bytes(batch) // _VALUE_BYTES, 1))
            for begin in range(0, batch.num_rows, rows):
                yield from printable_batches(Result(batch.schema, (each for each in [batch.slice(begin, rows)])))


def expanded_bytes(batch: pa.RecordBatch) -> int:
    """Bytes of a batch once texts that it has in a dictionary are written out, in each row the longest."""
    return int(batch.nbytes) + sum(map(_dictionary_bytes, batch.columns))


def _dictionary_bytes(column: pa.Array) -> int:
    if pa.types.is_dictionary(column.type):
        return len(column) * int(pc.max(pc.binary_length(column.dictionary)).as_py() or 0)
    return sum(map(_dictionary_bytes, _inner(column)))


def _values(column: pa.Array) -> int:
    return len(column) + sum(map(_values, _inner(column)))


def _inner(column: pa.Array) -> list[pa.Array]:
    """Arrays within an array."""
    kind = column.type
    if pa.types.is_map(kind):
        return [column.keys, column.items]
    if pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind):
        return [column.flatten()]
    if pa.types.is_struct(kind):
        return list(column.flatten())
    if pa.types.is_union(kind):
        return [column.field(number) for number in range(kind.num_fields)]
    return []


def _shown(column: pa.Array) -> list[Any]:
    """Values of a column, in which NaN and infinities, which JSON lacks, are texts."""
    values: list[Any] = column.to_pylist()
    if not pa.types.is_floating(column.type):
        return values
    return [each if each is None or math.isfinite(each) else _NOT_FINITE[str(each)] for each in values]
