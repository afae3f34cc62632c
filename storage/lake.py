"""The lake: columnar Parquet, one folder for each sealed segment of the log.

A folder is written under ``tmp/`` and renamed into place, so it is there once and whole, or not at all. Counts
stay counts; scale and offset stand in the channels table; ``value`` is made in the views.
"""

import hashlib
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from storage.mcap_segments import EVENTS, SAMPLES, LogRecord, read_segment
from storage.store import Store, sync_folder
from stream.batch import SampleBatch
from stream.errors import StoreError
from stream.events import EstimatePublished, EventMessage, decode_event
from stream.identity import EstimateKey, EventKey, parse_key
from stream.wire import decode_batch

SAMPLE_COLUMNS = pa.schema(
    [
        ("channel", pa.int64()),
        ("seq", pa.int64()),
        ("t_ns", pa.int64()),
        ("counts", pa.int32()),
        ("value", pa.float64()),
        ("flags", pa.uint8()),
    ]
)
CHANNEL_COLUMNS = pa.schema(
    [
        ("channel", pa.int64()),
        ("site", pa.string()),
        ("station", pa.string()),
        ("unit", pa.string()),
        ("signal", pa.string()),
        ("run", pa.string()),
        ("epoch", pa.string()),
        ("unit_of_measure", pa.string()),
        ("is_counts", pa.bool_()),
        ("scale", pa.float64()),
        ("offset", pa.float64()),
        ("dt_ns", pa.int64()),
        ("irregular", pa.bool_()),
        ("samples", pa.int64()),
        ("t_first_ns", pa.int64()),
        ("t_last_ns", pa.int64()),
        ("arrival_first_ns", pa.int64()),
        ("arrival_last_ns", pa.int64()),
    ]
)
EVENT_COLUMNS = pa.schema(
    [
        ("site", pa.string()),
        ("station", pa.string()),
        ("kind", pa.string()),
        ("run", pa.string()),
        ("unit", pa.string()),
        ("uid", pa.string()),
        ("t_ns", pa.int64()),
        ("arrival_ns", pa.int64()),
        ("document", pa.string()),
    ]
)
ESTIMATE_COLUMNS = pa.schema(
    [
        ("site", pa.string()),
        ("station", pa.string()),
        ("run", pa.string()),
        ("unit", pa.string()),
        ("signal", pa.string()),
        ("estimator", pa.string()),
        ("t_ns", pa.int64()),
        ("arrival_ns", pa.int64()),
        ("final", pa.bool_()),
        ("tau_s", pa.float64()),
        ("value", pa.float64()),
        ("lo", pa.float64()),
        ("hi", pa.float64()),
        ("confidence", pa.float64()),
        ("edf", pa.float64()),
        ("n", pa.int64()),
        ("unit_of_measure", pa.string()),
        ("samples", pa.int64()),
        ("missing", pa.int64()),
        ("sample_interval_s", pa.float64()),
        ("reason", pa.string()),
        ("uid", pa.string()),
    ]
)
TABLES = {
    "samples": SAMPLE_COLUMNS,
    "channels": CHANNEL_COLUMNS,
    "events": EVENT_COLUMNS,
    "estimates": ESTIMATE_COLUMNS,
}
REMAKE = "remove that folder: it is made anew from the log by the next import or record"

_ROW_GROUP = 1_000_000
_ESTIMATE_FIELDS = (
    *("run", "unit", "signal", "estimator", "t_ns", "final", "confidence", "unit_of_measure"),
    *("samples", "missing", "sample_interval_s", "reason", "uid"),
)


@dataclass
class _Channel:
    """Samples of one channel within a segment, gathered message by message."""

    batch: SampleBatch
    site: str
    station: str
    arrival_first_ns: int
    arrival_last_ns: int = 0
    irregular: bool = False
    batches: list[SampleBatch] = field(default_factory=list)


def build_missing(store: Store) -> Iterator[str]:
    """Bring every sealed segment that is not in the lake into it; yields their names.

    Raises
    ------
    StoreError
        If a segment is damaged; the others are brought there first.
    """
    damaged: StoreError | None = None
    for segment in sorted(store.log.glob("*.mcap")):
        if (store.lake / segment.stem).exists():
            continue
        try:
            build_part(store, segment)
        except StoreError as error:
            damaged = damaged or error
            continue
        yield segment.stem
    if damaged is not None:
        raise damaged


def parts(store: Store) -> list[Path]:
    """Folders of the lake in the order of their segments; whatever else lies there is left alone.

    Raises
    ------
    StoreError
        If a folder is not whole.
    """
    found = sorted(path for path in store.lake.iterdir() if path.name.isdecimal() and path.is_dir())
    for part in found:
        missing = [table for table in TABLES if not (part / f"{table}.parquet").is_file()]
        if missing:
            raise StoreError(f"{part} lacks {', '.join(f'{table}.parquet' for table in missing)}; {REMAKE}")
    return found


def build_part(store: Store, segment: Path) -> None:
    """Make the lake's folder of one sealed segment; the same segment gives the same rows."""
    channels: dict[int, _Channel] = {}
    events: list[dict[str, object]] = []
    estimates: list[dict[str, object]] = []
    seen: set[str] = set()
    for record in read_segment(segment):
        if record.schema == SAMPLES:
            _gather(channels, record)
        elif record.schema == EVENTS:
            message = decode_event(record.data)
            if isinstance(message.document, EstimatePublished):
                # two estimators of one signal say the same, under the same identity
                if message.document.uid not in seen:
                    estimates += _estimate_rows(record, message.document)
                seen.add(message.document.uid)
            else:
                events.append(_event_row(record, message))
    fresh = store.tmp / f"lake-{segment.stem}"
    shutil.rmtree(fresh, ignore_errors=True)
    fresh.mkdir(parents=True)
    rows = [_channel_row(channel, gathered) for channel, gathered in sorted(channels.items())]
    _write(fresh / "channels.parquet", rows, CHANNEL_COLUMNS)
    _write_samples(fresh / "samples.parquet", channels)
    _write(fresh / "events.parquet", events, EVENT_COLUMNS)
    _write(fresh / "estimates.parquet", estimates, ESTIMATE_COLUMNS)
    sync_folder(fresh)
    fresh.rename(store.lake / segment.stem)
    sync_folder(store.lake)


