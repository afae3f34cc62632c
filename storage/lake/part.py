"""A sealed segment of the log built into a part of the lake; the same segment gives the same rows."""

import hashlib
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import pyarrow as pa

from storage.lake import tables
from storage.lake.channel_buffer import ChannelBuffer
from storage.lake.quarantine import Quarantine, event_row
from storage.lake.rollups import Rollup, merge, rollup_table
from storage.log.store_documents import is_own
from storage.manifests.lake import DroppedRows, Part, PartFile, write_part
from storage.segments.disk import sha256_of
from storage.segments.reader import read_segment
from storage.segments.records import EVENTS, SAMPLES, LogRecord
from stream.batch import IntArray, SampleBatch
from stream.bounds import beyond_bounds
from stream.errors import GyrofleetError, OutOfMemory, StoreError, WireError
from stream.events import RAW_ROWS_DROPPED, RAW_ROWS_RESTORED, AnyDocument, EstimatePublished, StoreNoted, decode_event
from stream.identity import Place, parse_key
from stream.wire.batches import decode_batch
from stream.wire.event_validation import invalid_reason

_ESTIMATE_FIELDS = (
    *("run", "unit", "signal", "estimator", "t_ns", "final", "confidence", "unit_of_measure"),
    *("samples", "missing", "sample_interval_s", "reason", "uid"),
)


class Drops(NamedTuple):
    """Segments whose raw rows are dropped, by which document, and restored ones, by which documents no longer."""

    dropped: dict[str, str]
    restored: dict[str, tuple[str, ...]]

    def take(self, document: StoreNoted, store: str) -> None:
        """Apply a document, if it is the store's own and about raw rows."""
        if not is_own(document, store) or invalid_reason(document) is not None:
            return
        if document.what == RAW_ROWS_DROPPED:
            self.dropped.update(dict.fromkeys(document.details["segments"], document.uid))
        elif document.what == RAW_ROWS_RESTORED:
            ended = tuple(document.details["documents"])
            for segment in document.details["segments"]:
                self.restored[segment] = (*self.restored.get(segment, ()), *ended)

    def join(self, other: "Drops") -> "Drops":
        """The union; restored segments are not dropped, and `self` takes precedence over `other`."""
        restored = {
            segment: tuple(dict.fromkeys((*other.restored.get(segment, ()), *self.restored.get(segment, ()))))
            for segment in other.restored.keys() | self.restored.keys()
        }
        dropped = {
            segment: document
            for drops in (other.dropped, self.dropped)
            for segment, document in drops.items()
            if document not in restored.get(segment, ())
        }
        return Drops(dropped, restored)


class BuiltPart(NamedTuple):
    """A part that is not in force yet, and what its documents say of raw rows."""

    folder: Path
    part: Part
    drops: Drops


class _Segment:
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

    def add(self, record: LogRecord) -> None:
        """Add a message; one that cannot be built is quarantined."""
        if record.schema not in {SAMPLES, EVENTS}:
            return
        try:
            if record.schema == SAMPLES:
                self._add_samples(record)
            else:
                self._add_document(record, decode_event(record.data).document)
        except StoreError:
            raise
        except (GyrofleetError, ArithmeticError, LookupError, TypeError, ValueError) as error:
            self.quarantine.add(record, error)
        arrival_ns, first_ns, last_ns = record.arrival_ns, self.arrival_first_ns, self.arrival_last_ns
        self.arrival_first_ns = arrival_ns if first_ns is None else min(first_ns, arrival_ns)
        self.arrival_last_ns = arrival_ns if last_ns is None else max(last_ns, arrival_ns)

    def _add_samples(self, record: LogRecord) -> None:
        batch = decode_batch(record.data)
        is_counts = batch.counts is not None
        name = (record.topic, batch.run, batch.epoch, is_counts, batch.unit_of_measure, batch.scale, batch.offset)
        channel = self.channels.get(name)
        if channel is None:
            channel = self.channels[name] = ChannelBuffer(channel_id(record.topic, batch), _place(record), batch)
        channel.add(batch, record.arrival_ns)

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


def build_part(segment: Path, fresh: Path, name: str, *, store: str, without_raw: str | None = None) -> BuiltPart:
    """Build the part of one sealed segment in the folder `fresh`, emptied first; `name` is its name in the lake.

    `store` is the identity of the store, `without_raw` the document by which its raw rows are dropped, if they are.
    """
    content = _Segment(store, segment.stem)
    try:
        for record in read_segment(segment):
            content.add(record)
        with fresh_folder(fresh):
            return _written(segment, fresh, name, content, without_raw)
    except (MemoryError, OutOfMemory) as error:  # of pyarrow too
        raise StoreError(
            f"segment {segment} cannot be brought to the lake: not enough memory; free some, then run "
            f"`gyrofleet lake --once`"
        ) from error
    except (ArithmeticError, LookupError, TypeError, ValueError) as error:
        raise StoreError(
            f"segment {segment} cannot be brought to the lake ({type(error).__name__}: {error}); the log keeps it, "
            f"please report this"
        ) from error


