"""The command `gyrofleet sql`."""

import csv
import itertools
import shutil
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich.table import Table

from stream.console import csv_text, json_text, notes, print_json, reporting, results, store_option

if TYPE_CHECKING:
    from collections.abc import Iterator

    import pyarrow as pa

    from storage.sql.catalog import Catalog

_SHOWN_ROWS = 200
_POSITIVE = click.FloatRange(min=0.0, min_open=True)
_MEMORY_BYTES = 64 << 20


@click.command("sql")
@click.argument("statement", required=False)
@store_option
@click.option("--tables", is_flag=True, help="List the tables, or the columns of STATEMENT where it is a table's name.")
@click.option(
    "--catalogue",
    "catalogue_path",
    type=click.Path(path_type=Path),
    help="Write a DuckDB database with all tables, for any DuckDB client.",
)
@click.option("--csv", "as_csv", is_flag=True, help="Print the result as CSV.")
@click.option("--parquet", "parquet_path", type=click.Path(path_type=Path), help="Write the result to this file.")
@click.option(
    "--max-time", "time_s", type=_POSITIVE, metavar="SECONDS", help="Time that STATEMENT may compute.  [default: 60]"
)
@click.option(
    "--max-memory", "memory_gib", type=_POSITIVE, metavar="GIB",
    help="Memory that STATEMENT may take.  [default: 4, or half of the machine's]",
)  # fmt: skip
@click.option("--max-rows", type=click.IntRange(min=1), help="Rows that the result may have.  [default: 100,000,000]")
@reporting
def sql(
    statement: str | None,
    folder: Path,
    parquet_path: Path | None,
    catalogue_path: Path | None,
    time_s: float | None,
    memory_gib: float | None,
    max_rows: int | None,
    *,
    tables: bool,
    as_csv: bool,
    as_json: bool,
) -> None:
    """Ask the store in SQL: samples, runs, steps, unit_metrics, and others; --tables lists them.

    STATEMENT runs in a process that can read the store and nothing else. A statement that would do more, fails, or
    takes more than --max-time, --max-memory or --max-rows allow, ends with exit code 2.

    \b
    gyrofleet sql --tables
    gyrofleet sql --tables samples
    gyrofleet sql "select unit, signal, run, samples from signals"
    gyrofleet sql "select unit, run, avg(value) from samples group by all"
    """  # noqa: D301  click's mark for lines that are not to be joined
    from storage.store import Store
    from storage.store_files import check_outside
    from stream.errors import BadInput

    if as_csv + as_json + (parquet_path is not None) > 1:
        raise BadInput("give one of --json, --csv and --parquet FILE")
    if tables + (catalogue_path is not None) + (statement is not None and not tables) != 1:
        raise BadInput("give one of STATEMENT, --tables [NAME] and --catalogue FILE")
    store = Store.open(folder)
    for path in (catalogue_path, parquet_path):
        if path is not None:
            check_outside(store, path)
    if catalogue_path is not None:
        from storage.sql.tables import export_catalogue

        export_catalogue(store, catalogue_path)
        notes().print(f"written to {catalogue_path}: duckdb {catalogue_path}")
        return
    if tables:
        from storage.sql.catalog import Catalog

        with Catalog(store) as catalog:
            _tell_tables(catalog, statement, as_json=as_json)
        return
    assert statement is not None
    from storage.sql.door import QueryLimits, SqlDoor

    limits = QueryLimits()
    limits = QueryLimits(
        limits.time_s if time_s is None else time_s,
        limits.memory_bytes if memory_gib is None else int(memory_gib * 2**30),
        limits.rows if max_rows is None else max_rows,
    )
    with SqlDoor(store, limits) as door:
        result = door.ask(statement)
        if not door.is_enforced:
            notes().print(
                "note: this kernel has no Landlock; that the statement writes nothing is left to DuckDB's own settings"
            )
        if parquet_path is not None:
            _write_parquet(result.schema, result.batches, parquet_path)
        elif as_csv:
            writer = csv.writer(sys.stdout)
            writer.writerow(csv_text(name) for name in result.schema.names)
            for rows in _plain(result.batches):
                writer.writerows([_csv_cell(value) for value in row.values()] for row in rows)
        elif as_json:
            _print_json(_plain(result.batches))
        else:
            _print_table(result.schema.names, _plain(result.batches))


