"""The tables that users can query: their columns and comments, examples, and a database file with all of them."""

from collections.abc import Mapping
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

import duckdb

from storage.sql.catalog import Catalog, known_tables, layers
from storage.store import Store
from stream.errors import BadInput, GyrofleetError, NotFound
from stream.files.atomic_file import replacement
from stream.files.toml_text import decode_toml

ColumnTexts = Mapping[str, Mapping[str, str]]
_EVERY = "every"

EXAMPLES = {
    "How many samples of what?": "select unit, signal, run, samples, sample_interval_s from signals",
    "What ran, and how did it end?": "select run, started, duration_s, outcome, units from runs",
    "Mean output in deg/h": (
        "select unit, avg(deg_per_h(value, unit_of_measure)) as deg_per_h from samples "
        "where signal = 'rate' group by unit"
    ),
    "Allan deviation of a unit": "select run, tau_s, value, lo, hi from adev('FOG-0231', 'rate')",
}
ADEV = "adev"
FUNCTIONS = (
    "functions: adev('UNIT', 'SIGNAL') as a table, the Allan deviation as last estimated while samples flowed (with "
    "strides, about 1 % from the value of `gyrofleet allan`, which takes every window up to a million samples); "
    "deg_per_h(value, unit), deg_c(value, unit)"
)


def examples() -> dict[str, str]:
    """Questions and the statements that answer them, of the store's own tables and of all layers."""
    return EXAMPLES | {question: sql for layer in layers() for question, sql in layer.examples.items()}


def described_tables(catalog: Catalog) -> list[dict[str, object]]:
    """Name and comment of every table; for a layer that cannot be computed, why."""
    failed: dict[str, str] = {}
    for layer in layers():
        try:
            catalog.fill(layer.tables)
        except GyrofleetError as error:
            failed |= dict.fromkeys(layer.tables, f"cannot be computed: {error}")
    comments: dict[str, str | None] = dict(
        catalog.rows(
            "select view_name, comment from duckdb_views() where schema_name = 'main' "
            "union all select table_name, comment from duckdb_tables() where schema_name = 'main'"
        )
    )
    return [{"table": name, "what": failed.get(name) or comments.get(name) or ""} for name in known_tables()]


def columns_of(catalog: Catalog, name: str) -> list[dict[str, object]]:
    """Name, type and meaning of the columns of a table; NotFound if there is no such table."""
    if name not in (*known_tables(), ADEV):
        raise NotFound(f"there is no table {name!r}; tables are {', '.join(known_tables())}")
    texts = column_texts(name)
    source = "select * from adev('', '')" if name == ADEV else name
    rows = catalog.rows(f"select column_name, column_type from (describe {source})")  # noqa: S608  a known name
    return [{"column": column, "type": kind, "what": texts.get(column, "")} for column, kind in rows]


def read_texts(file: Traversable) -> ColumnTexts:
    """Read column meanings: TOML with a table for each SQL table, and ``[every]`` for columns common to all."""
    return decode_toml(file.read_bytes(), dict[str, dict[str, str]])


def column_texts(table: str) -> dict[str, str]:
    """Meaning of the columns of a table."""
    found: dict[str, str] = {"plant": "plant that recorded it, in a fleet store"}
    own = read_texts(files("storage.sql").joinpath("schema", "columns.toml"))
    for texts in (own, *(layer.columns for layer in layers() if table in layer.tables)):
        found |= texts.get(_EVERY, {})
        found |= texts.get(table, {})
    return found


def comment_columns(catalog: Catalog) -> None:
    """Set the comments of all columns in a catalogue; not done on opening, where every command would wait for it."""
    texts = {table: column_texts(table) for table in known_tables()}
    columns = catalog.rows(
        "select table_name, column_name from duckdb_columns() "
        "where schema_name = 'main' and table_name in (select unnest($known))",
        {"known": known_tables()},
    )
    statements = []
    for table, column in columns:
        if column in texts[table]:
            text = texts[table][column].replace("'", "''")
            statements.append(f'comment on column "{table}"."{column}" is \'{text}\'')
    catalog.define(";".join(statements))


def export_catalogue(store: Store, path: Path) -> None:
    """Write or replace a DuckDB database: views over the store's Parquet files as they are now, metrics as tables."""
    fresh = path.with_name(f"{path.name}.part")
    fresh.unlink(missing_ok=True)
    try:
        with replacement(path, fresh), Catalog(store, fresh) as catalog:
            catalog.fill()
            comment_columns(catalog)
    except (OSError, duckdb.IOException) as error:
        raise BadInput(f"cannot write {path}: {error}; give --catalogue a file in a folder you can write") from error
    finally:
        fresh.with_name(f"{fresh.name}.wal").unlink(missing_ok=True)
