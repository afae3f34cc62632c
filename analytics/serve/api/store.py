"""The store itself: segments of the log, parts of the lake, disk, who writes it, clocks, last verification."""

import shutil
from typing import Any, TypedDict

import msgspec

from analytics.event_words import store_note
from analytics.serve.api.jobs import result_of
from analytics.serve.api.operation import Call, Nothing, get
from analytics.serve.api.rows import dictionaries, iso
from storage.log.files import sealed_segments
from storage.log.recovery import left_open
from storage.manifests.lake import left_aside, read_manifest
from storage.manifests.log import read_log_manifest
from storage.recording.status_board import read_statuses
from storage.recording.store_status import StoreStatus, conditions, store_status
from storage.store import Store, writer_endpoint, writer_is_active

_MOST_SEGMENTS = 50
_CLOCKS = "select * from clocks order by unit, run, signal limit 500"
# what sources announced at the end of a run, beside what is stored of it
_DELIVERY = """
with ended as (
  select run, arg_max(document, arrival_ns) as document, max(arrival_ns) as arrival_ns
  from internal.lake_documents where kind = 'RunEnded' group by run order by arrival_ns desc limit 50
), announced as (
  select run, arrival_ns, each->>'$.unit' as unit, each->>'$.signal' as signal,
    sum((each->>'$.samples')::bigint) as announced
  from (select run, arrival_ns, unnest(json_extract(document, '$.totals[*]')) as each from ended) group by all
), stored as (
  select run, unit, signal, sum(samples)::bigint as recorded from internal.served_signals group by all
)
select a.run, count(*) as signals, sum(a.announced)::bigint as announced,
  sum(least(coalesce(s.recorded, 0), a.announced))::bigint as recorded,
  sum(greatest(a.announced - coalesce(s.recorded, 0), 0))::bigint as missing
from announced a left join stored s using (run, unit, signal)
group by a.run order by max(a.arrival_ns) desc, a.run
"""
_NOTES = """
select t_ns, document->>'$.what' as what, document->>'$.text' as text from internal.lake_documents
where kind = 'StoreNoted' order by arrival_ns desc limit 50
"""


class LogRow(msgspec.Struct, frozen=True, kw_only=True):
    """The log: sealed segments, their size and content; those being written; what is set aside."""

    segments: int
    bytes: int
    samples: int
    messages: int
    open_segments: int
    open_bytes: int
    lost_segments: int
    damaged_manifest_lines: int
    set_aside: list[str]
    last_arrival_ns: int | None
    last_arrival: str | None


class LakeRow(msgspec.Struct, frozen=True, kw_only=True):
    """The lake: parts in force, their size, rows whose raw samples were dropped, segments that are not in it yet."""

    manifest: int
    parts: int
    bytes: int
    samples: int
    dropped_samples: int
    quarantined_messages: int
    behind: list[str]
    set_aside: list[str]


class SegmentRow(msgspec.Struct, frozen=True, kw_only=True):
    """A sealed segment: its size and content, when it was written, whether the lake has it."""

    segment: str
    bytes: int
    messages: int
    samples: int
    origin: str
    first: str | None
    last: str | None
    last_ns: int
    is_in_lake: bool


class DeliveryRow(msgspec.Struct, frozen=True, kw_only=True):
    """A run: samples that its sources announced when it ended, and how many of them are stored."""

    run: str
    signals: int
    announced: int
    recorded: int
    missing: int


class CounterRow(msgspec.Struct, frozen=True, kw_only=True):
    """The last counters that a program reported, from its start on: messages, duplicates, interruptions."""

    role: str
    name: str
    condition: str
    at_ns: int
    at: str | None
    numbers: dict[str, float]


class DiskRow(msgspec.Struct, frozen=True, kw_only=True):
    """The disk of the store, in bytes."""

    total_bytes: int
    free_bytes: int


class ClockRow(TypedDict):
    """The clock of a source beside the recorder's, as the table ``clocks`` has it."""

    unit: str
    signal: str
    run: str
    drift_ppm: float | None
    drift_uncertainty_ppm: float | None
    offset_least_ns: int | None
    offset_most_ns: int | None
    backward_jumps: int | None
    jumps: int | None
    largest_jump_ns: int | None
    stretches: int | None
    messages: int | None
    reason: str | None


class StoreDocument(msgspec.Struct, frozen=True, kw_only=True):
    """A store and its state; `verified` is the last verification that this server ran, None if there was none."""

    store: str
    identity: str
    is_written: bool
    writer: str | None
    log: LogRow
    lake: LakeRow
    disk: DiskRow
    segments: list[SegmentRow]
    delivery: list[DeliveryRow]
    counters: list[CounterRow]
    clocks: list[ClockRow]
    notes: list[dict[str, Any]]
    verified: dict[str, Any] | None
    verified_ns: int | None


