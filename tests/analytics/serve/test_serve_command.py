"""The commands `gyrofleet serve` and `gyrofleet users`: what they refuse, what they print, how they end."""

import json
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.analytics.serve.conftest import start
from tests.forked_commands import CommandServer

Run = Callable[..., Any]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, run_command: Run) -> Path:
    """A folder with a small store S."""
    found = tmp_path_factory.mktemp("command")
    (found / "a.csv").write_text("time[s],rate[deg/h]\n" + "".join(f"{i},{i % 5}\n" for i in range(100)))
    done = run_command("import", "a.csv", "--unit", "G-1", "--store", "S", cwd=found)
    assert done.code == 0, done.err
    return found


@pytest.mark.long
@pytest.mark.parametrize(
    ("words", "message", "code"),
    [
        (("--host", "0.0.0.0"), "needs users (--users FILE", 2),
        (("--host", "0.0.0.0", "--users", "users.toml"), "needs TLS (--certificate", 2),
        (("--host", "192.0.2.1", "--certificate", "none.pem", "--key", "none.pem"), "there is no such file", 2),
        (("--certificate", "a.csv"), "belong together", 2),
        (("--host", "not-a-host", "--trust-network"), "cannot listen", 1),
        (("--users", "missing.toml"), "missing.toml", 2),
        (("--users", "a.csv"), "a.csv", 2),
        (("--store", "nowhere"), "nowhere is not a gyrofleet store", 1),
    ],
)
def test_what_it_refuses(folder: Path, run_command: Run, words: tuple[str, ...], message: str, code: int) -> None:
    (folder / "users.toml").write_text("[users]\n")
    store = () if "--store" in words else ("--store", "S")
    done = run_command("serve", *store, "--port", 0, *words, "--json", cwd=folder)
    assert done.code == code, done.out
    assert message in done.json["error"]["message"]


def test_a_port_that_is_taken_is_named(folder: Path, run_command: Run) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        done = run_command("serve", "--store", "S", "--port", port, cwd=folder)
    assert done.code == 1
    assert f"port {port}" in done.err
    assert "--port" in done.err


@pytest.mark.long
def test_ctrl_c_ends_it_at_once_while_pages_listen(folder: Path, command_server: CommandServer) -> None:
    process, ready = start(command_server, "--store", "S", "--port", 0, cwd=folder)
    # the address that it prints logs a browser in
    with httpx.Client(base_url=ready["url"], timeout=30) as browser:
        entered = browser.get(ready["login"])
        assert entered.status_code == 200
        assert browser.get("/api/me").json() | {"csrf": ""} == {"name": "token", "role": "approver", "csrf": ""}
        with browser.stream("GET", "/api/live") as stream:
            lines = stream.iter_lines()
            while not next(lines).startswith("data"):
                pass
            began = time.monotonic()
            process.send_signal(signal.SIGINT)
            assert list(lines) is not None  # the stream ends
    out, err = process.communicate(timeout=20)
    assert time.monotonic() - began < 3.0
    assert process.returncode == 0
    # the one thing that happened
    assert len(err.splitlines()) == 1
    assert err.endswith(" login from 127.0.0.1: the token, approver\n")
    assert json.loads(out)["event"] == "ended"


@pytest.mark.long
def test_a_request_in_the_middle_is_answered_as_it_ends(folder: Path, command_server: CommandServer) -> None:
    process, ready = start(command_server, "--store", "S", "--port", 0, "--token", "T", cwd=folder)
    answers: list[httpx.Response] = []

    def ask() -> None:
        sql = "select count(*) from range(100000000000) a where a.range % 7 = 3"
        headers = {"Authorization": "Bearer T"}
        answers.append(httpx.post(f"{ready['url']}/api/sql", json={"sql": sql}, headers=headers, timeout=60.0))

    asking = threading.Thread(target=ask)
    asking.start()
    time.sleep(1.0)
    began_s = time.monotonic()
    process.terminate()
    _, err = process.communicate(timeout=30)
    asking.join(timeout=30)
    assert process.returncode == 0, err
    assert time.monotonic() - began_s < 10
    assert "Traceback" not in err
    assert answers[0].status_code == 503
    assert answers[0].json()["error"]["kind"] == "Stopping"


