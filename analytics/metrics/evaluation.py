"""Every metric of every unit: computed from the step records, kept, and brought up to date for units that changed."""

import hashlib
import os
from collections import defaultdict
from collections.abc import Iterable, Mapping
from contextlib import suppress
from importlib.resources import files
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from analytics.metrics.header import Limits
from analytics.metrics.limits_of_value import chi_square_limits, deviation_uncertainty, t_limits
from analytics.metrics.product_files import products_of
from analytics.metrics.registry import Metric, metrics
from analytics.metrics.scale_factor import keep_scale_fits
from analytics.step_records.step_table import FOLDER, Told, step_means
from storage.catalog import Catalog
from stream.errors import UnknownUnit
from stream.quantities import conversion, is_angular_rate

_FILE = "unit_metrics.parquet"
# evaluated before the others, which use the tables that it leaves
_FIRST = "scale_factor"

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


def unit_metrics(catalog: Catalog, told: Told | None = None) -> pa.Table:
    """All metrics of all units of a store.

    Leaves the tables ``step_means``, ``unit_metrics`` and the views of this package in the catalogue.

    Parameters
    ----------
    catalog : Catalog
        Of the store.
    told : callable, optional
        Hears how many of how many changed runs have been reduced.

    Returns
    -------
    Table
        `COLUMNS`. Values of units whose records and products have not changed are taken as they were kept; computed
        anew they are the same to the last bit.
    """
    steps = step_means(catalog, told)
    products = products_of(catalog.store)
    prints = _unit_fingerprints(steps, products.fingerprint, _entered(catalog))
    kept = _kept(catalog)
    fresh: set[str] = set()
    if kept is not None:
        known = dict(zip(kept["unit"].to_pylist(), kept["fingerprint"].to_pylist(), strict=True))
        fresh = {unit for unit, mark in known.items() if prints.get(unit) == mark}
    stale = sorted(set(prints) - fresh)
    define_views(catalog, steps, products.scales)
    tables = [] if kept is None else [kept.filter(pa.compute.is_in(kept["unit"], pa.array(sorted(fresh), pa.string())))]
    if stale:
        changed = steps.filter(pa.compute.is_in(steps["unit"], pa.array(stale, pa.string())))
        catalog.put("step_means", changed)
        found = evaluate(catalog, metrics().values())
        # a metric may also look at documents, which are those of all units
        found = found.filter(pa.compute.is_in(found["unit"], pa.array(stale, pa.string())))
        marks = pa.array([prints[unit] for unit in found["unit"].to_pylist()], pa.string())
        tables.append(found.append_column("fingerprint", marks))
        catalog.put("step_means", steps)
    order = [(name, "ascending") for name in ("metric", "unit", "signal", "run", "parameters", "standard")]
    empty = COLUMNS.append(pa.field("fingerprint", pa.string())).empty_table()
    table = pa.concat_tables([*tables, empty]).sort_by(order).combine_chunks()
    if stale or kept is None or len(fresh) != len(set(kept["unit"].to_pylist())):
        _keep(catalog, table)
    keep_scale_fits(catalog)
    table = table.drop_columns(["fingerprint"])
    catalog.put("unit_metrics", table)
    return table


def define_views(catalog: Catalog, steps: pa.Table, product_scales: pa.Table) -> None:
    """Define the tables and views that the metrics stand on."""
    catalog.put("step_means", steps)
    catalog.put("product_scales", product_scales)
    catalog.put("rate_units", _rate_units(steps))
    empty = {name: pa.array([], pa.string()) for name in ("unit", "signal", "run")}
    none = pa.table(empty | {"value": pa.array([], pa.float64()), "t_to_ns": pa.array([], pa.int64())})
    catalog.put("scale_factors", none)
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
        if each in wanted:
            tables.append(table)
    return pa.concat_tables(tables)


def _values(catalog: Catalog, metric: Metric) -> pa.Table:
    if metric.sql is not None:
        body = f"select * replace (to_json(parameters)::varchar as parameters) from ({metric.sql})"  # noqa: S608
        rows: list[dict[str, Any]] = catalog.reader(body).read_all().to_pylist()
    else:
        assert metric.compute is not None
        rows = [dict(row) for row in metric.compute(catalog)]
    header = metric.header
    columns: dict[str, list[Any]] = {name: [row.get(name) for row in rows] for name in COLUMNS.names}
    columns["metric"] = [header.id] * len(rows)
    columns["unit_of_measure"] = [row.get("unit_of_measure") or header.unit for row in rows]
    columns["standard"] = [row.get("standard") or header.standard for row in rows]
    columns["clause"] = [row.get("clause") or header.clause for row in rows]
    _add_limits(columns, header.limits)
    return pa.table(columns, schema=COLUMNS)


