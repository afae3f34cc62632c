"""A sealed segment of the log built into a part of the lake; the same segment gives the same rows."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import pyarrow as pa

from storage.lake import tables
from storage.lake.buffered_rows import buffered_rows, together
from storage.lake.clock_stretches import clock_table
from storage.lake.drops import Drops
from storage.lake.rollups import Rollup, rollup_tables
from storage.lake.segment_content import SegmentContent
from storage.manifests.part import DroppedRows, Part, PartFile, write_part
from storage.segments.disk import sha256_of
from storage.segments.reader import read_segment
from stream.batch import IntArray
from stream.decoding import decode_json
from stream.errors import OutOfMemory, StoreError
from stream.events import StoreNoted

_ROLLED_TOGETHER = 262_144  # buckets of a second, of whole channels


class BuiltPart(NamedTuple):
    """A part that is not in force yet, and what its documents say of raw rows."""

    folder: Path
    part: Part
    drops: Drops


def build_part(segment: Path, fresh: Path, name: str, *, store: str, without_raw: str | None = None) -> BuiltPart:
    """Build the part of one sealed segment in the folder `fresh`, emptied first; `name` is its name in the lake.

    `store` is the identity of the store, `without_raw` the document by which its raw rows are dropped, if they are.
    """
    content = SegmentContent(store, segment.stem)
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


def _written(segment: Path, fresh: Path, name: str, content: SegmentContent, without_raw: str | None) -> BuiltPart:
    files, rows = _write_tables(fresh, content)
    part = Part(
        name=name, segments=(segment.stem,), sources={segment.stem: sha256_of(segment)}, files=files,
        samples=sum(row["samples"] for row in rows),
        t_first_ns=min((row["t_first_ns"] for row in rows), default=None),
        t_last_ns=max((row["t_last_ns"] for row in rows), default=None), arrival_first_ns=content.arrival_first_ns,
        arrival_last_ns=content.arrival_last_ns, quarantined=content.quarantine.messages,
        quarantined_samples=content.quarantine.samples, columns=tables.COLUMNS_VERSION,
    )  # fmt: skip
    if without_raw is not None:
        part = without_samples(part, without_raw)
        (fresh / tables.SAMPLES_FILE).unlink()
    write_part(fresh, part)
    return BuiltPart(fresh, part, content.drops)


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
            found.take(decode_json(row["document"], StoreNoted), store)
    return found


def _write_tables(folder: Path, content: SegmentContent) -> tuple[dict[str, PartFile], list[dict[str, Any]]]:
    seconds: list[tuple[IntArray, Rollup]] = []
    clocks: list[tuple[IntArray, tuple[IntArray, ...]]] = []
    rows: list[dict[str, Any]] = []
    with tables.part_writers(folder) as writer:
        samples, rollup_1s, rollup_10s = writer("samples"), writer("rollup_1s"), writer("rollup_10s")

        def write_rollups() -> None:
            of_1s, of_10s = rollup_tables(seconds)
            rollup_1s.write(of_1s)
            rollup_10s.write(of_10s)
            seconds.clear()

        # each is freed once written: a segment can be too large to be in memory twice
        channels = sorted(content.channels.values(), key=lambda each: each.identity, reverse=True)
        content.channels.clear()
        for group in together(channels.pop() for _ in range(len(channels))):
            found = buffered_rows(group, samples.write)
            rows += [channel.row() for channel in group]
            seconds.append(found.seconds)
            clocks.append(found.clocks)
            if sum(len(numbers) for numbers, _ in seconds) >= _ROLLED_TOGETHER:
                write_rollups()
        write_rollups()
        joined = {
            "channels": pa.Table.from_pylist(rows, schema=tables.CHANNEL_COLUMNS),
            "events": pa.Table.from_pylist(content.event_rows(), schema=tables.EVENT_COLUMNS),
            "estimates": pa.Table.from_pylist(content.estimates, schema=tables.ESTIMATE_COLUMNS),
            "clocks": clock_table(clocks),
        }
        files = {"samples": samples.finish()}
        files |= {name: writer(name).write_all([table]) for name, table in joined.items()}
        files |= {"rollup_1s": rollup_1s.finish(), "rollup_10s": rollup_10s.finish()}
    return {f"{name}.parquet": files[name] for name in tables.TABLES}, rows
