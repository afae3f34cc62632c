"""Which statements are allowed: those that only read views, by the tree of DuckDB's own parser.

The kind of a statement is not enough: EXPLAIN ANALYZE runs what it explains, and the WITH of a SELECT may contain
DELETE or COPY.
"""

import json
import re
from collections.abc import Collection, Iterator
from typing import Any

import duckdb

from stream.errors import QueryError

_NODES = {"SELECT_NODE", "SET_OPERATION_NODE", "RECURSIVE_CTE_NODE", "CTE_NODE"}
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
"""Table functions of DuckDB that read only the statement and the catalogue."""
REFUSED_FUNCTIONS = frozenset({"currval", "nextval", "pg_sleep", "setseed", "setval", "sleep_ms", "write_log"})
"""Scalar functions with side effects."""


def check_statement(connection: duckdb.DuckDBPyConnection, sql: str, macros: Collection[str]) -> set[str]:
    """Refuse, by a QueryError, everything but one statement that only reads the store; returns the tables it names.

    Its parser is that of `connection`; `macros` are the store's own table macros.

    >>> connection = duckdb.connect()
    >>> check_statement(connection, "explain analyze select * from Runs", ())
    {'runs'}
    >>> check_statement(connection, "explain analyze copy (select 1) to 'x'", ())
    Traceback (most recent call last):
    storage.sql.sandbox.guard._Refused: COPY is refused: the store is only read here. What runs is SELECT (also ...
    """
    try:
        statement = one_statement(connection, sql)
    except duckdb.Error as error:
        raise QueryError(plain_message(error)) from error
    try:
        kind, text = statement.type, statement.query
    except ValueError:  # a kind without a name in the list, as UPDATE EXTENSIONS
        raise refused("this kind of statement") from None
    if kind == duckdb.StatementType.EXPLAIN:
        inner = [check_statement(connection, each, macros) for each in _explained(connection, text)]
        return {name for names in inner for name in names}
    if kind != duckdb.StatementType.SELECT:
        raise refused(kind.name)
    return _check_tree(_tree(connection, text), {*TABLE_FUNCTIONS, *macros})


def one_statement(connection: duckdb.DuckDBPyConnection, sql: str) -> duckdb.Statement:
    """The statement in a text; QueryError if there is not exactly one."""
    statements = connection.extract_statements(sql)
    if len(statements) != 1:
        raise QueryError(f"{len(statements)} statements found, one is expected: give them one at a time")
    return statements[0]


def plain_message(error: Exception) -> str:
    """DuckDB's error message on one line, without the position in the statement and the places in its own code."""
    return " ".join(re.split(r"\n\nLINE|\s+Stack Trace:", str(error))[0].split())


class _Refused(QueryError):
    """A statement that does more than read."""


def refused(what: str) -> QueryError:
    """The error of a statement that does more than read; the door adds how a result is kept."""
    return _Refused(
        f"{what} is refused: the store is only read here. What runs is SELECT (also WITH, FROM, DESCRIBE, SUMMARIZE, "
        "EXPLAIN)"
    )


def _explained(connection: duckdb.DuckDBPyConnection, text: str) -> list[str]:
    """Every statement that EXPLAIN may contain; each position is tried, since the end of its options is not known."""
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
                break  # what follows belongs to it
    if not found:
        raise refused("EXPLAIN of this")
    return found


def _tree(connection: duckdb.DuckDBPyConnection, text: str) -> dict[str, Any]:
    try:
        ((row,),) = connection.execute("select json_serialize_sql(?::varchar)", [text]).fetchall()
    except duckdb.Error as error:
        raise QueryError(plain_message(error)) from error
    try:
        tree: dict[str, Any] = json.loads(row)
    except RecursionError:
        raise QueryError("the statement is nested too deeply; write its inner parts with WITH") from None
    if tree["error"]:
        raise QueryError(f"{tree.get('error_message', 'the statement cannot be parsed')}")
    return tree


def _check_tree(tree: dict[str, Any], functions: Collection[str]) -> set[str]:
    tables: set[str] = set()
    for each in _objects(tree):
        kind = each.get("type")
        if not isinstance(kind, str):
            continue
        if kind.endswith("_NODE") and kind not in _NODES:
            raise refused(f"{kind.removesuffix('_NODE').removesuffix('_QUERY')} inside of a statement")
        if kind == "TABLE_FUNCTION":
            name = str(each["function"].get("function_name", each["function"].get("type"))).lower()
            if name not in functions:
                raise refused(f"the function {name}()")
        elif kind == "FUNCTION" and str(each.get("function_name")).lower() in REFUSED_FUNCTIONS:
            raise refused(f"the function {each['function_name']}()")
        elif kind in {"BASE_TABLE", "SHOW_REF"}:
            name = str(each.get("table_name") or "")
            if re.search(r"[./\\*?:\[]", name.strip('\\"')):  # DuckDB would read it as a file name
                raise refused(f"the file {name}, and every other,")
            tables.add(name.strip('\\"').lower())
    return tables


def _objects(tree: Any) -> Iterator[dict[str, Any]]:
    waiting = [tree]
    while waiting:
        each = waiting.pop()
        if isinstance(each, dict):
            yield each
            waiting.extend(each.values())
        elif isinstance(each, list):
            waiting.extend(each)
