"""Every door for SQL against the corpus of hostile statements: nothing written, nothing read outside, all bounded.

`tests/storage/sql/hostile.jsonl` has a statement a line, what it tries, and what comes of it: ``refused``, ``answers``
(it reads the store or its own text), or ``bounded`` (it is ended by a limit, fails, or answers within it). SECRET is a
file beside the store, PLACE one in it, OUT none.
"""

import hashlib
import json
import os
import resource
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import httpx
import pytest

from analytics.serve.doors.roles import Role
from analytics.serve.doors.users_file import add_program
from storage.sql.door import QueryLimits, SqlDoor
from storage.store import Store
from stream.errors import QueryError
from tests.analytics.serve.conftest import TOKEN, start
from tests.forked_commands import SERVER_LIMITS, CommandServer
from tests.storage.sql_corpus import oversized

pytestmark = pytest.mark.usefixtures("own_sandbox")

CORPUS = Path(__file__).parents[1] / "storage" / "sql" / "hostile.jsonl"
OF_FILE, OF_ENVIRONMENT = "s3cr3t-of-a-file", "s3cr3t-of-the-environment"
LIMITS = QueryLimits(time_s=2.0, memory_bytes=256 << 20, rows=100_000)
PATIENCE_S = 20.0  # for a statement of 2 s, on a machine at work on other things
PARTS = 4  # of the corpus, to be asked beside each other: each command is a process and starts another
PROGRAMS = 20  # who may ask 60 statements each at once


class Hostile(NamedTuple):
    """A line of the corpus."""

    tries: str
    outcome: str
    sql: str


def corpus() -> list[Hostile]:
    lines = CORPUS.read_text(encoding="utf-8").splitlines()
    return [
        *(Hostile(**json.loads(line)) for line in lines),
        *(Hostile("size", "bounded", each) for each in oversized()),
    ]


def sample(every: int) -> list[Hostile]:
    """Every so many of each kind, without those that run into a limit of time or memory."""
    quick = [each for each in corpus() if each.tries not in ("memory", "time", "size")]
    return quick[::every]


