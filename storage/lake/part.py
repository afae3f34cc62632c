"""A sealed segment of the log made into a part of the lake: the same segment gives the same rows."""

import hashlib
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import msgspec
import pyarrow as pa

from storage.lake.channel_buffer import ChannelBuffer
from storage.lake.quarantine import Quarantine
from storage.lake.rollups import Rollup, merge, rollup_table
from storage.lake.tables import (
    CHANNEL_COLUMNS,
    CLOCK_COLUMNS,
    ESTIMATE_COLUMNS,
    EVENT_COLUMNS,
    ROLLUP_COLUMNS,
    SAMPLES_FILE,
    damaged,
    open_table,
    part_writers,
)
from storage.log.notes import is_own
from storage.manifests.lake import DroppedRows, Part, PartFile, write_part
from storage.segments.reader import read_segment
from storage.segments.records import EVENTS, SAMPLES, LogRecord
from stream.batch import IntArray, SampleBatch
from stream.bounds import beyond_bounds
from stream.errors import GyrofleetError, OutOfMemory, StoreError, WireError
from stream.events import RAW_ROWS_DROPPED, RAW_ROWS_RESTORED, EstimatePublished, EventMessage, StoreNoted, decode_event
from stream.identity import EstimateKey, EventKey, parse_key
from stream.wire.batches import decode_batch
from stream.wire.event_validation import invalid_reason

_ESTIMATE_FIELDS = (
    *("run", "unit", "signal", "estimator", "t_ns", "final", "confidence", "unit_of_measure"),
    *("samples", "missing", "sample_interval_s", "reason", "uid"),
)


class Drops(NamedTuple):
    """Segments whose raw rows are dropped, with the document of each; and those that came back, with the documents that
    count for them no more.
    """

    dropped: dict[str, str]
    restored: dict[str, tuple[str, ...]]

    def take(self, document: StoreNoted, store: str) -> None:
        """Take in a document, if it is the store's own and says something of raw rows."""
        if not is_own(document, store) or invalid_reason(document) is not None:
            return
        if document.what == RAW_ROWS_DROPPED:
            self.dropped.update(dict.fromkeys(document.details["segments"], document.uid))
        elif document.what == RAW_ROWS_RESTORED:
            ended = tuple(document.details["documents"])
            for segment in document.details["segments"]:
                self.restored[segment] = (*self.restored.get(segment, ()), *ended)

    def join(self, other: "Drops") -> "Drops":
        """Both together; what came back is not dropped, and what `self` says goes before what `other` says."""
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
    """A part in a folder of its own that is not in force yet, and what it says of raw rows of segments."""

    folder: Path
    part: Part
    drops: Drops


class _Segment:
    """What a segment of the store with that identity holds, sorted by table."""

    def __init__(self, store: str, segment: str) -> None:
        self._store = store
        self.quarantine = Quarantine(store, segment)
        self.channels: dict[tuple[object, ...], ChannelBuffer] = {}
        self.events: list[dict[str, object]] = []
        self.estimates: list[dict[str, object]] = []
        self.drops = Drops({}, {})
        self.arrival_first_ns: int | None = None
        self.arrival_last_ns: int | None = None
        self._seen: set[str] = set()

    def add(self, record: LogRecord) -> None:
        """Take in a message; one that cannot be built is quarantined."""
        if record.schema not in {SAMPLES, EVENTS}:
            return
        try:
            if record.schema == SAMPLES:
                self._add_samples(record)
            else:
                self._add_document(record, decode_event(record.data))
        except StoreError:
            raise
        except (GyrofleetError, ArithmeticError, LookupError, TypeError, ValueError) as error:
            self.quarantine.add(record, error)
        arrival_ns = record.arrival_ns
        if self.arrival_first_ns is None or arrival_ns < self.arrival_first_ns:
            self.arrival_first_ns = arrival_ns
        if self.arrival_last_ns is None or arrival_ns > self.arrival_last_ns:
            self.arrival_last_ns = arrival_ns

    def _add_samples(self, record: LogRecord) -> None:
        batch = decode_batch(record.data)
        is_counts = batch.counts is not None
        name = (record.topic, batch.run, batch.epoch, is_counts, batch.unit_of_measure, batch.scale, batch.offset)
        channel = self.channels.get(name)
        if channel is None:
            place = parse_key(record.topic).place
            channel = self.channels[name] = ChannelBuffer(channel_id(record.topic, batch), place, batch)
        channel.add(batch, record.arrival_ns)

    def _add_document(self, record: LogRecord, message: EventMessage) -> None:
        document = message.document
        if (reason := beyond_bounds(document)) is not None:
            raise WireError(f"{type(document).__name__}: {reason}")
        if isinstance(document, EstimatePublished):
            # two estimators of one signal say the same, under the same identity
            if document.uid not in self._seen:
                self.estimates += _estimate_rows(record, document)
            self._seen.add(document.uid)
            return
        self.events.append(_event_row(record, message))
        if isinstance(document, StoreNoted):
            self.drops.take(document, self._store)


