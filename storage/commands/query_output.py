"""The result of a statement as a table, JSON, CSV or a Parquet file."""

import itertools
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from storage.sql.printable import csv_lines, printable_batches
from stream.errors import BadInput, GyrofleetError, QueryError
from stream.files.atomic_file import replacement
from stream.terminal.console import json_text, notes, results, styled
from stream.terminal.result_table import ResultTable

if TYPE_CHECKING:
    import pyarrow as pa

    from storage.sql.door import Result

_SHOWN_ROWS = 200
_HELD_CHARS = 16 << 20


def print_table(result: "Result") -> None:
    """Print the first 200 rows as a table."""
    table = ResultTable(*result.schema.names)
    pages = (page.to_pylist() for page in printable_batches(result))
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
        for text in _json_chunks(printable_batches(result)):
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
    import pyarrow as pa

    sys.stdout.write(csv_lines(pa.array([name], pa.string()) for name in result.schema.names))
    for page in printable_batches(result):
        sys.stdout.write(csv_lines(page.columns))


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
