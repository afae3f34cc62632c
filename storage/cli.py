"""Commands of the store: `gyrofleet record` and `gyrofleet sql`."""

import csv
import itertools
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich.table import Table

from stream.console import (
    json_text,
    notes,
    print_json,
    reporting,
    results,
    store_option,
    until_stopped,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    import pyarrow as pa

    from storage.recorder import Recorder

_SHOWN_ROWS = 200
_SHOWN_REJECTIONS = 5


@click.command("record")
@store_option
@click.option(
    "--listen",
    default="tcp/127.0.0.1:7447",
    show_default=True,
    help="Where sources connect to; loopback unless you say otherwise.",
)
@click.option(
    "--rotate-mb",
    type=click.IntRange(min=1),
    default=128,
    show_default=True,
    help="Payload of a segment of the log before it is sealed.",
)
@click.option(
    "--rotate-s",
    type=click.FloatRange(min=1),
    default=300.0,
    show_default=True,
    help="Age of a segment in seconds before it is sealed and reaches the lake.",
)
@reporting
def record(folder: Path, listen: str, rotate_mb: int, rotate_s: float, *, as_json: bool) -> None:
    """Record everything that sources send to `--listen`, until stopped."""
    from storage.event_log import EventLog
    from storage.recorder import Recorder
    from storage.store import Store, WriterLock
    from stream.zenoh_bus import ZenohBus

    console = notes()
    store = Store.create(folder)
    with WriterLock(store, "gyrofleet record", listen), until_stopped() as stopped:
        log = EventLog(store, rotate_bytes=rotate_mb << 20, rotate_s=rotate_s)
        for recovery in log.recovered:
            console.print(
                f"recovered {recovery.records:,} messages of {recovery.segment}, left open by an earlier process; "
                f"{recovery.damaged_chunks} damaged chunks; the file as it was: {recovery.kept_aside}"
            )
        with ZenohBus(listen=[listen]) as bus, Recorder(store, bus, log) as recorder:
            if as_json:
                print_json({"event": "recording", "store": str(folder), "listen": listen})
            else:
                console.print(f"recording from {listen} to {folder}; Ctrl-C ends")
            told_at, told_samples = time.monotonic(), 0
            while not stopped.wait(0.2) and recorder.failure is None:
                if time.monotonic() - told_at >= 5.0 and recorder.counts.samples != told_samples and not as_json:
                    rate = (recorder.counts.samples - told_samples) / (time.monotonic() - told_at)
                    told_at, told_samples = time.monotonic(), recorder.counts.samples
                    console.print(f"{told_samples:,} samples, {rate:,.0f}/s")
            if not as_json:
                console.print("stopping: writing what has arrived, sources keep the rest")
    _tell_counts(recorder, as_json=as_json)


def _tell_counts(recorder: "Recorder", *, as_json: bool) -> None:
    counts = recorder.counts
    if as_json:
        print_json(
            {
                "event": "ended",
                "messages": counts.messages,
                "samples": counts.samples,
                "segments": counts.segments,
                "duplicates": counts.duplicates,
                "out_of_order": counts.out_of_order,
                "rejected": counts.rejected,
                "rejections": list(counts.rejections),
            }
        )
        return
    console = notes()
    console.print(
        f"{counts.samples:,} samples in {counts.segments} segments; {counts.duplicates} messages came twice, "
        f"{counts.rejected} could not be read"
    )
    for rejection in list(counts.rejections)[-_SHOWN_REJECTIONS:]:
        console.print(f"  kept aside, among the last: {rejection}", markup=False, soft_wrap=True)


@click.command("sql")
@click.argument("statement")
@store_option
@click.option("--csv", "as_csv", is_flag=True, help="Print the result as CSV.")
@click.option("--parquet", "parquet_path", type=click.Path(path_type=Path), help="Write the result to this file.")
@reporting
def sql(statement: str, folder: Path, parquet_path: Path | None, *, as_csv: bool, as_json: bool) -> None:
    """Ask the store in SQL: views samples, signals, runs, steps, estimates, events.

    \b
    gyrofleet sql "describe samples"
    gyrofleet sql "select unit, signal, run, samples from signals"
    gyrofleet sql "select unit, avg(value), stddev(value) from samples group by unit"
    """  # noqa: D301  click's mark for lines that are not to be joined
    from storage.catalog import Catalog
    from storage.store import Store
    from stream.errors import BadInput

    if as_csv + as_json + (parquet_path is not None) > 1:
        raise BadInput("give one of --json, --csv and --parquet FILE")
    with Catalog(Store.open(folder)) as catalog:
        reader = catalog.reader(statement)
        if parquet_path is not None:
            _write_parquet(reader.schema, catalog.guarded(reader), parquet_path)
        elif as_csv:
            writer = csv.writer(sys.stdout)
            writer.writerow(reader.schema.names)
            for rows in _plain(catalog.guarded(reader)):
                writer.writerows([_csv_cell(value) for value in row.values()] for row in rows)
        elif as_json:
            print_json([row for rows in _plain(catalog.guarded(reader)) for row in rows])
        else:
            _print_table(reader.schema.names, _plain(catalog.guarded(reader)))


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


def _csv_cell(value: object) -> object:
    if isinstance(value, list | dict):
        return json_text(value)
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
