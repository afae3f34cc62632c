"""What the columns of a catalogue's tables hold, in words: said once for all tables, or of one."""

from collections.abc import Mapping
from importlib.resources import files
from importlib.resources.abc import Traversable

import msgspec

from storage.sql.catalog import VIEWS, Catalog, layers

Words = Mapping[str, Mapping[str, str]]
_EVERY = "every"


def read_words(file: Traversable) -> Words:
    """Read words for columns: TOML with a table for each SQL table, and ``[every]`` for what means the same in all."""
    return msgspec.toml.decode(file.read_bytes(), type=dict[str, dict[str, str]])


def column_words(table: str) -> dict[str, str]:
    """What columns of a table hold, as far as it has such columns.

    Examples
    --------
    >>> column_words("samples")["unit"], column_words("runs")["duration_s"]
    ('serial number of the device', 'from its first sample to its last, s')
    """
    found: dict[str, str] = {}
    own = read_words(files("storage.sql").joinpath("schema", "columns.toml"))
    for words in (own, *(layer.columns for layer in layers() if table in layer.tables)):
        found |= words.get(_EVERY, {})
        found |= words.get(table, {})
    return found


def comment_columns(catalog: Catalog) -> None:
    """Write the words onto the columns of all tables that are in a catalogue, as comments.

    Not done when a catalogue is opened, since that is what every command waits for.
    """
    known = [*VIEWS, *(table for layer in layers() for table in layer.tables)]
    words = {table: column_words(table) for table in known}
    columns = catalog.rows(
        "select table_name, column_name from duckdb_columns() "
        "where schema_name = 'main' and table_name in (select unnest($known))",
        {"known": known},
    )
    statements = []
    for table, column in columns:
        if column in words[table]:
            text = words[table][column].replace("'", "''")
            statements.append(f'comment on column "{table}"."{column}" is \'{text}\'')
    catalog.define(";".join(statements))