def _add_limits(columns: dict[str, list[Any]], limits: Limits) -> None:
    """Fill in `lo` and `hi`, and the uncertainty of deviations; nothing where there is no value."""
    value, u, freedom = (
        np.array([np.nan if each is None else each for each in columns[name]], np.float64)
        for name in ("value", "standard_uncertainty", "freedom")
    )
    missing = np.isnan(value)
    for at in np.flatnonzero(missing & np.array([reason is None for reason in columns["reason"]], bool)):
        columns["reason"][at] = "the steps hold too little to compute it"
    columns["value"] = [None if gone else each for gone, each in zip(missing, columns["value"], strict=True)]
    if limits is Limits.T:
        lo, hi = t_limits(value, u, np.nan_to_num(freedom, nan=1e9))
    elif limits is Limits.CHI_SQUARE:
        lo, hi = chi_square_limits(value, np.nan_to_num(freedom, nan=1.0))
        u = np.where(np.isnan(u), deviation_uncertainty(value, np.nan_to_num(freedom, nan=1.0)), u)
    else:
        lo, hi = (
            np.array([np.nan if each is None else each for each in columns[name]], np.float64) for name in ("lo", "hi")
        )
    for name, array in (("lo", lo), ("hi", hi), ("standard_uncertainty", u)):
        gone = missing | np.isnan(array)
        columns[name] = [None if absent else float(each) for absent, each in zip(gone, array, strict=True)]


def _rate_units(steps: pa.Table) -> pa.Table:
    found = {}
    for unit in steps["unit_of_measure"].unique().to_pylist():
        with suppress(UnknownUnit):
            if is_angular_rate(unit):
                found[unit] = conversion(unit, "deg/h")[0]
    return pa.table(
        {
            "unit_of_measure": pa.array(found.keys(), pa.string()),
            "deg_per_h": pa.array(found.values(), pa.float64()),
        }
    )


def _entered(catalog: Catalog) -> dict[str, str]:
    """What was entered by hand of each unit, as a hash; it may belong to no run."""
    found = catalog.rows(
        "select unit, bit_xor(hash(uid))::varchar || '/' || count(*) from lake_documents "
        "where kind = 'CheckEntered' group by unit"
    )
    return {str(unit): str(mark) for unit, mark in found}


def _unit_fingerprints(steps: pa.Table, products: str, entered: Mapping[str, str]) -> dict[str, str]:
    """What a unit's metrics depend on: its records and checks, the products' numbers, how metrics are written."""
    runs: defaultdict[str, set[str]] = defaultdict(set)
    for unit, mark in entered.items():
        runs[unit].add(mark)
    for unit, mark in zip(steps["unit"].to_pylist(), steps["fingerprint"].to_pylist(), strict=True):
        runs[unit].add(mark)
    written = _written()
    return {
        unit: hashlib.sha256("/".join([written, products, *sorted(marks)]).encode()).hexdigest()[:32]
        for unit, marks in runs.items()
    }


def _written() -> str:
    """Hash of the metrics and views as they are written."""
    parts = []
    here = files("analytics.metrics")
    for folder in (here, here.joinpath("views"), files("analytics.calibration")):
        parts += [each.read_bytes() for each in sorted(folder.iterdir(), key=lambda e: e.name) if each.is_file()]
    return hashlib.sha256(b"".join(parts)).hexdigest()


def _kept(catalog: Catalog) -> pa.Table | None:
    try:
        return pq.read_table(catalog.store.folder / FOLDER / _FILE)
    except (OSError, pa.ArrowException):  # it is derived: what is missing or damaged is made anew
        return None


def _keep(catalog: Catalog, table: pa.Table) -> None:
    folder = catalog.store.folder / FOLDER
    with suppress(OSError):
        folder.mkdir(exist_ok=True)
        fresh = folder / f"{_FILE}.{os.getpid()}.part"
        try:
            pq.write_table(table, fresh, compression="zstd")
            fresh.replace(folder / _FILE)
        finally:
            fresh.unlink(missing_ok=True)


def row_of(row: Mapping[str, Any]) -> dict[str, Any]:
    """A value as `gyrofleet metrics --json` tells it."""
    import json

    told = {name: row[name] for name in COLUMNS.names if name != "freedom"}
    return told | {"parameters": json.loads(row["parameters"] or "{}")}
