"""Scale-factor repeatability: all together, from run to run, from day to day, and its components of variance."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from analytics.methods.repeatability import KINDS, Scatter, deviation_of, scatter
from storage.sql.catalog import Catalog

HEADER = """\
-- id:        scale_factor_repeatability
-- en:        Scale-factor repeatability
-- zh:        标度因数重复性
-- unit:      ppm
-- better:    lower
-- grain:     unit, signal, run (or all runs of the unit, then no run is named), kind
-- parameters: kind, scale_factors, mean, days
-- source:    GJB 2426A-2004 5.8.4 (12); JJF 2014-2022 7.2.4 (10)
-- needs:     Q scale factors, the unit off and cooled in between; GJB: Q >= 6
-- limits:    given
-- equation:  K_r = sqrt(sum((K_i - mean(K))^2)/(Q - 1))/mean(K)
"""

_CLAUSES = {"GJB2426A": "5.8.4 (12)", "JJF2014": "7.2.4 (10)"}
# GJB asks for 6 measurements, JJF 2014 leaves Q open
_LEAST = {"GJB2426A": 6, "JJF2014": 2}

# A run is a test by itself if its procedure is one or it holds several scale factors; all runs of a unit together are
# another. Left out are those that were measured under several conditions on purpose.
_SQL = """
with conditioned as (
  select *,
    count(distinct coalesce(temperature_command, 1e9)) over test as temperatures,
    count(distinct coalesce(position, '')) over test as positions,
    case when date_known then strftime(timezone(time_zone, make_timestamptz(t_from_ns // 1000)), '%Y-%m-%d') end as day
  from scale_results('internal.scale_fits')
  where standard <> 'JJF1536' and phase is null and axis is null
    and not regexp_matches(coalesce("procedure", ''), '^(scale_factor_(temp|acc|shock|vib)|threshold|resolution)')
  window test as (partition by run, unit, signal, "procedure", standard)
), counted as (
  select *,
    count(*) over own as in_run,
    bool_or(starts_with("procedure", 'scale_factor_repeatability')) over own as is_test
  from conditioned where temperatures = 1 and positions = 1
  window own as (partition by unit, signal, output_unit, standard, run)
), scoped as (
  select *, run as scope from counted where is_test or in_run > 1
  union all
  select *, null as scope from counted
)
select unit, signal, scope as run, standard,
  list(k order by t_from_ns, run, steps) filter (lack is null) as scales,
  list(coalesce(day, 'run ' || run) order by t_from_ns, run, steps) filter (lack is null) as days,
  bool_and(day is not null) as is_dated,
  list(distinct run order by run) as runs,
  flatten(list(steps order by run, t_from_ns, steps)) as steps,
  min('run ' || run || ': ' || lack) as lack
from scoped
group by unit, signal, output_unit, scope, standard
having scope is not null or count(distinct run) > 1
order by unit, signal, output_unit, scope, standard
"""


def compute(catalog: Catalog) -> Iterator[dict[str, Any]]:
    """Rows of the metric: a row for each kind and standard.

    The kinds are those of the bias repeatability, of the relative scale factors K_i/mean(K). ``run_to_run`` is the
    deviation within a day, pooled over days; ``day_to_day`` that of the means of days. The uncertainty of the K_i is
    not subtracted: most of it is nonlinearity, which is the same in all.
    """
    for row in catalog.reader(_SQL).read_all().to_pylist():
        scales, days = row["scales"] or [], row["days"] or []
        mean = sum(scales) / len(scales) if scales else 1.0
        found = scatter([each / mean * 1e6 for each in scales] if mean else [], days if mean else [])
        parameters = {"scale_factors": len(scales), "mean": mean if scales else None}
        parameters["days"] = len(set(days)) if row["is_dated"] else None
        common = {name: row[name] for name in ("unit", "signal", "run", "standard", "runs", "steps")}
        common |= {"n": len(scales), "clause": _CLAUSES[row["standard"]]}
        for kind in KINDS:
            yield common | {"parameters": {"kind": kind} | parameters} | _value(row, found, kind)


def _lack_of_repeats(days: Sequence[str], kind: str, least: int, *, is_dated: bool) -> str | None:
    """Why there are too few measurements of this kind: from day to day days count, from run to run those of one day."""
    if not is_dated or least <= 2:
        return None
    if kind == "day_to_day" and 1 < len(set(days)) < least:
        return f"scale factors of {len(set(days))} days, {least} or more are asked for"
    repeated = sum(1 for day in days if days.count(day) > 1)
    if kind == "run_to_run" and 0 < repeated < least:
        return f"{repeated} scale factors on days with more than one, {least} or more are asked for"
    return None


def _value(row: Mapping[str, Any], found: Scatter, kind: str) -> dict[str, Any]:
    """Value with its limits, or the reason why there is none."""
    least = _LEAST[row["standard"]]
    if row["scales"] and not found.values:
        return {"reason": "the mean of the scale factors is 0: the output does not answer to the rate"}
    if found.values < least:
        short = f"{found.values} scale factors measured, {least} or more are asked for"
        return {"reason": short if row["lack"] is None else f"{short}; {row['lack']}"}
    if (lack := _lack_of_repeats(row["days"] or [], kind, least, is_dated=row["is_dated"])) is not None:
        return {"reason": lack}
    return deviation_of(found, kind, "scale factors", is_dated=row["is_dated"])
