"""Users' statements read the store and do nothing else, within their limits."""

import hashlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from storage import open_store
from storage.sql.door import QueryLimits, SqlDoor
from storage.store import Store
from stream.errors import QueryError
from tests.storage import sql_corpus

pytestmark = pytest.mark.usefixtures("own_sandbox")

COUNT = "select count(*) as n from samples"
BY_COMMAND = [
    "explain analyze copy (select 42) to 'PLACE'",
    "explain analyze drop view samples",
    "create table t as select 1",
    "with x as (copy (select 42) to 'PLACE') from x",
    "with x as (delete from internal.lake_channels returning *) select * from x",
    "select 1; copy (select 42) to 'PLACE'",
    "from read_text('/etc/passwd')",
    "update extensions",
    "select * from no_such_table",
    "",
]


def digest(folder: Path) -> dict[str, tuple[int, str]]:
    """Every file below a folder: when it was written, and what it holds."""
    return {
        str(path.relative_to(folder)): (path.stat().st_mtime_ns, hashlib.sha256(path.read_bytes()).hexdigest())
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, run_command: Callable[..., Any]) -> Path:
    """Where a store S lies, of one unit and 300 samples."""
    folder = tmp_path_factory.mktemp("sql")
    lines = ["time[s],rate[deg/h],temperature[degC]", *(f"{i},{i % 7},{20 + i % 3}" for i in range(300))]
    (folder / "a.csv").write_text("\n".join(lines))
    done = run_command("import", "a.csv", "--unit", "G-1", "--run", "r1", "--store", "S", cwd=folder)
    assert done.code == 0, done.err
    return folder


@pytest.fixture(scope="module")
def place(folder: Path) -> Path:
    """A file of the lake."""
    return next((folder / "S" / "lake").glob("*/samples.parquet")).resolve()


@pytest.fixture
def unchanged(folder: Path) -> Iterator[None]:
    before = digest(folder)
    yield
    assert digest(folder) == before


@pytest.fixture
def store(folder: Path) -> Store:
    return Store.open(folder / "S")


@pytest.mark.long
@pytest.mark.parametrize("statement", BY_COMMAND)
def test_the_command_ends_with_2(
    statement: str, folder: Path, place: Path, run_command: Callable[..., Any], unchanged: None
) -> None:
    done = run_command("sql", statement.replace("PLACE", str(place)), "--store", "S", cwd=folder)
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith("error: ")


def test_nothing_of_the_corpus_is_answered(store: Store, folder: Path, place: Path, unchanged: None) -> None:
    answered = []
    with SqlDoor(store) as door:
        for statement in sql_corpus.statements(str(place), str(folder / "new")):
            try:
                door.ask(statement).read_all()
            except QueryError:
                continue
            answered.append(statement)
        assert answered == []
        assert door.ask(COUNT).read_all().to_pylist() == [{"n": 600}]


@pytest.mark.long
def test_without_landlock_the_rest_holds(store: Store, place: Path, unchanged: None) -> None:
    with SqlDoor(store, landlock=False) as door:
        assert door.ask(COUNT).read_all().to_pylist() == [{"n": 600}]
        assert door.is_enforced is False
        for statement in (*sql_corpus.BY_KIND["COPY"], *sql_corpus.WITHIN, *sql_corpus.FILES):
            with pytest.raises(QueryError):
                door.ask(statement.replace("PLACE", str(place))).read_all()


@pytest.mark.long
@pytest.mark.parametrize("statement", sql_corpus.ENDLESS)
def test_what_has_no_end_is_ended(statement: str, store: Store, unchanged: None) -> None:
    limits = QueryLimits(time_s=2.0, memory_bytes=256 << 20, rows=1_000_000)
    with SqlDoor(store, limits) as door:
        door.ask(COUNT).read_all()
        begun = time.monotonic()
        with pytest.raises(QueryError, match=r"may|ended after 2 s|more than 1,000,000 rows"):
            door.ask(statement).read_all()
        assert time.monotonic() - begun < 20  # the limit, and a machine at work on other things
        assert door.ask(COUNT).read_all().to_pylist() == [{"n": 600}]


def test_limits_are_options(folder: Path, run_command: Callable[..., Any]) -> None:
    def reported(*options: object) -> str:
        done = run_command("sql", *options, "--store", "S", cwd=folder)
        assert done.code == 2
        return str(done.err)

    assert "ended after 0.5 s" in reported(sql_corpus.ENDLESS[2], "--max-time", 0.5)
    assert "more memory than the 0.1 GiB" in reported(sql_corpus.ENDLESS[1], "--max-memory", 0.1)
    assert "more than 10 rows" in reported("from samples", "--max-rows", 10, "--csv")


