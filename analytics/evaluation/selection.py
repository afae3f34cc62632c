"""Selection of metrics: by unit, lot, run, metric, standard and time."""

import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Any, NamedTuple

import pyarrow as pa

from analytics.evaluation.evaluation import define_scripts, row_of
from analytics.evaluation.kept_metrics import unit_metrics
from analytics.metric_registry.registry import alike, check_metrics, metrics
from ingest.moment import moment_ns
from storage.sql.catalog import Catalog
from stream.errors import BadInput, NotFound

Row = dict[str, Any]

_FEW_UNITS = 5
_YEAR = re.compile(r"[-—]\d{4}$")
# of a catalogue whose tables of metrics are partial: which metrics they have
_PARTIAL = "partial_metrics"
_NUMBERED = '(select row_number() over () as "row", * from unit_metrics)'
_HAS_PARTIAL = "select 1 from information_schema.tables where table_name = 'partial_metrics'"


class Selection(NamedTuple):
    """The selection; an empty part selects all."""

    units: tuple[str, ...] = ()
    lots: tuple[str, ...] = ()
    runs: tuple[str, ...] = ()
    metrics: tuple[str, ...] = ()
    standards: tuple[str, ...] = ()
    since_ns: int | None = None  # only values of a run that began at this moment or later


@contextmanager
def evaluated(catalog: Catalog, names: Collection[str]) -> Iterator[None]:
    """Within it the catalogue has ``unit_runs`` and the ``unit_metrics`` of some metrics, of all if none is named."""
    if not names:
        yield
        return
    with catalog.suspended_layers() as waiting:
        if any("unit_metrics" in layer.tables for layer in waiting):
            is_partial = bool(catalog.rows(_HAS_PARTIAL))
            has = {name for (name,) in catalog.rows(f"from internal.{_PARTIAL}")} if is_partial else set()
            if not has.issuperset(names):
                unit_metrics(catalog, catalog.progress, has | set(names))
                define_scripts(catalog, "tables", ["05_unit_runs.sql"])
                catalog.put(_PARTIAL, pa.table({"metric": sorted(has | set(names))}))
        yield


def selected(catalog: Catalog, asked: Selection) -> list[Row]:
    """Selected values and reasons, as in `gyrofleet metrics --json`; only the named metrics are computed.

    Raises NotFound if a unit, lot or run is not in the store; the message names similar ones; BadInput if there is no
    such metric or standard.
    """
    return [row_of(row) for batch in selected_table(catalog, asked).to_batches() for row in batch.to_pylist()]


def selected_table(catalog: Catalog, asked: Selection) -> pa.Table:
    """The same as a table of the columns of ``unit_metrics``."""
    check_metrics(asked.metrics)
    standards = [standard_named(each) for each in asked.standards]
    with evaluated(catalog, asked.metrics):
        for kind, names in (("unit", asked.units), ("lot", asked.lots), ("run", asked.runs)):
            _check(catalog, kind, names)
        conditions, given = _in_lists({"m.metric": asked.metrics, "m.unit": asked.units})
        if asked.lots or asked.runs or asked.since_ns is not None:
            of_runs, more = _in_lists({"u.lot": asked.lots, "u.run": asked.runs}, asked.since_ns, "u.")
            given |= more
            conditions += (
                ' and m."row" in (select r."row" from '  # noqa: S608
                f'(select "row", unit, unnest(runs) as run from {_NUMBERED}) r '
                f"join unit_runs u on u.run = r.run and u.unit = r.unit where {of_runs})"
            )
        sql = f'select m.* exclude ("row") from {_NUMBERED} m where {conditions} '  # noqa: S608
        ordered = f"{sql} order by m.unit, m.metric, m.signal, m.run, m.standard, m.parameters"
        return _narrowed_table(catalog.reader(ordered, given or None).read_all(), standards)


def _narrowed_table(table: pa.Table, standards: Sequence[str]) -> pa.Table:
    """Rows of these standards, of each what is theirs; all without standards. See `narrowed`."""
    if not standards or not table.num_rows:
        return table
    columns = ("metric", "standard", "clause")
    rows = zip(*(table[name].to_pylist() for name in columns), strict=True)
    known: dict[tuple[str, ...], Row | None] = {}
    found = []
    for key in rows:
        if key not in known:
            known[key] = narrowed(dict(zip(columns, key, strict=True)), standards)
        found.append(known[key])
    for name in columns[1:]:
        texts = pa.array([None if row is None else row[name] for row in found], pa.string())
        table = table.set_column(table.schema.get_field_index(name), name, texts)
    return table.filter(pa.array([row is not None for row in found], pa.bool_()))


def _in_lists(
    columns: dict[str, Sequence[str]], since_ns: int | None = None, of: str = ""
) -> tuple[str, dict[str, Any]]:
    """Condition that columns are among the given names and a run's date is known and not before a moment."""
    conditions = ["true"]
    given: dict[str, object] = {}
    for column, names in columns.items():
        if names:
            key = column.rpartition(".")[2]
            conditions.append(f"list_contains(${key}, {column})")
            given[key] = list(names)
    if since_ns is not None:
        conditions.append(f"{of}date_known and {of}t_start_ns >= $since")
        given["since"] = since_ns
    return " and ".join(conditions), given


def dated(text: str, name: str = "--since") -> int:
    """Nanoseconds UTC of the value `name`: a date (its first moment, UTC), or a moment with a time zone.

    Raises BadInput if it is neither.

    >>> dated("2026-11-21") == dated("2026-11-21T08:00:00+08:00")
    True
    """
    return moment_ns(f"{text}T00:00:00Z" if len(text) == len("2026-11-21") else text, name)


