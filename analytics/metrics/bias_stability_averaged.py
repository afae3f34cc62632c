"""Bias stability over averages: of 1, 10 and 100 s, and of the product's own averaging time."""

import numpy as np
import pyarrow as pa

from analytics.step_records.scatter import scatter_of_averages
from analytics.step_records.series_statistics import AVERAGES_S, LEAST_SHARE
from storage.sql.catalog import Catalog

_ASKED = """
select s.run, s.unit, s.signal, s."index", s.t_from_ns, s.t_to_ns, p.average_s
from internal.bias_steps s join internal.run_products p on p.unit = s.unit and p.run = s.run
where s.lack is null and p.average_s is not null and not list_contains($usual, p.average_s)
order by s.unit, s.signal, s.run, s."index"
"""

# The stored means are combined into means over the product's averaging time, on the grid of the source's clock.
_MEANS = """
with mean as (
  select w.which, b.t_ns // w.average_ns as number, sum(b.n) as n,
    any_value(w.average_ns / s.sample_interval_s / 1e9) as whole,
    sum(b.n * b.mean order by b.t_ns) / sum(b.n) as value
  from internal.averages_wanted w
  join signals s on s.run = w.run and s.unit = w.unit and s.signal = w.signal
  join {source} b on b.run = w.run and b.unit = w.unit and b.signal = w.signal
    and b.t_ns // w.average_ns * w.average_ns >= w.t_from_ns
    and (b.t_ns // w.average_ns + 1) * w.average_ns <= w.t_to_ns + s.sample_interval_s * 1e9
  where w.base_ns = {base_ns}
  group by w.which, number
)
select which, list(number order by number) as numbers, list(value order by number) as means
from mean where whole >= 1 and n >= {share} * whole
group by which order by which
"""
_AVERAGES = pa.schema(
    [(name, pa.string()) for name in ("unit", "signal", "run")]
    + [("index", pa.int64()), ("average_s", pa.float64()), ("n", pa.int64())]
    + [(name, pa.float64()) for name in ("sd", "freedom")]
)
_SAMPLES = "(select run, unit, signal, t_ns, 1 as n, value as mean from internal.samples_in($paths))"
_SOURCES = {10 * 10**9: "internal.rollup_10s_in($paths)", 10**9: "internal.rollup_1s_in($paths)", 1: _SAMPLES}


def compute(catalog: Catalog, sql: str) -> pa.Table:
    """Rows of the metric; correlation of neighbouring averages lowers the degrees of freedom below N/P - 1."""
    catalog.put("product_averages", _products_averages(catalog))
    return catalog.table(sql)


def _products_averages(catalog: Catalog) -> pa.Table:
    """Averages over the product's averaging time: how many, their deviation, its degrees of freedom."""
    steps = catalog.reader(_ASKED, {"usual": list(AVERAGES_S)}).read_all().to_pylist()
    for which, step in enumerate(steps):
        average_ns = round(step["average_s"] * 1e9)
        base_ns = next(base for base in _SOURCES if average_ns % base == 0)
        step |= {"which": which, "average_ns": average_ns, "base_ns": base_ns, "average_s": average_ns / 1e9, "n": 0}
    if steps:
        catalog.put("averages_wanted", pa.Table.from_pylist(steps))
    for base_ns in sorted({step["base_ns"] for step in steps}):
        sql = _MEANS.format(source=_SOURCES[base_ns], base_ns=base_ns, share=LEAST_SHARE)
        runs = {step["run"] for step in steps if step["base_ns"] == base_ns}
        paths = catalog.checked_paths_of(runs, sql)
        for row in catalog.table(sql, parameters={"paths": paths}).to_pylist():
            found = scatter_of_averages(np.array(row["numbers"], np.int64), np.array(row["means"], np.float64))
            steps[row["which"]] |= found._asdict() if found.n > 1 else {"n": found.n}
    return pa.Table.from_pylist(steps, schema=_AVERAGES)