@pytest.mark.long
def test_time_in_which_the_reader_rests_does_not_count(store: Store) -> None:
    with SqlDoor(store, QueryLimits(time_s=3.0)) as door:
        door.ask(COUNT).read_all()
        batches = door.ask("select range as i, repeat('x', 1000) as x from range(100000)").batches
        rows = next(batches).num_rows
        time.sleep(3.2)
        assert rows + sum(batch.num_rows for batch in batches) == 100_000


@pytest.mark.long
def test_a_result_that_is_left_does_not_reach_the_next_statement(store: Store) -> None:
    with SqlDoor(store) as door:
        batches = door.ask("from range(1000000)").batches
        next(batches)
        batches.close()
        assert door.ask(COUNT).read_all().to_pylist() == [{"n": 600}]


def test_an_output_among_the_files_of_the_store_is_refused(
    folder: Path, place: Path, run_command: Callable[..., Any], unchanged: None
) -> None:
    (segment,) = (folder / "S" / "log").glob("*.mcap")
    for words in (("select 1", "--parquet", place), ("select 1", "--parquet", segment), ("--catalogue", place)):
        done = run_command("sql", *words, "--store", "S", cwd=folder)
        assert done.code == 1
        assert "among the files of the store" in done.err


@pytest.mark.long
def test_python_asks_through_the_same_door(folder: Path, place: Path, tmp_path: Path) -> None:
    """A store as it was when it was opened, whatever happens to it or to a statement."""
    copy = tmp_path / "S"
    shutil.copytree(folder / "S", copy)
    with open_store(copy, QueryLimits(time_s=4.0)) as opened:
        manifest = copy / "lake" / "manifest.json"
        hidden = manifest.read_bytes()
        manifest.unlink()
        asked = "select signal, count(*) as n from samples where signal = $signal group by 1"
        assert opened.sql(asked, {"signal": "rate"}).rows() == [{"signal": "rate", "n": 300}]
        with pytest.raises(QueryError, match="COPY is refused"):
            opened.sql(f"explain analyze copy (select 42) to '{place}'")
        with pytest.raises(QueryError, match="ended after 4 s"):
            opened.sql(sql_corpus.ENDLESS[2])
        assert opened.sql(COUNT).polars()["n"].to_list() == [600]
        manifest.write_bytes(hidden)


@pytest.mark.long
def test_metrics_are_computed_and_kept_once(bias_store: Path, run_command: Callable[..., Any]) -> None:
    """The process of a statement cannot write; who starts it computes and keeps what is lacking."""
    asked = ("sql", "select metric from unit_metrics where value is not null", "--json", "--store", bias_store)
    first = run_command(*asked, cwd=bias_store.parent)
    assert first.code == 0, first.err
    assert first.json
    kept = digest(bias_store / "metrics")
    assert set(kept) >= {"steps.parquet", "unit_metrics.parquet"}
    assert run_command(*asked, cwd=bias_store.parent).json == first.json
    assert digest(bias_store / "metrics") == kept


@pytest.fixture
def bias_store(tmp_path: Path, run_command: Callable[..., Any]) -> Path:
    lines = ["time[s],rate[deg/h],procedure,step", *(f"{i},{i % 7},static_bias,1" for i in range(400))]
    (tmp_path / "b.csv").write_text("\n".join(lines))
    done = run_command("import", "b.csv", "--unit", "G-1", "--run", "r1", "--store", "S", cwd=tmp_path)
    assert done.code == 0, done.err
    return tmp_path / "S"


@pytest.mark.long
def test_the_process_ends_with_who_asks(folder: Path) -> None:
    script = """
import sys
from pathlib import Path
from storage.sql.door import SqlDoor
from storage.store import Store
with SqlDoor(Store.open(Path(sys.argv[1]))) as door:
    door.ask("select 1").read_all()
    print(door._process._process.pid, flush=True)
    door.ask("select count(*) from range(100000000000) a, range(1000) b").read_all()
"""
    with subprocess.Popen(
        [sys.executable, "-P", "-c", script, str(folder / "S")], stdout=subprocess.PIPE, text=True
    ) as asking:
        assert asking.stdout is not None
        child = int(asking.stdout.readline())
        time.sleep(0.5)
        os.kill(child, 0)
        asking.send_signal(signal.SIGKILL)
        asking.wait()
    until = time.monotonic() + 10
    while Path(f"/proc/{child}/stat").exists() and " Z " not in Path(f"/proc/{child}/stat").read_text():
        assert time.monotonic() < until, "it is still at work"
        time.sleep(0.05)
