"""The command `gyrofleet export-iceberg`: the lake as tables that Trino, Spark SQL, Snowflake and others read."""

from pathlib import Path

import click

from stream.terminal.console import counted, notes, print_json, reporting, results, store_option
from stream.terminal.result_table import ResultTable


@click.command("export-iceberg")
@store_option
@click.option(
    "--warehouse",
    type=click.Path(path_type=Path),
    required=True,
    help="Folder of the tables' metadata; made if missing.",
)
@click.option("--namespace", default="gyrofleet", show_default=True, help="Of the tables in the catalogue.")
@click.option(
    "--catalog", metavar="NAME",
    help="A catalogue of pyiceberg's configuration (.pyiceberg.yaml); by default a file of SQLite in the warehouse.",
)  # fmt: skip
@reporting
def export_iceberg(folder: Path, warehouse: Path, namespace: str, catalog: str | None, *, as_json: bool) -> None:
    """Show the lake as tables of Apache Iceberg: its own Parquet files, nothing copied.

    Only what has changed since the last export is added or removed, in one snapshot for each table. Repeat it after
    `gyrofleet lake`, and at least once an hour while a recorder runs: it removes files that it has joined an hour ago.

    \b
    gyrofleet export-iceberg --store S --warehouse W
    """  # noqa: D301  click's mark for lines that are not to be joined
    from storage.lake import iceberg_export
    from storage.store import Store

    with notes().status("exporting"):
        found = iceberg_export.export_iceberg(Store.open(folder), warehouse, namespace=namespace, catalog=catalog)
    if as_json:
        document = {"warehouse": str(warehouse.resolve()), "catalog": found.catalog, "namespace": namespace}
        print_json(document | {"changed": found.is_changed, "tables": [each._asdict() for each in found.tables]})
        return
    table = ResultTable("table", "files", "rows", "MB", "added", "removed")
    for each in found.tables:
        numbers = (
            f"{each.files:,}",
            f"{each.rows:,}",
            f"{each.bytes / 1e6:,.1f}",
            f"{each.added:,}",
            f"{each.removed:,}",
        )
        table.add_row(each.table, *numbers)
    results().print(table)
    changed = sum(1 for each in found.tables if each.added or each.removed)
    results().print(f"{counted(changed, 'table')} changed; catalogue {found.catalog}, namespace {namespace}")
