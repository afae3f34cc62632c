"""Limits that lie far from all values that a store has kept, as where a unit of measure is mistaken."""

import json
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any

from analytics.evaluation.kept_metrics import kept_metrics
from analytics.metric_registry.magnitudes import as_judged
from analytics.specifications.sql_tables import parameter_key
from storage.specifications.specification import SpecificationLimit
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.errors import UnknownUnit
from stream.quantities import result_factor

_FAR = 300  # deg/s for deg/h is 3600, mdps for dps 1000, and a good value 100 times inside of its limit
_VALUES = """
select distinct m.value, m.unit_of_measure, m.parameters, m.signal, m.standard, u.product
from internal.stored_values m left join units u on u.unit = m.unit and list_contains(m.runs, u.run)
where m.metric = $metric and isfinite(m.value)
"""


def far_limits(store: Store, limits: Sequence[SpecificationLimit]) -> list[str]:
    """A sentence for each limit that all kept values are far inside or far beyond; none is computed for it."""
    with Catalog(store) as catalog:
        kept, _ = kept_metrics(catalog.kept)
        if kept is None:
            return []
        catalog.put_content("stored_values", kept)
        return [each for limit in map(as_judged, limits) for each in _far(limit, _values(catalog, limit))]


def _far(limit: SpecificationLimit, values: Sequence[float]) -> Iterator[str]:
    bound = max(abs(each) for each in (limit.lower, limit.upper) if each is not None)
    least, most, n, unit = min(values, default=0.0), max(values, default=0.0), len(values), limit.unit_of_measure
    if most and bound > _FAR * most:
        how = f"{bound:g} {unit} is {bound / most:,.0f} times the largest of {n} stored values ({most:.4g})"
    elif bound and least > _FAR * bound:
        how = f"the smallest of {n} stored values ({least:.4g}) is {least / bound:,.0f} times {bound:g} {unit}"
    else:
        return
    yield f"warning: {limit.subject}: {how}: check its unit of measure"


def _values(catalog: Catalog, limit: SpecificationLimit) -> list[float]:
    """Magnitudes of the values that a limit judges, in its unit."""
    names, rows = catalog.named_rows(_VALUES, {"metric": limit.metric})
    return [abs(each) for row in rows for each in _in_unit(limit, dict(zip(names, row, strict=True)))]


def _in_unit(limit: SpecificationLimit, row: dict[str, Any]) -> Iterator[float]:
    """The value of a row in the unit of a limit that judges it."""
    stated = json.loads(row["parameters"] or "{}")
    if any(
        name not in stated or parameter_key(stated[name]) != parameter_key(each)
        for name, each in limit.parameters.items()
    ):
        return
    if limit.product not in {None, row["product"]} or limit.signal not in {None, row["signal"]}:
        return
    if limit.standard is None or limit.standard in (row["standard"] or "").split(", "):
        with suppress(UnknownUnit):
            yield row["value"] * result_factor(row["unit_of_measure"], limit.unit_of_measure)
