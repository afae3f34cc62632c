"""Metrics of all units, kept in the store and updated for units that changed.

They are computed for ranges of units, one after the other: the memory is that of a range, however large the fleet is,
and the rows come in their order.
"""

import hashlib
import json
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from importlib.resources import files
from pathlib import Path
from typing import Protocol

import pyarrow as pa
import pyarrow.parquet as pq

from analytics.evaluation import evaluation
from analytics.evaluation.evaluation import COLUMNS, choose_steps, define_scripts, define_views, of_units
from analytics.metric_registry.registry import metrics
from analytics.step_records import FOLDER
from analytics.step_records.step_table import Progress, open_kept, step_records, write_kept_content
from storage.sql.catalog import Catalog, NotKept

FILE = "unit_metrics.parquet"
# Records of steps in one range of units.
RANGE_RECORDS = 50_000
# Hash of each unit's checks that were entered by hand, which may belong to no run; and of its products' numbers.
_ENTERED = """
select unit, bit_xor(hash(uid))::varchar || '/' || count(*) from internal.lake_documents
where kind = 'CheckEntered' group by unit
"""
_PRODUCTS = """
select unit, md5(string_agg(to_json(p)::varchar, ';' order by run)) from internal.run_products p group by unit
"""
# A total order, so that kept and recomputed rows make the same table.
_SORTED = """
select * from given_rows
order by unit, metric, signal nulls first, run nulls first, parameters nulls first, standard, clause, steps, runs,
  reason
"""
_KEPT = """
select * from internal.kept_metrics where unit between $first and $last
  and not (unit in (select unnest($stale)) and metric in (select unnest($replaced)))
  and unit not in (select unnest($outdated))
"""
# In the metadata of the kept file: the fingerprint of each unit; for a unit with some metrics only, with their ids.
_PRINTS = b"gyrofleet.units"
_BATCH_ROWS = 50_000
# Packages whose text the values depend on, besides the numbers.
_PACKAGES = (
    "analytics.metrics", "analytics.methods", "analytics.system_level", "analytics.metric_registry",
    "analytics.evaluation.views", "analytics.uncertainty",
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
    define_views(catalog, step_records(catalog, progress, None if computation is None else computation.records))
    prints = _unit_fingerprints(catalog)
    file, marks = kept_metrics(catalog.kept)
    every = frozenset(metrics())
    needed = wanted or every
    known = {unit: _computed(mark, prints.get(unit), every) for unit, mark in marks.items()}
    stale = frozenset(unit for unit in prints if not needed <= known.get(unit, frozenset()))
    if not stale and all(known.values()):
        catalog.put("unit_metrics", _batches(file))
        return
    if catalog.frozen:
        raise NotKept
    outdated = frozenset(unit for unit, names in known.items() if not names)
    for unit in stale:
        known[unit] = known.get(unit, frozenset()) | needed
    marks = {
        unit: mark if known[unit] >= every else f"{mark}:{','.join(sorted(known[unit]))}"
        for unit, mark in prints.items()
    }
    catalog.put("kept_metrics", _batches(file), is_large=True)
    catalog.put("unit_metrics", COLUMNS.empty_table())
    sink = pa.BufferOutputStream()
    with pq.ParquetWriter(sink, COLUMNS.with_metadata({_PRINTS: json.dumps(marks)}), compression="zstd") as writer:
        found = computation.values(catalog, sorted(stale), needed) if computation is not None and stale else None
        for rows in _updated(catalog, list(_ranges(catalog, prints)), stale, needed, outdated, found):
            catalog.append("unit_metrics", rows)
            writer.write_table(rows)
    catalog.put("kept_metrics", COLUMNS.empty_table(), is_large=True)
    write_kept_content(catalog.kept / FOLDER / FILE, sink.getvalue())


def _updated(
    catalog: Catalog,
    ranges: list[list[str]],
    stale: Collection[str],
    needed: Collection[str],
    outdated: Collection[str],
    computed: pa.Table | None,
) -> Iterator[pa.Table]:
    """Rows of each range of units: kept ones, and the needed metrics of stale units, computed here if they are not."""
    chosen = [metrics()[name] for name in sorted(needed)]
    is_whole = True
    for units in ranges:
        of_range = [unit for unit in units if unit in stale]
        given = {"first": units[0], "last": units[-1], "stale": of_range, "replaced": sorted(needed)}
        rows = (
            catalog.reader(_KEPT, given | {"outdated": [unit for unit in units if unit in outdated]})
            .read_all()
            .cast(COLUMNS)
        )
        if of_range:
            if computed is None and (len(of_range) < len(units) or len(ranges) > 1):
                choose_steps(catalog, of_range)
                is_whole = False
            # a metric may also look at documents, which are those of all units
            found = evaluation.evaluate(catalog, chosen) if computed is None else computed
            rows = pa.concat_tables([rows, of_units(found, of_range)])
            del found
            rows = catalog.table(_SORTED, rows).cast(COLUMNS)
        yield rows
    if not is_whole:
        choose_steps(catalog)
        define_scripts(catalog, "views")  # whose tables are of a range


def _ranges(catalog: Catalog, units: Iterable[str]) -> Iterator[list[str]]:
    """All units in their order, in ranges with a bounded number of records."""
    records = dict(catalog.rows("select unit, count(*) from internal.step_records group by unit"))
    found: list[str] = []
    count = 0
    for unit in sorted(units):
        count += records.get(unit, 0)
        if found and count > RANGE_RECORDS:
            yield found
            found, count = [], records.get(unit, 0)
        found.append(unit)
    if found:
        yield found


def _batches(file: pq.ParquetFile | None) -> pa.RecordBatchReader:
    if file is None:
        return COLUMNS.empty_table().to_reader()
    return pa.RecordBatchReader.from_batches(COLUMNS, file.iter_batches(_BATCH_ROWS))


def _unit_fingerprints(catalog: Catalog) -> dict[str, str]:
    """Hash of all that a unit's metrics depend on: its records, its checks and products, the text of the metrics."""
    marks: defaultdict[str, set[str]] = defaultdict(set)
    for unit, mark in catalog.rows("select distinct unit, fingerprint from internal.step_records"):
        marks[unit].add(mark)
    averages = _averaging_times(catalog)
    for own in marks.values() if averages else ():
        own.add(averages)
    for sql in (_ENTERED, _PRODUCTS):
        for unit, mark in catalog.rows(sql):
            marks[unit].add(mark)
    text = hashlib.sha256()
    for package in _PACKAGES:
        for each in sorted(files(package).iterdir(), key=lambda e: e.name):
            if each.is_file():
                text.update(each.read_bytes())
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


def kept_metrics(folder: Path) -> tuple[pq.ParquetFile | None, dict[str, str]]:
    """Metrics kept below a folder, and the mark of each unit: its fingerprint, with ``:ids`` where some are missing."""
    file = open_kept(folder / FOLDER / FILE)
    if file is not None:
        with suppress(ValueError, KeyError, TypeError):  # of another version
            known = dict(json.loads((file.schema_arrow.metadata or {})[_PRINTS]))
            if file.schema_arrow.equals(COLUMNS):
                return file, known
    return None, {}
