"""Values of metrics, computed from the step records that are in the catalogue."""

import json
from collections.abc import Collection, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from importlib.resources import files
from pkgutil import resolve_name
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from analytics.evaluation.type_b import COVERAGE, UNCERTAINTIES, TypeB
from analytics.methods.confidence_bounds import chi_square_bounds, deviation_uncertainty, t_bounds
from analytics.metric_registry.failed_metrics import OF_THE_COMPUTER, failed_rows, failure
from analytics.metric_registry.registry import BoundsSource, Metric, parameters_text
from analytics.specifications.sql_tables import SPECIFICATION_TABLES, put_specifications
from storage.sql.catalog import Catalog, NotKept
from storage.sql.deferred import words_of
from storage.sql.parquet_content import ParquetContent
from stream.decoding import decode_json
from stream.errors import GyrofleetError, QueryError
from stream.quantities import conversion, is_angular_rate

_TOO_LITTLE = "the steps hold too little to compute it"
_WITH_TEXT = "select * replace (to_json(parameters)::varchar as parameters) from ({})"
_CONTRADICTS = "its interval does not contain the value: the definition of the metric is wrong"
_UNDEFINED = "no finite number: a division by 0, as where the output does not answer to the input, or one too large"

_TEXTS, _NUMBERS = ("metric", "unit", "signal", "run"), ("lo", "hi", "standard_uncertainty", "freedom")
_TEXT, _REAL = pa.string(), pa.float64()
COLUMNS = pa.schema({
    **dict.fromkeys(_TEXTS, _TEXT), "value": _REAL, "unit_of_measure": _TEXT, **dict.fromkeys(_NUMBERS, _REAL),
    **dict.fromkeys(UNCERTAINTIES, _REAL), "uncertainty_reason": _TEXT,
    "n": pa.int64(), "parameters": _TEXT, "runs": pa.list_(_TEXT), "steps": pa.list_(pa.int64()),
    "standard": _TEXT, "clause": _TEXT, "reason": _TEXT,
})  # fmt: skip
# Metrics that are computed at the same time: their statements are planned by one thread each.
_MOST_THREADS = 2
# Scripts of tables that many metrics use.
_OF_RATES = ("11_rate_points.sql", "13_scale_fits.sql", "14_measured_scale_factors.sql", "56_range_sets.sql")
_OF_RESTS = ("30_static_steps.sql", "31_bias_steps.sql", "45_noise_coefficients.sql")
_RATE_POINT = "select 1 from internal.rate_points limit 1"
_WITHOUT_RATES = ("scale_fits", "scale_factors")
# What metrics ask of all units, also where they are computed for a part of them.
_OF_RECORDS = """
create or replace table internal.units_of_runs as select distinct run, unit, "procedure" from internal.step_records;
create or replace table internal.procedures_of_steps as select distinct "procedure" from internal.units_of_runs;
"""


def define_views(
    catalog: Catalog, steps: pa.Table | ParquetContent, of_store: Mapping[str, pa.Table] | None = None
) -> None:
    """Put the records of steps, and define the tables and views that metrics use.

    Where `steps` are those of some units, `of_store` has the tables of the whole store, see `tables_of_store`.
    """
    if isinstance(steps, ParquetContent):
        catalog.put_content("step_records", steps)
    else:
        catalog.put("step_records", steps, is_large=True)
    choose_steps(catalog)
    catalog.define(_OF_RECORDS)
    if of_store is None:
        put_specifications(catalog)
    for name, table in (of_store or {}).items():
        catalog.put(name, table)
    catalog.put("rate_units", _rate_units(catalog))
    define_scripts(catalog, "views")


def tables_of_store(catalog: Catalog) -> dict[str, pa.Table]:
    """Tables that metrics of some units need, and that are of all units; by name."""
    return {name: catalog.stored(name) for name in (*SPECIFICATION_TABLES, "units_of_runs", "procedures_of_steps")}


def choose_steps(catalog: Catalog, units: Collection[str] = ()) -> None:
    """Let ``step_means`` have the records of these units, of all if none is given."""
    catalog.put("chosen_units", pa.table({"unit": pa.array(sorted(units), pa.string())}))
    where = ""
    if units:  # the range, by which most of the others are not even read
        lower, upper = (each.replace("'", "''") for each in (min(units), max(units)))
        where = f" where unit between '{lower}' and '{upper}' and unit in (from internal.chosen_units)"
    catalog.define(f"create or replace view step_means as from internal.step_records{where}")