def test_two_signals_at_once_are_one_end(folder: Path, command_server: CommandServer) -> None:
    process, _ = start(command_server, "--store", "S", "--port", 0, "--token", "T", cwd=folder)
    for number in (signal.SIGINT, signal.SIGTERM):  # Ctrl-C, and the program that started it passes the end on
        process.send_signal(number)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 0, err
    assert "Traceback" not in err


@pytest.mark.long
def test_users_come_and_go_while_it_runs(folder: Path, command_server: CommandServer, run_command: Run) -> None:
    users = ("--users", "people.toml")
    added = run_command("users", "add", "dashboard", "--role", "viewer", "--program", *users, "--json", cwd=folder)
    token = added.json["token"]
    assert token not in (folder / "people.toml").read_text()
    assert (folder / "people.toml").stat().st_mode & 0o077 == 0
    process, ready = start(command_server, "--store", "S", "--port", 0, *users, cwd=folder)
    try:
        with httpx.Client(base_url=ready["url"], timeout=30, headers={"Authorization": f"Bearer {token}"}) as client:
            assert client.get("/api/me").json()["role"] == "viewer"
            words = ("users", "add", "li", "--role", "engineer", "--password-stdin", *users)
            person = subprocess.run(
                [sys.executable, "-m", "gyrofleet", *words], input="a password of length\n", cwd=folder,
                capture_output=True, text=True, timeout=60,
            )  # fmt: skip
            assert person.returncode == 0, person.stderr
            listed = run_command("users", "list", *users, "--json", cwd=folder).json
            assert listed == [
                {"user": "dashboard", "role": "viewer", "kind": "program"},
                {"user": "li", "role": "engineer", "kind": "person"},
            ]
            with httpx.Client(base_url=ready["url"], timeout=30) as browser:
                fields = {"name": "li", "password": "a password of length"}
                assert browser.post("/login", data=fields).status_code == 200
                assert browser.get("/api/me").json()["role"] == "engineer"
                assert run_command("users", "remove", "li", *users, cwd=folder).code == 0
                assert browser.get("/api/me").status_code == 401
            assert client.get("/api/me").status_code == 200
    finally:
        process.terminate()
        process.communicate(timeout=20)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("add", "a/b", "--role", "viewer", "--program"), "cannot be a user's name"),
        (("remove", "nobody"), "no user 'nobody'"),
        (("list", "--users", "absent.toml"), "there is no file absent.toml"),
    ],
)
def test_users_that_cannot_be(folder: Path, run_command: Run, words: tuple[str, ...], message: str) -> None:
    done = run_command("users", *words, "--json", cwd=folder)
    assert done.code == 1
    assert message in done.json["error"]["message"]


@pytest.mark.long
def test_without_the_extra_a_sentence_names_it(folder: Path) -> None:
    program = "import sys; sys.modules['starlette'] = None\nimport gyrofleet\ngyrofleet.main(['serve', '--store', 'S'])"
    done = subprocess.run([sys.executable, "-c", program], cwd=folder, capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    assert "pip install 'gyrofleet[serve]'" in done.stderr


def test_what_a_user_had_ends_and_is_named(folder: Path, run_command: Run) -> None:
    words = ("users", "add", "arm", "--role", "viewer", "--users", "again.toml")
    first = run_command(*words, "--program", "--json", cwd=folder)
    assert first.json["ended"] == ""
    assert first.err == ""
    second = run_command(*words, "--program", cwd=folder)
    assert "arm was there already: what opened the door before has ended (its token)" in second.err
    named = run_command(*words, "--certificate", "CN=arm", "--json", cwd=folder)
    assert named.json["ended"] == "its token"
    same = run_command(*words, "--certificate", "CN=arm", cwd=folder)
    assert "ended" not in same.err
