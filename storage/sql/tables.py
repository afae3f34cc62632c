"""What can be asked in SQL: a catalogue's tables, their columns, examples, and a database file with all of them."""

from pathlib import Path

import duckdb

from storage.sql.catalog import Catalog, known_tables, layers
from storage.sql.columns import column_words, comment_columns
from storage.store import Store
from stream.errors import BadInput, GyrofleetError, NotFound

EXAMPLES = {
    "How many samples of what?": "select unit, signal, run, samples, sample_interval_s from signals",
    "What ran, and how did it end?": "select run, started, duration_s, outcome, units from runs",
    "Mean output in deg/h": (
        "select unit, avg(deg_per_h(value, unit_of_measure)) as deg_per_h from samples "
        "where signal = 'rate' group by unit"
    ),
    "Allan deviation of a unit": "select run, tau_s, value, lo, hi from adev('FOG-0231', 'rate')",
}


def examples() -> dict[str, str]:
    """Questions and the statements that answer them, of the store's own tables and of all layers."""
    return EXAMPLES | {question: sql for layer in layers() for question, sql in layer.examples.items()}


def described_tables(catalog: Catalog) -> list[dict[str, object]]:
    """Name and comment of every table that is meant to be asked; of a layer that cannot be made, why."""
    failed: dict[str, str] = {}
    for layer in layers():
        try:
            catalog.rows(f"select 1 from {layer.tables[0]} limit 0")  # noqa: S608  a layer's own name
        except GyrofleetError as error:
            failed |= dict.fromkeys(layer.tables, f"cannot be made: {error}")
    told = (
        "select view_name, comment from duckdb_views() where schema_name = 'main' "
        "union all select table_name, comment from duckdb_tables() where schema_name = 'main'"
    )
    comments: dict[str, str | None] = {name: comment for name, comment in catalog.rows(told)}  # noqa: C416
    return [{"table": name, "what": failed.get(name) or comments.get(name) or ""} for name in known_tables()]


def columns_of(catalog: Catalog, name: str) -> list[dict[str, object]]:
    """Columns of a table: name, type, and what it holds."""
    if name not in known_tables():
        raise NotFound(f"there is no table {name!r}; tables are {', '.join(known_tables())}")
    words = column_words(name)
    # it is named, so that it is made
    rows = catalog.rows(f"select column_name, column_type from (describe {name})")  # noqa: S608  one of ours
    return [{"column": column, "type": kind, "what": words.get(column, "")} for column, kind in rows]


def export_catalogue(store: Store, path: Path) -> None:
    """Write a DuckDB database: views over the store's Parquet files where they lie, metrics as tables.

    It shows the store as it is now; made again it replaces the file.
    """
    fresh = path.with_name(path.name + ".part")
    fresh.unlink(missing_ok=True)
    try:
        with Catalog(store, fresh) as catalog:
            catalog.fill()
            comment_columns(catalog)
        fresh.replace(path)
    except (OSError, duckdb.IOException) as error:
        raise BadInput(f"cannot write {path}: {error}; give --catalogue a file in a folder you can write") from error
    finally:
        for each in (fresh, fresh.with_name(fresh.name + ".wal")):
            each.unlink(missing_ok=True)
