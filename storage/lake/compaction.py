"""Compaction: the parts of a finished day become one, many small parts of the present day become few.

Rows do not change; samples are sorted by channel and number, rollups by channel and time. It takes effect with the
manifest: a crash leaves the parts as they were.
"""

import hashlib
import itertools
import math
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Set
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pyarrow as pa

from storage.lake.drops import Drops
from storage.lake.part import BuiltPart, fresh_folder
from storage.lake.rows_by_channel import rows_by_channel
from storage.lake.tables import (
    CHANNEL_COLUMNS,
    ROW_GROUP,
    SAMPLES_FILE,
    TABLES,
    TableWriter,
    damaged,
    open_table,
    part_writers,
)
from storage.manifests.lake import Manifest
from storage.manifests.part import Part, PartFile, hull, with_sources, write_part
from stream.errors import StoreError

if TYPE_CHECKING:
    import pyarrow.parquet as pq

    from storage.lake.lake import Lake

FAN_IN = 64
MOST_BYTES = 4 << 30
_MOST_ROW_GROUPS = 20_000  # whose footers are in memory at a time
_DAY_NS = 86_400 * 10**9
_DAY_GRACE_NS = 600 * 10**9  # a segment of the day before may still be open
_JOINED = ("events", "estimates", "clocks")
_ROLLUPS = ("rollup_1s", "rollup_10s")


class Compacted(NamedTuple):
    """A new part and the number of parts it was made from."""

    name: str
    parts: int


class _Interleaved(Exception):
    """Parts whose numbers of one channel interleave: concatenated they would not be in order."""


def compact(lake: "Lake", *, now_ns: int | None = None) -> Iterator[Compacted]:
    """Merge what is due, each step in force when it is yielded; a damaged part raises StoreError at the end."""
    failure: StoreError | None = None
    skipped: set[str] = set()
    while True:
        group = next(due(lake.manifest, time.time_ns() if now_ns is None else now_ns, skipped), None)
        if group is None:
            break
        try:
            yield merge_parts(lake, group)
        except _Interleaved:
            skipped.add(group[-1].name)
        except StoreError as error:
            failure = failure or error
            skipped |= {part.name for part in group}
    if failure is not None:
        raise failure


