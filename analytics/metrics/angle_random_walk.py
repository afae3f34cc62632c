"""Angle random walk: from the Allan variance, and by normalised bias stability of a short fast record."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from analytics.methods.confidence_bounds import TWO_SIDED, chi_square_bounds, deviation_uncertainty
from analytics.metric_registry.registry import parameters_text
from storage.sql.catalog import Catalog
from storage.sql.reading import stored_between
from stream.errors import NotFound
from stream.estimators.base import NoEstimate
from stream.estimators.noise.normalised_random_walk import angle_random_walk_normalised

_SHORT = "from internal.random_walk_steps order by unit, signal, run, steps"
_IS_SHORT = "from internal.random_walk_procedures limit 1"


def compute(catalog: Catalog, sql: str) -> pa.Table:
    """Rows of the metric; the normalised method reads the samples of its steps, which are short."""
    table = catalog.table(sql)
    value, freedom = table["value"].to_numpy(), np.nan_to_num(table["freedom"].to_numpy(), nan=1.0)
    lo, hi = chi_square_bounds(value, freedom)
    u = deviation_uncertainty(value, freedom)
    for name, numbers in (("lo", lo), ("hi", hi), ("standard_uncertainty", u)):
        of_step = pa.array(numbers, pa.float64(), mask=np.isnan(numbers))
        column = pc.if_else(pc.is_null(table["freedom"]), table[name], of_step)
        table = table.set_column(table.schema.get_field_index(name), name, column)
    if not catalog.rows(_IS_SHORT):
        return table
    short = [
        row | _normalised(catalog, row) | {"parameters": parameters_text(row["parameters"])}
        for row in catalog.reader(_SHORT).read_all().to_pylist()
    ]
    schema = pa.schema([*table.schema, ("standard", pa.string()), ("clause", pa.string())])
    return pa.concat_tables([table, pa.Table.from_pylist(short, schema=schema)], promote_options="default")


def _normalised(catalog: Catalog, row: Mapping[str, Any]) -> dict[str, Any]:
    if row["reason"] is not None:
        return {}
    which = (row[name] for name in ("unit", "signal", "run", "t_from_ns", "t_to_ns"))
    try:
        times_ns, values = stored_between(catalog, *which, is_checked=True)
    except NotFound as error:
        return {"reason": str(error)}
    slots = np.rint((times_ns - times_ns[0]) / 1e9 / row["sample_interval_s"]).astype(np.int64)
    rates = np.full(int(slots[-1]) + 1, np.nan)
    rates[slots] = values * row["deg_per_h"]
    walk = angle_random_walk_normalised(rates, row["sample_interval_s"])
    if isinstance(walk, NoEstimate):
        return {"reason": walk.reason}
    found = walk.coefficient
    if row["is_no_noise"]:
        return {"value": found.value}
    u = (found.hi - found.lo) / (2 * TWO_SIDED)
    return {"value": found.value, "lo": found.lo, "hi": found.hi, "standard_uncertainty": u}
