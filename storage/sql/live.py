"""Rows that only the log has so far, beside those of the lake, in views of the same names.

They stand in a database of their own, so that what layers compute from the lake and keep never sees them. A message is
in the lake or here, by its segment: segments that are in no part of the catalogue are read from the log, whatever
becomes of them meanwhile.
"""

import os
import re
from collections.abc import Collection, Iterable, Iterator
from itertools import chain
from typing import TYPE_CHECKING, Self

import duckdb
import pyarrow as pa

from storage.lake.clock_stretches import clock_table
from storage.lake.rollups import rollup_tables
from storage.lake.tables import MESSAGE_COLUMNS, TABLES
from storage.log.misplaced import misplaced_segments
from storage.manifests.log import read_log_manifest
from storage.manifests.part import Part
from storage.sql.sandbox.guard import plain_message
from storage.sql.views import define_views, reading_lake
from storage.store import Store, writer_is_active
from stream.errors import QueryError, StoreError

if TYPE_CHECKING:
    from storage.lake.channel_buffer import ChannelBuffer
    from storage.lake.segment_content import SegmentContent

# of sealed segments that no builder has brought to the lake; an open one may be read in any case
MOST_SAMPLES = 100_000_000
_FEW_SEGMENTS = 2  # a builder at work may be as many behind

_DATABASE = "lake_and_log"
_FILE = re.compile(r"(\d+)\.mcap(\.(?:open|abandoned-\d+))?")
_ROLLED = ("rollup_1s", "rollup_10s", "clocks")
# tables of samples in memory have a list of counts or values for each message
_SAMPLES = """
create view internal.lake_samples as
from {lake}.internal.lake_samples
union all
select channel, seq + i, coalesce(at_ns, t0_ns + i * dt_ns), count, 0, val, flag, null
from (
  select channel, seq, t0_ns, dt_ns, unnest(range(n)) as i, unnest(counts) as count, unnest(vals) as val,
    unnest(times_ns) as at_ns, unnest(flags) as flag
  from internal.live_messages
)
"""


