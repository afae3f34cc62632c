"""Which metrics are asked for: by unit, lot, run, metric, standard and time; and what has gone by a wrong name."""

import re
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from analytics.evaluation.evaluation import row_of
from analytics.metrics.names import alike, check_metrics
from analytics.metrics.registry import metrics
from ingest.moment import moment_ns
from storage.sql.catalog import Catalog
from stream.errors import BadInput, NotFound

Row = dict[str, Any]

_FEW_UNITS = 5
_YEAR = re.compile(r"[-—]\d{4}$")


class Selection(NamedTuple):
    """What is asked for; an empty part asks for all.

    Parameters
    ----------
    units, lots, runs, metrics, standards: Names.
    since_ns: Only what rests on a run that was begun at this moment or later.
    """

    units: tuple[str, ...] = ()
    lots: tuple[str, ...] = ()
    runs: tuple[str, ...] = ()
    metrics: tuple[str, ...] = ()
    standards: tuple[str, ...] = ()
    since_ns: int | None = None


def selected(catalog: Catalog, asked: Selection) -> list[Row]:
    """Values and reasons that are asked for, as `gyrofleet metrics --json` tells them.

    Raises
    ------
    NotFound: If a unit, lot or run is not in the store; the message names what looks alike.
    BadInput: If there is no such metric or standard.
    """
    check_metrics(asked.metrics)
    standards = [standard_named(each) for each in asked.standards]
    for kind, names in (("unit", asked.units), ("lot", asked.lots), ("run", asked.runs)):
        _check(catalog, kind, names)
    where = ["true"]
    given: dict[str, object] = {}
    for column, names in (("metric", asked.metrics), ("unit", asked.units)):
        if names:
            where.append(f"list_contains(${column}, m.{column})")
            given[column] = list(names)
    if asked.lots or asked.runs or asked.since_ns is not None:
        where.append(_resting_on(asked, given))
    rows = _rows(catalog, f"select m.* from unit_metrics m where {' and '.join(where)}", given)  # noqa: S608
    told = (narrowed(row_of(row), standards) for row in rows)
    return [row for row in told if row is not None]


def dated(text: str) -> int:
    """Nanoseconds UTC of what `--since` was given: a date (from its first moment, UTC), or a moment with a time zone.

    Raises
    ------
    BadInput: If it is neither.

    Examples
    --------
    >>> dated("2026-11-21") == dated("2026-11-21T08:00:00+08:00")
    True
    """
    is_date = len(text) == len("2026-11-21")
    return moment_ns(f"{text}T00:00:00Z" if is_date else text, "--since")


def undated_runs(catalog: Catalog) -> int:
    """How many runs with steps have no known date, and so are in no answer to `--since`."""
    ((count,),) = catalog.rows("select count(distinct run) from unit_runs where not date_known")
    return int(count)


def unused_steps(catalog: Catalog, asked: Selection) -> list[tuple[str, int, str]]:
    """Steps of the chosen units and runs that no characteristic rests on.

    Returns
    -------
    list of tuple
        Reason, how many steps, and of which units (by name where they are few).
    """
    conditions = ["true"]
    given: dict[str, object] = {}
    for column, names in (("unit", asked.units), ("run", asked.runs)):
        if names:
            conditions.append(f"list_contains(${column}, {column})")
            given[column] = list(names)
    if asked.lots:
        conditions.append("(unit, run) in (select (unit, run) from unit_runs where list_contains($lot, lot))")
        given["lot"] = list(asked.lots)
    if asked.since_ns is not None:
        conditions.append(
            "(unit, run) in (select (unit, run) from unit_runs where date_known and t_start_ns >= $since)"
        )
        given["since"] = asked.since_ns
    found = catalog.rows(
        "select reason, count(*), list(distinct unit order by unit) from unused_steps "  # noqa: S608
        f"where {' and '.join(conditions)} group by reason order by count(*) desc, reason",
        given or None,
    )
    return [
        (str(reason), int(steps), ", ".join(units) if len(units) <= _FEW_UNITS else f"{len(units):,} units")
        for reason, steps, units in found
    ]


def standard_named(text: str) -> str:
    """A standard as the metrics name it, from how people write it.

    Raises
    ------
    BadInput: If no metric is of that standard.

    Examples
    --------
    >>> standard_named("GJB 2426A-2004")
    'GJB2426A'
    """
    known = sorted({source.standard for metric in metrics().values() for source in metric.header.sources})
    name = _YEAR.sub("", text.strip()).replace(" ", "").upper()
    if name not in known:
        raise BadInput(f"no metric is of the standard {text!r}; there are {', '.join(known)}")
    return name


def narrowed(row: Row, standards: Sequence[str]) -> Row | None:
    """A row as these standards have it; None where it is of none of them. Without standards it stays as it is."""
    if not standards:
        return row
    of_row = [each.strip() for each in row["standard"].split(",")]
    kept = [each for each in of_row if each in standards]
    if not kept or len(kept) == len(of_row):
        return row if kept else None
    clauses = clauses_of(row)
    return row | {"standard": ", ".join(kept), "clause": "; ".join(clauses[each] for each in kept)}


def clauses_of(row: Row) -> dict[str, str]:
    """The clause of each standard that a row is of."""
    of_row = [each.strip() for each in row["standard"].split(",")]
    if len(of_row) == 1:
        return {of_row[0]: row["clause"]}
    return {
        standard: "; ".join(
            each.clause for each in metrics()[row["metric"]].header.sources if each.standard == standard
        )
        for standard in of_row
    }


def _check(catalog: Catalog, kind: str, names: Iterable[str]) -> None:
    if not names:
        return
    known = {name for (name,) in catalog.rows(f"select distinct {kind} from unit_runs where {kind} is not null")}  # noqa: S608
    if kind == "unit":
        known |= {name for (name,) in catalog.rows("select distinct unit from unit_metrics")}
    for name in names:
        if name not in known:
            if kind in {"unit", "run"} and catalog.rows(f"from signals where {kind} = $name limit 1", {"name": name}):
                raise NotFound(
                    f"{kind} {name!r} has samples, but no completed step says what was measured: import its files "
                    "again with --procedure, as --procedure static_bias --position IRA_up for records at rest"
                )
            raise NotFound(
                f"no completed step of {kind} {name!r} is in the store; {alike(name, known, f'{kind}s are')}"
            )


def _resting_on(asked: Selection, given: dict[str, object]) -> str:
    conditions = ["true"]
    for column, names in (("lot", asked.lots), ("run", asked.runs)):
        if names:
            conditions.append(f"list_contains(${column}, u.{column})")
            given[column] = list(names)
    if asked.since_ns is not None:
        conditions.append("u.date_known and u.t_start_ns >= $since")
        given["since"] = asked.since_ns
    return (
        "m.rowid in (select r.row from (select rowid as row, unit, unnest(runs) as run from unit_metrics) r "  # noqa: S608
        f"join unit_runs u on u.run = r.run and u.unit = r.unit where {' and '.join(conditions)})"
    )


def _rows(catalog: Catalog, sql: str, given: dict[str, object]) -> list[Row]:
    ordered = f"{sql} order by m.unit, m.metric, m.signal, m.run, m.standard, m.parameters"
    return [row for batch in catalog.batches(ordered, given or None) for row in batch.to_pylist()]
