"""Resolution: the smallest change of a rate that the output follows."""

from collections.abc import Iterator, Mapping
from typing import Any

from analytics.methods.half_error import within_half_both_ways
from storage.sql.catalog import Catalog

HEADER = """\
-- id:        resolution
-- en:        Resolution
-- zh:        分辨率
-- unit:      deg/h
-- better:    lower
-- grain:     unit, signal, run, repeat
-- parameters: repeat, base_rate_deg_per_h, scale_factor
-- source:    GJB 2426A-2004 5.11 (18); JJF 2014-2022 7.2.10 (18)
-- needs:     procedure resolution: falling increments upon a base rate in both directions
-- limits:    given
-- equation:  the smallest dOmega with |(dFhat - dF)/dFhat| <= 50 % at it and at all larger ones; the larger of + and -
"""

# The base rate of a direction is its smallest one; measured before and after the increments, it is the mean of both.
_SQL = """
with turning as (
  select *, rate_command > 0 as is_forward, mean * deg_per_h as output, standard_uncertainty * abs(deg_per_h) as u,
    abs(rate_command) <= min(abs(rate_command)) over side * (1 + 1e-9) as is_base
  from rate_steps
  where n > 0 and rate_command <> 0 and frequency is null and regexp_matches("procedure", '^resolution|分辨率')
    and coalesce(step, '') <> 'rate'
  window side as (partition by run, unit, signal, repeat, rate_command > 0)
), grouped as (
  select run, unit, signal, repeat, is_forward,
    list_avg(list(output order by "index") filter (is_base)) as base_output,
    list_avg(list(input_rate * 3600 order by "index") filter (is_base)) as base_rate,
    sqrt(list_sum(list(u ** 2 order by "index") filter (is_base))) / count(*) filter (is_base) as u_base,
    coalesce(list({input: input_rate * 3600, output: output, u: u, freedom: coalesce(freedom, 1)} order by "index")
      filter (not is_base), []) as points,
    min(scale_source) as scale_source, min(unit_of_measure) as unit_of_measure, min(product) as product,
    bool_and(deg_per_h is not null) as is_scaled,
    sum(n)::bigint as n, list("index" order by "index") as steps
  from turning group by all
)
select g.run, g.unit, g.signal, g.repeat,
  min(scale_source) as scale_source, min(unit_of_measure) as unit_of_measure, bool_and(is_scaled) as is_scaled,
  min(p.expected_threshold_deg_per_h) as expected_threshold, min(abs(base_rate)) as base_rate,
  flatten(list([
    {is_forward: is_forward, size: abs(p.input - base_rate),
      error: abs((p.input - base_rate) - (p.output - base_output)), u: sqrt(p.u ** 2 + u_base ** 2), freedom: p.freedom}
    for p in points if p.input <> base_rate] order by is_forward)) as compared,
  sum(n)::bigint as n, list_sort(flatten(list(steps order by is_forward))) as steps
from grouped g left join internal.run_products p on p.unit = g.unit and p.run = g.run
group by g.run, g.unit, g.signal, g.repeat order by g.run, g.unit, g.signal, g.repeat
"""

# Clause, and the base rate over the expected threshold: from, to, in the words of the clause.
_BASES = {
    "GJB2426A": ("5.11 (18)", 100.0, float("inf"), "more than 100 times"),
    "JJF2014": ("7.2.10 (18)", 20.0, 50.0, "20 to 50 times"),
}


def compute(catalog: Catalog) -> Iterator[dict[str, Any]]:
    """Rows of the metric, one for each standard: they differ in the base rate, checked where the threshold is known."""
    for row in catalog.reader(_SQL).read_all().to_pylist():
        found = {"reason": f"no scale factor for an output in {row['unit_of_measure']}: measure it before"}
        if row["is_scaled"]:
            found = within_half_both_ways(row["compared"], "increment")
        common = {name: row[name] for name in ("unit", "signal", "run", "n", "steps")}
        parameters = {"repeat": row["repeat"], "base_rate_deg_per_h": row["base_rate"]}
        common["parameters"] = parameters | {"scale_factor": row["scale_source"]}
        for standard, (clause, *_) in _BASES.items():
            yield common | {"standard": standard, "clause": clause} | (_unsuitable(row, standard) or found)


def _unsuitable(row: Mapping[str, Any], standard: str) -> dict[str, Any] | None:
    """Why the base rate is not what the standard asks for."""
    if row["expected_threshold"] is None:
        return None
    _, least, most, words = _BASES[standard]
    ratio = row["base_rate"] / row["expected_threshold"]
    if least * (1 - 1e-3) <= ratio <= most * (1 + 1e-3):
        return None
    threshold = f"the expected threshold of {row['expected_threshold']:g} deg/h"
    return {"reason": f"the base rate is {ratio:.3g} times {threshold}, the clause asks for {words}"}
