"""SQL over a store: DuckDB views on the lake, for reading only."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib.metadata import entry_points
from importlib.resources import files
from pathlib import Path
from typing import Any, Protocol

import duckdb
import pyarrow as pa

from storage.findings import Finding
from storage.lake.tables import TABLES
from storage.manifests.lake import Part, read_manifest
from storage.sql.guard import check_statement
from storage.sql.guard import plain_message as _told
from storage.sql.macros import conversion_macros
from storage.store import Store
from stream.errors import QueryError, StoreError

VIEWS = ("samples", "signals", "runs", "units", "steps", "estimates", "events", "rollup_1s", "rollup_10s", "clocks")

Told = Callable[[int, int], None]

_READING = {duckdb.StatementType.SELECT, duckdb.StatementType.EXPLAIN}
_SQL_TYPES = {
    pa.int64(): "bigint",
    pa.int32(): "integer",
    pa.uint8(): "utinyint",
    pa.float64(): "double",
    pa.string(): "varchar",
    pa.bool_(): "boolean",
}


class NotKept(Exception):
    """A layer would have to compute what is not kept in the store, in a catalogue that only reads."""


class Layer(Protocol):
    """Further tables, made by a package that stands above this one; an entry point in the group `gyrofleet.catalog`.

    Its tables are made when a statement first names one of them.
    """

    tables: tuple[str, ...]
    """Names of its tables, views and macros."""
    folder: str
    """Folder in the store in which it keeps what it has computed."""
    examples: Mapping[str, str]
    """Questions and the statements that answer them."""

    @property
    def columns(self) -> Mapping[str, Mapping[str, str]]:
        """What the columns of its tables hold: table, column, words; of table ``every`` what means the same in all."""

    def fill(self, catalog: "Catalog") -> None:
        """Define the tables in the catalogue, through `Catalog.put` and `Catalog.define`."""

    def findings(self, store: Store) -> list[Finding]:
        """What is wrong with what it keeps in a store, for `gyrofleet verify`."""


@cache
def layers() -> tuple[Layer, ...]:
    """The layers that are installed."""
    found = sorted(entry_points(group="gyrofleet.catalog"), key=lambda each: each.name)
    return tuple(each.load()() for each in found)


class Catalog:
    """The views of a store: ``samples``, ``signals``, ``runs``, ``units``, ``steps``, ``estimates``, and others.

    It sees what has reached the lake when it is opened.

    Parameters
    ----------
    store: Which store.
    file: A DuckDB database that is made with the same views; it can be opened by any DuckDB for as long as the store's
        Parquet files are where they are. By default the views are in memory.
    told: Hears from a layer that is being filled how many of how many parts of its work are done.
    parts: Parts of the lake that it sees; by default those in force now.
    kept: Folder whose `Layer.folder` holds what layers keep; by default the store's.
    frozen: Layers take what is kept and neither compute nor keep anything: they raise `NotKept` instead.
    memory_bytes: What DuckDB may take; by default most of the machine's. Nothing is put on the disk when it does not
        suffice.

    Attributes
    ----------
    parts: Parts of the lake that it sees, in the order of their segments.

    Raises
    ------
    StoreError: If the lake is damaged.
    """

    def __init__(
        self,
        store: Store,
        file: Path | None = None,
        *,
        told: Told | None = None,
        parts: Iterable[Part] | None = None,
        kept: Path | None = None,
        frozen: bool = False,
        memory_bytes: int | None = None,
    ) -> None:
        self.store = store
        self.told = told
        self.kept = store.folder if kept is None else kept
        self.frozen = frozen
        self._connection = duckdb.connect(":memory:" if file is None else str(file))
        self._connection.execute("set timezone = 'UTC'")
        self.parts = read_manifest(store).parts if parts is None else tuple(parts)
        self._unfilled = list(layers())
        for table in ("samples", "events", "estimates", "rollup_1s", "rollup_10s", "clocks"):
            self._attach(f"lake_{table}", table, self.parts)
        self._attach("lake_channels_kept", "channels", [part for part in self.parts if part.dropped is None])
        self._attach("lake_channels_dropped", "channels", [part for part in self.parts if part.dropped is not None])
        for script in sorted(files("storage.sql").joinpath("schema").iterdir(), key=lambda each: each.name):
            if script.name.endswith(".sql"):
                self._run(script.read_text())
        self.define(
            conversion_macros(unit for (unit,) in self._selected("select distinct unit_of_measure from lake_channels"))
        )
        folders = [store.lake, *(self.kept / layer.folder for layer in layers())]
        allowed = ", ".join("'" + str(each.resolve()).replace("'", "''") + "'" for each in folders)
        self._connection.execute(f"set allowed_directories = [{allowed}]")
        if memory_bytes is not None:
            self._connection.execute(f"set memory_limit = '{memory_bytes}B'")
            self._connection.execute("set temp_directory = ''")
        self._connection.execute("set enable_external_access = false")
        self._connection.execute("set python_enable_replacements = false")  # a table's name is never a variable's
        self._connection.execute("set lock_configuration = true")

    def _selected(self, sql: str) -> list[tuple[Any, ...]]:
        return self._connection.execute(sql).fetchall()

    def _attach(self, source: str, table: str, parts: Iterable[Part]) -> None:
        """A view of a table over the parts that have it; DuckDB opens the first file now, the others when asked."""
        file = f"{table}.parquet"
        paths = [
            str(self.store.lake / part.name / file) for part in parts if file in part.files and part.files[file].rows
        ]
        if not paths:
            columns = ", ".join(f'"{column.name}" {_SQL_TYPES[column.type]}' for column in TABLES[table])
            self._connection.execute(f"create table {source} ({columns}, filename varchar)")
            return
        listed = ", ".join("'" + path.replace("'", "''") + "'" for path in paths)
        self._run(f"create view {source} as select *, filename from read_parquet([{listed}])")  # noqa: S608

    def _run(self, sql: str) -> None:
        try:
            self._connection.execute(sql)
        except duckdb.Error as error:
            raise StoreError(
                f"the lake of {self.store.folder} cannot be read ({_told(error)}); `gyrofleet verify` says what is "
                f"damaged, `gyrofleet recover` makes it anew from the log"
            ) from error

    def define(self, sql: str) -> None:
        """Run statements that define tables, views and macros; for layers.

        Raises
        ------
        QueryError: If one fails.
        """
        try:
            self._connection.execute(sql)
        except duckdb.Error as error:
            raise QueryError(_told(error)) from error

    def put(self, name: str, table: pa.Table) -> None:
        """Make a table of these rows, in place of one of that name."""
        self._connection.register("put_rows", table)
        try:
            self.define(f'create or replace table "{name}" as select * from put_rows')  # noqa: S608  a layer's own name
        finally:
            self._connection.unregister("put_rows")

    def fill(self) -> None:
        """Make the tables of all layers now, not when they are first named."""
        self._fill(" ".join(table for layer in layers() for table in layer.tables))

    @contextmanager
    def suspended_layers(self) -> Iterator[tuple[Layer, ...]]:
        """Within it no layer is filled, so that one can put a part of its tables; the layers not filled yet."""
        waiting, self._unfilled = self._unfilled, []
        try:
            yield tuple(waiting)
        finally:
            self._unfilled = waiting

    def _fill(self, sql: str) -> None:
        if not self._unfilled:
            return
        words = set(re.findall(r"\w+", sql.lower()))
        for layer in [each for each in self._unfilled if words.intersection(each.tables)]:
            self._unfilled.remove(layer)  # before: it asks this catalogue
            try:
                layer.fill(self)
            except BaseException:
                self._unfilled.append(layer)
                raise

    def reader(self, sql: str, parameters: object = None, rows: int = 100_000) -> pa.RecordBatchReader:
        """The result of one of our own statements that read, to be taken piece by piece through `guarded`.

        A user's statement goes through `user_reader`.

        Raises
        ------
        QueryError: If the statement would write, is more than one, or fails.
        """
        self._fill(sql)
        try:
            statements = self._connection.extract_statements(sql)
            if len(statements) != 1:
                raise QueryError(f"{len(statements)} statements found, one is expected: give them one at a time")
            kind = statements[0].type
            if kind not in _READING:
                raise QueryError(
                    f"{kind.name} is refused: the store is only read here. What runs is SELECT (also WITH, FROM, "
                    f"DESCRIBE, SUMMARIZE, EXPLAIN); to keep a result use --csv or --parquet FILE"
                )
            return self._connection.cursor().sql(sql, params=parameters).to_arrow_reader(rows)
        except duckdb.Error as error:
            raise _failed(error) from error

    def prepare(self, sql: str) -> None:
        """Check a user's statement, and make the tables of layers that it names.

        Raises
        ------
        QueryError: If it would do more than read the views, is more than one, or cannot be parsed.
        NotKept: If the catalogue is frozen and a table would have to be computed.
        """
        macros = {"adev", *(table for layer in layers() for table in layer.tables)}
        try:
            check_statement(self._connection, sql, macros)
        except QueryError as error:
            if isinstance(error.__cause__, duckdb.Error):
                raise _failed(error.__cause__) from error
            raise
        self._fill(sql)

    def user_reader(self, sql: str, parameters: object = None, rows: int = 100_000) -> pa.RecordBatchReader:
        """The result of a user's statement, which may name the store's views and no file; read through `guarded`.

        Raises
        ------
        QueryError: If it would do more than read the views, is more than one, or fails.
        """
        self.prepare(sql)
        try:
            cursor = self._connection.cursor()
            cursor.execute("begin transaction read only")
            return cursor.sql(sql, params=parameters).to_arrow_reader(rows)
        except duckdb.Error as error:
            raise _failed(error) from error

    def guarded(self, reader: pa.RecordBatchReader) -> Iterator[pa.RecordBatch]:
        """The pieces of a result.

        Raises
        ------
        QueryError: If the statement fails on its way.
        """
        try:
            yield from reader
        except (duckdb.Error, pa.ArrowException, OSError) as error:
            raise QueryError(_told(error)) from error

    def batches(self, sql: str, parameters: object = None, rows: int = 100_000) -> Iterator[pa.RecordBatch]:
        """The pieces of a statement's result."""
        yield from self.guarded(self.reader(sql, parameters, rows))

    def rows(self, sql: str, parameters: object = None) -> list[tuple[Any, ...]]:
        """All rows of a statement that reads."""
        return [tuple(row.values()) for batch in self.batches(sql, parameters) for row in batch.to_pylist()]

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()

    def __enter__(self) -> "Catalog":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _failed(error: duckdb.Error) -> QueryError:
    reason = _told(error)
    if "disabled by configuration" in reason:
        reason += "; only the store is read here, import other data first"
    known = ", ".join([*VIEWS, *(table for layer in layers() for table in layer.tables)])
    return QueryError(f"{reason} (views: {known})")
