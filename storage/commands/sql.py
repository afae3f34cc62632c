"""The command `gyrofleet sql`."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from storage.commands.lake_address import asked_at, lake_options
from storage.commands.query_output import cell, print_csv, print_json_rows, print_table, write_parquet
from stream.terminal.console import notes, print_json, reporting, results, store_option
from stream.terminal.result_table import ResultTable

if TYPE_CHECKING:
    from storage.sql.catalog import Catalog
    from storage.sql.door import QueryLimits, SqlDoor
    from storage.store import Store

_POSITIVE = click.FloatRange(min=0.0, min_open=True)


@click.command("sql")
@click.argument("statement", required=False)
@store_option
@click.option("--tables", is_flag=True, help="List the tables, or the columns of the table named by STATEMENT.")
@click.option(
    "--catalogue", "catalogue_path", type=click.Path(path_type=Path),
    help="Write a DuckDB database with all tables, for any DuckDB client.",
)  # fmt: skip
@click.option("--csv", "as_csv", is_flag=True, help="Print the result as CSV.")
@click.option("--parquet", "parquet_path", type=click.Path(path_type=Path), help="Write the result to this file.")
@click.option(
    "--max-time", "time_s", type=_POSITIVE, metavar="SECONDS", help="Time that STATEMENT may compute.  [default: 60]"
)
@click.option(
    "--max-memory", "memory_gib", type=_POSITIVE, metavar="GIB",
    help="Memory that STATEMENT may take.  [default: 4, or half of the machine's]",
)  # fmt: skip
@lake_options
@click.option("--max-rows", type=click.IntRange(min=1), help="Rows that the result may have.  [default: 100,000,000]")
@reporting
def sql(
    statement: str | None, folder: Path, parquet_path: Path | None, catalogue_path: Path | None, time_s: float | None,
    memory_gib: float | None, max_rows: int | None, url: str | None, endpoint_url: str | None, cache_size: str | None,
    *, tables: bool, as_csv: bool, as_json: bool,
) -> None:  # fmt: skip
    """Ask the store in SQL: samples, runs, steps, unit_metrics, and others; --tables lists them.

    STATEMENT runs in a process that can only read the store. One that would do more, fails, or exceeds --max-time,
    --max-memory or --max-rows, ends with exit code 2. Of a fleet store all tables have the column plant. With --lake it
    asks a lake that `gyrofleet lake --lake` published: parts of files are fetched as statements need them, and kept in
    a cache; credentials come from AWS_*.

    \b
    gyrofleet sql --tables
    gyrofleet sql --tables samples
    gyrofleet sql "select unit, signal, run, samples from signals"
    gyrofleet sql "select unit, run, avg(value) from samples group by all"
    """  # noqa: D301  click's mark for lines that are not to be joined
    from storage.store import check_outside
    from stream.errors import BadInput

    if as_csv + as_json + (parquet_path is not None) > 1:
        raise BadInput("give one of --json, --csv and --parquet FILE")
    if tables + (catalogue_path is not None) + (statement is not None and not tables) != 1:
        raise BadInput("give one of STATEMENT, --tables [NAME] and --catalogue FILE")
    asked = _Asked(asked_at(folder, url, endpoint_url, cache_size))
    for path in (catalogue_path, parquet_path):
        if path is not None:
            check_outside(asked.store, path)
    if catalogue_path is not None:
        asked.export(catalogue_path)
        return
    if tables:
        with asked.catalog() as catalog:
            _print_tables(catalog, statement, as_json=as_json)
        return
    assert statement is not None
    from storage.sql.door import QueryLimits
    from storage.sql.sandbox.landlock import WITHOUT_LANDLOCK

    memory_bytes = None if memory_gib is None else int(memory_gib * 2**30)
    given: dict[str, Any] = {"time_s": time_s, "memory_bytes": memory_bytes, "rows": max_rows}
    limits = QueryLimits()._replace(**{name: value for name, value in given.items() if value is not None})
    with asked.door(limits) as door:
        result = door.ask(statement)
        if not door.is_enforced:
            notes().print(f"note: {WITHOUT_LANDLOCK}", soft_wrap=True)
        for note in result.notes:
            notes().print(f"note: {note}", soft_wrap=True, markup=False)
        if parquet_path is not None:
            write_parquet(result, parquet_path)
        elif as_csv:
            print_csv(result)
        elif as_json:
            print_json_rows(result)
        else:
            print_table(result)


class _Asked:
    """The store that is asked, a fleet store, or the store of a published lake."""

    def __init__(self, at: "Path | Store") -> None:
        from storage.fleet_store import FleetStore, is_fleet
        from storage.store import Store

        self._fleet, self._has_files = None, isinstance(at, Path)
        if not isinstance(at, Path):
            self.store = at
        elif is_fleet(at):
            self._fleet, self.store = FleetStore.open(at), Store(at, "")
        else:
            self.store = Store.open(at)

    def catalog(self) -> "Catalog":
        """A catalogue of all tables."""
        from storage.sql.catalog import Catalog
        from storage.sql.fleet.fleet_door import opened_fleet_catalog

        return Catalog(self.store) if self._fleet is None else opened_fleet_catalog(self._fleet)

    def door(self, limits: "QueryLimits") -> "SqlDoor":
        """The process that answers statements."""
        if self._fleet is None:
            from storage.sql.door import SqlDoor

            return SqlDoor(self.store, limits)
        from storage.sql.fleet.fleet_door import FleetDoor

        return FleetDoor(self._fleet, limits)

    def export(self, path: Path) -> None:
        """Write a DuckDB database of one store."""
        from storage.sql.tables import export_catalogue
        from stream.errors import BadInput

        if self._fleet is not None:
            raise BadInput(f"a catalogue is of one store: --store {self._fleet.folder}/plants/NAME")
        if not self._has_files:
            raise BadInput("a catalogue has views over the files of a store; --parquet FILE keeps a result of a --lake")
        export_catalogue(self.store, path)
        notes().print(
            f"written to {path}: DuckDB 1.3 or later opens it, its view samples needs DuckDB 2.0", soft_wrap=True
        )


def _print_tables(catalog: "Catalog", name: str | None, *, as_json: bool) -> None:
    from storage.sql.tables import FUNCTIONS, columns_of, described_tables, examples

    console = results()
    rows = described_tables(catalog) if name is None else columns_of(catalog, name)
    if as_json:
        print_json(rows)
        return
    table = ResultTable(*rows[0])
    for row in rows:
        table.add_row(*(cell(value) for value in row.values()))
    console.print(table)
    if name is None:
        console.print(f"{FUNCTIONS}\n", soft_wrap=True, markup=False)
        for question, statement in examples().items():
            console.print(f"{question}\n  {statement}", soft_wrap=True, markup=False)