@contextmanager
def fresh_folder(fresh: Path) -> Iterator[None]:
    """An empty folder to build a part in; removed after an error, to free the disk."""
    shutil.rmtree(fresh, ignore_errors=True)
    fresh.mkdir(parents=True)
    try:
        yield
    except Exception:
        shutil.rmtree(fresh, ignore_errors=True)
        raise


def _written(segment: Path, fresh: Path, name: str, content: _Segment, without_raw: str | None) -> BuiltPart:
    content.events += content.quarantine.rows()
    files, rows = _write_tables(fresh, content)
    part = Part(
        name=name, segments=(segment.stem,), sources={segment.stem: sha256_of(segment)}, files=files,
        samples=sum(row["samples"] for row in rows),
        t_first_ns=min((row["t_first_ns"] for row in rows), default=None),
        t_last_ns=max((row["t_last_ns"] for row in rows), default=None), arrival_first_ns=content.arrival_first_ns,
        arrival_last_ns=content.arrival_last_ns, quarantined=content.quarantine.messages,
        quarantined_samples=content.quarantine.samples,
    )  # fmt: skip
    if without_raw is not None:
        part = without_samples(part, without_raw)
        (fresh / tables.SAMPLES_FILE).unlink()
    write_part(fresh, part)
    return BuiltPart(fresh, part, content.drops)


def _place(record: LogRecord) -> Place:
    return parse_key(record.topic).place


def without_samples(part: Part, document: str) -> Part:
    """The description of a part once its raw rows are dropped by a document."""
    files = dict(part.files)
    raw = files.pop(tables.SAMPLES_FILE)
    dropped = DroppedRows(document, raw.rows, raw.bytes)
    return msgspec.structs.replace(part, files=files, dropped=dropped)


def documented_drops(folder: Path, store: str) -> Drops:
    """Dropped and restored raw rows by the store's own documents in a part."""
    path = folder / "events.parquet"
    try:
        rows = tables.open_table(path).read(["kind", "document"]).to_pylist()
    except (pa.ArrowException, OSError) as error:
        raise tables.damaged(path, error) from error
    found = Drops({}, {})
    for row in rows:
        if row["kind"] == StoreNoted.__name__:
            found.take(msgspec.json.decode(row["document"], type=StoreNoted), store)
    return found


def channel_id(key: str, batch: SampleBatch) -> int:
    """Identity of a channel, a hash of its origin and meaning."""
    kind = "counts" if batch.counts is not None else "values"
    text = "\0".join(
        [key, batch.run, batch.epoch.hex, kind, batch.unit_of_measure, repr(batch.scale), repr(batch.offset)]
    )
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=8).digest(), "big", signed=True)


def _write_tables(folder: Path, content: _Segment) -> tuple[dict[str, PartFile], list[dict[str, Any]]]:
    seconds, tens = [tables.ROLLUP_COLUMNS.empty_table()], [tables.ROLLUP_COLUMNS.empty_table()]
    clocks = [tables.CLOCK_COLUMNS.empty_table()]
    rows: list[dict[str, Any]] = []
    with tables.part_writers(folder) as writer:
        samples = writer("samples")
        # each is freed once written: a segment can be too large to be in memory twice
        channels = sorted(content.channels.values(), key=lambda each: each.identity, reverse=True)
        content.channels.clear()
        while channels:
            channel = channels.pop()
            rollups: list[Rollup] = []
            backward: list[IntArray] = []
            for table, rollup, back in channel.tables():
                samples.write(table)
                rollups.append(rollup)
                backward.append(back)
            rows.append(channel.row())
            second, clock = channel.rollup_and_clock(rollups, backward)
            seconds.append(rollup_table(channel.identity, second))
            tens.append(rollup_table(channel.identity, merge(second, every=10)))
            clocks.append(clock)
        joined = {
            "channels": pa.Table.from_pylist(rows, schema=tables.CHANNEL_COLUMNS),
            "events": pa.Table.from_pylist(content.events, schema=tables.EVENT_COLUMNS),
            "estimates": pa.Table.from_pylist(content.estimates, schema=tables.ESTIMATE_COLUMNS),
            "rollup_1s": pa.concat_tables(seconds).combine_chunks(),
            "rollup_10s": pa.concat_tables(tens).combine_chunks(),
            "clocks": pa.concat_tables(clocks).combine_chunks(),
        }
        files = {tables.SAMPLES_FILE: samples.finish()}
        files |= {f"{name}.parquet": writer(name).write_all([table]) for name, table in joined.items()}
    return files, rows
