"""Limits that lie far from all values that a store has kept, as where a unit of measure is mistaken."""

import json
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

from analytics.metric_registry.magnitudes import as_judged
from analytics.specifications.sql_tables import parameter_key
from storage.specifications.specification import SpecificationLimit
from storage.sql.catalog import Catalog
from storage.sql.parquet_content import ParquetContent
from stream.errors import UnknownUnit
from stream.quantities import result_factor

_FAR = 300  # a good value may be 100 times inside of its limit
# milli, per hour for per second, arc seconds per radian, parts per million; and how far from these factors a limit may
# be that good values are within
_MISTAKES, _NEAR = (1e3, 3600.0, 206_265.0, 1e6), 3.0
_LEAST_VALUES, _LEAST_UNITS = 5, 3  # that a limit lies far beyond, so that they are no single very good unit
_VALUES = """
select distinct m.value, m.unit, m.unit_of_measure, m.parameters, m.signal, m.standard, u.product
from internal.stored_values m left join units u on u.unit = m.unit and list_contains(m.runs, u.run)
where m.metric = $metric and isfinite(m.value)
"""


class Kept(NamedTuple):
    """A stored value: its magnitude in the unit of a limit, itself with its own unit, and whose it is."""

    size: float
    text: str
    serial: str


def far_limits(catalog: Catalog, kept: ParquetContent, limits: Sequence[SpecificationLimit]) -> list[str]:
    """A sentence for each limit that all kept values of metrics are far inside or far beyond."""
    catalog.put_content("stored_values", kept)
    return [each for limit in map(as_judged, limits) for each in doubts(limit, _values(catalog, limit))]


def doubts(limit: SpecificationLimit, values: Sequence[Kept]) -> Iterator[str]:
    """A sentence where all values are far inside or far beyond of a limit."""
    bound = max((each for each in (limit.upper, limit.lower) if each is not None), key=abs)
    unit, size = limit.unit_of_measure, abs(bound)
    least, most = min(values, default=None), max(values, default=None)
    if most and most.size and size > _FAR * most.size and _is_mistake(size / most.size) and _are_enough(values):
        how = f"{size / most.size:,.0f} times the largest of {len(values)} stored values ({most.text})"
        yield f"warning: {limit.subject}: {bound:g} {unit} is {how}: check its unit of measure"
    elif least and size and least.size > _FAR * size:
        how = f"the smallest of {len(values)} stored values ({least.text}) is {least.size / size:,.0f} times"
        yield f"warning: {limit.subject}: {how} {bound:g} {unit}: check its unit of measure"


def _is_mistake(factor: float) -> bool:
    """Whether a limit so far from values that are good may be one in another unit."""
    return any(each / _NEAR <= factor <= each * _NEAR for each in _MISTAKES)


def _are_enough(values: Sequence[Kept]) -> bool:
    """Whether so many values are not those of a unit that is better than asked for."""
    return len(values) >= _LEAST_VALUES and len({each.serial for each in values}) >= _LEAST_UNITS


def _values(catalog: Catalog, limit: SpecificationLimit) -> list[Kept]:
    """Magnitudes of the values that a limit judges, in its unit."""
    names, rows = catalog.named_rows(_VALUES, {"metric": limit.metric})
    return [each for row in rows for each in _in_unit(limit, dict(zip(names, row, strict=True)))]


def _in_unit(limit: SpecificationLimit, row: dict[str, Any]) -> Iterator[Kept]:
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
            size = abs(row["value"]) * result_factor(row["unit_of_measure"], limit.unit_of_measure)
            yield Kept(size, f"{row['value']:.4g} {row['unit_of_measure']}", row["unit"])
