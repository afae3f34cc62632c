"""Tables that layers put into a catalogue: rows in memory, compressed if they are many, or a Parquet file's content."""

from collections.abc import Callable, Collection, Iterator

import duckdb
import pyarrow as pa

from storage.sql.deferred import DeferredDefinitions
from storage.sql.parquet_content import ParquetContent

_COMPACT = "compact"  # a database in memory whose tables take a tenth of the memory, and longer to write
_PART_ROWS = 122_880  # that DuckDB compresses together


class PutTables:
    """Writes tables through the connection of a catalogue.

    Parameters
    ----------
    connection : DuckDBPyConnection
        Of the catalogue.
    run : Callable[[str], None]
        Runs a statement in it.
    deferred : DeferredDefinitions
        Loses the definition of what is put.
    listed : Callable[[], Collection[str]]
        Tables that layers list, which are in the schema `main`; others go to `internal`.
    is_in_memory : bool
        Whether the catalogue is no file.
    """

    def __init__(
        self, connection: duckdb.DuckDBPyConnection, run: Callable[[str], None], deferred: DeferredDefinitions,
        listed: Callable[[], Collection[str]], *, is_in_memory: bool,
    ) -> None:  # fmt: skip
        self._connection, self._run, self._deferred = connection, run, deferred
        self._listed, self._is_in_memory = listed, is_in_memory
        if is_in_memory:
            connection.execute(f"attach ':memory:' as {_COMPACT} (compress)")
            connection.execute(f"create schema {_COMPACT}.internal")

    def put(self, name: str, table: pa.Table | pa.RecordBatchReader, *, is_large: bool = False) -> None:
        """Create or replace a table; a listed or large one is a view on a table that takes little memory."""
        self._deferred.discard(name)
        place, view = self._place_of(name, is_large=is_large)
        parts = _parts(table) if isinstance(table, pa.RecordBatchReader) else iter([table])
        self._write(f"create or replace table {place} as from put_rows", next(parts))
        for part in parts:
            self._write(f"insert into {place} from put_rows", part)
        if view is not None:
            self._run(f"create or replace view {view} as from {place}")

    def put_content(self, name: str, file: ParquetContent) -> None:
        """Create or replace a table whose rows stay in the content of a Parquet file and are read on demand."""
        if not self._is_in_memory:  # others open the catalogue's file
            self.put(name, file.reader(), is_large=True)
            return
        self._deferred.discard(name)
        inner = f"content_of_{name}"
        self._connection.from_arrow(file.dataset()).create_view(inner, replace=True)
        self._run(f"create or replace view {self._qualified(name)} as from {inner}")

    def stored(self, name: str) -> pa.Table:
        """The rows of a table that was put."""
        return self._connection.sql(f"from {self._qualified(name)}").to_arrow_table()

    def _qualified(self, name: str) -> str:
        return f'{"main" if name in self._listed() else "internal"}."{name}"'

    def _place_of(self, name: str, *, is_large: bool) -> tuple[str, str | None]:
        """Where a table is, and the view on it if there is one."""
        view = self._qualified(name)
        if not (name in self._listed() or is_large):
            return view, None
        return (f'{_COMPACT}.internal."{name}"' if self._is_in_memory else f'internal."{name}_rows"'), view

    def _write(self, sql: str, table: pa.Table) -> None:
        self._connection.register("put_rows", table)
        try:
            self._run(sql)
        finally:
            self._connection.unregister("put_rows")
        if f" {_COMPACT}." in sql:
            self._run(f"checkpoint {_COMPACT}")  # compresses what was written


def _parts(reader: pa.RecordBatchReader) -> Iterator[pa.Table]:
    """The rows that a reader gives, in tables that fit into memory; one without rows at least."""
    batches: list[pa.RecordBatch] = []
    for batch in reader:
        batches.append(batch)
        if sum(each.num_rows for each in batches) >= _PART_ROWS:
            yield pa.Table.from_batches(batches)
            batches = []
    yield pa.Table.from_batches(batches, reader.schema)