def channel_id(key: str, batch: SampleBatch) -> int:
    """Identity of a channel: the same samples' origin and meaning give the same number anywhere."""
    kind = "counts" if batch.counts is not None else "values"
    text = "\0".join(
        [key, batch.run, batch.epoch.hex, kind, batch.unit_of_measure, repr(batch.scale), repr(batch.offset)]
    )
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=8).digest(), "big", signed=True)


def _gather(channels: dict[int, _Channel], record: LogRecord) -> None:
    batch = decode_batch(record.data)
    identity = channel_id(record.topic, batch)
    channel = channels.get(identity)
    if channel is None:
        place = parse_key(record.topic).place
        channel = channels[identity] = _Channel(batch, place.site, place.station, record.arrival_ns)
    channel.batches.append(batch)
    channel.arrival_last_ns = record.arrival_ns
    channel.irregular |= batch.irregular


def _channel_row(identity: int, channel: _Channel) -> dict[str, object]:
    batch = channel.batch
    return {
        "channel": identity,
        "site": channel.site,
        "station": channel.station,
        "unit": batch.unit,
        "signal": batch.signal,
        "run": batch.run,
        "epoch": str(batch.epoch),
        "unit_of_measure": batch.unit_of_measure,
        "is_counts": batch.counts is not None,
        "scale": batch.scale,
        "offset": batch.offset,
        "dt_ns": batch.dt_ns,
        "irregular": channel.irregular,
        "samples": sum(len(each) for each in channel.batches),
        "t_first_ns": min(each.t0_ns for each in channel.batches),
        "t_last_ns": max(each.last_ns for each in channel.batches),
        "arrival_first_ns": channel.arrival_first_ns,
        "arrival_last_ns": channel.arrival_last_ns,
    }


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


def _write(path: Path, rows: list[dict[str, object]], schema: pa.Schema) -> None:
    table = pa.Table.from_pylist(rows, schema=schema)
    with path.open("wb") as file:
        pq.write_table(table, file, compression="zstd", compression_level=3)
        file.flush()
        os.fsync(file.fileno())


def _write_samples(path: Path, channels: dict[int, _Channel]) -> None:
    with (
        path.open("wb") as file,
        pq.ParquetWriter(
            file,
            SAMPLE_COLUMNS,
            compression="zstd",
            compression_level=3,
            use_dictionary=["channel", "flags"],
            column_encoding={
                "seq": "DELTA_BINARY_PACKED",
                "t_ns": "DELTA_BINARY_PACKED",
                "counts": "DELTA_BINARY_PACKED",
                "value": "BYTE_STREAM_SPLIT",
            },
        ) as writer,
    ):
        for identity in sorted(channels):
            writer.write_table(_sample_table(identity, channels.pop(identity).batches), row_group_size=_ROW_GROUP)
        writer.close()
        file.flush()
        os.fsync(file.fileno())


def _sample_table(identity: int, batches: list[SampleBatch]) -> pa.Table:
    n = sum(len(batch) for batch in batches)
    seq = np.empty(n, np.int64)
    t_ns = np.empty(n, np.int64)
    at = 0
    for stretch in _stretches(batches):
        first = stretch[0]
        end = at + stretch[-1].next_seq - first.seq
        seq[at:end] = np.arange(first.seq, stretch[-1].next_seq)
        if first.times_ns is None:
            t_ns[at:end] = first.t0_ns + first.dt_ns * np.arange(end - at)
        else:
            np.concatenate([batch.times_ns for batch in stretch if batch.times_ns is not None], out=t_ns[at:end])
        at = end
    counts = _joined([batch.counts for batch in batches], pa.int32(), n)
    value = _joined([batch.values for batch in batches], pa.float64(), n)
    if any(batch.flags is not None for batch in batches):
        zeros = [np.zeros(len(batch), np.uint8) if batch.flags is None else batch.flags for batch in batches]
        flags = pa.array(np.concatenate(zeros))
    else:
        flags = pa.nulls(n, pa.uint8())
    channel = pa.array(np.full(n, identity, np.int64))
    return pa.Table.from_arrays([channel, pa.array(seq), pa.array(t_ns), counts, value, flags], schema=SAMPLE_COLUMNS)


def _stretches(batches: list[SampleBatch]) -> Iterator[list[SampleBatch]]:
    """Batches that follow each other in number and, where their times are computed, in time."""
    stretch: list[SampleBatch] = []
    for batch in batches:
        if stretch and not _follows(stretch[-1], batch):
            yield stretch
            stretch = []
        stretch.append(batch)
    yield stretch


def _follows(before: SampleBatch, batch: SampleBatch) -> bool:
    if batch.seq != before.next_seq or (batch.times_ns is None) != (before.times_ns is None):
        return False
    is_timed = batch.times_ns is not None
    return is_timed or (batch.dt_ns == before.dt_ns and batch.t0_ns == before.last_ns + batch.dt_ns)


def _joined(arrays: list[npt.NDArray[np.generic] | None], kind: pa.DataType, n: int) -> pa.Array:
    present = [array for array in arrays if array is not None]
    return pa.array(np.concatenate(present)) if present else pa.nulls(n, kind)
