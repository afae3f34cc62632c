"""Metrics of all units: computed from the step records, kept in the store, updated for units that changed."""

import hashlib
import json
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from importlib.resources import files
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, Protocol

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from analytics.evaluation.type_b import COVERAGE, UNCERTAINTIES, TypeB
from analytics.methods.confidence_bounds import chi_square_bounds, deviation_uncertainty, t_bounds
from analytics.metric_registry.registry import BoundsSource, Metric, metrics, parameters_text
from analytics.specifications.sql_tables import SPECIFICATION_TABLES, put_specifications
from analytics.step_records import FOLDER
from analytics.step_records.step_table import Progress, read_kept, step_means, write_kept
from storage.sql.catalog import Catalog, NotKept
from storage.sql.columns import distinct_pairs
from stream.errors import UnknownUnit
from stream.quantities import conversion, is_angular_rate

FILE = "unit_metrics.parquet"
_TOO_LITTLE = "the steps hold too little to compute it"
_WITH_TEXT = "select * replace (to_json(parameters)::varchar as parameters) from ({})"
_UNDEFINED = "what it is divided by is 0, as where the output does not answer to the input, or a number is too large"

_TEXTS, _NUMBERS = ("metric", "unit", "signal", "run"), ("lo", "hi", "standard_uncertainty", "freedom")
_TEXT, _REAL = pa.string(), pa.float64()
COLUMNS = pa.schema({
    **dict.fromkeys(_TEXTS, _TEXT), "value": _REAL, "unit_of_measure": _TEXT, **dict.fromkeys(_NUMBERS, _REAL),
    **dict.fromkeys(UNCERTAINTIES, _REAL), "uncertainty_reason": _TEXT,
    "n": pa.int64(), "parameters": _TEXT, "runs": pa.list_(_TEXT), "steps": pa.list_(pa.int64()),
    "standard": _TEXT, "clause": _TEXT, "reason": _TEXT,
})  # fmt: skip
# Hash of each unit's checks that were entered by hand, which may belong to no run; and of its products' numbers.
_ENTERED = """
select unit, bit_xor(hash(uid))::varchar || '/' || count(*) from internal.lake_documents
where kind = 'CheckEntered' group by unit
"""
_PRODUCTS = """
select unit, md5(string_agg(to_json(p)::varchar, ';' order by run)) from internal.run_products p group by unit
"""
# The lines of the scale factors, the scale factors that metrics may use, and with these the steps in deg/h.
_SHARED = """
create or replace table internal.scale_fits as from scale_lines('internal.scale_sides');
create or replace table internal.scale_factors as from measured_scale_factors('internal.scale_fits');
create or replace table internal.still_steps as from internal.standing_steps;
"""
# What metrics ask of all units, also where they are computed for a part of them.
_OF_RECORDS = """
create or replace table internal.units_of_runs as select distinct run, unit, "procedure" from step_means
"""
# A total order, so that kept and recomputed rows make the same table.
_SORTED = """
select * from unit_metrics
order by metric, unit, signal nulls first, run nulls first, parameters nulls first, standard, clause, steps, runs,
  reason
"""
# In the metadata of the kept file: the fingerprint of each unit; for a unit with some metrics only, with their ids.
_PRINTS = b"gyrofleet.units"
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

    def values(self, catalog: Catalog, steps: pa.Table, units: list[str], names: Collection[str]) -> pa.Table:
        """These metrics of units, from all step records; `COLUMNS`."""


def unit_metrics(
    catalog: Catalog, progress: Progress | None = None, wanted: Collection[str] = (),
    computation: Computation | None = None,
) -> pa.Table:  # fmt: skip
    """Metrics of all units of a store; puts the tables ``step_means``, ``unit_metrics`` and the views of this package.

    `progress` is called with how many of how many changed runs have been reduced. Of units that changed only the
    `wanted` metrics are computed, all if empty. The columns are `COLUMNS`. Values of units whose records and products
    have not changed are read from the kept file; recomputed they are the same to the last bit. Metrics that are not
    wanted may be missing. What is not kept is computed here, or by a `computation`.
    """
    steps = step_means(catalog, progress, None if computation is None else computation.records)
    define_views(catalog, steps)
    of_documents = (dict(catalog.rows(sql)) for sql in (_ENTERED, _PRODUCTS))
    prints = _unit_fingerprints(steps, *of_documents, _averaging_times(catalog, steps))
    table, marks = kept_metrics(catalog.kept)
    every = frozenset(metrics())
    needed = frozenset(wanted) or every
    known = {unit: _computed(mark, prints.get(unit), every) for unit, mark in marks.items()}
    stale = sorted(unit for unit in prints if not needed <= known.get(unit, frozenset()))
    is_same = all(known.values())
    if catalog.frozen and (stale or not is_same):
        raise NotKept
    if not is_same:
        table = of_units(table, [unit for unit, names in known.items() if names])
    is_partial = len(stale) < len(prints)
    if stale:
        if computation is not None:
            found = computation.values(catalog, steps, stale, needed)
        else:
            if is_partial:
                catalog.put("step_means", of_units(steps, stale))
            # a metric may also look at documents, which are those of all units
            found = of_units(evaluate(catalog, [metrics()[name] for name in sorted(needed)]), stale)
        replaced = pc.and_(_is_in(table["unit"], stale), _is_in(table["metric"], needed))
        catalog.put("unit_metrics", pa.concat_tables([table.filter(pc.invert(replaced)), found]))
        table = catalog.table(_SORTED).cast(COLUMNS)
        if is_partial:
            catalog.put("step_means", steps)
    if stale or not is_same:
        for unit in stale:
            known[unit] = known.get(unit, frozenset()) | needed
        marks = {
            unit: mark if known[unit] >= every else f"{mark}:{','.join(sorted(known[unit]))}"
            for unit, mark in prints.items()
        }
        if not catalog.frozen:
            write_kept(catalog.kept / FOLDER / FILE, table.replace_schema_metadata({_PRINTS: json.dumps(marks)}))
    if computation is not None or (is_partial and needed == every):  # else the evaluation has put those of all units
        keep_scale_factors(catalog)
    catalog.put("unit_metrics", table)
    return table


