"""What `gyrofleet sql` prints and writes: rows as they come, a closed pipe, and a catalogue for other clients."""

import json
import os
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import duckdb
import pytest

from storage.sql.catalog import known_tables
from storage.sql.views import VIEWS

ROWS = 200_000
MANY = f"select i, repeat('x', 600) as text from range({ROWS}) t(i)"
CLOSED = 128 + signal.SIGPIPE


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, run_command: Callable[..., Any]) -> Path:
    """Where a store S lies, of one unit and 300 samples."""
    folder = tmp_path_factory.mktemp("output")
    lines = ["time[s],rate[deg/h]", *(f"{i},{i % 7}" for i in range(300))]
    (folder / "a.csv").write_text("\n".join(lines))
    done = run_command("import", "a.csv", "--unit", "G-1", "--run", "r1", "--store", "S", cwd=folder)
    assert done.code == 0, done.err
    return folder


@pytest.fixture
def start(folder: Path, command_line: Callable[..., list[str]]) -> Callable[..., subprocess.Popen[bytes]]:
    def start(*words: object, stdout: Any = subprocess.PIPE) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            command_line(*words, "--store", "S"), cwd=folder, stdout=stdout, stderr=subprocess.PIPE, bufsize=0
        )

    return start


def peak_mb(process: "subprocess.Popen[bytes]") -> float:
    """Memory that a process, or one that it started, took at most."""
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    assert process.stderr is not None
    assert process.stderr.read() == b""
    process.stderr.close()
    return usage.ru_maxrss / 1024


@pytest.mark.long
@pytest.mark.parametrize("form", ["--json", pytest.param("--csv", marks=pytest.mark.long)])
def test_many_rows_take_the_memory_of_few(
    form: str, start: Callable[..., "subprocess.Popen[bytes]"], tmp_path: Path
) -> None:
    peaks = []
    for statement in (MANY.replace(str(ROWS), "20000"), MANY):
        with (tmp_path / "out").open("wb") as out, start("sql", statement, form, stdout=out) as process:
            peaks.append(peak_mb(process))
            assert process.returncode == 0
    content = (tmp_path / "out").read_bytes()
    assert len(content) > 120_000_000
    assert content.count(b"x" * 600) == ROWS
    assert peaks[1] - peaks[0] < 80
    if form == "--json":
        assert content.startswith(b'[{"i":0,"text":"xxx')
        assert content.endswith(b'x"}]\n')


@pytest.mark.long
@pytest.mark.parametrize(
    ("statement", "rows"),
    [
        ("select 1 as a, null as b where false", []),
        ("select i, [i, 2] as both, 'a\"b' as text, 0.5::decimal(9, 3) as d, 'nan'::double as n from range(2) t(i)",
         [{"i": i, "both": [i, 2], "text": 'a"b', "d": 0.5, "n": None} for i in range(2)]),
        ("select i, i as i from range(40000) t(i)", [{"i": i, "i_2": i} for i in range(40_000)]),
    ],
)  # fmt: skip
def test_json_is_one_array(
    statement: str, rows: list[dict[str, Any]], folder: Path, run_command: Callable[..., Any]
) -> None:
    done = run_command("sql", statement, "--json", "--store", "S", cwd=folder)
    assert (done.code, done.err, done.out.count("\n")) == (0, "", 1)
    assert done.json == rows


def test_csv_tells_null_an_empty_text_and_nan_apart(folder: Path, run_command: Callable[..., Any]) -> None:
    """RFC 4180: DuckDB and others read the empty cell as null, the quoted one as a text."""
    statement = "select * from (values (null, 1.5::double), ('', 'nan'), ('a,\"b', null)) t(text, n)"
    done = run_command("sql", statement, "--csv", "--store", "S", cwd=folder)
    assert done.out.splitlines() == ["text,n", ",1.5", '"",nan', '"a,""b",']


def test_a_failure_before_the_first_megabytes_is_the_whole_json(folder: Path, run_command: Callable[..., Any]) -> None:
    done = run_command("sql", MANY, "--json", "--max-rows", 10_000, "--store", "S", cwd=folder)
    assert done.code == 2
    assert done.json["error"]["kind"] == "QueryError"


@pytest.mark.long
def test_a_failure_after_them_leaves_the_array_open(folder: Path, run_command: Callable[..., Any]) -> None:
    done = run_command("sql", MANY, "--json", "--max-rows", 100_000, "--store", "S", cwd=folder)
    assert done.code == 2
    assert "more than 100,000 rows" in done.err
    assert "the JSON array is incomplete" in done.err
    with pytest.raises(json.JSONDecodeError):
        json.loads(done.out)


@pytest.mark.long
@pytest.mark.parametrize(
    "words", [("sql", MANY, "--csv"), ("sql", MANY, "--json"), ("sql", "--tables"), ("runs",), ("verify",)]
)
def test_a_closed_pipe_ends_a_command_quietly(
    words: tuple[str, ...], start: Callable[..., "subprocess.Popen[bytes]"]
) -> None:
    if words == ("runs",):
        words = ("sql", "from runs")
    with start(*words) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        if MANY in words:
            assert process.stdout.read(100)
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == CLOSED


@pytest.mark.long
def test_tables_are_those_for_users(folder: Path, run_command: Callable[..., Any]) -> None:
    shown = run_command("sql", "show tables", "--json", "--store", "S", cwd=folder)
    assert sorted(row["name"] for row in shown.json) == sorted(VIEWS)
    listed = run_command("sql", "--tables", "--json", "--store", "S", cwd=folder)
    assert [row["table"] for row in listed.json] == known_tables()
    assert all(row["what"] for row in listed.json)


@pytest.mark.parametrize("each", [3, pytest.param(1, marks=pytest.mark.long)])  # of the tables that are read
def test_the_catalogue_opens_anywhere_and_in_older_duckdb(
    folder: Path, run_command: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, each: int
) -> None:
    path = tmp_path / "catalogue.duckdb"
    done = run_command("sql", "--catalogue", path, "--store", "S", cwd=folder)
    assert (done.code, done.out) == (0, "")
    assert done.err == f"written to {path}: DuckDB 1.3 or later opens it, its view samples needs DuckDB 2.0\n"
    monkeypatch.chdir(tmp_path)
    with duckdb.connect("catalogue.duckdb", read_only=True) as plain:
        assert [name for (name,) in plain.sql("show tables").fetchall()] == sorted(known_tables())
        for table in known_tables()[::each]:
            plain.sql(f"select * from {table}").fetchall()
        assert plain.sql("select count(*) from samples").fetchall() == [(300,)]
        (tags,) = plain.sql("select tags from duckdb_databases() where database_name = 'catalogue'").fetchall()
        assert tags[0]["storage_version"] == "v1.0.0+"
