"""SQL over the store: statements run in a process that can only read it, and is killed at its limits."""

import tempfile
import time
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import msgspec
import pyarrow as pa

from analytics.serve.api.operation import Call, Nothing, get, post
from analytics.serve.api.query.sql_result import SqlResult, SqlRows, expanded_bytes
from analytics.serve.doors.roles import Role
from analytics.serve.sql_pool import MOST_ROWS
from storage.sql.catalog import Catalog
from storage.sql.tables import columns_of, described_tables, examples
from storage.store import Store
from stream.errors import BadInput, QueryError

_MOST_BYTES = 256 << 20


class SqlAsked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One statement, in `sql`, and its parameters for ``$name`` or ``?``.

    A result of more than `rows` is cut there and says so. `shape` of the rows in JSON: objects by column, arrays, or
    shown: arrays with the texts NaN, Infinity and -Infinity, which are null otherwise.
    """

    sql: str
    parameters: dict[str, Any] | list[Any] | None = None
    rows: Annotated[int, msgspec.Meta(ge=1, le=MOST_ROWS)] = 10_000
    shape: Literal["objects", "arrays", "shown"] = "objects"
    format: Literal["json", "arrow", "csv", "parquet"] | None = None


class SqlTables(msgspec.Struct, frozen=True, kw_only=True):
    """The tables with their columns, and example statements."""

    tables: list[dict[str, Any]]
    examples: list[dict[str, str]]


@post("/api/sql", role=Role.VIEWER)
def sql(call: Call, asked: SqlAsked) -> SqlRows:
    """Run one statement that reads; as JSON, or as Arrow, CSV or Parquet by the header Accept or `format`."""
    # the endpoint encodes it in the form that is asked for, which in JSON is that of SqlRows
    return cast("SqlRows", answered(call, asked))


def answered(call: Call, asked: SqlAsked) -> SqlResult:
    """The result of a statement; QueryError if it fails, BadInput if it is empty."""
    if not asked.sql.strip():
        raise BadInput("the statement is empty; write one, as: select unit, signal, run, samples from signals")
    began_s = time.monotonic()
    with call.service.sql.door(call.state, call.person) as door:
        result = door.ask(asked.sql, asked.parameters)
        batches, rows, size = [], 0, 0
        for batch in result.batches:
            batches.append(batch)
            rows += batch.num_rows
            size += expanded_bytes(batch)
            if size > _MOST_BYTES:
                raise QueryError(f"the result has more than {_MOST_BYTES >> 20} MiB; ask for fewer rows or columns")
            if rows > asked.rows:
                break
        result.batches.close()  # ends the process where rows are left
    table = pa.Table.from_batches(batches, result.schema).slice(0, asked.rows)
    seconds = time.monotonic() - began_s
    return SqlResult(table, asked.shape, seconds, is_truncated=rows > asked.rows)


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
