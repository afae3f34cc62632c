"""Bias repeatability over power-ons: all together, from run to run, from day to day, and its components of variance."""

from collections.abc import Iterator, Mapping
from typing import Any

from analytics.metrics.largest_magnitude import json_text
from analytics.metrics.variance_components import Scatter, between, deviation, scatter
from storage.catalog import Catalog

HEADER = """\
-- id:        bias_repeatability
-- en:        Bias repeatability
-- zh:        零偏重复性
-- unit:      deg/h
-- better:    lower
-- grain:     unit, signal, run (or all runs of the unit, then no run is named), kind
-- source:    GJB 2426A-2004 5.12.3 (21); JJF 2014-2022 7.2.15 (30)
-- needs:     static steps in several power-ons (procedure bias_repeatability, or several runs of static_bias)
-- limits:    given
-- equation:  Br = sqrt(sum((B0_i - mean(B0))^2)/(Q - 1)) over Q power-ons
"""

LEAST_GJB = 6
KINDS = ("all", "run_to_run", "day_to_day", "within_day_component", "between_day_component")

# A run is a test if its procedure is one or it has several power-ons; all runs of a unit together are another test.
_SQL = """
with told as (
  select *,
    count(*) over (partition by unit, signal, position, run) as in_run,
    bool_or(is_repeated) over (partition by unit, signal, position, run) as is_test
  from bias_power_ons
), scoped as (
  select *, run as scope from told where is_test or in_run > 1
  union all
  select *, null as scope from told
)
select unit, signal, position, scope as run,
  list(bias order by t_from_ns, run, power_on) as biases,
  list(coalesce(day::varchar, 'run ' || run) order by t_from_ns, run, power_on) as days,
  bool_and(day is not null) as is_dated,
  list(distinct run order by run) as runs,
  flatten(list(steps order by run, t_from_ns, power_on)) as steps
from scoped
group by unit, signal, position, scope
having scope is not null or count(distinct run) > 1
order by unit, signal, position, scope
"""


def compute(catalog: Catalog) -> Iterator[dict[str, Any]]:
    """Rows of the metric.

    Notes
    -----
    ``run_to_run`` is the deviation within a day, pooled over days; ``day_to_day`` that of the means of days, in which
    the scatter within the days is also. ``between_day_component`` is what is left of it without that, and
    ``within_day_component`` is the run-to-run deviation again, as the other part of the analysis of variance. A day is
    one of the station's time zone. GJB 2426A asks for 6 power-ons (days), JJF 2014 names no number.
    """
    for row in catalog.reader(_SQL).read_all().to_pylist():
        found = scatter(row["biases"], row["days"])
        repeated = sum(1 for day in row["days"] if row["days"].count(day) > 1)
        compared = {"run_to_run": repeated, "within_day_component": repeated, "all": found.values}
        for kind in KINDS:
            n = compared.get(kind, found.groups)
            yield from _standards(row, kind, n, _value(found, kind, is_dated=row["is_dated"]))


def _value(found: Scatter, kind: str, *, is_dated: bool) -> dict[str, Any]:
    """Value with its limits, or the reason why there is none."""
    if found.values < 2:
        return {"reason": f"1 power-on measured, at least 2 are needed, {LEAST_GJB} by GJB 2426A"}
    of_days = kind in {"day_to_day", "between_day_component"} or (kind != "all" and not found.within_freedom)
    if of_days and not is_dated:
        return {"reason": "the date is unknown, so the day is: import with the moment of the start"}
    if kind == "all":
        return deviation(found.square, found.values - 1)._asdict()
    if kind != "day_to_day" and not found.within_freedom:
        return {"reason": f"each of the {found.values} power-ons is of another day, 2 of one day are needed"}
    if kind in {"run_to_run", "within_day_component"}:
        return deviation(found.within, found.within_freedom)._asdict()
    if found.groups < 2:
        return {"reason": f"all {found.values} power-ons are of one day, 2 days are needed"}
    if kind == "day_to_day":
        return deviation(found.of_means, found.groups - 1)._asdict()
    return between(found)._asdict()


def _standards(row: Mapping[str, Any], kind: str, n: int, value: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """The row, or one for each standard where only one of them is content with the number of power-ons."""
    parameters = {"kind": kind, "position": row["position"], "power_ons": len(row["biases"])}
    told = {name: row[name] for name in ("unit", "signal", "run", "runs", "steps")}
    told |= {"n": n, "parameters": json_text(parameters | {"days": len(set(row["days"])) if row["is_dated"] else None})}
    if "component" in kind or n >= LEAST_GJB or "reason" in value:
        yield told | value
        return
    what = "days" if kind == "day_to_day" else "power-ons"
    yield told | {
        "reason": f"{n} {what} measured, the clause asks for {LEAST_GJB} or more",
        "standard": "GJB2426A",
        "clause": "5.12.3 (21)",
    }
    yield told | value | {"standard": "JJF2014", "clause": "7.2.15 (30)"}