def define_views(catalog: Catalog, steps: pa.Table, of_store: Mapping[str, pa.Table] | None = None) -> None:
    """Define the tables and views that metrics use.

    Where `steps` are those of some units, `of_store` has the tables of the whole store, see `tables_of_store`.
    """
    catalog.put("step_means", steps)
    catalog.define(_OF_RECORDS)
    if of_store is None:
        put_specifications(catalog)
    for name, table in (of_store or {}).items():
        catalog.put(name, table)
    catalog.put("rate_units", _rate_units(steps))
    define_scripts(catalog, "views")


def tables_of_store(catalog: Catalog) -> dict[str, pa.Table]:
    """Tables of a catalogue that metrics of a unit need, and that are of all units; by name."""
    return {name: catalog.stored(name) for name in (*SPECIFICATION_TABLES, "units_of_runs")}


def define_scripts(catalog: Catalog, folder: str, names: Collection[str] = ()) -> None:
    """Run the SQL scripts of a folder of this package in the order of their names, or some of them."""
    scripts = files("analytics.evaluation").joinpath(folder).iterdir()
    for script in sorted(scripts, key=lambda each: each.name):
        if script.name.endswith(".sql") and (not names or script.name in names):
            catalog.define(script.read_text(encoding="utf-8"))


def evaluate(catalog: Catalog, chosen: Iterable[Metric]) -> pa.Table:
    """Compute metrics from the ``step_means`` that are in the catalogue; `COLUMNS`."""
    keep_scale_factors(catalog)
    able = _with_rows(catalog, list(chosen))
    type_b = TypeB(catalog) if able else None
    return pa.concat_tables([COLUMNS.empty_table(), *(_values(catalog, metric, type_b) for metric in able)])


def _with_rows(catalog: Catalog, chosen: list[Metric]) -> list[Metric]:
    """Those with rows in what they are made of: planning a statement takes much longer than running it."""
    sources = {metric.header.of for metric in chosen} - {""}
    sql = ", ".join(f'exists (from {source}) as "{source}"' for source in sorted(sources))
    found = catalog.table(f"select {sql}").to_pylist()[0] if sources else {}
    return [metric for metric in chosen if found.get(metric.header.of, True)]


def keep_scale_factors(catalog: Catalog) -> None:
    """Put the tables that many metrics use: ``scale_fits``, ``scale_factors`` and ``still_steps``."""
    catalog.define(_SHARED)


def _values(catalog: Catalog, metric: Metric, type_b: TypeB | None) -> pa.Table:
    found, columns = columns_of(catalog, metric)
    if type_b is not None:
        columns |= type_b.columns(metric.header, found, columns)
    return pa.table(columns, schema=COLUMNS)


def columns_of(catalog: Catalog, metric: Metric) -> tuple[pa.Table, dict[str, pa.Array]]:
    """Rows of a metric as its statement gives them, and the columns of `COLUMNS`, those of type B not yet filled in."""
    header = metric.header
    found = _found(catalog, metric)
    n = found.num_rows
    columns = {
        field.name: found[field.name].combine_chunks().cast(field.type)
        if field.name in found.column_names
        else pa.nulls(n, field.type)
        for field in COLUMNS
    }
    columns["metric"] = pa.repeat(header.id, n)
    for name, usual in (("unit_of_measure", header.unit), ("standard", header.standard), ("clause", header.clause)):
        columns[name] = columns[name].fill_null(usual)
    _make_readable(columns)
    _add_bounds(columns, header.limits)
    return found, columns


def _found(catalog: Catalog, metric: Metric) -> pa.Table:
    """Rows of a metric's statement or function, before the columns that all metrics share are filled in."""
    if not metric.header.python:
        return catalog.table(_WITH_TEXT.format(metric.sql))
    rows = resolve_name(metric.header.python)(catalog, metric.sql)
    if isinstance(rows, pa.Table):
        return rows
    found = [{"runs": [row["run"]], **row, "parameters": parameters_text(row["parameters"])} for row in rows]
    return pa.Table.from_pylist(found, schema=COLUMNS)


