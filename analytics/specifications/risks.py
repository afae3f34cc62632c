"""Consumer's and producer's risk over a lot, by the rules that its values were judged with (JCGM 106:2012 9)."""

import math
from collections import defaultdict
from typing import Any

import numpy as np

from analytics.specifications.verdicts import rows_of
from analytics.uncertainty.conformity import Interval, global_risks
from storage.sql.catalog import Catalog

LEAST_UNITS = 20  # from which a process has a mean and a deviation
_VALUES = """
select lot, metric, subject, specification, revision, decision_rule, unit, value, standard_uncertainty as u, guard,
  lower, upper
from verdicts where conformity is not null and verdict <> 'NO_DATA'
"""
_KEY = ("lot", "metric", "subject", "specification", "revision", "decision_rule")


def lot_risks(catalog: Catalog) -> list[dict[str, Any]]:
    """Rows of ``conformity_risks`` with the global risks of the lot's process beside those of its own values.

    `process_consumer_risk` and `process_producer_risk` take the true values of the lot as normal, with the scatter of
    its values less the uncertainty of measurement; they are None where the lot has too few units or no such scatter.
    """
    values: defaultdict[tuple[Any, ...], list[dict[str, Any]]] = defaultdict(list)
    for row in rows_of(catalog, _VALUES):
        values[tuple(row[name] for name in _KEY)].append(row)
    rows = rows_of(catalog, "select * from conformity_risks order by all")
    return [row | _of_process(values[tuple(row[name] for name in _KEY)]) for row in rows]


def _of_process(members: list[dict[str, Any]]) -> dict[str, float | None]:
    unknown: dict[str, float | None] = {"process_consumer_risk": None, "process_producer_risk": None}
    if len({row["unit"] for row in members}) < LEAST_UNITS:
        return unknown
    found = np.array([(row["value"], row["u"], row["guard"] or 0.0) for row in members], dtype=np.float64)
    u, guard = math.sqrt(float(np.mean(found[:, 1] ** 2))), float(np.mean(found[:, 2]))
    spread = float(np.var(found[:, 0], ddof=1)) - u**2
    lower, upper = members[0]["lower"], members[0]["upper"]
    if spread <= 0 or u == 0:
        return unknown
    tolerance = Interval(lower, upper)
    acceptance = Interval(None if lower is None else lower + guard, None if upper is None else upper - guard)
    risks = global_risks(float(np.mean(found[:, 0])), math.sqrt(spread), u, tolerance, acceptance)
    return {"process_consumer_risk": risks.consumer, "process_producer_risk": risks.producer}