class LiveTables:
    """The views of a store with the rows of its log, in the database of `cursor`; made when a statement needs them.

    They show the log as it is when they are made. `notes` say what of the log they lack, and why.
    """

    def __init__(self, store: Store, in_lake: Collection[str], connection: duckdb.DuckDBPyConnection) -> None:
        self._store, self._in_lake, self._connection = store, frozenset(in_lake), connection
        ((self._lake,),) = connection.execute("select current_database()").fetchall()
        connection.execute(f"attach ':memory:' as {_DATABASE}")
        self.notes: list[str] = []
        self._contents: list[SegmentContent] | None = None
        self._has_samples = self._has_rollups = False

    @classmethod
    def beyond(cls, store: Store, parts: Iterable[Part], connection: duckdb.DuckDBPyConnection) -> Self | None:
        """The live tables of a catalogue of these parts; None if the log has nothing else."""
        in_lake = {segment for part in parts for segment in part.segments}
        found = (_FILE.fullmatch(name) for name in _names(store))
        if all(match is None or (match[2] is None and match[1] in in_lake) for match in found):
            return None
        return cls(store, in_lake, connection)

    def cursor(self, *, of_layers: bool = False) -> duckdb.DuckDBPyConnection:
        """A cursor on the views with live rows, and if asked on the tables that layers have made of the lake."""
        cursor = self._connection.cursor()
        behind = f",{self._lake}.main" if of_layers else ""
        cursor.execute(f"set search_path = '{_DATABASE}.main{behind}'")
        return cursor

    def fill(self, named: Collection[str]) -> None:
        """Make what a statement needs that names these tables; samples and rollups only if they are among them."""
        try:
            with self.cursor() as cursor:
                if self._contents is None:
                    contents = self._read()
                    with reading_lake(self._store):
                        self._define(cursor, contents)
                    self._contents = contents
                is_inner = any(name.startswith(("lake_", "live_")) for name in named)
                if not self._has_samples and (is_inner or "samples" in named):
                    self._put_samples(cursor)
                if not self._has_rollups and (is_inner or not set(_ROLLED).isdisjoint(named)):
                    self._put_rollups(cursor)
        except duckdb.Error as error:
            raise QueryError(plain_message(error)) from error

    def _read(self) -> "list[SegmentContent]":
        """Contents of the segments that are not in the lake; their samples as they are on the wire."""
        from storage.lake.segment_content import SegmentContent
        from storage.log.follower import LogFollower

        left_out = self._left_out()
        contents: dict[str, SegmentContent] = {}
        try:
            with LogFollower(self._store, self._in_lake | left_out, unread=True) as follower:
                for segment, record, _, content in follower.poll():
                    if segment not in contents:
                        contents[segment] = SegmentContent(self._store.identity, segment)
                    contents[segment].take(record, content)
        except OSError as error:
            raise StoreError(f"the log of {self._store.folder} cannot be read: {error}") from error
        for segment, damaged in follower.damaged_bytes.items():
            self.notes.append(
                f"segment {segment} of the log is damaged: {damaged:,} bytes of it cannot be read, their rows are not "
                f"shown; `gyrofleet verify` says more, `gyrofleet recover` saves the rest"
            )
        return list(contents.values())

    def _left_out(self) -> set[str]:
        """Sealed segments beyond `MOST_SAMPLES`, the oldest: no builder is at work."""
        sealed = [match[1] for name in _names(self._store) if (match := _FILE.fullmatch(name)) and match[2] is None]
        missing = sorted(set(sealed) - self._in_lake)
        if missing and not writer_is_active(self._store.folder) and (misplaced := misplaced_segments(self._store)):
            names = ", ".join(f"{name} is {own}" for name, own in sorted(misplaced.items())[:3])
            self.notes.append(f"segments of the log have other names than they were sealed with ({names}): "
                              "`gyrofleet recover` puts them back")  # fmt: skip
            return {name.removesuffix(".mcap") for name in misplaced}
        if len(missing) <= _FEW_SEGMENTS:
            return set()
        entries = read_log_manifest(self._store).entries
        samples = {segment: entry.samples for segment in missing if (entry := entries.get(f"{segment}.mcap"))}
        left_out: set[str] = set()
        room = MOST_SAMPLES
        for segment in reversed(missing):
            room -= samples.get(segment, 0)
            if room < 0:
                left_out.add(segment)
        if left_out:
            unseen = sum(samples.get(segment, 0) for segment in left_out)
            self.notes.append(
                f"{len(left_out)} sealed segments of the log, {min(left_out)} to {max(left_out)}, are not in the lake, "
                f"and too many to be read for a statement: their {unseen:,} samples are not shown; `gyrofleet lake "
                f"--once` brings them to the lake"
            )
        return left_out

    def _define(self, cursor: duckdb.DuckDBPyConnection, contents: "list[SegmentContent]") -> None:
        """Define all tables and views, with the rows of channels and documents."""
        cursor.execute("create or replace schema internal")
        rows = {
            "channels": [channel.row() for channel in _channels(contents)],
            "events": list(chain.from_iterable(content.event_rows() for content in contents)),
            "estimates": list(chain.from_iterable(content.estimates for content in contents)),
        }
        for name in (*rows, *_ROLLED):
            _put(cursor, f"live_{name}", pa.Table.from_pylist(rows.get(name, []), schema=TABLES[name]))
        _put(cursor, "live_messages", MESSAGE_COLUMNS.empty_table())
        for name, own in (("channels_kept", "channels"), *((name, name) for name in ("events", "estimates", *_ROLLED))):
            cursor.execute(
                f"create view internal.lake_{name} as from {self._lake}.internal.lake_{name} "
                f"union all by name from internal.live_{own}"
            )
        cursor.execute(
            f"create view internal.lake_channels_dropped as from {self._lake}.internal.lake_channels_dropped"
        )
        cursor.execute(_SAMPLES.format(lake=self._lake))
        define_views(cursor)

    def _put_samples(self, cursor: duckdb.DuckDBPyConnection) -> None:
        tables = chain.from_iterable(channel.message_tables() for channel in _channels(self._contents or []))
        batches = chain.from_iterable(table.to_batches() for table in tables)
        _put(cursor, "live_messages", pa.RecordBatchReader.from_batches(MESSAGE_COLUMNS, batches))
        self._has_samples = True

    def _put_rollups(self, cursor: duckdb.DuckDBPyConnection) -> None:
        from storage.lake.buffered_rows import buffered_rows, together

        groups = (each for content in self._contents or [] for each in together(content.channels.values()))
        found = list(map(buffered_rows, groups))
        rollups, clocks = rollup_tables(each.seconds for each in found), clock_table([each.clocks for each in found])
        for name, table in zip(_ROLLED, (*rollups, clocks), strict=True):
            _put(cursor, f"live_{name}", table)
        self._has_rollups = True


def _names(store: Store) -> list[str]:
    try:
        return os.listdir(store.log)  # noqa: PTH208  names alone, perhaps 100,000
    except FileNotFoundError:
        return []


def _channels(contents: "Iterable[SegmentContent]") -> "Iterator[ChannelBuffer]":
    for content in contents:
        yield from content.channels.values()


def _put(cursor: duckdb.DuckDBPyConnection, name: str, rows: pa.Table | pa.RecordBatchReader) -> None:
    """Create or fill a table of the schema `internal`."""
    cursor.register("put_rows", rows)
    try:
        cursor.execute(f"create table if not exists internal.{name} as from put_rows limit 0")
        cursor.execute(f"insert into internal.{name} from put_rows")
    finally:
        cursor.unregister("put_rows")
