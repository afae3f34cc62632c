"""Content of a segment of the log as the tables of a part of the lake, whether it is sealed or still open."""

import hashlib
from typing import Any

import msgspec

from storage.lake.channel_buffer import ChannelBuffer
from storage.lake.drops import Drops
from storage.lake.quarantine import Quarantine, event_row
from storage.log.follower import ContinuedBatch
from storage.log.sequence import parse_record
from storage.segments.records import EVENTS, SAMPLES, LogRecord
from stream.batch import SampleBatch
from stream.bounds import beyond_bounds
from stream.errors import GyrofleetError, StoreError, WireError
from stream.events import AnyDocument, EstimatePublished, StoreNoted
from stream.identity import Place, parse_key
from stream.wire.batches import RawBatch

_ESTIMATE_FIELDS = (
    *("run", "unit", "signal", "estimator", "t_ns", "final", "confidence", "unit_of_measure"),
    *("samples", "missing", "sample_interval_s", "reason", "uid"),
)
_UNFIT = (GyrofleetError, ArithmeticError, LookupError, TypeError, ValueError)


class SegmentContent:
    """Content of a segment, by table; `store` is the identity of the store."""

    def __init__(self, store: str, segment: str) -> None:
        self._store = store
        self.quarantine = Quarantine(store, segment)
        self.channels: dict[tuple[object, ...], ChannelBuffer] = {}
        self.events: list[dict[str, Any]] = []
        self.estimates: list[dict[str, Any]] = []
        self.drops = Drops({}, {})
        self.arrival_first_ns: int | None = None
        self.arrival_last_ns: int | None = None
        self._seen: set[str] = set()
        self._continued: dict[str, tuple[RawBatch, ChannelBuffer]] = {}  # by topic: of the batch that was continued

    def add(self, record: LogRecord) -> None:
        """Add a message; one that cannot be built is quarantined."""
        if record.schema not in {SAMPLES, EVENTS}:
            return
        content: RawBatch | AnyDocument | Exception
        try:
            parsed = parse_record(record)
            assert parsed is not None
            content = parsed.content
        except _UNFIT as error:
            content = error
        self.take(record, content)

    def take(self, record: LogRecord, content: RawBatch | ContinuedBatch | AnyDocument | Exception) -> None:
        """Add a message that has been parsed, or the reason why it cannot be."""
        try:
            if isinstance(content, ContinuedBatch):
                self._add_continued(record, content)
            elif isinstance(content, RawBatch):
                self._add_samples(record, content)
            elif isinstance(content, Exception):
                raise content
            else:
                self._add_document(record, content)
        except StoreError:
            raise
        except _UNFIT as error:
            self.quarantine.add(record, error)
        arrival_ns, first_ns, last_ns = record.arrival_ns, self.arrival_first_ns, self.arrival_last_ns
        self.arrival_first_ns = arrival_ns if first_ns is None else min(first_ns, arrival_ns)
        self.arrival_last_ns = arrival_ns if last_ns is None else max(last_ns, arrival_ns)

    def _add_samples(self, record: LogRecord, batch: RawBatch) -> None:
        batch.check_bounds()
        name = _channel_name(record, batch)
        channel = self.channels.get(name)
        if channel is None:
            first = batch.decoded()
            channel = self.channels[name] = ChannelBuffer(channel_id(record.topic, first), _place(record), first)
        channel.add(batch, record.arrival_ns)

    def _add_continued(self, record: LogRecord, batch: ContinuedBatch) -> None:
        like, channel = self._continued.get(record.topic, (None, None))
        if like is batch.like and channel is not None:
            channel.add_continued(batch, record.arrival_ns)
            return
        self._add_samples(record, batch.read())
        self._continued[record.topic] = batch.like, self.channels[_channel_name(record, batch.like)]

    def event_rows(self) -> list[dict[str, Any]]:
        """Rows of the table of events, with those on quarantined messages."""
        return self.events + self.quarantine.rows()

    def _add_document(self, record: LogRecord, document: AnyDocument) -> None:
        if (reason := beyond_bounds(document)) is not None:
            raise WireError(f"{type(document).__name__}: {reason}")
        if isinstance(document, EstimatePublished):
            # two estimators of one signal publish the same document
            if document.uid not in self._seen:
                place = _place(record)
                common: dict[str, object] = {name: getattr(document, name) for name in _ESTIMATE_FIELDS}
                common |= {"site": place.site, "station": place.station, "arrival_ns": record.arrival_ns}
                self.estimates += [common | msgspec.structs.asdict(point) for point in document.points] or [common]
            self._seen.add(document.uid)
            return
        self.events.append(event_row(_place(record), document, record.arrival_ns))
        if isinstance(document, StoreNoted):
            self.drops.take(document, self._store)


def channel_id(key: str, batch: SampleBatch) -> int:
    """Identity of a channel, a hash of its origin and meaning."""
    kind = "counts" if batch.counts is not None else "values"
    text = "\0".join(
        [key, batch.run, batch.epoch.hex, kind, batch.unit_of_measure, repr(batch.scale), repr(batch.offset)]
    )
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=8).digest(), "big", signed=True)


def _channel_name(record: LogRecord, batch: RawBatch) -> tuple[object, ...]:
    message = batch.message
    return (
        record.topic, message.run, message.epoch, not message.values, message.unit_of_measure, message.scale,
        message.offset,
    )  # fmt: skip


def _place(record: LogRecord) -> Place:
    return parse_key(record.topic).place
