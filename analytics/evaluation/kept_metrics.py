"""Metrics of all units, kept in the store and updated for units that changed.

They are computed for ranges of units, one after the other: the memory is that of a range, however large the fleet is,
and the rows come in their order.
"""

import hashlib
import json
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Protocol

import pyarrow as pa
import pyarrow.parquet as pq

from analytics.evaluation.evaluation import COLUMNS, define_views
from analytics.evaluation.ranges import Update, in_order, ranges_of, updated
from analytics.metric_registry.failed_metrics import lacking_modules
from analytics.metric_registry.registry import metrics
from analytics.step_records import FOLDER
from analytics.step_records.step_table import Progress, open_kept, step_records, write_kept_content
from storage.sql.catalog import Catalog, NotKept
from storage.sql.parquet_content import ROW_GROUP, ParquetContent
from stream.files.own_files import files_of

FILE = "unit_metrics.parquet"
_RECORDS = """
select unit, string_agg(distinct fingerprint, '/' order by fingerprint) from internal.step_records group by unit
"""
# Hash of each unit's checks that were entered by hand, which may belong to no run; and of its products' numbers.
_ENTERED = """
select unit, bit_xor(hash(uid))::varchar || '/' || count(*) from internal.standing_checks group by unit
"""
_PRODUCTS = """
select unit, md5(string_agg(to_json(p)::varchar, ';' order by run)) from internal.run_products p group by unit
"""
# In the metadata of the kept file: the fingerprint of each unit; for a unit with some metrics only, with their ids.
_PRINTS = b"gyrofleet.units"
# Packages whose text the values depend on, besides the numbers.
_PACKAGES = (
    "analytics.metrics", "analytics.methods", "analytics.methods.attitude", "analytics.system_level",
    "analytics.metric_registry", "analytics.evaluation", "analytics.evaluation.views", "analytics.uncertainty",
)  # fmt: skip


class Computation(Protocol):
    """Computes what is not kept, otherwise than in this process; the results are the same to the last bit."""

    def records(
        self, catalog: Catalog, runs: list[str], prints: Mapping[str, str], progress: Progress | None
    ) -> pa.Table:
        """Step records of runs, see `records_of`."""

    def values(self, catalog: Catalog, units: list[str], names: Collection[str]) -> pa.Table:
        """These metrics of units from the step records that are in the catalogue; `COLUMNS`."""


def unit_metrics(
    catalog: Catalog,
    progress: Progress | None = None,
    wanted: Collection[str] = (),
    computation: Computation | None = None,
) -> None:
    """Put the tables ``step_means`` and ``unit_metrics`` of all units of a store, and the views of this package.

    `progress` is called with how many of how many changed runs have been reduced. Of units that changed only the
    `wanted` metrics are computed, all if empty. Values of units whose records and products have not changed are read
    from the kept file; recomputed they are the same to the last bit. Metrics that are not wanted may be missing.
    What is not kept is computed here, or by a `computation`.
    """
    with catalog.suspended_layers():
        _update(catalog, progress, frozenset(wanted), computation)


def _update(
    catalog: Catalog, progress: Progress | None, wanted: frozenset[str], computation: Computation | None
) -> None:
    steps = step_records(catalog, progress, None if computation is None else computation.records)
    define_views(catalog, steps)
    prints = _unit_fingerprints(catalog)
    kept, marks = kept_metrics(catalog.kept)
    every = frozenset(metrics())
    needed = wanted or every
    known = {unit: _computed(mark, prints.get(unit), every) for unit, mark in marks.items()}
    stale = frozenset(unit for unit in prints if not needed <= known.get(unit, frozenset()))
    if not stale and all(known.values()):
        catalog.put_content("unit_metrics", kept or ParquetContent.of(COLUMNS.empty_table()))
        return
    if catalog.frozen:
        raise NotKept
    current = frozenset(unit for unit, names in known.items() if names)
    for unit in stale:
        known[unit] = known.get(unit, frozenset()) | needed
    marks = {
        unit: mark if known[unit] >= every else f"{mark}:{','.join(sorted(known[unit]))}"
        for unit, mark in prints.items()
    }
    computed = computation.values(catalog, sorted(stale), needed) if computation is not None and stale else None
    update = Update(kept, stale, needed, current)
    content = _content(catalog, updated(catalog, steps, ranges_of(catalog, prints), update, computed), marks)
    catalog.put_content("unit_metrics", content)
    write_kept_content(catalog.kept / FOLDER / FILE, content.content)


def _content(catalog: Catalog, found: Iterable[tuple[pa.Table, bool]], marks: Mapping[str, str]) -> ParquetContent:
    """The kept file; the rows of a range are sorted and written while those of the next one are computed."""
    sink = pa.BufferOutputStream()
    schema = COLUMNS.with_metadata({_PRINTS: json.dumps(marks)})
    with pq.ParquetWriter(sink, schema, compression="zstd") as writer, ThreadPoolExecutor(1) as beside:

        def write(rows: pa.Table, is_sorted: bool) -> None:
            writer.write_table(rows if is_sorted else in_order(catalog, rows), ROW_GROUP)
            del rows
            pa.default_memory_pool().release_unused()

        written: Future[None] = Future()
        written.set_result(None)
        for rows, is_sorted in found:
            written.result()  # the memory is that of two ranges
            written = beside.submit(write, rows, is_sorted)
            del rows
        written.result()
    return ParquetContent(sink.getvalue())


def _unit_fingerprints(catalog: Catalog) -> dict[str, str]:
    """Hash of all that a unit's metrics depend on: its records, its checks and products, the text of the metrics."""
    marks: defaultdict[str, set[str]] = defaultdict(set)
    for unit, mark in catalog.rows(_RECORDS):
        marks[unit].add(mark)
    averages = _averaging_times(catalog)
    for own in marks.values() if averages else ():
        own.add(averages)
    for sql in (_ENTERED, _PRODUCTS):
        for unit, mark in catalog.rows(sql):
            marks[unit].add(mark)
    text = hashlib.sha256()
    for package in _PACKAGES:
        for each in files_of(package):
            text.update(each.read_bytes())
    text.update(json.dumps(lacking_modules()).encode())  # computed again once they can be imported
    return {
        unit: hashlib.sha256("/".join([text.hexdigest(), *sorted(own)]).encode()).hexdigest()[:32]
        for unit, own in marks.items()
    }


def _averaging_times(catalog: Catalog) -> str:
    """The averaging times of the Allan deviation that limits name, which are those of every unit's values."""
    sql = "select string_agg(distinct key, ';' order by key) from internal.specification_parameters "
    ((keys,),) = catalog.rows(f"{sql} where metric = 'allan_deviation'")
    return keys or ""


def _computed(mark: str, fingerprint: str | None, every: frozenset[str]) -> frozenset[str]:
    """Metrics of a unit that are kept and up to date."""
    kept, colon, names = mark.partition(":")
    if kept != fingerprint:
        return frozenset()
    return frozenset(names.split(",")) if colon else every


def kept_metrics(folder: Path) -> tuple[ParquetContent | None, dict[str, str]]:
    """Metrics kept below a folder, and the mark of each unit: its fingerprint, with ``:ids`` where some are missing."""
    kept = open_kept(folder / FOLDER / FILE)
    if kept is not None:
        with suppress(ValueError, KeyError, TypeError):  # of another version
            known = dict(json.loads(kept.metadata[_PRINTS]))
            if kept.schema.equals(COLUMNS):
                return kept, known
    return None, {}
