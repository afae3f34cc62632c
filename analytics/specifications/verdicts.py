"""Verdicts of a store's units, by the specifications that were valid when they were measured."""

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, get_args

from analytics.metric_registry.registry import alike
from storage.sql.catalog import Catalog
from stream.errors import NotFound

Row = dict[str, Any]
GroupKind = Literal["all", "product", "lot", "station", "fixture", "day", "week", "month"]
GROUP_KINDS: tuple[GroupKind, ...] = get_args(GroupKind)
UNGIVEN = "(not given)"  # name of the lot, station or other place of what has none; filters take it
UNGIVEN_ZH = "（未给出）"


class Group(NamedTuple):
    """What was measured of a product, in a lot, at a place, in a time, of some units; empty asks for all."""

    product: str = ""
    lot: str = ""
    station: str = ""
    fixture: str = ""
    day: str = ""  # as 2026-03-29
    week: str = ""  # ISO week, as 2026-W13
    month: str = ""  # as 2026-03
    run: str = ""
    units: tuple[str, ...] = ()
    since_ns: int | None = None
    since_day: str = ""  # of the station, as 2026-03-29

    def part(self, kind: GroupKind, name: str) -> "Group":
        """A lot, a station or another part of the group; all of it without a name."""
        parts: dict[str, Any] = {} if kind == "all" or not name else {kind: name}
        return self._replace(**parts)

    @property
    def parameters(self) -> dict[str, Any]:
        """The values that `GROUP_ARGUMENTS` names."""
        return self._asdict() | {"units": list(self.units)}


EVERYTHING = Group()
# arguments of the macros `internal.verdicts_in`, `internal.unlimited_in` and `internal.yield_in`
GROUP_ARGUMENTS = ", ".join(
    f"{name if name == 'since_ns' else f'of_{name}'} := ${name}{'::varchar[]' * (name == 'units')}"
    for name in Group._fields
)


class Verdicts(NamedTuple):
    """Verdicts of units, as rows of the tables of the catalogue."""

    units: list[Row]  # ``unit_verdicts``: one row for each unit, its worst verdict
    verdicts: list[Row]  # each value against its limit
    pareto: list[Row]  # ``failure_pareto``: what units fail by; of the whole store
    warnings: list[Row]  # ``unit_warnings``: units that probably have two names

    def has(self, verdict: str) -> bool:
        """Whether a unit has that verdict."""
        return any(row["verdict"] == verdict for row in self.units)


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


_YIELD = f"""
select * exclude (kind) from internal.yield_in({GROUP_ARGUMENTS}) where kind = $kind order by name nulls last
"""  # noqa: S608  our own statement
_FAILURES = f"""
with each_limit as (
  select unit, metric, subject,
    verdict_of_rank(coalesce(min(verdict_rank(verdict)) filter (verdict <> 'NO_DATA'), 3)) as verdict
  from internal.verdicts_in({GROUP_ARGUMENTS}) group by unit, signal, metric, subject, standard, specification
), counted as (
  select metric, subject, count(distinct unit) filter (verdict = 'FAIL') as failed,
    count(distinct unit) filter (verdict = 'MARGINAL') as marginal,
    count(distinct unit) filter (verdict <> 'NO_DATA') as judged
  from each_limit group by metric, subject
)
select row_number() over worst as place, c.metric, c.subject, coalesce(n.en, c.metric) as en,
  coalesce(n.zh, c.metric) as zh,
  c.failed, c.marginal, c.judged, c.failed / sum(c.failed) over () as share,
  sum(c.failed) over worst / sum(c.failed) over () as cumulative_share
from counted c left join metric_names n using (metric)
where c.failed > 0
window worst as (order by c.failed desc, c.marginal desc, c.metric, c.subject rows unbounded preceding)
order by place
"""  # noqa: S608  our own statement


def yield_by(catalog: Catalog, kind: GroupKind, group: Group = EVERYTHING) -> list[Row]:
    """Yield of each product, lot, station, fixture, day, week or month in a group, with its 95 % interval."""
    return rows_of(catalog, _YIELD, group.parameters | {"kind": kind})


def failures_in(catalog: Catalog, group: Group) -> list[Row]:
    """The table ``failure_pareto`` of a group, in which units are judged by what was measured there."""
    return rows_of(catalog, _FAILURES, group.parameters)


def rows_of(catalog: Catalog, sql: str, parameters: object = None) -> list[Row]:
    """Rows of a statement, as dictionaries."""
    names, rows = catalog.named_rows(sql, parameters)
    return [dict(zip(names, row, strict=True)) for row in rows]
