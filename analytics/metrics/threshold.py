"""Threshold by the three methods: on the rate table, on the indexing head, and in one slow turn."""

from collections.abc import Iterator, Mapping
from typing import Any

from analytics.methods.half_error import turns, within_half_both_ways
from storage.sql.catalog import Catalog

HEADER = """\
-- id:        threshold
-- en:        Threshold
-- zh:        阈值
-- unit:      deg/h
-- better:    lower
-- grain:     unit, signal, run, method, repeat
-- parameters: method, repeat, scale_factor
-- source:    GJB 2426A-2004 5.10 (14)-(17); JJF 2014-2022 7.2.9 (16)(17)
-- needs:     procedure threshold (rates in both directions and at rest), threshold_indexing_head or threshold_slow_turn
-- limits:    given
-- equation:  the smallest Omega with |(K Omega - F)/(K Omega)| <= 50 % at it and all larger ones; the larger of + and -
"""

# F is the output less that at rest (JJF 2014 7.2.9.2). On the indexing head no position is without input: there the
# mean of directions that are opposite to each other is the zero.
_SQL = """
with small as (
  select *,
    mean * deg_per_h as output, standard_uncertainty * abs(deg_per_h) as u,
    try_cast(regexp_extract(position, '^(-?[0-9.]+) ?deg$', 1) as double) as angle_deg,
    case when angle_deg is not null and coalesce(rate_command, 0) = 0 then 'indexing_head' else 'rate_table' end
      as method,
    case method when 'rate_table' then input_rate * 3600
      else round(cos(radians(angle_deg)), 12) * cos(radians(latitude_deg)) * earth_rate_deg_per_h() end as input
  from rate_steps
  where n > 0 and frequency is null and regexp_matches("procedure", '^threshold|阈值')
    and not regexp_matches("procedure", 'slow_turn') and coalesce(step, '') not in ('rest_before', 'rate', 'rest_after')
    and (rate_command is not null or regexp_matches(position, '^-?[0-9.]+ ?deg$'))
), opposed as (
  select *,
    case method when 'rate_table' then rate_command = 0
      else count(*) filter ((angle_deg + 720) % 360 < 180) over line
        = count(*) filter ((angle_deg + 720) % 360 >= 180) over line end as is_zero
  from small
  window line as (partition by run, unit, signal, repeat, method, round((angle_deg + 720) % 180, 6))
), grouped as (
  select run, unit, signal, repeat, method,
    list_avg(list(output order by "index") filter (is_zero)) as zero,
    sqrt(list_sum(list(u ** 2 order by "index") filter (is_zero))) / count(*) filter (is_zero) as u_zero,
    list({input: input, output: output, u: u, freedom: coalesce(freedom, 1)} order by "index")
      filter (abs(input) > 0) as points,
    min(scale_source) as scale_source, min(unit_of_measure) as unit_of_measure,
    bool_and(deg_per_h is not null) as is_scaled, bool_and(latitude_deg is not null) as is_placed,
    sum(n)::bigint as n, list("index" order by "index") as steps
  from opposed group by all
)
select *, [
    {is_forward: p.input > 0, size: abs(p.input), error: abs(p.input - (p.output - zero)),
      u: sqrt(p.u ** 2 + u_zero ** 2), freedom: p.freedom}
    for p in points] as compared
from grouped order by run, unit, signal, repeat, method
"""

_CLAUSES = {"indexing_head": "5.10.4.2 (16)", "slow_turn": "5.10.4.3 (17)"}


def compute(catalog: Catalog) -> Iterator[dict[str, Any]]:
    """Rows of the metric.

    ``parameters.method`` is ``rate_table`` (GJB method 1, JJF 2014), ``indexing_head`` (2) or ``slow_turn`` (3).

    Erratum: GJB (15) divides by the output F; meant is the theoretical output K Omega, as JJF 2014 (17) has it: else an
    output of 0 would be no error at all.
    """
    for row in catalog.reader(_SQL).read_all().to_pylist():
        yield _row(row, row["method"], _value(row))
    for turn in turns(catalog):
        yield _row(turn, "slow_turn", turn["found"])


def _row(row: Mapping[str, Any], method: str, found: dict[str, Any]) -> dict[str, Any]:
    parameters = {"method": method, "repeat": row["repeat"], "scale_factor": row["scale_source"]}
    common = {name: row[name] for name in ("unit", "signal", "run", "n", "steps")} | {"parameters": parameters}
    if method in _CLAUSES:
        common |= {"standard": "GJB2426A", "clause": _CLAUSES[method]}
    return common | found


def _value(row: Mapping[str, Any]) -> dict[str, Any]:
    if not row["is_scaled"]:
        return {"reason": f"no scale factor for an output in {row['unit_of_measure']}: measure it before"}
    if row["method"] == "indexing_head" and not row["is_placed"]:
        return {"reason": "no latitude, so the Earth's rate on the axis is unknown: give the station's latitude_deg"}
    if row["zero"] is None:
        missing = "opposite directions" if row["method"] == "indexing_head" else "the table at rest"
        return {"reason": f"no record of {missing}: the output less its zero is compared with the line"}
    return within_half_both_ways(row["compared"] or [], "rate")
