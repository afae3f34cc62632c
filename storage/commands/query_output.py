"""The result of a statement as a table, JSON, CSV or a Parquet file."""

import csv
import itertools
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stream.atomic_file import replacement
from stream.console import csv_text, json_text, notes, results, styled
from stream.errors import BadInput, GyrofleetError, QueryError
from stream.result_table import ResultTable

if TYPE_CHECKING:
    import pyarrow as pa

    from storage.sql.door import Result

_SHOWN_ROWS = 200
_HELD_CHARS = 16 << 20


def print_table(result: "Result") -> None:
    """Print the first 200 rows as a table."""
    table = ResultTable(*result.schema.names)
    pages = (page.to_pylist() for page in _pages(result))
    rows = list(itertools.islice(itertools.chain.from_iterable(pages), _SHOWN_ROWS + 1))
    for row in rows[:_SHOWN_ROWS]:
        table.add_row(*(cell(value) for value in row.values()))
    console = results()
    console.print(table)
    if len(rows) > _SHOWN_ROWS:
        console.print(f"the first {_SHOWN_ROWS} rows; --csv, --json or --parquet FILE give all")
    else:
        console.print(f"{len(rows)} row{'' if len(rows) == 1 else 's'}")


def print_json_rows(result: "Result") -> None:
    """Print all rows as one JSON array, as they come.

    The first 16 MB are held back, so that a statement that fails early prints its error and nothing else. One that
    fails later leaves the array open, reports the error on standard error, and ends the command with its exit code.
    """
    held: list[str] | None = []
    size = 0
    try:
        for text in _json_chunks(_pages(result)):
            if held is None:
                sys.stdout.write(text)
                continue
            held.append(text)
            size += len(text)
            if size > _HELD_CHARS:
                sys.stdout.writelines(held)
                held = None
    except GyrofleetError as error:
        if held is not None:
            raise
        click.echo()
        notes().print(styled(f"error: {error}; the JSON array is incomplete", "red"), soft_wrap=True)
        sys.exit(error.exit_code)
    sys.stdout.writelines(held or ())
    click.echo()


def _json_chunks(pages: "Iterator[pa.RecordBatch]") -> Iterator[str]:
    between = "["
    for page in pages:
        yield between + json_text(page.to_pylist())[1:-1]
        between = ","
    yield "[]" if between == "[" else "]"


def print_csv(result: "Result") -> None:
    """Print all rows as CSV, as they come."""
    writer = csv.writer(sys.stdout)
    writer.writerow(csv_text(name) for name in result.schema.names)
    for page in _pages(result):
        writer.writerows(zip(*map(_csv_cells, page.columns), strict=True))


def write_parquet(result: "Result", path: Path) -> None:
    """Write all rows to a Parquet file, which is there only once it is complete."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    count = 0
    try:
        with replacement(path) as fresh, pq.ParquetWriter(fresh, result.schema, compression="zstd") as writer:
            for batch in result.batches:
                writer.write_batch(batch)
                count += batch.num_rows
    except pa.ArrowNotImplementedError as error:
        raise QueryError(f"{error}; cast such a column with COLUMN::varchar in the statement") from error
    except OSError as error:
        raise BadInput(f"cannot write {path}: {error}; give --parquet a file in a folder you can write") from error
    notes().print(f"{count:,} rows written to {path}")


def cell(value: object) -> str:
    """A value as text for a table."""
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.9g}"
    if isinstance(value, bytes):
        return value.hex()
    return ", ".join(cell(each) for each in value) if isinstance(value, list) else str(value)


def _csv_cells(column: "pa.Array") -> list[Any]:
    import pyarrow as pa

    values = column.to_pylist()
    is_number = pa.types.is_integer(column.type) or pa.types.is_floating(column.type)
    return values if is_number else [_csv_cell(value) for value in values]


def _csv_cell(value: object) -> object:
    if isinstance(value, list | dict):
        return csv_text(json_text(value))
    if isinstance(value, str):
        return csv_text(value)
    return value.hex() if isinstance(value, bytes) else value


def _pages(result: "Result") -> "Iterator[pa.RecordBatch]":
    """Some rows at a time, of types that JSON and people can read."""
    import pyarrow as pa

    for batch in result.batches:
        names = batch.schema.names
        distinct = [name if names.index(name) == i else f"{name}_{i + 1}" for i, name in enumerate(names)]
        columns = [_printable(name, column) for name, column in zip(names, batch.columns, strict=True)]
        yield pa.RecordBatch.from_arrays(columns, names=distinct)


def _printable(name: str, column: "pa.Array") -> "pa.Array":
    import pyarrow as pa

    try:
        if pa.types.is_interval(column.type):
            return pa.array([None if each is None else _interval(each) for each in column.to_pylist()], pa.string())
        return column.cast(_printable_type(column.type))
    except pa.ArrowException as error:
        raise QueryError(
            f"column {name} of type {column.type} cannot be printed; cast it with {name}::varchar in the statement"
        ) from error


def _printable_type(kind: "pa.DataType") -> "pa.DataType":
    """Times become text with all their digits, since Python's datetime has no nanoseconds."""
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
