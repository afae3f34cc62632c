"""SQL over a store: read-only DuckDB views on the lake."""

import os
import threading
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Protocol

import duckdb
import pyarrow as pa

from storage.findings import Finding
from storage.lake.tables import COLUMNS_VERSION, TABLES
from storage.manifests.part import Part
from storage.sql.columns import rows_of
from storage.sql.deferred import DeferredDefinitions, bound_where_used, words_of
from storage.sql.lake_source import LakeSource, source_of
from storage.sql.live import LiveTables
from storage.sql.overlay import Overlay
from storage.sql.parquet_content import ParquetContent
from storage.sql.put_tables import PutTables
from storage.sql.sandbox.guard import check_statement, one_statement, plain_message, refused
from storage.sql.sandbox.moments import in_utc
from storage.sql.views import VIEWS, defer_views, define_deferred_views, lists_views, reading_lake, unreadable_lake
from storage.store import Store
from stream.closing import Closing
from stream.errors import GyrofleetError, QueryError

STORAGE_VERSION = "v1.0.0"  # version of the file format of a written catalogue: DuckDB from 1.0 reads it

_ALWAYS_READ = {"channels"}
_OF_CHANNELS = ("samples", "rollup_1s", "rollup_10s")
_MOST_KNOWN = 1000  # statements
_SMALL_BYTES = 8 << 20  # of a lake that one thread reads as soon as several
Progress = Callable[[int, int], None]

_READING = {duckdb.StatementType.SELECT, duckdb.StatementType.EXPLAIN}
_SQL_TYPES = {
    pa.int64(): "bigint", pa.int32(): "integer", pa.uint8(): "utinyint", pa.float64(): "double",
    pa.string(): "varchar", pa.bool_(): "boolean",
}  # fmt: skip


class NotKept(Exception):
    """A layer would have to compute tables that are not kept in the store, in a frozen catalogue."""


class Layer(Protocol):
    """Tables of a higher package (entry points `gyrofleet.catalog`), computed when a statement first names one."""

    tables: tuple[str, ...]  # names of its tables and views for users
    folder: str  # folder in the store in which it keeps what it has computed
    examples: Mapping[str, str]  # questions and the statements that answer them

    @property
    def columns(self) -> Mapping[str, Mapping[str, str]]:
        """Meaning of columns by table and column; under ``every`` those common to all tables."""

    def fill(self, catalog: "Catalog") -> None:
        """Define the tables through `Catalog.put` and `Catalog.define`; others belong in the schema `internal`."""

    def findings(self, store: Store, /) -> list[Finding]:
        """What is wrong with what it keeps in a store, for `gyrofleet verify`."""


@cache
def layers() -> tuple[Layer, ...]:
    """The installed layers."""
    found = sorted(entry_points(group="gyrofleet.catalog"), key=lambda each: each.name)
    return tuple(each.load()() for each in found)


def known_tables() -> list[str]:
    """Names of the tables for users: the store's own and those of all layers."""
    return [*VIEWS, *(table for layer in layers() for table in layer.tables)]


