"""Which statements a store answers: those that read its views, judged by the tree that DuckDB's own parser makes.

The kind of a statement is not enough: EXPLAIN ANALYZE runs what it explains, and a WITH may hold DELETE or COPY in
what is a SELECT by kind.
"""

import json
import re
from collections.abc import Collection, Iterator
from typing import Any

import duckdb

from stream.errors import QueryError

_NODES = {"SELECT_NODE", "SET_OPERATION_NODE", "RECURSIVE_CTE_NODE", "CTE_NODE"}
_READS = "What runs is SELECT (also WITH, FROM, DESCRIBE, SUMMARIZE, EXPLAIN)"
TABLE_FUNCTIONS = frozenset(
    {
        "duckdb_columns", "duckdb_constraints", "duckdb_databases", "duckdb_dependencies", "duckdb_functions",
        "duckdb_indexes", "duckdb_keywords", "duckdb_memory", "duckdb_schemas", "duckdb_settings", "duckdb_tables",
        "duckdb_types", "duckdb_views", "generate_series", "histogram", "histogram_values", "icu_calendar_names",
        "json_each", "json_tree", "pg_timezone_names", "pragma_collations", "pragma_database_size",
        "pragma_platform", "pragma_show", "pragma_table_info", "pragma_version", "range", "repeat", "repeat_row",
        "summary", "test_all_types", "unnest",
    }
)  # fmt: skip
"""Functions of DuckDB that give a table and read nothing but the statement and the catalogue."""
REFUSED_FUNCTIONS = frozenset({"currval", "nextval", "setseed", "setval", "sleep_ms", "write_log"})
"""Functions that give a value and do something besides."""


def check_statement(connection: duckdb.DuckDBPyConnection, sql: str, macros: Collection[str]) -> None:
    """Refuse what is not one statement that only reads the store.

    Parameters
    ----------
    connection: Whose parser judges; nothing is run on it but that.
    sql: The statement.
    macros: Table macros that are the store's own.

    Examples
    --------
    >>> connection = duckdb.connect()
    >>> check_statement(connection, "explain analyze select 1", ())
    >>> check_statement(connection, "explain analyze copy (select 1) to 'x'", ())
    Traceback (most recent call last):
    stream.errors.QueryError: COPY is refused: the store is only read here. What runs is SELECT (also ...
    """
    try:
        statements = connection.extract_statements(sql)
    except duckdb.Error as error:
        raise QueryError(plain_message(error)) from error
    if len(statements) != 1:
        raise QueryError(f"{len(statements)} statements found, one is expected: give them one at a time")
    try:
        kind, text = statements[0].type, statements[0].query
    except ValueError:  # a kind that DuckDB's parser knows and its list does not, as UPDATE EXTENSIONS
        raise _refused("this kind of statement") from None
    if kind == duckdb.StatementType.EXPLAIN:
        for inner in _explained(connection, text):
            check_statement(connection, inner, macros)
        return
    if kind != duckdb.StatementType.SELECT:
        raise _refused(kind.name)
    _check_tree(_tree(connection, text), {*TABLE_FUNCTIONS, *macros})


def plain_message(error: Exception) -> str:
    """What DuckDB says is wrong, on one line, without the place in the statement."""
    return " ".join(str(error).split("\n\nLINE")[0].split())


def _refused(what: str) -> QueryError:
    return QueryError(
        f"{what} is refused: the store is only read here. {_READS}; to keep a result use --csv or --parquet FILE"
    )


def _explained(connection: duckdb.DuckDBPyConnection, text: str) -> list[str]:
    """All that EXPLAIN may be explaining; DuckDB does not say where its options end, so each place is tried."""
    tokens = [begin for begin, kind in duckdb.tokenize(text) if kind != duckdb.token_type.comment]
    encoded = text.encode()
    found = []
    for begin in tokens[1:]:
        rest = encoded[begin:].decode(errors="replace")
        try:
            statements = connection.extract_statements(rest)
        except duckdb.Error:
            continue
        if len(statements) == 1:
            found.append(rest)
            if not rest.startswith("("):
                break  # the words after it belong to it
    if not found:
        raise _refused("EXPLAIN of this")
    return found


def _tree(connection: duckdb.DuckDBPyConnection, text: str) -> dict[str, Any]:
    try:
        ((row,),) = connection.execute("select json_serialize_sql(?::varchar)", [text]).fetchall()
    except duckdb.Error as error:
        raise QueryError(plain_message(error)) from error
    tree: dict[str, Any] = json.loads(row)
    if tree["error"]:
        raise QueryError(f"{tree.get('error_message', 'the statement cannot be parsed')}")
    return tree


def _check_tree(tree: dict[str, Any], functions: Collection[str]) -> None:
    for each in _objects(tree):
        kind = each.get("type")
        if not isinstance(kind, str):
            continue
        if kind.endswith("_NODE") and kind not in _NODES:
            raise _refused(f"{kind.removesuffix('_NODE').removesuffix('_QUERY')} inside of a statement")
        if kind == "TABLE_FUNCTION":
            name = str(each["function"].get("function_name", each["function"].get("type"))).lower()
            if name not in functions:
                raise _refused(f"the function {name}()")
        elif kind == "FUNCTION" and str(each.get("function_name")).lower() in REFUSED_FUNCTIONS:
            raise _refused(f"the function {each['function_name']}()")
        elif kind in {"BASE_TABLE", "SHOW_REF"}:
            _check_name(str(each.get("table_name") or ""))


def _check_name(name: str) -> None:
    """DuckDB takes a table's name that looks like a file's for that file."""
    if re.search(r"[./\\*?:\[]", name.strip('\\"')):
        raise _refused(f"the file {name}, and every other,")


def _objects(tree: Any) -> Iterator[dict[str, Any]]:
    waiting = [tree]
    while waiting:
        each = waiting.pop()
        if isinstance(each, dict):
            yield each
            waiting.extend(each.values())
        elif isinstance(each, list):
            waiting.extend(each)
