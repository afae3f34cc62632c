"""Uncertainty budgets of a unit's measured values: type A of the value, type B of the station's standards."""

import json
import math
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from analytics.evaluation.evaluation import COLUMNS, choose_steps, columns_of, define_scripts, keep_scale_factors
from analytics.evaluation.kept_metrics import unit_metrics
from analytics.evaluation.type_b import COVERAGE, NO_SENSITIVITY, NO_TYPE_A, TypeB, scale_run_of
from analytics.metric_registry.registry import MetricHeader, alike, metrics
from analytics.uncertainty.budget import Budget, Expanded, Unknown
from analytics.uncertainty.component import Component
from analytics.uncertainty.monte_carlo import Propagated
from analytics.uncertainty.rounding import round_with
from analytics.uncertainty.station_standards import component
from ingest.measurement_standards import QUANTITIES
from storage.sql.catalog import Catalog
from stream.errors import NotFound

_SCATTER = ("scatter of the measurement", "测量重复性")


class ValueBudget(NamedTuple):
    """The budget of one measured value, with what the value is."""

    budget: Budget
    signal: str | None
    run: str | None
    runs: tuple[str, ...]
    standard: str
    clause: str
    parameters: dict[str, Any]

    def expand(self, k: float | None = None, p: float | None = None) -> Expanded | None:
        """Expanded uncertainty, by default that of 95.45 %; None where components are unknown."""
        if self.budget.unknown:
            return None
        return self.budget.expand(k=k, p=COVERAGE if k is None and p is None else p)


def value_budgets(catalog: Catalog, unit: str, metric: str, run: str | None = None) -> list[ValueBudget]:
    """Budgets of the values of a unit's metric, the oldest run first; only those of a run if it is named.

    Raises NotFound if there is no such value; the message has the reasons why.
    """
    header = metrics()[metric].header
    unit_metrics(catalog, catalog.progress, [metric])
    choose_steps(catalog, [unit])
    keep_scale_factors(catalog)
    found, columns = columns_of(catalog, metrics()[metric])
    type_b = TypeB(catalog)
    sensitivities = type_b.sensitivities(header, found, columns) if found.num_rows else []
    choose_steps(catalog)
    define_scripts(catalog, "views")
    rows = [
        (
            row,
            {each.quantity: float(of_rows[at]) for each, of_rows in zip(header.influences, sensitivities, strict=True)},
        )
        for at, row in enumerate(pa.table(columns, schema=COLUMNS).to_pylist())
        if row["unit"] == unit and (run is None or run in {row["run"], *(row["runs"] or [])})
    ]
    begun = dict(catalog.rows("select run, t_ns from internal.run_standards"))
    rows.sort(key=lambda each: (begun.get(each[0]["run"]) or 0, each[0]["run"] or ""))
    budgets = [_budget(header, row, parts, type_b) for row, parts in rows if row["value"] is not None]
    if not budgets and not rows:
        known = sorted({name for (name,) in catalog.rows("select distinct unit from unit_runs")})
        if unit not in known:
            raise NotFound(f"no completed step is of unit {unit!r}; {alike(unit, known, 'units are')}")
    if not budgets:
        reasons = "; ".join(dict.fromkeys(row["reason"] for row, _ in rows if row["reason"]))
        where = f"run {run}, " if run is not None else ""
        raise NotFound(f"unit {unit}, {where}{metric}: there is no value: {reasons or f'it needs {header.needs}'}")
    return budgets


def _budget(header: MetricHeader, row: dict[str, Any], parts: dict[str, float], type_b: TypeB) -> ValueBudget:
    unit = row["unit_of_measure"]
    components: list[Component] = []
    unknown: list[Unknown] = []
    u, freedom = row["standard_uncertainty"], row["freedom"]
    if u is None:
        unknown.append(Unknown(*_SCATTER, NO_TYPE_A))
    else:
        degrees = math.inf if freedom is None else freedom
        components.append(Component.type_a(*_SCATTER, u, degrees, unit, source=f"run {row['run'] or row['runs']}"))
    if header.no_influence:
        unknown.append(Unknown("type B", "B类", header.no_influence))
    runs = tuple(row["runs"] or [])
    parameters: dict[str, Any] = json.loads(row["parameters"] or "{}")
    own, scale_run = [row["run"]] if row["run"] is not None else list(runs), scale_run_of(parameters)
    for name, sensitivity in parts.items():
        stated, quantity = type_b.stated(own, scale_run, name), QUANTITIES[name]
        if np.isnan(sensitivity):
            unknown.append(Unknown(quantity.en, quantity.zh, f"type B unknown: {NO_SENSITIVITY}"))
        elif stated.reason and sensitivity:
            unknown.append(Unknown(quantity.en, quantity.zh, f"type B unknown: {stated.reason}"))
        elif not stated.reason:
            components.append(component(name, stated, sensitivity, unit))
    sources = (row["standard"] and f"{row['standard']} {row['clause']}", "JJF 1059.1-2012", "JCGM 100:2008")
    budget = Budget(
        en=header.en, zh=header.zh, value=row["value"], unit=unit, components=tuple(components),
        unknown=tuple(unknown), sources=tuple(filter(None, sources)),
    )  # fmt: skip
    return ValueBudget(budget, row["signal"], row["run"], runs, row["standard"], row["clause"], parameters)


def budget_document(found: ValueBudget, expanded: Expanded | None, checked: Propagated | None = None) -> dict[str, Any]:
    """A budget for programs; `nu` is null where the degrees of freedom are infinite."""
    budget = found.budget
    u_a, u_b = budget.standard_uncertainty("A"), budget.standard_uncertainty("B")
    is_known = not budget.unknown
    value_text, expanded_text = round_with(budget.value, expanded.expanded) if expanded else (None, None)
    return {
        "signal": found.signal, "run": found.run, "runs": list(found.runs), "standard": found.standard,
        "clause": found.clause, "parameters": found.parameters, "value": budget.value, "unit_of_measure": budget.unit,
        "components": [
            {
                "name": each.en, "name_zh": each.zh, "type": each.evaluation, "distribution": each.distribution.value,
                "stated": each.stated, "divisor": each.divisor, "u": each.u, "unit": each.unit,
                "sensitivity": each.sensitivity, "sensitivity_unit": each.sensitivity_unit,
                "contribution": each.contribution, "nu": _finite(each.freedom), "group": each.group or None,
                "source": each.source,
            }
            for each in budget.components
        ],
        "correlations": [each._asdict() for each in budget.correlations],
        "unknown": [each._asdict() for each in budget.unknown],
        "u_type_a": u_a if any(each.evaluation == "A" for each in budget.components) else None,
        "u_type_b": u_b if is_known else None,
        "u": expanded.u if expanded else None, "nu": _finite(expanded.freedom) if expanded else None,
        "k": expanded.k if expanded else None, "p": expanded.p if expanded else None,
        "U": expanded.expanded if expanded else None, "U_rounded": expanded.rounded if expanded else None,
        "value_text": value_text, "U_text": expanded_text, "method": expanded.method if expanded else None,
        "reason": "; ".join(f"{each.en}: {each.reason}" for each in budget.unknown) or None,
        "monte_carlo": None if checked is None or expanded is None else {
            "method": "JCGM 101", "u": checked.u, "lo": budget.value + checked.lo, "hi": budget.value + checked.hi,
            "p": checked.p, "trials": checked.trials, "is_stable": checked.is_stable,
            "confirms_first_order": checked.confirms(expanded),
        },
        "sources": list(budget.sources),
    }  # fmt: skip


def _finite(freedom: float) -> float | None:
    return freedom if math.isfinite(freedom) else None
