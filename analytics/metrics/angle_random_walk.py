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

HEADER = """\
-- id:        angle_random_walk
-- en:        Angle random walk
-- zh:        角度随机游走系数
-- unit:      deg/sqrt(h)
-- better:    lower
-- grain:     unit, signal, run, step, method
-- parameters: method, duration_s, record, sample_interval_s, remark
-- source:    GJB 2426A-2004 5.12.5.4 (23)-(31); JJF 2014-2022 7.2.20 (34)-(39)
-- needs:     a static step, one hour long as a rule; for the normalised method one of procedure random_walk
-- limits:    given
-- equation:  RWC = sqrt(A_-1), sigma^2(tau) = sum A_m tau^m; normalised RWC = Bs(1 s) sqrt(1 s)
"""

# The fit of the whole run's Allan curve, else the white part of the step's own curve, whose bounds are added below.
_ALLAN = """
select s.unit, s.signal, s.run, s.n, [s.run] as runs, [s."index"] as steps,
  case when s.lack is null then
    case when c.run is not null then c.value else sqrt(nullif(s.white, 0)) * abs(s.deg_per_h) / 60 end end as value,
  c.lo, c.hi, c.standard_uncertainty,
  -- the shortest averaging times determine white noise; long steps are reduced from means of 1 s
  case when c.run is null then greatest(case when s.n > 20000 then s.duration_s else s.n end / 1.5, 1) end as freedom,
  to_json({
    method: 'allan', duration_s: round(s.duration_s), record: case when c.run is not null then 'run' else 'step' end,
    remark: s.remark
  })::varchar as parameters,
  case when s.lack is not null then s.lack when c.run is not null then c.reason when coalesce(s.white, 0) = 0 then
    'the record shows no angle random walk: other noise covers it at every averaging time' end as reason
from internal.bias_steps s
left join internal.noise_coefficients c
  on c.run = s.run and c.unit = s.unit and c.signal = s.signal and c."index" = s."index"
  and c.coefficient = 'angle_random_walk' and (c.value is not null or s.white is null)
order by s.unit, s.signal, s.run, s."index"
"""

_SHORT = """
select s.unit, s.signal, s.run, s."index", s.n, s.duration_s, s.t_from_ns, s.t_to_ns, abs(s.deg_per_h) as deg_per_h,
  s.unit_of_measure, g.sample_interval_s, g.irregular
from internal.still_steps s join signals g on g.run = s.run and g.unit = s.unit and g.signal = s.signal
where regexp_matches(s."procedure", '^random_walk|随机游走')
order by s.unit, s.signal, s.run, s."index"
"""


def compute(catalog: Catalog) -> pa.Table:
    """Rows of the metric; the normalised method reads the samples of its steps, which are short."""
    table = catalog.reader(_ALLAN).read_all()
    value, freedom = table["value"].to_numpy(), np.nan_to_num(table["freedom"].to_numpy(), nan=1.0)
    lo, hi = chi_square_bounds(value, freedom)
    u = deviation_uncertainty(value, freedom)
    for name, numbers in (("lo", lo), ("hi", hi), ("standard_uncertainty", u)):
        of_step = pa.array(numbers, pa.float64(), mask=np.isnan(numbers))
        column = pc.if_else(pc.is_null(table["freedom"]), table[name], of_step)
        table = table.set_column(table.schema.get_field_index(name), name, column)
    clause = {"standard": "GJB2426A", "clause": "5.12.5.4.1 (23)(24)"}
    short = [_described(row) | clause | _short(catalog, row) for row in catalog.reader(_SHORT).read_all().to_pylist()]
    schema = pa.schema([*table.schema, *((name, pa.string()) for name in clause)])
    return pa.concat_tables([table, pa.Table.from_pylist(short, schema=schema)], promote_options="default")


def _described(row: Mapping[str, Any]) -> dict[str, Any]:
    described = {name: row[name] for name in ("unit", "signal", "run", "n")}
    parameters = {"method": "normalised", "duration_s": round(row["duration_s"])}
    parameters |= {"sample_interval_s": row["sample_interval_s"]}
    return described | {"runs": [row["run"]], "steps": [row["index"]], "parameters": parameters_text(parameters)}


def _short(catalog: Catalog, row: Mapping[str, Any]) -> dict[str, Any]:
    if row["n"] == 0:
        return {"reason": "no sample in the evaluated part of the step"}
    if row["deg_per_h"] is None:
        how = "measure it or give the nominal one of the product"
        return {"reason": f"no scale factor for an output in {row['unit_of_measure']}: {how}"}
    if row["irregular"]:
        return {"reason": "the samples lie on no grid, and means over 1 s of the normalised method need one"}
    try:
        which, window = (row["unit"], row["signal"], row["run"]), (row["t_from_ns"], row["t_to_ns"])
        times_ns, values = stored_between(catalog, *which, *window)
    except NotFound as error:
        return {"reason": str(error)}
    slots = np.rint((times_ns - times_ns[0]) / 1e9 / row["sample_interval_s"]).astype(np.int64)
    rates = np.full(int(slots[-1]) + 1, np.nan)
    rates[slots] = values * row["deg_per_h"]
    walk = angle_random_walk_normalised(rates, row["sample_interval_s"])
    if isinstance(walk, NoEstimate):
        return {"reason": walk.reason}
    found = walk.coefficient
    u = (found.hi - found.lo) / (2 * TWO_SIDED)
    return {"value": found.value, "lo": found.lo, "hi": found.hi, "standard_uncertainty": u}