def due(manifest: Manifest, now_ns: int, skipped: Set[str] = frozenset()) -> Iterator[list[Part]]:
    """Neighbouring parts to merge, oldest first: all of a finished day (UTC, by arrival), full groups of today."""
    kinds: dict[tuple[str, bool, bool, int, int], list[Part]] = defaultdict(list)
    for part in manifest.parts:
        if part.name in skipped or part.bytes > MOST_BYTES // 2:
            continue
        arrival_ns = part.arrival_first_ns or 0
        is_finished = (arrival_ns // _DAY_NS + 1) * _DAY_NS + _DAY_GRACE_NS <= now_ns
        level = 0 if is_finished else math.floor(math.log(len(part.segments), FAN_IN) + 1e-9)
        kinds[part.day, part.dropped is not None, is_finished, level, part.columns].append(part)
    for (_, _, is_finished, _, _), parts in kinds.items():
        group: list[Part] = []
        for part in parts:
            if group and not _fits([*group, part]):
                if len(group) > 1:
                    yield group
                group = []
            group.append(part)
        if len(group) > 1 and (is_finished or len(group) == FAN_IN):
            yield group


def merge_parts(lake: "Lake", group: list[Part]) -> Compacted:
    """Merge parts and replace them."""
    segments = " ".join(sorted(segment for part in group for segment in part.segments))
    digest = hashlib.blake2b(segments.encode(), digest_size=4).hexdigest()
    name = lake.free_name(f"{group[0].day or 'empty'}-{digest}")
    fresh = lake.store.tmp / f"lake-{name}"
    with fresh_folder(fresh):
        part = hull([with_sources(lake.store.lake, each) for each in group], name, _merged_files(lake, group, fresh))
        write_part(fresh, part)
    lake.swap([each.name for each in group], [BuiltPart(fresh, part, Drops({}, {}))])
    return Compacted(name, len(group))


def _merged_files(lake: "Lake", group: list[Part], folder: Path) -> dict[str, PartFile]:
    files: dict[str, PartFile] = {}
    with part_writers(folder) as writer:
        if group[0].dropped is None:
            with ExitStack() as stack:
                files[SAMPLES_FILE] = writer("samples").write_all(_sorted_samples(lake, group, stack))
        files["channels.parquet"] = writer("channels").write_all([_merged_channels(lake, group)])
        for name in _JOINED:
            files[f"{name}.parquet"] = writer(name).write_all(_joined_rows(lake, group, name))
        for name in _ROLLUPS:
            paths = [lake.store.lake / part.name / f"{name}.parquet" for part in group]
            files[f"{name}.parquet"] = _merged_rollups(lake, paths, folder / f"{name}.parquet", writer)
    return files


def _merged_rollups(lake: "Lake", paths: list[Path], merged: Path, writer: Callable[[str], TableWriter]) -> PartFile:
    """Write rollups by channel, a second time where their files had them in the order of time.

    Of these, more rows would have to wait than memory should hold, so that the first pass sorts them piece by piece.
    """
    written, is_by_channel = _write_sorted(lake, paths, writer(merged.stem))
    if is_by_channel:
        return written
    by_piece = merged.rename(merged.with_suffix(".by_piece"))
    written, _ = _write_sorted(lake, [by_piece], writer(merged.stem))
    by_piece.unlink()
    return written


def _write_sorted(lake: "Lake", paths: list[Path], writer: TableWriter) -> tuple[PartFile, bool]:
    """Write the rows of rollups, and say whether each channel has come in one place."""
    is_by_channel, last = True, None

    def noted(tables: Iterator[pa.Table]) -> Iterator[pa.Table]:
        nonlocal is_by_channel, last
        for table in tables:
            channels = table.column("channel")
            is_by_channel &= last is None or channels[0].as_py() > last
            last = channels[-1].as_py()
            yield table

    with ExitStack() as stack:
        try:
            tables = rows_by_channel([stack.enter_context(open_table(path)) for path in paths])
            return writer.write_all(noted(tables)), is_by_channel
        except (pa.ArrowException, OSError) as error:
            raise damaged(lake.store.lake, error) from error


def _fits(group: list[Part]) -> bool:
    return (
        len(group) <= FAN_IN
        and sum(part.bytes for part in group) <= MOST_BYTES
        and sum(part.files["channels.parquet"].rows + part.samples // ROW_GROUP for part in group) <= _MOST_ROW_GROUPS
    )


class _Stretch(NamedTuple):
    """Rows of one channel in a row group, which may be shared with other channels."""

    channel: int
    seq_first: int
    seq_last: int
    file: "pq.ParquetFile"
    row_group: int
    first_row: int
    rows: int
    is_shared: bool


def _sorted_samples(lake: "Lake", group: list[Part], stack: ExitStack) -> Iterator[pa.Table]:
    """Samples by channel and number, in tables of a row group at most."""
    shared: dict[pq.ParquetFile, tuple[int, pa.Table]] = {}  # the last of each file

    def read(file: "pq.ParquetFile", number: int) -> pa.Table:
        # files differ in which columns they say are never null
        return file.read_row_group(number, use_threads=False).cast(TABLES["samples"])

    def rows_of(stretch: _Stretch) -> pa.Table:
        file, number = stretch.file, stretch.row_group
        if not stretch.is_shared:
            return read(file, number)
        if file not in shared or shared[file][0] != number:
            shared[file] = number, read(file, number)
        return shared[file][1].slice(stretch.first_row, stretch.rows)

    try:
        stretches: list[_Stretch] = []
        for part in group:
            stretches += _stretches(stack.enter_context(open_table(lake.store.lake / part.name / SAMPLES_FILE)))
        stretches.sort(key=lambda each: each[:3])
        for before, after in itertools.pairwise(stretches):
            if before.channel == after.channel and after.seq_first <= before.seq_last:
                raise _Interleaved
        pending: list[pa.Table] = []
        for at, each in enumerate(stretches):
            pending.append(rows_of(each))
            is_last = at + 1 == len(stretches) or stretches[at + 1].channel != each.channel
            rows = sum(table.num_rows for table in pending)
            if is_last or rows >= ROW_GROUP:
                table = pa.concat_tables(pending)
                whole = rows if is_last else rows - rows % ROW_GROUP
                yield table.slice(0, whole).combine_chunks()
                pending = [] if whole == rows else [table.slice(whole)]
    except (pa.ArrowException, OSError) as error:
        raise damaged(lake.store.lake, error) from error


def _stretches(file: "pq.ParquetFile") -> Iterator[_Stretch]:
    metadata = file.metadata
    for index in range(metadata.num_row_groups):
        group = metadata.row_group(index)
        if not group.num_rows:
            continue
        channel, seq = (group.column(i).statistics for i in (0, 1))
        if channel.min == channel.max:
            yield _Stretch(channel.min, seq.min, seq.max, file, index, 0, group.num_rows, is_shared=False)
            continue
        table = file.read_row_group(index, columns=["channel", "seq"], use_threads=False)
        channels, numbers = (table.column(i).to_numpy() for i in (0, 1))
        borders = (np.flatnonzero(channels[1:] != channels[:-1]) + 1).tolist()
        for begin, end in itertools.pairwise([0, *borders, group.num_rows]):
            own, of = numbers[begin:end], int(channels[begin])
            yield _Stretch(of, int(own.min()), int(own.max()), file, index, begin, end - begin, is_shared=True)


def _merged_channels(lake: "Lake", group: list[Part]) -> pa.Table:
    """One row for each channel."""
    merged: dict[int, dict[str, Any]] = {}
    for part in group:
        for batch in _read(lake, part, "channels"):
            for each in batch.to_pylist():
                before = merged.setdefault(each["channel"], each)
                if before is not each:
                    _add_channel(before, each)
    return pa.Table.from_pylist([merged[channel] for channel in sorted(merged)], schema=CHANNEL_COLUMNS)


def _add_channel(row: dict[str, Any], later: dict[str, Any]) -> None:
    row["overlapping"] |= later["overlapping"] or later["t_first_ns"] < row["t_last_ns"]
    row["irregular"] |= later["irregular"]
    row["samples"] += later["samples"]
    for name in ("dt_ns", "seq_first", "t_first_ns", "arrival_first_ns"):
        row[name] = min(row[name], later[name])
    for name in ("seq_next", "t_last_ns", "arrival_last_ns"):
        row[name] = max(row[name], later[name])


def _joined_rows(lake: "Lake", group: list[Part], name: str) -> Iterator[pa.Table]:
    """Rows of all parts in their order, in tables of about a row group."""
    pending: list[pa.RecordBatch] = []
    for batch in itertools.chain.from_iterable(_read(lake, part, name) for part in group):
        pending.append(batch)
        if sum(each.num_rows for each in pending) >= ROW_GROUP:
            yield pa.Table.from_batches(pending, schema=TABLES[name]).combine_chunks()
            pending = []
    if pending:
        yield pa.Table.from_batches(pending, schema=TABLES[name]).combine_chunks()


def _read(lake: "Lake", part: Part, name: str) -> Iterator[pa.RecordBatch]:
    path = lake.store.lake / part.name / f"{name}.parquet"
    with open_table(path) as file:
        try:
            yield from file.iter_batches(ROW_GROUP, use_threads=False)
        except (pa.ArrowException, OSError) as error:
            raise damaged(path, error) from error