class Room:
    """A store, a secret file beside it, and what both were."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.store = folder / "S"
        self._place = next((self.store / "lake").glob("*/samples.parquet")).resolve()
        self._before = self._digest()

    def filled(self, sql: str) -> str:
        words = {"SECRET": self.folder / "secret.csv", "PLACE": self._place, "OUT": self.folder / "new"}
        for word, path in words.items():
            sql = sql.replace(word, str(path))
        return sql

    def check(self, hostile: Hostile, is_answered: bool, shown: str, seconds: float) -> None:
        """Judge one answer."""
        assert OF_FILE not in shown, hostile
        assert OF_ENVIRONMENT not in shown, hostile
        assert "root:x:0" not in shown, hostile
        assert seconds < PATIENCE_S, hostile
        if hostile.outcome != "bounded":
            assert is_answered == (hostile.outcome == "answers"), (hostile, shown[:500])

    def check_unchanged(self) -> None:
        """Nothing was written, here or in a folder of statements."""
        assert self._digest() == self._before

    def _digest(self) -> dict[str, tuple[int, str]]:
        own = [self.folder / "users.toml", *self.store.glob("status/*")]  # of this test, and of the server itself
        paths = [path for path in sorted(self.folder.rglob("*")) if path.is_file() and path not in own]
        return {str(path): (path.stat().st_mtime_ns, hashlib.sha256(path.read_bytes()).hexdigest()) for path in paths}


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory, run_command: Callable[..., Any]) -> Iterator[Room]:
    folder = tmp_path_factory.mktemp("hostile")
    (folder / "secret.csv").write_text(f"content\n{OF_FILE}\n")
    lines = ["time[s],rate[deg/h],temperature[degC]", *(f"{i},{i % 7},{20 + i % 3}" for i in range(300))]
    (folder / "a.csv").write_text("\n".join(lines))
    done = run_command("import", "a.csv", "--unit", "G-1", "--run", "r1", "--store", "S", cwd=folder)
    assert done.code == 0, done.err
    assert run_command("metrics", "--store", "S", cwd=folder).code == 0  # else the server computes and keeps them
    (folder / "a.csv").unlink()
    made = Room(folder)
    os.environ["HOSTILE_SECRET"] = OF_ENVIRONMENT
    yield made
    del os.environ["HOSTILE_SECRET"]
    made.check_unchanged()


def test_the_corpus_has_five_hundred_statements_of_every_kind() -> None:
    found = corpus()
    assert len({each.sql for each in found}) == len(found) >= 500
    assert {each.outcome for each in found} == {"refused", "answers", "bounded"}
    kinds = {
        "file function",
        "replacement scan",
        "more than reading",
        "hidden",
        "memory",
        "time",
        "size",
        "system",
        "reading",
    }
    assert {each.tries for each in found} == kinds
    assert {each.outcome for each in found if each.tries in ("file function", "hidden")} <= {"refused", "answers"}


def ask_all(room: Room, door: SqlDoor, statements: list[Hostile]) -> None:
    for hostile in statements:
        begun, shown = time.monotonic(), ""
        try:
            for batch in door.ask(room.filled(hostile.sql)).batches:
                shown += str(batch.slice(0, 1000).to_pydict()) if len(shown) < 1 << 20 else ""
            is_answered = True
        except QueryError as error:
            is_answered, shown = False, shown + str(error)
        room.check(hostile, is_answered, shown, time.monotonic() - begun)
        if hostile.outcome == "bounded":
            assert door.ask("select 1 as one").read_all().to_pylist() == [{"one": 1}], (
                f"nobody is answered after {hostile}"
            )
    room.check_unchanged()


@pytest.mark.long
@pytest.mark.parametrize("landlock", [True, False], ids=["both walls", "without Landlock"])
def test_python(room: Room, landlock: bool) -> None:
    """Without Landlock, as on an older kernel, the other guards refuse the same."""
    with SqlDoor(Store.open(room.store), LIMITS, landlock=landlock) as door:
        ask_all(room, door, sample(2))


@pytest.mark.long
def test_an_error_within_duckdb_ends_its_process_and_no_other_statement(room: Room) -> None:
    """It calls its database invalid from then on; who asked next was refused, on pages everybody."""
    fatal = Hostile("memory", "bounded", "select reservoir_quantile(i, 0.5, 1000000000) from range(1000) t(i)")
    with SqlDoor(Store.open(room.store), LIMITS) as door:
        ask_all(room, door, [fatal, fatal])


@pytest.mark.long
def test_python_all(room: Room) -> None:
    with SqlDoor(Store.open(room.store), LIMITS) as door:
        ask_all(room, door, corpus())
    most_bytes = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024
    assert most_bytes < (2 << 30), "the limit, what is slack beside it, and the libraries"


def by_command(room: Room, run_command: Callable[..., Any], statements: list[Hostile]) -> None:
    limits = ("--max-time", LIMITS.time_s, "--max-memory", LIMITS.memory_bytes / 2**30, "--max-rows", LIMITS.rows)
    for number, hostile in enumerate(statements):
        sql = room.filled(hostile.sql)
        if "\0" in sql or len(sql.encode()) > 100_000:
            continue  # no argument of a process holds it
        form = ("--json", "--csv", "")[number % 3]
        chosen = limits if hostile.outcome == "bounded" else ()
        begun = time.monotonic()
        done = run_command("sql", *filter(None, [form]), *chosen, "--store", "S", "--", sql, cwd=room.folder)
        room.check(hostile, done.code == 0, done.out[: 1 << 20] + done.err, time.monotonic() - begun)
        assert done.code in (0, 2), (hostile, done.err)
    room.check_unchanged()


def test_command_line(room: Room, run_command: Callable[..., Any]) -> None:
    by_command(room, run_command, sample(90))


@pytest.mark.long
@pytest.mark.parametrize("part", range(PARTS))
def test_command_line_all(room: Room, run_command: Callable[..., Any], part: int) -> None:
    by_command(room, run_command, corpus()[part::PARTS])


class Asking:
    """A server over the store, with enough programs that none asks too often."""

    def __init__(self, url: str, tokens: list[str]) -> None:
        self._clients = [
            httpx.Client(base_url=url, headers={"Authorization": f"Bearer {token}"}, timeout=120.0) for token in tokens
        ]
        self._asked = 0

    def post(self, path: str, **body: Any) -> httpx.Response:
        self._asked += 1
        return self._clients[self._asked // 50 % len(self._clients)].post(path, **body)

    def close(self) -> None:
        for each in self._clients:
            each.close()


@pytest.fixture(scope="module")
def asking(room: Room, command_server: CommandServer) -> Iterator[Asking]:
    tokens = [add_program(room.folder / "users.toml", f"p{number}", Role.APPROVER) for number in range(PROGRAMS)]
    words = ("--store", "S", "--port", 0, "--token", TOKEN, "--users", "users.toml")
    # its own 30 s would be waited for sixty times; what a statement does to the server at those, test_sql_api asks
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(SERVER_LIMITS, json.dumps(LIMITS._asdict()))
        process, ready = start(command_server, *words, cwd=room.folder)
    found = Asking(ready["url"], [TOKEN, *tokens])
    yield found
    found.close()
    process.terminate()
    _, err = process.communicate(timeout=60)
    assert "Traceback" not in err, err


def over_http(room: Room, asking: Asking, statements: list[Hostile], *, page: bool) -> None:
    for hostile in statements:
        sql, begun = room.filled(hostile.sql), time.monotonic()
        if page:
            answer = asking.post("/sql", data={"sql": sql}, headers={"Accept": "text/html"})
            is_answered = 'id="result-title"' in answer.text
        else:
            answer = asking.post("/api/sql", json={"sql": sql, "rows": 1000})
            is_answered = answer.status_code == 200
        assert answer.status_code < 500, (hostile, answer.text[:500])
        assert answer.status_code != 429, hostile
        room.check(hostile, is_answered, answer.text[: 1 << 20], time.monotonic() - begun)
    room.check_unchanged()


@pytest.mark.long
@pytest.mark.parametrize("page", [False, True], ids=["API", "page"])
def test_server(room: Room, asking: Asking, page: bool) -> None:
    over_http(room, asking, sample(40), page=page)


@pytest.mark.long
@pytest.mark.parametrize("page", [False, True], ids=["API", "page"])
def test_server_all(room: Room, asking: Asking, page: bool) -> None:
    over_http(room, asking, corpus(), page=page)