def build_part(segment: Path, fresh: Path, name: str, *, store: str, without_raw: str | None = None) -> BuiltPart:
    """Make the part of one sealed segment in the folder `fresh`.

    Parameters
    ----------
    segment: A sealed segment.
    fresh: Folder to make it in; what is there is removed.
    name: That it will have in the lake.
    store: Identity of the store; what documents of another say is dropped is not.
    without_raw: The document that says that its raw rows are dropped.

    Raises
    ------
    StoreError: If the segment is damaged, or does not fit into memory.
    """
    content = _Segment(store, segment.stem)
    try:
        for record in read_segment(segment):
            content.add(record)
        with fresh_folder(fresh):
            return _written(segment, fresh, name, content, without_raw)
    except (MemoryError, OutOfMemory) as error:  # of pyarrow too
        raise StoreError(
            f"segment {segment} cannot be brought to the lake: not enough memory; free some, then give "
            f"`gyrofleet lake --once`"
        ) from error
    except (ArithmeticError, LookupError, TypeError, ValueError) as error:
        raise StoreError(
            f"segment {segment} cannot be brought to the lake ({type(error).__name__}: {error}); the log keeps it, "
            f"please report this"
        ) from error


@contextmanager
def fresh_folder(fresh: Path) -> Iterator[None]:
    """An empty folder to make a part in; where an error comes it is removed, for what it takes of a full disk."""
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
        name=name,
        segments=(segment.stem,),
        sources={segment.stem: _sha256(segment)},
        files=files,
        samples=sum(int(str(row["samples"])) for row in rows),
        t_first_ns=min((int(str(row["t_first_ns"])) for row in rows), default=None),
        t_last_ns=max((int(str(row["t_last_ns"])) for row in rows), default=None),
        arrival_first_ns=content.arrival_first_ns,
        arrival_last_ns=content.arrival_last_ns,
        quarantined=content.quarantine.messages,
        quarantined_samples=content.quarantine.samples,
    )
    if without_raw is not None:
        part = without_samples(part, without_raw)
        (fresh / SAMPLES_FILE).unlink()
    write_part(fresh, part)
    return BuiltPart(fresh, part, content.drops)


def _sha256(segment: Path) -> str:
    with segment.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def without_samples(part: Part, document: str) -> Part:
    """The description of a part whose raw rows are dropped, as `document` says."""
    files = dict(part.files)
    raw = files.pop(SAMPLES_FILE)
    dropped = DroppedRows(document, raw.rows, raw.bytes)
    return msgspec.structs.replace(part, files=files, dropped=dropped)


def noted_drops(folder: Path, store: str) -> Drops:
    """What the store's own documents in a part say of raw rows."""
    path = folder / "events.parquet"
    try:
        rows = open_table(path).read(["kind", "document"]).to_pylist()
    except (pa.ArrowException, OSError) as error:
        raise damaged(path, error) from error
    found = Drops({}, {})
    for row in rows:
        if row["kind"] == StoreNoted.__name__:
            found.take(msgspec.json.decode(row["document"], type=StoreNoted), store)
    return found


def channel_id(key: str, batch: SampleBatch) -> int:
    """Identity of a channel: the same samples' origin and meaning give the same number anywhere."""
    kind = "counts" if batch.counts is not None else "values"
    text = "\0".join(
        [key, batch.run, batch.epoch.hex, kind, batch.unit_of_measure, repr(batch.scale), repr(batch.offset)]
    )
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=8).digest(), "big", signed=True)


def _write_tables(folder: Path, content: _Segment) -> tuple[dict[str, PartFile], list[dict[str, object]]]:
    seconds, tens = [ROLLUP_COLUMNS.empty_table()], [ROLLUP_COLUMNS.empty_table()]
    clocks = [CLOCK_COLUMNS.empty_table()]
    rows: list[dict[str, object]] = []
    with part_writers(folder) as writer:
        samples = writer("samples")
        # each is let go of when it is written: a segment can hold more than there should be in memory twice
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
        tables = {
            "channels": pa.Table.from_pylist(rows, schema=CHANNEL_COLUMNS),
            "events": pa.Table.from_pylist(content.events, schema=EVENT_COLUMNS),
            "estimates": pa.Table.from_pylist(content.estimates, schema=ESTIMATE_COLUMNS),
            "rollup_1s": pa.concat_tables(seconds).combine_chunks(),
            "rollup_10s": pa.concat_tables(tens).combine_chunks(),
            "clocks": pa.concat_tables(clocks).combine_chunks(),
        }
        files = {SAMPLES_FILE: samples.finish()}
        for name, table in tables.items():
            each = writer(name)
            each.write(table)
            files[f"{name}.parquet"] = each.finish()
    return files, rows


def _event_row(record: LogRecord, message: EventMessage) -> dict[str, object]:
    parsed = parse_key(record.topic)
    assert isinstance(parsed, EventKey | EstimateKey)
    document = message.document
    return {
        "site": parsed.place.site,
        "station": parsed.place.station,
        "kind": type(document).__name__,
        "run": document.run,
        "unit": getattr(document, "unit", None),
        "uid": document.uid,
        "t_ns": document.t_ns,
        "arrival_ns": record.arrival_ns,
        "document": msgspec.json.encode(document).decode(),
    }


def _estimate_rows(record: LogRecord, document: EstimatePublished) -> list[dict[str, object]]:
    parsed = parse_key(record.topic)
    common: dict[str, object] = {name: getattr(document, name) for name in _ESTIMATE_FIELDS}
    common |= {"site": parsed.place.site, "station": parsed.place.station, "arrival_ns": record.arrival_ns}
    return [common | msgspec.structs.asdict(point) for point in document.points] or [common]
