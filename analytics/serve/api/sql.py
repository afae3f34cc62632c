"""SQL over the store: statements run in a process that can only read it, and is killed at its limits."""

import csv
import io
import tempfile
import time
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from analytics.serve.answer_cache import Answer
from analytics.serve.api.encoding import Form
from analytics.serve.api.operation import Call, Nothing, get, post
from analytics.serve.doors.roles import Role
from analytics.serve.sql_pool import MOST_ROWS
from storage.sql.catalog import Catalog
from storage.sql.door import Result
from storage.sql.printable import csv_cells, distinct_names, printable_batches
from storage.sql.tables import columns_of, described_tables, examples
from storage.store import Store
from stream.console import json_text
from stream.errors import BadInput, QueryError

_MOST_BYTES = 256 << 20


class SqlAsked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One statement, in `sql`, and its parameters for ``$name`` or ``?``.

    A result of more than `rows` is cut there and says so. `shape` of the rows in JSON: objects by column, or arrays.
    """

    sql: str
    parameters: dict[str, Any] | list[Any] | None = None
    rows: Annotated[int, msgspec.Meta(ge=1, le=MOST_ROWS)] = 10_000
    shape: Literal["objects", "arrays"] = "objects"
    format: Literal["json", "arrow", "csv", "parquet"] | None = None


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
    """A result in the form that was asked for."""

    def __init__(self, table: pa.Table, asked: SqlAsked, seconds: float, *, is_truncated: bool) -> None:
        self._table, self._asked, self._seconds, self._is_truncated = table, asked, seconds, is_truncated

    def encoded(self, form: Form) -> Answer:
        """The answer."""
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
        elif form is Form.CSV:
            text = io.StringIO()
            writer_of_rows = csv.writer(text)
            writer_of_rows.writerow(csv_cells(pa.array(names)))
            for batch in self._printable():
                writer_of_rows.writerows(zip(*map(csv_cells, batch.columns), strict=True))
            sink.write(text.getvalue().encode())
        else:
            sink.write(json_text(self._document()).encode())
        return Answer(sink.getvalue(), form.media_type)

    def _document(self) -> SqlRows:
        rows: list[Any] = []
        for batch in self._printable():
            if self._asked.shape == "objects":
                rows += batch.to_pylist()
            else:
                rows += map(list, zip(*(column.to_pylist() for column in batch.columns), strict=True))
        names = distinct_names(self._table.schema.names)
        columns = [SqlColumn(name, str(kind)) for name, kind in zip(names, self._table.schema.types, strict=True)]
        return SqlRows(
            columns=columns, rows=rows, count=self._table.num_rows, truncated=self._is_truncated,
            seconds=round(self._seconds, 4),
        )  # fmt: skip

    def _printable(self) -> list[pa.RecordBatch]:
        return list(printable_batches(Result(self._table.schema, (batch for batch in self._table.to_batches()))))


class SqlTables(msgspec.Struct, frozen=True, kw_only=True):
    """The tables with their columns, and example statements."""

    tables: list[dict[str, Any]]
    examples: list[dict[str, str]]


@post("/api/sql", role=Role.VIEWER)
def sql(call: Call, asked: SqlAsked) -> SqlRows:
    """Run one statement that reads; as JSON, or as Arrow, CSV or Parquet by the header Accept or `format`."""
    if not asked.sql.strip():
        raise BadInput("the statement is empty; write one, as: select unit, signal, run, samples from signals")
    began_s = time.monotonic()
    with call.service.sql.door(call.state, call.person) as door:
        result = door.ask(asked.sql, asked.parameters)
        batches, rows, size = [], 0, 0
        for batch in result.batches:
            batches.append(batch)
            rows += batch.num_rows
            size += batch.nbytes
            if size > _MOST_BYTES:
                raise QueryError(f"the result has more than {_MOST_BYTES >> 20} MiB; ask for fewer rows or columns")
            if rows > asked.rows:
                break
        result.batches.close()  # ends the process where rows are left
    table = pa.Table.from_batches(batches, result.schema).slice(0, asked.rows)
    seconds = time.monotonic() - began_s
    # encoded by the endpoint in the form that is asked for
    return SqlResult(table, asked, seconds, is_truncated=rows > asked.rows)  # type: ignore[return-value]


@get("/api/sql/tables", is_slow=True)
def sql_tables(call: Call, asked: Nothing) -> SqlTables:
    """The tables that a statement can name, with the meaning of their columns, and examples."""
    del call, asked
    return known_tables()


@cache
def known_tables() -> SqlTables:
    """The tables of any store; read from an empty one, where no metrics have to be computed first."""
    with (
        tempfile.TemporaryDirectory(prefix="gyrofleet-serve-") as folder,
        Catalog(Store.create(Path(folder))) as catalog,
    ):
        tables = described_tables(catalog)
        rows = [each | {"columns": columns_of(catalog, str(each["table"]))} for each in tables]
    pairs = [{"question": question, "sql": statement} for question, statement in examples().items()]
    return SqlTables(tables=rows, examples=pairs)
