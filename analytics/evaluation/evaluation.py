"""Every metric of every unit: computed from the step records, kept, and brought up to date for units that changed."""

import hashlib
import json
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from analytics.metrics.header import Limits
from analytics.metrics.largest_magnitude import json_text
from analytics.metrics.limits_of_value import chi_square_limits, deviation_uncertainty, t_limits
from analytics.metrics.registry import Metric, metrics
from analytics.metrics.scale_factor import keep_scale_fits
from analytics.specifications.sql_tables import put_specifications
from analytics.step_records import FOLDER
from analytics.step_records.kept_file import read_kept, write_kept
from analytics.step_records.step_table import Told, step_means
from storage.sql.catalog import Catalog, NotKept
from stream.errors import UnknownUnit
from stream.quantities import conversion, is_angular_rate

_NO_JSON = "NaN|Infinity"
FILE = "unit_metrics.parquet"
# evaluated before the others, which use the tables that it leaves
_FIRST = "scale_factor"
_TOO_LITTLE = "the steps hold too little to compute it"
_UNDEFINED = "what it is divided by is 0, as where the output does not answer to the input, or a number is too large"

COLUMNS = pa.schema(
    [
        ("metric", pa.string()),
        ("unit", pa.string()),
        ("signal", pa.string()),
        ("run", pa.string()),
        ("value", pa.float64()),
        ("unit_of_measure", pa.string()),
        ("lo", pa.float64()),
        ("hi", pa.float64()),
        ("standard_uncertainty", pa.float64()),
        ("freedom", pa.float64()),
        ("n", pa.int64()),
        ("parameters", pa.string()),
        ("runs", pa.list_(pa.string())),
        ("steps", pa.list_(pa.int64())),
        ("standard", pa.string()),
        ("clause", pa.string()),
        ("reason", pa.string()),
    ]
)
_STILL = "create or replace table internal.still_steps as from internal.standing_steps"
# One order of all rows, so that what was kept and what is computed anew make the same table.
_SORTED = """
select * from unit_metrics
order by metric, unit, signal nulls first, run nulls first, parameters nulls first, standard, clause, steps, runs,
  reason
"""
_NO_SCALES = pa.schema(
    [
        *((name, pa.string()) for name in ("unit", "signal", "run", "output_unit")),
        ("value", pa.float64()),
        ("t_to_ns", pa.int64()),
    ]
).empty_table()
# In the kept file's own words: what each unit's rows were computed from.
_PRINTS = b"gyrofleet.units"
# What values depend on as it is written, besides the numbers.
_PACKAGES = ("analytics.metrics", "analytics.metrics.views", "analytics.calibration")


def unit_metrics(catalog: Catalog, told: Told | None = None) -> pa.Table:
    """All metrics of all units of a store.

    Leaves the tables ``step_means``, ``unit_metrics`` and the views of this package in the catalogue.

    Parameters
    ----------
    catalog: Of the store.
    told: Hears how many of how many changed runs have been reduced.

    Returns
    -------
    Table
        `COLUMNS`. Values of units whose records and products have not changed are taken as they were kept; computed
        anew they are the same to the last bit.
    """
    steps = step_means(catalog, told)
    define_views(catalog, steps)
    prints = _unit_fingerprints(steps, _entered(catalog), _products(catalog), _averaging_times(catalog, steps))
    table, known = kept_metrics(catalog.kept)
    fresh = {unit for unit, mark in known.items() if prints.get(unit) == mark}
    stale = sorted(prints.keys() - fresh)
    if catalog.frozen and (stale or len(fresh) < len(known)):
        raise NotKept
    if len(fresh) < len(known):
        table = _of_units(table, fresh)
    if stale:
        if fresh:
            catalog.put("step_means", _of_units(steps, stale))
        # a metric may also look at documents, which are those of all units
        found = _of_units(evaluate(catalog, metrics().values()), stale)
        catalog.put("unit_metrics", pa.concat_tables([table, found]))
        table = catalog.reader(_SORTED).read_all().cast(COLUMNS)
        if fresh:
            catalog.put("step_means", steps)
    if stale or len(fresh) < len(known):
        _keep(catalog, table, prints)
    if fresh:  # else the evaluation has left what is of all units
        keep_scale_fits(catalog)
        catalog.define(_STILL)
    catalog.put("unit_metrics", table)
    return table