def _tell_tables(catalog: "Catalog", name: str | None, *, as_json: bool) -> None:
    from storage.sql.tables import columns_of, examples, told_tables

    console = results()
    rows = told_tables(catalog) if name is None else columns_of(catalog, name)
    if as_json:
        print_json(rows)
        return
    table = Table(header_style="bold")
    for title in rows[0]:
        table.add_column(title, overflow="fold")
    for row in rows:
        table.add_row(*(_cell(value) for value in row.values()))
    console.print(table)
    if name is None:
        console.print("functions: adev('UNIT', 'SIGNAL') as a table; deg_per_h(value, unit), deg_c(value, unit)\n")
        for question, statement in examples().items():
            console.print(f"{question}\n  {statement}", soft_wrap=True, markup=False)


def _plain(batches: "Iterator[pa.RecordBatch]") -> "Iterator[list[dict[str, Any]]]":
    """Rows as dictionaries of what JSON and people can read."""
    import pyarrow as pa

    for batch in batches:
        columns = [_printable(name, column) for name, column in zip(batch.schema.names, batch.columns, strict=True)]
        yield pa.RecordBatch.from_arrays(columns, names=_distinct(batch.schema.names)).to_pylist()


def _printable(name: str, column: "pa.Array") -> "pa.Array":
    import pyarrow as pa

    from stream.errors import QueryError

    try:
        if pa.types.is_interval(column.type):
            return pa.array([None if each is None else _interval(each) for each in column.to_pylist()], pa.string())
        return column.cast(_printable_type(column.type))
    except pa.ArrowException as error:
        raise QueryError(
            f"column {name} of type {column.type} cannot be printed; say {name}::varchar in the statement"
        ) from error


def _printable_type(kind: "pa.DataType") -> "pa.DataType":
    """Moments become text with all their digits, which Python's datetime has no room for."""
    import pyarrow as pa

    if pa.types.is_date(kind) or pa.types.is_time(kind) or pa.types.is_timestamp(kind) or pa.types.is_dictionary(kind):
        return pa.string()
    if pa.types.is_list(kind):
        return pa.list_(_printable_type(kind.value_type))
    if pa.types.is_struct(kind):
        return pa.struct([pa.field(field.name, _printable_type(field.type)) for field in kind])
    return kind


def _interval(value: "pa.MonthDayNano") -> str:
    return f"{value.months} months {value.days} days {value.nanoseconds / 1e9:.9g} s"


def _distinct(names: list[str]) -> list[str]:
    return [name if names.index(name) == i else f"{name}_{i + 1}" for i, name in enumerate(names)]


def _print_table(names: list[str], pages: "Iterator[list[dict[str, Any]]]") -> None:
    table = Table(header_style="bold")
    for name in names:
        table.add_column(name, overflow="fold")
    rows = list(itertools.islice(itertools.chain.from_iterable(pages), _SHOWN_ROWS + 1))
    for row in rows[:_SHOWN_ROWS]:
        table.add_row(*(_cell(value) for value in row.values()))
    console = results()
    console.print(table)
    if len(rows) > _SHOWN_ROWS:
        console.print(f"the first {_SHOWN_ROWS} rows; --csv, --json or --parquet FILE give all")
    else:
        console.print(f"{len(rows)} row{'' if len(rows) == 1 else 's'}")


def _print_json(pages: "Iterator[list[dict[str, Any]]]") -> None:
    """One JSON document, printed once all of it is there: an error must not follow half of one."""
    with tempfile.SpooledTemporaryFile(_MEMORY_BYTES, "w+", encoding="utf-8") as file:
        between = "["
        for rows in pages:
            for row in rows:
                file.write(between + json_text(row))
                between = ","
        file.write("[]" if between == "[" else "]")
        file.seek(0)
        shutil.copyfileobj(file, sys.stdout)
    click.echo()


def _csv_cell(value: object) -> object:
    if isinstance(value, list | dict):
        return csv_text(json_text(value))
    if isinstance(value, str):
        return csv_text(value)
    return value.hex() if isinstance(value, bytes) else value


def _cell(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.9g}"
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, list):
        return ", ".join(_cell(each) for each in value)
    return str(value)


def _write_parquet(schema: "pa.Schema", batches: "Iterator[pa.RecordBatch]", path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    from stream.errors import BadInput, QueryError

    fresh = path.with_name(path.name + ".part")
    count = 0
    try:
        with pq.ParquetWriter(fresh, schema, compression="zstd") as writer:
            for batch in batches:
                writer.write_batch(batch)
                count += batch.num_rows
        fresh.replace(path)
    except pa.ArrowNotImplementedError as error:
        raise QueryError(f"{error}; say COLUMN::varchar in the statement for such a column") from error
    except OSError as error:
        raise BadInput(f"cannot write {path}: {error}; give --parquet a file in a folder you can write") from error
    finally:
        fresh.unlink(missing_ok=True)
    notes().print(f"{count:,} rows written to {path}")