@get("/api/status", is_kept=False, shared_s=0.5)
def status(call: Call, asked: Nothing) -> StoreStatus:
    """What is at work on the store, and what is wrong: as `gyrofleet status --json`."""
    del asked
    found = store_status(call.store)
    return msgspec.structs.replace(found, store=call.store.folder.resolve().name)


@get("/api/store", is_kept=False, table="clocks", shared_s=1.0)
def store(call: Call, asked: Nothing) -> StoreDocument:
    """The store: log, lake, disk, who writes it, delivery, clocks of the sources, its notes, the last verification."""
    del asked
    folder = call.store.folder
    verified = call.service.jobs.last("verify")
    usage = shutil.disk_usage(folder)
    delivery, clocks, notes = call.service.memo.result(("store", call.state.tag), lambda: _of_lake(call))
    return StoreDocument(
        store=folder.resolve().name, identity=call.store.identity, is_written=writer_is_active(folder),
        writer=writer_endpoint(folder), log=_log(call.store), lake=_lake(call.store),
        disk=DiskRow(total_bytes=usage.total, free_bytes=usage.free), segments=_segments(call.store),
        delivery=delivery, counters=_counters(call.store), clocks=clocks, notes=notes,
        verified=None if verified is None else result_of(verified),
        verified_ns=None if verified is None else verified.ended_ns,
    )  # fmt: skip


def _of_lake(call: Call) -> tuple[list[DeliveryRow], list[dict[str, Any]], list[dict[str, Any]]]:
    """Delivery, clocks and notes: they change with the lake alone."""
    delivery = [DeliveryRow(**row) for row in dictionaries(call.views, _DELIVERY)]
    notes = [
        row | {"time": iso(row["t_ns"]), "in_chinese": store_note(row["what"], row["text"]).zh}
        for row in dictionaries(call.views, _NOTES)
    ]
    return delivery, dictionaries(call.views, _CLOCKS), notes


def _log(store: Store) -> LogRow:
    manifest = read_log_manifest(store)
    entries = manifest.entries.values()
    open_bytes = [path.stat().st_size for path in left_open(store) if path.exists()]
    last_ns = max((each.arrival_last_ns for each in entries), default=None)
    aside = sorted(path.name for path in store.aside.iterdir()) if store.aside.is_dir() else []
    return LogRow(
        segments=len(manifest.entries), bytes=sum(each.size for each in entries),
        samples=sum(each.samples for each in entries), messages=sum(each.messages for each in entries),
        open_segments=len(open_bytes), open_bytes=sum(open_bytes), lost_segments=len(manifest.lost),
        damaged_manifest_lines=len(manifest.damage), set_aside=aside, last_arrival_ns=last_ns,
        last_arrival=iso(last_ns),
    )  # fmt: skip


def _segments(store: Store) -> list[SegmentRow]:
    """The newest sealed segments."""
    entries = sorted(read_log_manifest(store).entries.values(), key=lambda each: each.arrival_last_ns, reverse=True)
    in_lake = read_manifest(store).segments
    return [
        SegmentRow(
            segment=each.segment, bytes=each.size, messages=each.messages, samples=each.samples, origin=each.origin,
            first=iso(each.arrival_first_ns), last=iso(each.arrival_last_ns), last_ns=each.arrival_last_ns,
            is_in_lake=each.segment.removesuffix(".mcap") in in_lake,
        )
        for each in entries[:_MOST_SEGMENTS]
    ]  # fmt: skip


def _counters(store: Store) -> list[CounterRow]:
    statuses = read_statuses(store)
    return [
        CounterRow(
            role=each.role, name=each.name, condition=condition, at_ns=each.at_ns, at=iso(each.at_ns),
            numbers={name: value for name, value in each.numbers.items() if name.endswith("_total")},
        )
        for each, condition in zip(statuses, conditions(statuses), strict=True)
    ]  # fmt: skip


def _lake(store: Store) -> LakeRow:
    manifest = read_manifest(store)
    sealed = {path.name.removesuffix(".mcap") for path in sealed_segments(store)}
    return LakeRow(
        manifest=manifest.number, parts=len(manifest.parts), bytes=sum(part.bytes for part in manifest.parts),
        samples=sum(part.samples for part in manifest.parts),
        dropped_samples=sum(part.dropped.samples for part in manifest.parts if part.dropped is not None),
        quarantined_messages=sum(part.quarantined for part in manifest.parts),
        behind=sorted(sealed - manifest.segments)[:100],
        set_aside=[path.name for path in left_aside(store)],
    )  # fmt: skip
