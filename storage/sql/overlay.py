"""The views of a catalogue with further rows of channels and documents, which only the log has so far.

Unlike the live tables of users' statements nothing is read from the log here: who follows it gives the rows.
"""

import threading
from collections.abc import Collection, Iterator, Mapping
from typing import Any

import duckdb
import pyarrow as pa

from storage.lake.tables import TABLES
from storage.sql.columns import rows_of
from storage.sql.deferred import DeferredDefinitions, named_by, words_of
from storage.sql.sandbox.guard import plain_message
from storage.sql.views import defer_views
from stream.closing import Closing
from stream.errors import QueryError

# all views go by runs: those of other runs stay as the lake has them
_OF_RUNS = """
create schema internal;
create table internal.live_channels as from live_channels_rows;
create table internal.live_events as from live_events_rows;
create table internal.live_runs as
  select distinct run from (select run from internal.live_channels union all select run from internal.live_events);
create view internal.lake_channels_kept as
  from (from {lake}.lake_channels_kept where run in (from internal.live_runs))
  union all by name from internal.live_channels;
create view internal.lake_channels_dropped as
  from {lake}.lake_channels_dropped where run in (from internal.live_runs);
create table internal.lake_events as
  from (from {lake}.lake_events where run in (from internal.live_runs) and kind in {kinds})
  union all by name from internal.live_events where kind in {kinds};
"""
_WHOLE = """
insert into internal.lake_channels
  from {lake}.lake_channels where run not in (from internal.live_runs);
drop table internal.lake_events;
create view internal.lake_events as
  from {lake}.lake_events union all by name from internal.live_events;
"""
_KEPT = """
create table internal.{name} as {statement};
insert into internal.{name} from {lake}.{name} where run not in (from internal.live_runs);
"""


class Overlay(Closing):
    """The views of a catalogue's lake with more rows; read by any thread.

    Views that the tables `kept` do not need are defined when a statement first names them: most of those who have a
    version of the log opened need none of them.

    Parameters
    ----------
    connection: Of the catalogue, which stays open as long as this.
    name: Of the database in which the views are; no other one of the catalogue has it.
    channels: Rows of the table of channels.
    events: Rows of the table of events.
    kept: Tables of the schema `internal` of the catalogue, each made by a statement on the views, with a column `run`.
    kinds: Of documents that those statements need: without the others they are made in a fraction of the time.
    same: Those of the tables `kept` that the further rows do not change.
    """

    def __init__(
        self, connection: duckdb.DuckDBPyConnection, name: str, channels: pa.Table, events: pa.Table,
        kept: Mapping[str, str], kinds: Collection[str], same: Collection[str] = (),
    ) -> None:  # fmt: skip
        self._connection, self._name = connection, name
        with connection.cursor() as cursor:  # requests ask through other ones meanwhile
            ((database,),) = cursor.execute("select current_database()").fetchall()
            cursor.execute(f"attach ':memory:' as {name}")
        lake = f"{database}.internal"
        self._deferred = DeferredDefinitions(self._define)
        self._defining = threading.Lock()
        try:
            with self._cursor() as cursor:
                cursor.register("live_channels_rows", channels)
                cursor.register("live_events_rows", events)
                cursor.execute(_OF_RUNS.format(lake=lake, kinds="('" + "', '".join(kinds) + "')"))
                for table in TABLES.keys() - {"channels", "events"}:
                    self._deferred.add(f"create or replace view internal.lake_{table} as from {lake}.lake_{table}")
                defer_views(self._deferred, self._cursor)
                self._deferred.define(["lake_channels"])  # a table, which gets those of other runs below
                for table in same:
                    cursor.execute(f"create view internal.{table} as from {lake}.{table}")
                for table, statement in kept.items():
                    if table in same:
                        continue
                    self._deferred.define(named_by(statement))
                    cursor.execute(_KEPT.format(name=table, statement=statement, lake=lake))
                cursor.execute(_WHOLE.format(lake=lake))
        except BaseException:
            self.close()
            raise

    def _cursor(self) -> duckdb.DuckDBPyConnection:
        cursor = self._connection.cursor()
        cursor.execute(f"set search_path = '{self._name}.main'")
        return cursor

    def _define(self, sql: str) -> None:
        with self._cursor() as cursor:
            cursor.execute(sql)

    def batches(self, sql: str, parameters: object = None) -> Iterator[pa.RecordBatch]:
        """The batches of a result of one of the project's own reading statements."""
        try:
            with self._defining:
                self._deferred.define(words_of(sql))
            with self._cursor() as cursor:
                yield from cursor.sql(sql, params=parameters).to_arrow_reader(100_000)
        except (duckdb.Error, pa.ArrowException, OSError) as error:
            raise QueryError(plain_message(error)) from error

    def rows(self, sql: str, parameters: object = None) -> list[tuple[Any, ...]]:
        """All rows of a statement's result."""
        return self.named_rows(sql, parameters)[1]

    def named_rows(self, sql: str, parameters: object = None) -> tuple[list[str], list[tuple[Any, ...]]]:
        """Names of the columns of a statement's result and all rows."""
        try:
            with self._defining:
                self._deferred.define(words_of(sql))
            with self._cursor() as cursor:
                return rows_of(cursor, sql, parameters)
        except (duckdb.Error, OSError) as error:
            raise QueryError(plain_message(error)) from error

    def close(self) -> None:
        """Leave the catalogue as it was."""
        with self._connection.cursor() as cursor:
            cursor.execute(f"detach {self._name}")
