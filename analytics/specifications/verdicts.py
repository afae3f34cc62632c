"""Verdicts of a store's units, by the specifications that were valid when they were measured."""

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

from analytics.metric_registry.registry import alike
from storage.sql.catalog import Catalog
from stream.errors import NotFound

Row = dict[str, Any]
Group = Literal["lot", "station", "fixture", "day"]


class Verdicts(NamedTuple):
    """Verdicts of units, as rows of the tables of the catalogue."""

    units: list[Row]  # ``unit_verdicts``: one row for each unit, its worst verdict
    verdicts: list[Row]  # each value against its limit
    pareto: list[Row]  # ``failure_pareto``: what units fail by; of the whole store
    warnings: list[Row]  # ``unit_warnings``: units that probably have two names

    @property
    def has_failure(self) -> bool:
        """Whether a unit fails."""
        return any(row["verdict"] == "FAIL" for row in self.units)


def verdicts_of(catalog: Catalog, units: Sequence[str] = (), *, with_values: bool = True) -> Verdicts:
    """Verdicts of these units, or of all; `with_values` asks for each value too, of which a fleet has many.

    Raises NotFound if the store does not have one of them; BadInput if a specification in the store is not right.
    """
    known = rows_of(catalog, "select * from unit_verdicts")
    names = [row["unit"] for row in known]
    for unit in units:
        if unit not in names:
            raise NotFound(f"nothing was measured of unit {unit!r}; {alike(unit, names, 'units are')}")
    asked = set(units) if units else set(names)
    values = values_of(catalog, sorted(asked)) if with_values else []
    warnings = [row for row in rows_of(catalog, "select * from unit_warnings") if not units or row["unit"] in asked]
    pareto = rows_of(catalog, "select * from failure_pareto")
    return Verdicts([row for row in known if row["unit"] in asked], values, pareto, warnings)


def values_of(catalog: Catalog, units: Sequence[str]) -> list[Row]:
    """Each value of these units with its verdict."""
    sql = (
        "select * replace (day::varchar as day) from verdicts where unit in (select unnest($units)) "
        "order by unit, metric, signal, t_ns, run, subject, standard, parameters"
    )
    return rows_of(catalog, sql, {"units": list(units)})


def yield_by(catalog: Catalog, group: Group) -> list[Row]:
    """Yield of each lot, station, fixture or day, with its 95 % interval."""
    return rows_of(catalog, "select * exclude (kind) from yield_by where kind = $kind", {"kind": group})


def rows_of(catalog: Catalog, sql: str, parameters: object = None) -> list[Row]:
    """Rows of a statement, as dictionaries."""
    return [row for batch in catalog.batches(sql, parameters) for row in batch.to_pylist()]
