"""A store opened for SQL from Python, with answers as Polars or Arrow."""

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import pyarrow as pa

from storage.sql.door import QueryLimits, SqlDoor
from storage.store import Store
from stream.closing import Closing

if TYPE_CHECKING:
    import polars as pl


class Answer:
    """The complete result of a statement; `notes` say what of the log it lacks, and why; mostly there are none."""

    def __init__(self, table: pa.Table, notes: tuple[str, ...] = ()) -> None:
        self._table, self.notes = table, notes

    def arrow(self) -> pa.Table:
        """As an Arrow table."""
        return self._table

    def polars(self) -> "pl.DataFrame":
        """As a Polars frame."""
        import polars as pl

        return pl.DataFrame(self._table)

    def rows(self) -> list[dict[str, object]]:
        """As a list of dictionaries."""
        return list(self._table.to_pylist())


def opened_at(folder: str | PathLike[str] | Store, endpoint_url: str | None = None) -> Store:
    """The store in a folder, or whose lake is published at ``s3://BUCKET/PREFIX``."""
    if isinstance(folder, Store):
        return folder
    if str(folder).startswith("s3:"):
        from storage.object_lake.published_store import PublishedStore

        return PublishedStore.open_url(str(folder), endpoint_url)
    return Store.open(Path(folder))


class OpenedStore(Closing):
    """A store as it is when it is opened; `limits` are the time, memory and rows of one statement.

    Raises a StoreError if the folder is not a store.

    >>> from storage import open_store
    >>> with open_store("gyrofleet-data") as store:  # doctest: +SKIP
    ...     frame = store.sql("select unit, value, lo, hi from unit_metrics where metric = 'bias'").polars()
    """

    def __init__(
        self, folder: str | PathLike[str] | Store, limits: QueryLimits | None = None, *, endpoint_url: str | None = None
    ) -> None:
        self.door = SqlDoor(opened_at(folder, endpoint_url), limits)

    def sql(self, statement: str, parameters: object = None) -> Answer:
        """Run one statement with its parameters; QueryError if it would not only read, fails, or exceeds limits."""
        result = self.door.ask(statement, parameters)
        return Answer(result.read_all(), result.notes)

    @property
    def store(self) -> Store:
        """The store."""
        return self.door.store

    def rows(self, sql: str, parameters: object = None) -> list[tuple[object, ...]]:
        """All rows of a statement's result."""
        return [tuple(row.values()) for row in self.sql(sql, parameters).rows()]

    def close(self) -> None:
        """Close it."""
        self.door.close()
