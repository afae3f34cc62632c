"""Bias stability over averages: of 1, 10 and 100 s, and of the product's own averaging time."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pyarrow as pa

from analytics.metrics.largest_magnitude import json_text
from analytics.metrics.product_files import products_of
from analytics.step_records.series_statistics import AVERAGES_S, LEAST_SHARE, bartlett_freedom
from storage.catalog import Catalog
from stream.batch import FloatArray, IntArray

HEADER = """\
-- id:        bias_stability_averaged
-- en:        Bias stability (standard deviation of averages)
-- zh:        零偏稳定性(平均)
-- unit:      deg/h
-- better:    lower
-- grain:     unit, signal, run, step, averaging time
-- source:    JJF 2014-2022 7.2.14 (29)
-- needs:     a static step (procedure static_bias or bias_repeatability), at least one hour long
-- limits:    chi_square
-- equation:  Bs = sqrt(sum((F_i - mean(F))^2)/(N/P - 1))/K, F_i means over P seconds
"""

_SQL = """
select unit, signal, run, "index", t_from_ns, t_to_ns, duration_s, product, position, repeat, scale_source, lack,
  abs(deg_per_h) as deg_per_h, n as samples,
  [n_1s, n_10s, n_100s] as n, [sd_1s, sd_10s, sd_100s] as sd, [freedom_1s, freedom_10s, freedom_100s] as freedom
from bias_steps
order by unit, signal, run, "index"
"""

# Means of what the store keeps make up means over the product's time, on the grid of the source's clock.
_MEANS = """
with mean as (
  select w.which, b.t_ns // w.average_ns as number, sum(b.n) as n,
    any_value(w.average_ns / s.sample_interval_s / 1e9) as whole,
    sum(b.n * b.mean order by b.t_ns) / sum(b.n) as value
  from averages_wanted w
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
_SAMPLES = "(select run, unit, signal, t_ns, 1 as n, value as mean from samples)"
_SOURCES = {10 * 10**9: "rollup_10s", 10**9: "rollup_1s", 1: _SAMPLES}

_Found = tuple[float, int, float | None, float | None]


def compute(catalog: Catalog) -> Iterator[dict[str, Any]]:
    """Rows of the metric; degrees of freedom are fewer than N/P - 1 as far as neighbouring averages correlate."""
    steps = catalog.reader(_SQL).read_all().to_pylist()
    own = _products_averages(catalog, steps)
    for which, step in enumerate(steps):
        found = list(zip(AVERAGES_S, step["n"], step["sd"], step["freedom"], strict=True))
        for average_s, n, sd, freedom in [*found, *own.get(which, ())]:
            parameters = {"average_s": average_s} | {name: step[name] for name in ("position", "repeat")}
            row = {name: step[name] for name in ("unit", "signal", "run")} | {
                "runs": [step["run"]],
                "steps": [step["index"]],
                "n": n or 0,
                "parameters": json_text(parameters | {"scale_factor": step["scale_source"]}),
            }
            reason = step["lack"]
            if reason is None and sd is None:
                reason = f"{n or 0} averages of {average_s:g} s in the record, at least 2 are needed"
            if reason is None:
                yield row | {"value": sd * step["deg_per_h"], "freedom": freedom}
            else:
                yield row | {"reason": reason}


def _products_averages(catalog: Catalog, steps: list[dict[str, Any]]) -> dict[int, list[_Found]]:
    """By step: time, number, deviation and its degrees of freedom of the averages that its product asks for."""
    asked = {name: each.average_s for name, each in products_of(catalog.store).by_name.items()}
    wanted = [
        {**{name: step[name] for name in ("run", "unit", "signal", "t_from_ns", "t_to_ns")}, "which": which}
        | {"average_ns": average_ns, "base_ns": next(base for base in _SOURCES if average_ns % base == 0)}
        for which, step in enumerate(steps)
        if step["lack"] is None and (average_ns := round((asked.get(step["product"]) or 0.0) * 1e9)) > 0
        if average_ns / 1e9 not in AVERAGES_S
    ]
    if not wanted:
        return {}
    catalog.put("averages_wanted", pa.Table.from_pylist(wanted))
    found: dict[int, list[_Found]] = {row["which"]: [(row["average_ns"] / 1e9, 0, None, None)] for row in wanted}
    for base_ns in {row["base_ns"] for row in wanted}:
        sql = _MEANS.format(source=_SOURCES[base_ns], base_ns=base_ns, share=LEAST_SHARE)
        for row in catalog.reader(sql).read_all().to_pylist():
            average_s = found[row["which"]][0][0]
            scatter = _scatter(np.array(row["numbers"], np.int64), np.array(row["means"], np.float64))
            found[row["which"]] = [(average_s, len(row["means"]), *scatter)]
    return found


def _scatter(numbers: IntArray, means: FloatArray) -> tuple[float | None, float | None]:
    """Standard deviation of averages and its degrees of freedom."""
    if len(means) < 2:
        return None, None
    centred = means - means.mean()
    next_to = np.diff(numbers) == 1
    total = float(centred @ centred)
    correlation = float(centred[:-1][next_to] @ centred[1:][next_to]) / total if total > 0 else 0.0
    return float(np.sqrt(total / (len(means) - 1))), bartlett_freedom(len(means), correlation)