def choose_records(catalog: Catalog, records: pa.Table) -> None:
    """Let ``step_means`` have these records of some units."""
    catalog.put("chosen_records", records)
    catalog.define("create or replace view step_means as from internal.chosen_records")


def define_scripts(catalog: Catalog, folder: str, names: Collection[str] = ()) -> None:
    """Define what the SQL scripts of a folder of this package define, or some of them, in the order of their names."""
    scripts = files("analytics.evaluation").joinpath(folder).iterdir()
    for script in sorted(scripts, key=lambda each: each.name):
        if script.name.endswith(".sql") and (not names or script.name in names):
            catalog.defer(script.read_text(encoding="utf-8"))


def evaluate(catalog: Catalog, chosen: Iterable[Metric]) -> pa.Table:
    """Compute metrics from the ``step_means`` that are in the catalogue, several at once; `COLUMNS`."""
    keep_scale_factors(catalog)
    with ThreadPoolExecutor(min(catalog.threads, _MOST_THREADS)) as pool:
        able, failed = _with_rows(catalog, list(chosen), pool)
        type_b = TypeB(catalog) if able else None
        tables = list(pool.map(lambda metric: _values_or_reasons(catalog, metric, type_b), able))
    return pa.concat_tables([COLUMNS.empty_table(), *tables, *failed])


def _with_rows(catalog: Catalog, chosen: list[Metric], pool: ThreadPoolExecutor) -> tuple[list[Metric], list[pa.Table]]:
    """Those with rows in what their header names, as planning takes longest; and reasons of those that fail there."""
    sources = sorted({metric.header.of for metric in chosen} - {""})

    def found_in(some: Collection[str]) -> dict[str, bool]:
        sql = ", ".join(f"exists (from {source}) as s{number}" for number, source in enumerate(some))
        return dict(zip(some, catalog.rows(f"select {sql}")[0], strict=True)) if some else {}

    found: dict[str, bool] = {}
    failed: dict[str, pa.Table] = {}
    try:
        for each in pool.map(found_in, [sources[at::_MOST_THREADS] for at in range(_MOST_THREADS)]):
            found |= each
    except QueryError:
        for metric in chosen:  # whose it is
            try:
                with _naming(metric):
                    found |= found_in({metric.header.of} - {""})
            except QueryError as error:
                failed[metric.header.id] = failed_rows(catalog, metric, error, COLUMNS)
        if not failed:
            raise
    able = [each for each in chosen if each.header.id not in failed and found.get(each.header.of, True)]
    return able, list(failed.values())


def keep_scale_factors(catalog: Catalog) -> None:
    """Make the tables that many metrics use of the chosen steps: of lines through rates, and of steps at rest."""
    # planning takes longer than all else of a small store, and is done in each range of units: what stands on a table
    # is planned sooner
    define_scripts(catalog, "views", _OF_RATES)
    catalog.hold("internal.rate_points")
    if catalog.rows(_RATE_POINT):
        catalog.hold("internal.scale_sets")
    else:
        for name in _WITHOUT_RATES:
            folder = files("analytics.evaluation").joinpath("without_rates")
            catalog.create(name, folder.joinpath(f"{name}.sql").read_text(encoding="utf-8"))
    define_scripts(catalog, "views", _OF_RESTS)
    catalog.fill((*_WITHOUT_RATES, "still_steps", "bias_steps"))


def _values_or_reasons(catalog: Catalog, metric: Metric, type_b: TypeB | None) -> pa.Table:
    try:
        return _values(catalog, metric, type_b)
    except QueryError as error:
        return failed_rows(catalog, metric, error, COLUMNS)


def _values(catalog: Catalog, metric: Metric, type_b: TypeB | None) -> pa.Table:
    found, columns = columns_of(catalog, metric)
    if type_b is not None:
        with _naming(metric):
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
    """Rows of a metric as `_computed` has them; an error of its own statement or function names it."""
    try:
        with _naming(metric):
            return _computed(catalog, metric)
    except (QueryError, NotKept, MemoryError, OSError, *OF_THE_COMPUTER):
        raise
    except (Exception, SystemExit) as error:
        if isinstance(error, GyrofleetError) and not metric.own_file:
            raise
        raise failure(metric, f"{type(error).__name__}: {error}") from error