class Catalog(Closing):
    """The views of a store, `VIEWS` and the tables of layers, over the lake as it was when the catalogue was opened.

    What they are made of is in the schema `internal`. A `file` is a DuckDB database to create with the same views; by
    default they are in memory. `progress` is called by a layer with the numbers of steps done and in total. `parts` of
    the lake are by default those in force now, and a `source` reads their files; layers keep what they compute in the
    folder `kept`, by default the store's, or raise `NotKept` instead of computing anything (`frozen`). `memory_bytes`
    is the limit of DuckDB, which then uses no disk either; by default most of the machine's memory. With `live` users'
    statements also see the rows that only the log has, as it is when one first names a table that has some; layers and
    the project's own statements never do. With `units` channels, documents and estimates of other units are left out,
    and so their samples; those of no unit stay. `threads` of DuckDB, by default as many as the machine has processors,
    and one for a small lake.
    """

    def __init__(
        self, store: Store, file: Path | None = None, *, progress: Progress | None = None,
        parts: Iterable[Part] | None = None, source: LakeSource | None = None, kept: Path | None = None,
        frozen: bool = False, memory_bytes: int | None = None, live: bool = False,
        units: Collection[str] | None = None, threads: int | None = None,
    ) -> None:  # fmt: skip
        self.store, self.progress = store, progress
        self.kept = store.folder if kept is None else kept
        self.frozen = frozen
        self.threads = threads or os.cpu_count() or 1
        config: dict[str, Any] = {} if file is None else {"storage_compatibility_version": STORAGE_VERSION}
        if threads is not None:
            config["threads"] = threads
        self._units = units
        self._connection = duckdb.connect(":memory:" if file is None else str(file), config=config)
        # a process without a file of its own, as of multiprocessing, would draw a bar into the output of a command
        self._connection.execute("set timezone = 'UTC'; set enable_progress_bar = false; create schema internal")
        # a statement on samples of one unit would spend most of its time on footers
        self._connection.execute("set parquet_metadata_cache = true")
        self._deferred = DeferredDefinitions(self._run_definition)
        self._is_in_memory = file is None
        self._tables = PutTables(
            self._connection, self._execute, self._deferred, known_tables, is_in_memory=self._is_in_memory
        )
        self._defining = threading.RLock()  # statements of several threads may need the same definitions
        self.source = source_of(store, parts) if source is None else source
        self.parts = self.source.parts
        self.source.attach(self._connection)
        self._unfilled = list(layers())
        for table in ("samples", "events", "estimates", "rollup_1s", "rollup_10s", "clocks"):
            self._attach(f"internal.lake_{table}", table, self.parts)
        for name, is_dropped in (("kept", False), ("dropped", True)):
            own = [part for part in self.parts if (part.dropped is not None) == is_dropped]
            self._attach(f"internal.lake_channels_{name}", "channels", own)
        self._live = LiveTables.beyond(store, self.parts, self._connection) if live else None
        self._has_views = False
        self._known_to_read: set[str] = set()  # statements that were asked before
        self._folders_of_runs: dict[str, list[str]] | None = None
        if self._live is None:
            self._add_views()
        if file is not None:  # others open it
            self.define_views()
        folders = [self.source.root, *(str((self.kept / layer.folder).resolve()) for layer in layers())]
        allowed = ", ".join("'" + each.replace("'", "''") + "'" for each in folders)
        self._connection.execute(f"set allowed_directories = [{allowed}]")
        if threads is None and self._live is None and sum(part.bytes for part in self.parts) < _SMALL_BYTES:
            self._connection.execute("set threads = 1")
        if memory_bytes is not None:
            self._connection.execute(f"set memory_limit = '{memory_bytes}B'; set temp_directory = ''")
        # a table name is not a Python variable
        self._connection.execute("set enable_external_access = false; set python_enable_replacements = false")
        self._connection.execute("set lock_configuration = true")

    def _attach(self, source: str, table: str, parts: Iterable[Part]) -> None:
        """A view of a table over the parts that have it; DuckDB opens the first file now, the others on demand."""
        file = f"{table}.parquet"
        by_columns: dict[int, list[str]] = defaultdict(list)
        for part in parts:
            if file in part.files and part.files[file].rows:
                by_columns[part.columns].append(self.source.path(part.name, file))
        empty = source if not by_columns else f"{source}_columns"
        if set(by_columns) != {COLUMNS_VERSION}:
            columns = ", ".join(f'"{column.name}" {_SQL_TYPES[column.type]}' for column in TABLES[table])
            self._connection.execute(f"create table {empty} ({columns}, filename varchar)")
        if not by_columns:
            return
        if table in _ALWAYS_READ:
            self.source.bring([path for paths in by_columns.values() for path in paths])
        of_units = ""
        if self._units is not None and "unit" in (column.name for column in TABLES[table]):
            of_units = f" where unit is null or unit in ({_quoted(['', *self._units])})"
        read = [
            f"select *, filename from read_parquet([{_quoted(paths)}]){of_units}"  # noqa: S608
            for paths in by_columns.values()
        ]
        if set(by_columns) != {COLUMNS_VERSION}:
            read.insert(0, f"from {empty}")
        sql = f"create view {source} as {' union all by name '.join(read)}"
        with reading_lake(self.store):
            self._connection.execute(sql)

    def _add_views(self) -> None:
        """Let the views on the lake wait for a statement that names them; most that see live rows need none of them."""
        if not self._has_views:
            self._has_views = True
            defer_views(self._deferred, self._connection.cursor)

    def define_views(self) -> None:
        """Define the views on the lake now."""
        with self._defining:
            self._add_views()
            define_deferred_views(self._deferred)

    def define(self, sql: str) -> None:
        """Run statements that define tables, views and macros of a layer."""
        with self._defining:
            self._deferred.define(words_of(sql))
            self._execute(sql)

    def create(self, name: str, sql: str) -> None:
        """Run the statement that makes a table, in place of the definition that may wait."""
        with self._defining:
            self._deferred.discard(name)
            self._execute(sql)

    def hold(self, view: str, units: Collection[str] | None = None) -> None:
        """Keep the rows of a view in memory, by default of all units, for many statements about a few rows each."""
        held = f"internal.held_{view.removeprefix('internal.')}"
        of_units = "" if units is None else f" where unit in ({_quoted(units)})"
        with self._defining:
            self._deferred.define(words_of(view))
            self._run_definition(f"create or replace table {held} as select * from {view}{of_units}")  # noqa: S608
            self._run_definition(f"create or replace view {view} as select * from {held}")  # noqa: S608

    def defer(self, script: str) -> None:
        """Define tables, views and macros of a layer when a statement first names them; see `DeferredDefinitions`."""
        with self._defining:
            self._deferred.add(script)

    def _run_definition(self, sql: str) -> None:
        """Run a definition that has waited; other threads ask meanwhile."""
        if self._is_in_memory:
            sql = bound_where_used(sql)
        with reading_lake(self.store), self._connection.cursor() as cursor:
            cursor.execute(sql)

    def _execute(self, sql: str) -> None:
        try:
            self._connection.execute(sql)
        except duckdb.Error as error:
            raise QueryError(plain_message(error)) from error

    def put(self, name: str, table: pa.Table | pa.RecordBatchReader, *, is_large: bool = False) -> None:
        """Create or replace a table; one that no layer lists goes to the schema `internal`.

        One that a layer lists is a view on a table that takes little memory, as is a large one.
        """
        with self._defining:
            self._tables.put(name, table, is_large=is_large)

    def put_content(self, name: str, file: ParquetContent) -> None:
        """The same, but the rows stay in the content of a Parquet file and are read on demand."""
        with self._defining:
            self._tables.put_content(name, file)

    def stored(self, name: str) -> pa.Table:
        """The rows of a table that was put."""
        return self._tables.stored(name)

    def paths_of(self, runs: Iterable[str]) -> list[str]:
        """Files that have all samples and rollups of some runs, for `internal.samples_in` and its like."""
        if self._folders_of_runs is None:
            found: defaultdict[str, list[str]] = defaultdict(list)
            for run, path in self.rows("select distinct run, filename from internal.lake_channel_parts"):
                found[run].append(path.rpartition("/")[0])
            self._folders_of_runs = dict(found)
        folders = {folder for run in runs for folder in self._folders_of_runs.get(run, ())}
        return [f"{folder}/{table}.parquet" for folder in sorted(folders) for table in _OF_CHANNELS]

    def checked_paths_of(self, runs: Iterable[str], sql: str) -> list[str]:
        """Those of the tables that a statement names, compared with their hashes; StoreError if one is damaged.

        DuckDB checks no page. A file is read once for that.
        """
        files = tuple(f"/{table}.parquet" for table in _OF_CHANNELS if f"internal.{table}_in(" in sql)
        paths = [path for path in self.paths_of(runs) if path.endswith(files)]
        self.source.check(paths)
        return paths

    def overlay(
        self, name: str, channels: pa.Table, events: pa.Table, kept: Mapping[str, str], kinds: Collection[str],
        same: Collection[str] = (),
    ) -> Overlay:  # fmt: skip
        """Its views with further rows of channels and events, as long as it is open; see `Overlay`."""
        with self._defining:
            self._add_views()
            self._deferred.define(["lake_channels"])
        with reading_lake(self.store):
            return Overlay(self._connection, name, channels, events, kept, kinds, same)

    def fill(self, tables: Collection[str] = ()) -> None:
        """Compute the tables of all layers now, and define all views; only these tables if some are given."""
        self._fill(" ".join(tables or (table for layer in layers() for table in layer.tables)))
        if not tables:
            with self._defining:
                self._deferred.define_all()

    @contextmanager
    def suspended_layers(self) -> Iterator[tuple[Layer, ...]]:
        """Within it no layer is filled, so that one can put a part of its tables; the layers not filled yet."""
        waiting, self._unfilled = self._unfilled, []
        try:
            yield tuple(waiting)
        finally:
            self._unfilled = waiting

    def _fill(self, sql: str) -> None:
        words = words_of(sql)
        for layer in [each for each in self._unfilled if words.intersection(each.tables)]:
            self._add_views()
            self._unfilled.remove(layer)  # first, since the layer queries this catalogue
            try:
                layer.fill(self)
            except BaseException:
                self._unfilled.append(layer)
                raise
        with self._defining:
            if self._has_views and lists_views(words):
                self.define_views()
            self._deferred.define(words)

    def reader(self, sql: str, parameters: object = None, rows: int = 100_000) -> pa.RecordBatchReader:
        """Result of one of the project's own reading statements; users' statements go through `user_reader`.

        Several threads may ask at once: each has a cursor of its own, since a connection at work refuses other calls.
        """
        try:
            return self._reading_cursor(sql).sql(sql, params=parameters).to_arrow_reader(rows)
        except duckdb.Error as error:
            raise self._failed(error) from error

    def _reading_cursor(self, sql: str) -> duckdb.DuckDBPyConnection:
        """A cursor for one of the project's own statements, which reads."""
        self._fill(sql)
        cursor = self._connection.cursor()
        if sql in self._known_to_read:
            return cursor
        kind = one_statement(cursor, sql).type
        if kind not in _READING:
            raise refused(kind.name)
        if len(self._known_to_read) < _MOST_KNOWN:
            self._known_to_read.add(sql)
        return cursor

    def prepare(self, sql: str) -> tuple[str, ...]:
        """Check a user's statement, and make the tables that it names; returns notes on what of the log they lack."""
        self._prepared(sql).close()
        return () if self._live is None else tuple(self._live.notes)

    def _prepared(self, sql: str) -> duckdb.DuckDBPyConnection:
        """Prepare a user's statement; a cursor to run it."""
        of_layers = {table for layer in layers() for table in layer.tables}
        try:
            named = check_statement(self._connection, sql, {"adev", *of_layers})
        except QueryError as error:
            if isinstance(error.__cause__, duckdb.Error):
                raise self._failed(error.__cause__) from error
            raise
        self._fill(sql)
        needs_layers = not named.isdisjoint(of_layers)
        if self._live is None or (needs_layers and named.isdisjoint(VIEWS)):  # tables of layers have no live rows
            return self._connection.cursor()
        self._live.fill(named)
        return self._live.cursor(of_layers=needs_layers)

    def user_reader(self, sql: str, parameters: object = None) -> pa.RecordBatchReader:
        """Result of a user's statement, which may read the store's views and no files."""
        try:
            return self._user_rows(sql, parameters)
        except (duckdb.BinderException, duckdb.CatalogException):
            self.define_views()  # then the message proposes what there is
        except duckdb.Error as error:
            raise self._failed(error) from error
        try:
            return self._user_rows(sql, parameters)
        except duckdb.Error as error:
            raise self._failed(error) from error

    def _user_rows(self, sql: str, parameters: object) -> pa.RecordBatchReader:
        cursor = self._prepared(sql)
        sql, parameters = in_utc(cursor, sql, parameters)
        cursor.execute("begin transaction read only")
        return cursor.sql(sql, params=parameters).to_arrow_reader(16_384)

    def guarded(self, reader: pa.RecordBatchReader) -> Iterator[pa.RecordBatch]:
        """The batches of a result; QueryError if the statement fails on the way, StoreError where a file is damaged."""
        try:
            yield from reader
        except (duckdb.Error, pa.ArrowException, OSError) as error:
            # arrow has one class for all; an error of a file that DuckDB does not name is of no class of its own
            if f"{self.source.root}/" in str(error) or str(error).startswith("Invalid Error: "):
                raise unreadable_lake(self.store, error) from error
            raise QueryError(plain_message(error)) from error

    def batches(self, sql: str, parameters: object = None, rows: int = 100_000) -> Iterator[pa.RecordBatch]:
        """The batches of a statement's result."""
        yield from self.guarded(self.reader(sql, parameters, rows))

    def table(self, sql: str, given: pa.Table | None = None, parameters: object = None) -> pa.Table:
        """The whole result of a statement of many views and macros: it is planned once, a reader's twice.

        The rows `given` are its table ``given_rows``.
        """
        self._fill(sql)
        try:
            with self._connection.cursor() as cursor:
                if given is not None:
                    cursor.register("given_rows", given)
                cursor.execute(f"create temporary table whole as {sql}", parameters)
                return cursor.table("whole").to_arrow_table()
        except duckdb.Error as error:
            raise self._failed(error) from error

    def rows(self, sql: str, parameters: object = None) -> list[tuple[Any, ...]]:
        """All rows of a statement's result."""
        return self.named_rows(sql, parameters)[1]

    def named_rows(self, sql: str, parameters: object = None) -> tuple[list[str], list[tuple[Any, ...]]]:
        """Names of the columns of a statement's result and all rows; it is planned once, a reader's twice."""
        try:
            with self._reading_cursor(sql) as cursor:
                return rows_of(cursor, sql, parameters)
        except (duckdb.Error, OSError) as error:
            raise self._failed(error) from error

    def _failed(self, error: Exception) -> GyrofleetError:
        # DuckDB opens files after a table's first one here; an error of one that it does not name is of no subclass
        is_of_file = isinstance(error, duckdb.IOException | duckdb.InvalidInputException)
        if type(error) is duckdb.Error or (is_of_file and f"{self.source.root}/" in str(error)):
            return unreadable_lake(self.store, error)
        return _failed(error)

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()


@contextmanager
def catalog_anew(store: Store, *, progress: Progress | None = None) -> Iterator[Catalog]:
    """A catalogue that computes everything: nothing that the store has kept of earlier computations is used."""
    with (
        TemporaryDirectory(prefix="gyrofleet-") as scratch,
        Catalog(store, progress=progress, kept=Path(scratch)) as one,
    ):
        yield one


def _quoted(texts: Iterable[str]) -> str:
    return ", ".join("'" + text.replace("'", "''") + "'" for text in texts)


def _failed(error: Exception) -> QueryError:
    reason = plain_message(error)
    if "disabled by configuration" in reason:
        reason += "; only the store is read here, import other data first"
    if "WITH TIME ZONE" in reason and isinstance(error, duckdb.BinderException):
        reason += (
            "; times here are UTC without a zone: write a moment as text with its offset, as "
            "'2026-11-21T18:00:00+08:00', and cast another expression, as now()::timestamp"
        )
    return QueryError(f"{reason} (views: {', '.join(known_tables())})")