def define_views(catalog: Catalog, steps: pa.Table) -> None:
    """Define the tables and views that the metrics stand on."""
    catalog.put("step_means", steps)
    put_specifications(catalog)
    catalog.put("rate_units", _rate_units(steps))
    catalog.put("scale_factors", _NO_SCALES)
    folder = files("analytics.metrics").joinpath("views")
    for script in sorted(folder.iterdir(), key=lambda each: each.name):
        if script.name.endswith(".sql"):
            catalog.define(script.read_text(encoding="utf-8"))


def evaluate(catalog: Catalog, chosen: Iterable[Metric]) -> pa.Table:
    """Compute metrics from the ``step_means`` that are in the catalogue; `COLUMNS`."""
    wanted = {metric.header.id: metric for metric in chosen}
    every = metrics()
    order = [_FIRST, *(each for each in wanted if each != _FIRST)] if _FIRST in every else list(wanted)
    tables = [COLUMNS.empty_table()]
    for each in order:
        table = _values(catalog, every[each])
        if each == _FIRST:
            catalog.define(_STILL)
        if each in wanted:
            tables.append(table)
    return pa.concat_tables(tables)


def _values(catalog: Catalog, metric: Metric) -> pa.Table:
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
    _add_limits(columns, header.limits)
    return pa.table(columns, schema=COLUMNS)


def _found(catalog: Catalog, metric: Metric) -> pa.Table:
    """What a metric's statement or function gives, as it gives it."""
    if metric.sql is not None:
        body = f"select * replace (to_json(parameters)::varchar as parameters) from ({metric.sql})"  # noqa: S608
        return catalog.reader(body).read_all()
    assert metric.compute is not None
    rows = metric.compute(catalog)
    return rows if isinstance(rows, pa.Table) else pa.Table.from_pylist([dict(row) for row in rows], schema=COLUMNS)


def _make_readable(columns: dict[str, pa.Array]) -> None:
    """Take numbers from the parameters that JSON cannot write, which would make every question about them fail."""
    parameters = columns["parameters"]
    unreadable = pc.fill_null(pc.match_substring_regex(parameters, _NO_JSON), False)
    if pc.any(unreadable).as_py():
        mended = [
            json_text(json.loads(text, parse_constant=lambda _: None))
            for text in parameters.filter(unreadable).to_pylist()
        ]
        columns["parameters"] = pc.replace_with_mask(parameters, unreadable, pa.array(mended, pa.string()))


def _add_limits(columns: dict[str, pa.Array], limits: Limits) -> None:
    """Fill in `lo` and `hi`, and the uncertainty of deviations; nothing where there is no value."""
    value, u, freedom, lo, hi = (
        columns[name].to_numpy(zero_copy_only=False)
        for name in ("value", "standard_uncertainty", "freedom", "lo", "hi")
    )
    missing = ~np.isfinite(value)
    why = pc.if_else(columns["value"].is_null(), _TOO_LITTLE, _UNDEFINED)
    columns["reason"] = pc.if_else(pc.and_(pa.array(missing), columns["reason"].is_null()), why, columns["reason"])
    value = np.where(missing, np.nan, value)
    if limits is Limits.T:
        lo, hi = t_limits(value, u, np.nan_to_num(freedom, nan=1e9))
    elif limits is Limits.CHI_SQUARE:
        lo, hi = chi_square_limits(value, np.nan_to_num(freedom, nan=1.0))
        u = np.where(np.isnan(u), deviation_uncertainty(value, np.nan_to_num(freedom, nan=1.0)), u)
    for name, array in (("value", value), ("lo", lo), ("hi", hi), ("standard_uncertainty", u)):
        columns[name] = pa.array(array, pa.float64(), mask=missing | ~np.isfinite(array))
    columns["freedom"] = pa.array(freedom, pa.float64(), mask=~np.isfinite(freedom))


