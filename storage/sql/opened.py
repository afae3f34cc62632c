"""A store opened for SQL from Python, with answers as Polars or Arrow."""

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import pyarrow as pa

from storage.sql.door import QueryLimits, SqlDoor
from storage.sql.printable import distinct_names
from storage.sql.sandbox.guard import plain_message
from storage.store import Store
from stream.arguments import optional_text, parameters_of, path_of, text_of
from stream.closing import Closing
from stream.errors import BadInput, QueryError

if TYPE_CHECKING:
    import polars as pl

_DAY_US = 86_400_000_000


class Answer:
    """The complete result of a statement; `notes` say what of the log it lacks, and why; mostly there are none."""

    def __init__(self, table: pa.Table, notes: tuple[str, ...] = ()) -> None:
        self._table, self.notes = table, notes

    def arrow(self) -> pa.Table:
        """As an Arrow table."""
        return self._table

    def polars(self) -> "pl.DataFrame":
        """As a Polars frame: intervals as durations, a name that comes again with its position, as ``a_2``.

        QueryError for a column that Polars has no type for.
        """
        import polars as pl

        names = distinct_names(self._table.column_names)
        columns = [_durations(name, each) for name, each in zip(names, self._table.columns, strict=True)]
        try:
            return pl.DataFrame(pa.table(columns, names=names))
        except pl.exceptions.PolarsError as error:
            raise QueryError(
                f"Polars has no type for the result ({plain_message(error)}): cast its columns in the statement, as "
                "NAME::varchar, or use arrow()"
            ) from error

    def rows(self) -> list[dict[str, object]]:
        """As a list of dictionaries; times are datetimes, to the microsecond (`t_ns` has nanoseconds)."""
        columns = [_to_microseconds(each) for each in self._table.columns]
        return list(pa.table(columns, names=self._table.column_names).to_pylist())


def _to_microseconds(column: pa.ChunkedArray) -> pa.ChunkedArray:
    """A column of times in nanoseconds, for which datetimes have no place, in microseconds; another one as it is."""
    kind = column.type
    if not pa.types.is_timestamp(kind) or kind.unit != "ns":
        return column
    return column.cast(pa.timestamp("us", kind.tz), safe=False)


def _durations(name: str, column: pa.ChunkedArray) -> pa.ChunkedArray:
    """A column of intervals as durations, which Polars has; other columns as they are."""
    if not pa.types.is_interval(column.type):
        if _holds_intervals(column.type):
            raise QueryError(f"column {name} holds intervals, which Polars has not: use arrow(), or epoch(...) of each")
        return column
    found = [None if each is None else (each.months, each.days, each.nanoseconds) for each in column.to_pylist()]
    if any(each is not None and each[0] for each in found):
        raise QueryError(
            f"column {name} has intervals of months, which are no durations: write {name}::varchar in the statement"
        )
    lengths_us = [None if each is None else each[1] * _DAY_US + each[2] // 1000 for each in found]
    return pa.chunked_array([pa.array(lengths_us, pa.duration("us"))])


def _holds_intervals(kind: pa.DataType) -> bool:
    inner = (kind.field(number).type for number in range(kind.num_fields))
    return pa.types.is_interval(kind) or any(_holds_intervals(each) for each in inner)


def opened_at(folder: str | PathLike[str] | Store, endpoint_url: str | None = None) -> Store:
    """The store in a folder, or whose lake is published at ``s3://BUCKET/PREFIX``."""
    if isinstance(folder, Store):
        return folder
    place = path_of(folder, "folder")
    if place.startswith("s3:"):
        from storage.object_lake.published_store import PublishedStore

        return PublishedStore.open_url(place, optional_text(endpoint_url, "endpoint_url"))
    return Store.open(Path(place))


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
        if limits is not None and not isinstance(limits, QueryLimits):
            raise BadInput(f"limits is {limits!r}: QueryLimits(time_s=..., memory_bytes=..., rows=...) is expected")
        self.door = SqlDoor(opened_at(folder, endpoint_url), limits)

    def sql(self, statement: str, parameters: object = None) -> Answer:
        """Run one statement with its parameters; QueryError if it would not only read, fails, or exceeds limits."""
        result = self.door.ask(text_of(statement, "statement"), parameters_of(parameters))
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
