"""Channels and documents that only the log has so far, as rows of the lake's tables."""

import time
from collections.abc import Collection
from typing import Any, NamedTuple

import pyarrow as pa

from storage.lake.channel_buffer import ChannelRow
from storage.lake.quarantine import event_row
from storage.lake.segment_content import channel_id
from storage.lake.tables import TABLES
from storage.log.follower import ContinuedBatch, FollowedMessage
from stream.bounds import beyond_bounds
from stream.errors import GyrofleetError
from stream.events import EstimatePublished
from stream.identity import parse_key
from stream.wire.batches import RawBatch

# a request may still look at the version of the lake before
_KEPT_S = 15.0
_NONE = (None, "", None)


class RowTables(NamedTuple):
    """Rows of channels and of documents."""

    channels: pa.Table
    events: pa.Table


class LiveRows:
    """Keeps the rows of segments until the lake has them, by the rules by which the lake is built.

    `version` grows when there are new ones, as often as `publish` is called, `documents` when there are new documents.
    For one thread at a time.
    """

    def __init__(self, version: int = 0, documents: int = 0) -> None:
        self.version, self.documents = version, documents
        self._channels: dict[str, dict[tuple[object, ...], ChannelRow]] = {}  # by segment
        self._continued: dict[str, tuple[RawBatch | None, str, ChannelRow | None]] = {}  # by topic
        self._columns: dict[str, pa.Table] = {}  # of those to which no message has come since
        self._events: dict[str, list[pa.Table]] = {}
        self._new_events: dict[str, list[dict[str, Any]]] = {}  # not columns yet
        self._in_lake: dict[str, float] = {}  # segments, and since when
        self._has_news = False

    def take(self, message: FollowedMessage) -> None:
        """Keep what a message adds; estimates are left out, and what the lake would not take."""
        segment, record, place, content = message
        if place is None or isinstance(content, GyrofleetError | EstimatePublished):
            return
        if isinstance(content, ContinuedBatch):
            like, of_segment, channel = self._continued.get(record.topic, _NONE)
            if like is content.like and of_segment == segment and channel is not None:
                _, seq, next_seq, t0_ns, last_ns, *_ = place
                channel.add_regular(seq, next_seq, t0_ns, last_ns, record.arrival_ns)
                self._columns.pop(segment, None)
                self._has_news = True
                return
        elif not isinstance(content, RawBatch):
            if beyond_bounds(content) is None:
                row = event_row(parse_key(record.topic).place, content, record.arrival_ns)
                self._new_events.setdefault(segment, []).append(row)
                self._has_news = True
            return
        like = content.like
        head = like.message
        name = (record.topic, head.run, head.epoch, not head.values, head.unit_of_measure, head.scale, head.offset)
        try:
            like.check_bounds()  # the numbers of what continues it are within them
            channels = self._channels.setdefault(segment, {})
            known = channels.get(name)
            if known is None:
                first = content.decoded()
                key = parse_key(record.topic)
                known = channels[name] = ChannelRow(channel_id(record.topic, first), key.place, first)
        except GyrofleetError:
            return  # quarantined when the lake is built
        if isinstance(content, RawBatch):
            known.add(content, record.arrival_ns)
        else:
            known.add_regular(place.seq, place.next_seq, place.first_ns, place.last_ns, record.arrival_ns)
            self._continued[record.topic] = like, segment, known
        self._columns.pop(segment, None)
        self._has_news = True

    def publish(self) -> None:
        """Let requests see what has come since."""
        self.documents += bool(self._new_events)
        self.version += self._has_news
        self._has_news = False
        for segment, rows in self._new_events.items():
            self._events.setdefault(segment, []).append(pa.Table.from_pylist(rows, schema=TABLES["events"]))
        self._new_events.clear()

    def forget(self, in_lake: Collection[str]) -> None:
        """Leave out what has been in the lake for some seconds."""
        now_s = time.monotonic()
        known = self._channels.keys() | self._events.keys()
        self._in_lake = {each: self._in_lake.get(each, now_s) for each in known if each in in_lake}
        for segment in [each for each, since_s in self._in_lake.items() if now_s - since_s > _KEPT_S]:
            self._channels.pop(segment, None)
            self._columns.pop(segment, None)
            self._events.pop(segment, None)
            self._continued.clear()

    def beyond(self, in_lake: Collection[str]) -> RowTables:
        """Rows of the segments that are not in a version of the lake, as of the last `publish`."""
        channels = [self._channel_rows(segment) for segment in self._channels if segment not in in_lake]
        events = [table for segment, own in self._events.items() if segment not in in_lake for table in own]
        return RowTables(_joined("channels", channels), _joined("events", events))

    def _channel_rows(self, segment: str) -> pa.Table:
        found = self._columns.get(segment)
        if found is None:
            schema, rows = TABLES["channels"], [channel.row() for channel in self._channels[segment].values()]
            columns = [pa.array([row[field.name] for row in rows], field.type) for field in schema]
            found = self._columns[segment] = pa.Table.from_arrays(columns, schema=schema)
        return found


def _joined(name: str, tables: list[pa.Table]) -> pa.Table:
    return pa.concat_tables([TABLES[name].empty_table(), *tables])