def day_or_moment(text: str, name: str = "--since") -> tuple[str, int | None]:
    """A day of the station, or nanoseconds UTC, of the value `name`; BadInput if it is neither.

    >>> day_or_moment("2026-11-21"), day_or_moment("1970-01-01T08:00:00+08:00"), day_or_moment("")
    (('2026-11-21', None), ('', 0), ('', None))
    """
    if not text:
        return "", None
    t_ns = dated(text, name)
    return (text, None) if len(text) == len("2026-11-21") else ("", t_ns)


def undated_runs(catalog: Catalog, asked: Selection) -> int:
    """How many runs with steps have no known date, and so are omitted by `--since`."""
    with evaluated(catalog, asked.metrics):
        ((count,),) = catalog.rows("select count(distinct run) from unit_runs where not date_known")
    return int(count)


def unused_steps(catalog: Catalog, asked: Selection) -> list[tuple[str, int, str]]:
    """Steps of the selected units and runs that no metric uses: the reason, how many, and of which units."""
    conditions, given = _in_lists({"unit": asked.units, "run": asked.runs})
    if asked.lots or asked.since_ns is not None:
        of_runs, more = _in_lists({"lot": asked.lots}, asked.since_ns)
        conditions += f" and (unit, run) in (select (unit, run) from unit_runs where {of_runs})"  # noqa: S608
        given |= more
    found = catalog.rows(
        "select reason, count(*), list(distinct unit order by unit) from unused_steps "  # noqa: S608
        f"where {conditions} group by reason order by count(*) desc, reason",
        given or None,
    )
    return [
        (str(reason), int(steps), ", ".join(units) if len(units) <= _FEW_UNITS else f"{len(units):,} units")
        for reason, steps, units in found
    ]


def standard_named(text: str) -> str:
    """Name of a standard in the metrics, from the ways people write it.

    Raises BadInput if no metric is of that standard, or of its year.

    >>> standard_named("GJB 2426A-2004")
    'GJB2426A'
    """
    known = sorted({source.standard for metric in metrics().values() for source in metric.header.sources})
    name = _YEAR.sub("", text.strip()).replace(" ", "").upper()
    if name not in known:
        raise BadInput(f"no metric is of the standard {text!r}; there are {', '.join(known)}")
    year = _YEAR.search(text.strip())
    if year is not None and with_year(name) != f"{name}-{year[0][1:]}":
        raise BadInput(f"the metrics are of {with_year(name)}, not of {text.strip()}; leave out the year")
    return name


def with_year(standards: str) -> str:
    """Names of standards with the year of the edition whose clauses the metrics follow.

    >>> with_year("GJB2426A, JJF2014"), with_year("informative")
    ('GJB2426A-2004, JJF2014-2022', 'informative')
    """
    years = _years()
    return ", ".join(f"{each}-{years[each]}" if years.get(each) else each for each in standards.split(", "))


@cache
def _years() -> dict[str, str]:
    return {each.standard: each.year for metric in metrics().values() for each in metric.header.sources}


def narrowed(row: Row, standards: Sequence[str]) -> Row | None:
    """A row restricted to these standards; None where it is of none of them, unchanged without standards."""
    if not standards:
        return row
    of_row = _standards(row)
    kept = [each for each in of_row if each in standards]
    if not kept or len(kept) == len(of_row):
        return row if kept else None
    clauses = clauses_of(row)
    return row | {"standard": ", ".join(kept), "clause": "; ".join(clauses[each] for each in kept)}


def clauses_of(row: Row) -> dict[str, str]:
    """The clause of each standard of a row."""
    of_row = _standards(row)
    if len(of_row) == 1:
        return {of_row[0]: row["clause"]}
    sources = metrics()[row["metric"]].header.sources
    return {standard: "; ".join(each.clause for each in sources if each.standard == standard) for standard in of_row}


def _standards(row: Row) -> list[str]:
    return [each.strip() for each in row["standard"].split(",")]


def _check_not_excluded(catalog: Catalog, kind: str, name: str) -> None:
    """NotFound that says why nothing counts of a unit or run that people have excluded."""
    sql = "select run, reason, by_whom from exclusions where $name = case $kind when 'unit' then unit else run end"
    found = catalog.rows(sql, {"name": name, "kind": kind})
    if found:
        reasons = dict.fromkeys(f"{run} ({reason}; {by})" for run, reason, by in found)
        raise NotFound(
            f"{kind} {name!r} is excluded from evaluation: {', '.join(list(reasons)[:4])}; "
            "`gyrofleet runs include RUN` takes a run in again"
        )


def _check(catalog: Catalog, kind: str, names: Iterable[str]) -> None:
    if not names:
        return
    known = {name for (name,) in catalog.rows(f"select distinct {kind} from unit_runs where {kind} is not null")}  # noqa: S608
    if kind == "unit":
        checked = "select distinct unit from internal.standing_checks"
        known |= {name for (name,) in catalog.rows(checked)}
    for name in names:
        if name not in known:
            if kind in {"unit", "run"}:
                _check_not_excluded(catalog, kind, name)
            if kind in {"unit", "run"} and catalog.rows(f"from signals where {kind} = $name limit 1", {"name": name}):
                raise NotFound(
                    f"{kind} {name!r} has samples, but no completed step says what was measured: import its files "
                    "again with --procedure, as --procedure static_bias --position IRA_up for records at rest"
                )
            similar = alike(name, known, f"{kind}s are")
            raise NotFound(f"no completed step of {kind} {name!r} is in the store; {similar}")