def _make_readable(columns: dict[str, pa.Array]) -> None:
    """Replace numbers that JSON cannot write: one in the parameters would make every query of them fail."""
    parameters = columns["parameters"]
    unreadable = pc.fill_null(pc.match_substring_regex(parameters, "NaN|Infinity"), False)
    if pc.any(unreadable).as_py():
        texts = parameters.filter(unreadable).to_pylist()
        mended = [parameters_text(json.loads(text, parse_constant=lambda _: None)) for text in texts]
        columns["parameters"] = pc.replace_with_mask(parameters, unreadable, pa.array(mended, pa.string()))


def _add_bounds(columns: dict[str, pa.Array], source: BoundsSource) -> None:
    """Fill in `lo` and `hi`, and the uncertainty of deviations; nothing where there is no value."""
    value, *bounds = (columns[name].to_numpy(zero_copy_only=False) for name in ("value", *_NUMBERS))
    lo, hi, u, freedom = bounds
    missing = ~np.isfinite(value)
    why = pc.if_else(columns["value"].is_null(), _TOO_LITTLE, _UNDEFINED)
    columns["reason"] = pc.if_else(pc.and_(pa.array(missing), columns["reason"].is_null()), why, columns["reason"])
    value = np.where(missing, np.nan, value)
    if source is BoundsSource.T:
        lo, hi = t_bounds(value, u, np.nan_to_num(freedom, nan=1e9))
    elif source is BoundsSource.CHI_SQUARE:
        degrees = np.nan_to_num(freedom, nan=1.0)
        lo, hi = chi_square_bounds(value, degrees)
        u = np.where(np.isnan(u), deviation_uncertainty(value, degrees), u)
    for name, array in (("value", value), ("lo", lo), ("hi", hi), ("standard_uncertainty", u)):
        columns[name] = pa.array(array, pa.float64(), mask=missing | ~np.isfinite(array))
    columns["freedom"] = pa.array(freedom, pa.float64(), mask=~np.isfinite(freedom))


def _is_in(column: pa.ChunkedArray, names: Collection[str]) -> pa.ChunkedArray:
    return pc.is_in(column, pa.array(sorted(names), pa.string()))


def of_units(table: pa.Table, units: Collection[str]) -> pa.Table:
    """Rows of some units."""
    return table.filter(_is_in(table["unit"], units))


def _rate_units(steps: pa.Table) -> pa.Table:
    found = {}
    for unit in steps["unit_of_measure"].unique().to_pylist():
        with suppress(UnknownUnit):
            if is_angular_rate(unit):
                found[unit] = conversion(unit, "deg/h")[0]
    units, factors = pa.array(found.keys(), pa.string()), pa.array(found.values(), pa.float64())
    return pa.table({"unit_of_measure": units, "deg_per_h": factors})


def _averaging_times(catalog: Catalog, steps: pa.Table) -> dict[str, str]:
    """The averaging times of the Allan deviation that limits name, which are those of every unit's values."""
    sql = "select string_agg(distinct key, ';' order by key) from internal.specification_parameters "
    ((keys,),) = catalog.rows(f"{sql} where metric = 'allan_deviation'")
    return {} if keys is None else dict.fromkeys(steps["unit"].unique().to_pylist(), str(keys))


def _unit_fingerprints(steps: pa.Table, *parts: Mapping[str, str]) -> dict[str, str]:
    """Hash of all that a unit's metrics depend on: its records, `parts` of other things, the text of the metrics."""
    marks: defaultdict[str, set[str]] = defaultdict(set)
    of_runs = distinct_pairs(steps, "unit", "fingerprint")
    for unit, mark in (*of_runs, *(pair for part in parts for pair in part.items())):
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


def _computed(mark: str, fingerprint: str | None, every: frozenset[str]) -> frozenset[str]:
    """Metrics of a unit that are kept and up to date."""
    kept, colon, names = mark.partition(":")
    if kept != fingerprint:
        return frozenset()
    return frozenset(names.split(",")) if colon else every


def kept_metrics(folder: Path) -> tuple[pa.Table, dict[str, str]]:
    """Metrics kept below a folder, and the mark of each unit: its fingerprint, with ``:ids`` where some are missing."""
    table = read_kept(folder / FOLDER / FILE)
    if table is not None:
        with suppress(pa.ArrowException, ValueError, KeyError, TypeError):  # of another version
            known = dict(json.loads(table.schema.metadata[_PRINTS]))
            return table.replace_schema_metadata(None).cast(COLUMNS), known
    return COLUMNS.empty_table(), {}


def row_of(row: Mapping[str, Any]) -> dict[str, Any]:
    """A value as in `gyrofleet metrics --json`."""
    found = {name: row[name] for name in COLUMNS.names if name != "freedom"}
    p = None if row["U"] is None else COVERAGE
    return found | {"p": p, "parameters": json.loads(row["parameters"] or "{}")}
