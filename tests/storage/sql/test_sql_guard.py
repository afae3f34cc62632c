"""Statements are judged by what they hold, not by how they begin."""

import subprocess
import sys
from pathlib import Path

import duckdb
import pytest

from storage.sql.sandbox.guard import TABLE_FUNCTIONS, check_statement
from storage.sql.sandbox.landlock import landlock_version
from stream.errors import QueryError
from tests.sources import SOURCES
from tests.storage import sql_corpus

READS = [
    "select 1", "from samples", "select * from samples s join signals using (unit) where value > 1.5",
    "describe samples", "summarize samples", "show tables", "explain select 1", "explain analyze from samples",
    "explain (select 1)", "explain (analyze, format json) (select 1)", "with x as (select 1) from x",
    "with recursive r as (select 1 as x union all select x + 1 from r where x < 3) from r",
    "select unnest(range(3))", "from range(3)", "values (1)", "select 1 union from range(2);", "from adev('U', 'rate')",
    "select * from (pivot samples on unit in ('a') using sum(value))", "select 'a.csv', \"x.y\" from samples",
    "from samples tablesample 10 percent", "select document->>'$.a' from events, json_each(document)",
    "explain analyze select 'copy (select 1) to ''x'''", "-- copy (select 1) to 'x'\nselect 1",
]  # fmt: skip


def test_the_corpus_has_every_kind_of_statement() -> None:
    """A kind that a later DuckDB adds must be looked at here."""
    kinds = {*sql_corpus.BY_KIND, *sql_corpus.READING, *sql_corpus.WITHOUT_TEXT}
    assert kinds == set(duckdb.StatementType.__members__)
    connection = duckdb.connect()
    for kind, texts in sql_corpus.BY_KIND.items():
        found = {_kind(connection, text) for text in texts}
        assert kind in found, kind


def _kind(connection: duckdb.DuckDBPyConnection, text: str) -> str:
    try:
        return str(connection.extract_statements(text)[0].type.name)
    except ValueError:
        return "one that the list lacks"


def test_functions_that_are_let_through_are_there_and_take_no_file() -> None:
    rows = duckdb.connect().execute(
        "select function_name, flatten(list(parameters)) from duckdb_functions() where function_type in "
        "('table', 'table_macro') group by 1"
    )
    known = dict(rows.fetchall())
    assert set(known) >= TABLE_FUNCTIONS
    of_files = {"paths", "file", "files", "filename", "pattern", "storage_path", "save_location"}
    assert [name for name in TABLE_FUNCTIONS if of_files.intersection(known[name])] == []
    assert [name for name in TABLE_FUNCTIONS if "path" in known[name]] in (
        ["json_each", "json_tree"],  # of JSON
        ["json_tree", "json_each"],
    )


def test_nothing_of_the_corpus_passes_the_check() -> None:
    connection = duckdb.connect()
    passed = []
    for statement in sql_corpus.statements("/store/lake/1/samples.parquet", "/store/lake/new"):
        try:
            check_statement(connection, statement, ())
        except QueryError:
            continue
        passed.append(statement)
    assert passed == []


@pytest.mark.parametrize(
    "statement",
    ["from " + "(from " * 900 + "range(3)" + ")" * 900, "select " + "case when 1 = 1 then " * 900 + "1" + " end" * 900],
    ids=["from", "case"],
)
def test_what_is_nested_too_deeply_is_said_to_be(statement: str) -> None:
    with pytest.raises(QueryError, match=r"nested too deeply|depth"):
        check_statement(duckdb.connect(), statement, ())


@pytest.mark.long
@pytest.mark.parametrize("statement", READS)
def test_what_reads_passes(statement: str) -> None:
    check_statement(duckdb.connect(), statement, ("adev",))


@pytest.mark.skipif(landlock_version() == 0, reason="this kernel has no Landlock")
def test_the_kernel_alone_lets_nothing_be_written(tmp_path: Path) -> None:
    """DuckDB without any of its own guards, behind Landlock: what the other guards would overlook."""
    place = tmp_path / "samples.parquet"
    place.write_bytes(b"as it was")
    script = """
import sys
from pathlib import Path
from storage.sql.sandbox.landlock import allow_reading_only
from storage.sql.sandbox.child import system_paths
assert allow_reading_only(Path(each) for each in (sys.argv[1], *system_paths()))
import duckdb
connection = duckdb.connect()
print(connection.execute("select size from read_text(?)", [sys.argv[2]]).fetchall())
for statement in (
    f"copy (select range from range(1000000)) to '{sys.argv[2]}'",
    f"copy (select 1) to '{sys.argv[1]}/new.csv'",
    f"copy (select range from range(1000000)) to '{sys.argv[1]}/many' (format csv, per_thread_output)",
    f"explain analyze copy (select 1) to '{sys.argv[2]}'",
    f"export database '{sys.argv[1]}/exported'",
    f"attach '{sys.argv[1]}/other.db' as other; create table other.t as select 1; checkpoint other",
    "from read_text('/etc/passwd')",
):
    try:
        connection.execute(statement).fetchall()
    except duckdb.Error as error:
        assert "Permission denied" in str(error) or "No files found" in str(error), error
    else:
        print("written:", statement)
"""
    command = [sys.executable, "-P", "-c", script, str(tmp_path), str(place)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=SOURCES)
    assert (done.returncode, done.stdout, done.stderr) == (0, "[(9,)]\n", "")
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("samples.parquet", b"as it was")]