def _of_units(table: pa.Table, units: Collection[str]) -> pa.Table:
    return table.filter(pc.is_in(table["unit"], pa.array(sorted(units), pa.string())))


def _rate_units(steps: pa.Table) -> pa.Table:
    found = {}
    for unit in steps["unit_of_measure"].unique().to_pylist():
        with suppress(UnknownUnit):
            if is_angular_rate(unit):
                found[unit] = conversion(unit, "deg/h")[0]
    return pa.table(
        {"unit_of_measure": pa.array(found.keys(), pa.string()), "deg_per_h": pa.array(found.values(), pa.float64())}
    )


def _entered(catalog: Catalog) -> dict[str, str]:
    """What was entered by hand of each unit, as a hash; it may belong to no run."""
    found = catalog.rows(
        "select unit, bit_xor(hash(uid))::varchar || '/' || count(*) from internal.lake_documents "
        "where kind = 'CheckEntered' group by unit"
    )
    return {str(unit): str(mark) for unit, mark in found}


def _products(catalog: Catalog) -> dict[str, str]:
    """The numbers of each unit's product in its runs, as a hash."""
    found = catalog.rows(
        "select unit, md5(string_agg(to_json(p)::varchar, ';' order by run)) from internal.run_products p group by unit"
    )
    return {str(unit): str(mark) for unit, mark in found}


def _averaging_times(catalog: Catalog, steps: pa.Table) -> dict[str, str]:
    """The averaging times of the Allan deviation that limits name, which are those of every unit's values."""
    found = catalog.rows(
        "select string_agg(distinct key, ';' order by key) from internal.specification_parameters "
        "where metric = 'allan_deviation'"
    )
    return {} if found[0][0] is None else dict.fromkeys(steps["unit"].unique().to_pylist(), str(found[0][0]))


def _unit_fingerprints(steps: pa.Table, *parts: Mapping[str, str]) -> dict[str, str]:
    """What a unit's metrics depend on: its records and `parts` of other things, and how metrics are written."""
    runs: defaultdict[str, set[str]] = defaultdict(set)
    for part in parts:
        for unit, mark in part.items():
            runs[unit].add(mark)
    pairs = steps.select(["unit", "fingerprint"]).group_by(["unit", "fingerprint"]).aggregate([])
    for unit, mark in zip(pairs["unit"].to_pylist(), pairs["fingerprint"].to_pylist(), strict=True):
        runs[unit].add(mark)
    written = _written()
    return {
        unit: hashlib.sha256("/".join([written, *sorted(marks)]).encode()).hexdigest()[:32]
        for unit, marks in runs.items()
    }


def _written() -> str:
    """Hash of the metrics, and of what they stand on, as they are written."""
    found = hashlib.sha256()
    for package in _PACKAGES:
        for each in sorted(files(package).iterdir(), key=lambda e: e.name):
            if each.is_file():
                found.update(each.read_bytes())
    return found.hexdigest()


def kept_metrics(folder: Path) -> tuple[pa.Table, dict[str, str]]:
    """What was kept below a folder, and for each unit what it was computed from."""
    table = read_kept(folder / FOLDER / FILE)
    if table is not None:
        with suppress(pa.ArrowException, ValueError, KeyError, TypeError):  # of another version
            known = dict(json.loads(table.schema.metadata[_PRINTS]))
            return table.replace_schema_metadata(None).cast(COLUMNS), known
    return COLUMNS.empty_table(), {}


def _keep(catalog: Catalog, table: pa.Table, prints: Mapping[str, str]) -> None:
    if not catalog.frozen:
        write_kept(catalog.kept / FOLDER / FILE, table.replace_schema_metadata({_PRINTS: json.dumps(prints)}))


def row_of(row: Mapping[str, Any]) -> dict[str, Any]:
    """A value as `gyrofleet metrics --json` tells it."""
    told = {name: row[name] for name in COLUMNS.names if name != "freedom"}
    return told | {"parameters": json.loads(row["parameters"] or "{}")}