@contextmanager
def _naming(metric: Metric) -> Iterator[None]:
    """Let an error of a statement name the metric of which it is."""
    try:
        yield
    except QueryError as error:
        raise failure(metric, str(error).partition(" (views: ")[0]) from error


def _computed(catalog: Catalog, metric: Metric) -> pa.Table:
    """Rows of a metric's statement or function, before the columns that all metrics share are filled in."""
    if not metric.header.python:
        found = catalog.table(_WITH_TEXT.format(metric.sql))
        _check_columns(metric, found.column_names)
        return found
    rows = resolve_name(metric.header.python)(catalog, metric.sql)
    if isinstance(rows, pa.Table):
        return rows
    found = [{"runs": [row["run"]], **row, "parameters": _parameters_of(row)} for row in rows]
    # numbers beside the columns that say how a standard's error enters
    named = words_of(" ".join(each.sensitivity for each in metric.header.influences))
    beside = sorted(named.intersection(*(row.keys() for row in found[:1])) - set(COLUMNS.names))
    return pa.Table.from_pylist(found, schema=pa.schema([*COLUMNS, *((name, pa.float64()) for name in beside)]))


def _parameters_of(row: Mapping[str, Any]) -> str:
    """Parameters of a function's row, which are a mapping; as JSON text they are taken as well."""
    given = row.get("parameters", {})
    if isinstance(given, str):
        given = json.loads(given)
    if not isinstance(given, Mapping):
        raise QueryError(f"`parameters` of a row are {given!r}, expected a mapping such as {{'duration_s': 60}}")
    return parameters_text(given)


def _check_columns(metric: Metric, names: Collection[str]) -> None:
    """QueryError where a statement gives a column that nothing reads, as by a slip of the pen, or lacks its bounds."""
    beside = words_of(" ".join(each.sensitivity for each in metric.header.influences))
    if unknown := sorted(set(names) - set(COLUMNS.names) - beside):
        known = ", ".join(name for name in COLUMNS.names if name != "metric")
        raise QueryError(f"nothing reads its column {unknown[0]!r}: there are {known}, and what `influence` names")
    lacking = {"lo", "hi"} - set(names) if metric.header.limits is BoundsSource.GIVEN else set()
    if lacking:
        raise QueryError(f"it has `limits: given`, and no column {' and '.join(sorted(lacking))}")


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
        lo, hi = chi_square_bounds(value, freedom)  # nothing where nobody knows the degrees of freedom
        u = np.where(np.isnan(u), deviation_uncertainty(value, freedom), u)
    # a statement that gives its own bounds can be wrong; what is judged by them would be too
    margin = 1e-9 * np.abs(value)
    wrong = ~missing & ((lo > value + margin) | (hi < value - margin))
    if wrong.any():
        columns["reason"] = pc.if_else(pa.array(wrong), _CONTRADICTS, columns["reason"])
        missing = missing | wrong
    for name, array in (("value", value), ("lo", lo), ("hi", hi), ("standard_uncertainty", u)):
        columns[name] = pa.array(array, pa.float64(), mask=missing | ~np.isfinite(array))
    columns["freedom"] = pa.array(freedom, pa.float64(), mask=~np.isfinite(freedom))


def of_units(table: pa.Table, units: Collection[str]) -> pa.Table:
    """Rows of some units."""
    within = pc.is_in(table["unit"], pa.array(sorted(units), pa.string()))
    return table if pc.all(within, min_count=0).as_py() else table.filter(within)


def _rate_units(catalog: Catalog) -> pa.Table:
    found = {}
    for (unit,) in catalog.rows("select distinct unit_of_measure from internal.step_records order by all"):
        if is_angular_rate(unit):
            found[unit] = conversion(unit, "deg/h")[0]
    units, factors = pa.array(found.keys(), pa.string()), pa.array(found.values(), pa.float64())
    return pa.table({"unit_of_measure": units, "deg_per_h": factors})


def row_of(row: Mapping[str, Any]) -> dict[str, Any]:
    """A value as in `gyrofleet metrics --json`."""
    found = {name: row[name] for name in COLUMNS.names if name != "freedom"}
    p = None if row["U"] is None else COVERAGE
    return found | {"p": p, "parameters": decode_json(row["parameters"] or "{}")}
