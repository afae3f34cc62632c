"""Slow requests, crowds of connections, and answers that go on after their reader has been thrown out."""

import re
import socket
import time
import tomllib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import httpx
import pytest
import tomli_w

from tests.analytics.serve.conftest import PASSWORD, start, write_users
from tests.forked_commands import CommandServer


class Alone(NamedTuple):
    """A server of its own, its file of users, and the file with what it reports."""

    url: str
    folder: Path
    log: Path

    def line(self) -> socket.socket:
        host, _, port = self.url.removeprefix("http://").partition(":")
        return socket.create_connection((host, int(port)), timeout=60)


@pytest.fixture(scope="module")
def alone(
    tmp_path_factory: pytest.TempPathFactory, command_server: CommandServer, run_command: Callable[..., Any]
) -> Iterator[Alone]:
    folder = tmp_path_factory.mktemp("alone")
    (folder / "a.csv").write_text("time[s],rate[deg/h]\n0,1\n1,2\n")
    assert run_command("import", "a.csv", "--unit", "G-1", "--store", "S", cwd=folder).code == 0
    write_users(folder / "users.toml")
    with (folder / "log").open("w") as file:
        process, ready = start(
            command_server, "--store", "S", "--port", 0, "--users", "users.toml", cwd=folder, stderr=file
        )
        yield Alone(ready["url"], folder, folder / "log")
        process.terminate()
        process.communicate(timeout=20)
    assert "Traceback" not in (folder / "log").read_text()


@contextmanager
def logged_in(alone: Alone, name: str) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=alone.url, timeout=60, limits=httpx.Limits(max_connections=300)) as browser:
        assert browser.post("/login", data={"name": name, "password": PASSWORD}).status_code == 200
        yield browser


@pytest.mark.long
def test_a_request_that_does_not_come_is_not_waited_for(alone: Alone) -> None:
    with ExitStack() as lines:
        slow = [lines.enter_context(alone.line()) for _ in range(3)]
        body = lines.enter_context(alone.line())
        body.sendall(b"POST /login HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 1000\r\n\r\nname=")
        began_s = time.monotonic()
        for number in range(12):  # a header now and then
            for line in slow[:2]:
                line.sendall(b"X-A: b\r\n" if number else b"GET / HTTP/1.1\r\n")
            time.sleep(1.5)
        for line in slow:
            with suppress(ConnectionResetError):
                assert line.recv(100) == b""
        assert 15.0 < time.monotonic() - began_s < 40.0
        assert body.recv(1000).startswith(b"HTTP/1.1 408 ")
    log = alone.log.read_text()
    assert log.count("no whole request has come") == 3
    assert "POST /login as nobody: the request has not come whole" in log


@pytest.mark.parametrize("length", [True, False])
def test_a_body_that_is_too_long_is_not_read(alone: Alone, length: bool) -> None:
    head = b"Content-Length: 2000000000" if length else b"Transfer-Encoding: chunked"
    with alone.line() as line:
        line.sendall(b"POST /login HTTP/1.1\r\nHost: 127.0.0.1\r\n%s\r\n\r\n" % head)
        sent = 0
        with suppress(OSError):
            while sent < 50 << 20:
                piece = b"x" * 65536
                line.sendall(piece if length else b"10000\r\n%s\r\n" % piece)
                sent += len(piece)
    assert sent < 20 << 20


@pytest.mark.long
def test_a_crowd_of_silent_lines_keeps_nobody_out(alone: Alone) -> None:
    with ExitStack() as lines:
        for _ in range(2300):
            lines.enter_context(alone.line())
        assert httpx.get(f"{alone.url}/health", timeout=30).status_code == 200
    log = alone.log.read_text()
    assert "there are more than 2000 connections" in log
    assert log.count("there are more than") <= 101  # of a flood some lines


@pytest.mark.long
def test_requests_that_are_none_do_not_fill_the_log(alone: Alone) -> None:
    before = alone.log.stat().st_size
    for _ in range(1000):
        with alone.line() as line:
            line.sendall(b"\x16\x03\x01 no request\r\n\r\n")
            assert line.recv(100).startswith(b"HTTP/1.1 400")
    assert alone.log.stat().st_size - before < 20_000


@pytest.mark.long
def test_one_person_does_not_take_all_places_of_listeners(alone: Alone) -> None:
    with ExitStack() as ends:
        greedy = ends.enter_context(logged_in(alone, "vera"))
        statuses, heard = [], []
        for _ in range(205):
            stream = ends.enter_context(greedy.stream("GET", "/api/live"))
            statuses.append(stream.status_code)
            if stream.status_code == 200:
                heard.append(stream.iter_raw())
                next(heard[-1])
        assert statuses == [200] * 200 + [429] * 5
        other = ends.enter_context(logged_in(alone, "otto"))
        assert ends.enter_context(other.stream("GET", "/api/live")).status_code == 200
    deadline = time.monotonic() + 60.0
    with logged_in(alone, "vera") as again:  # places come back
        status = 0
        while status != 200:
            assert time.monotonic() < deadline
            with again.stream("GET", "/api/live") as stream:
                status = stream.status_code


@pytest.mark.long
def test_who_is_thrown_out_hears_no_more(alone: Alone) -> None:
    """By a logout, by a lower role, by being removed; who stays hears on."""
    with ExitStack() as ends:
        heard, browsers = {}, {}
        for name in ("vera", "otto", "eva", "anna"):
            browser = browsers[name] = ends.enter_context(logged_in(alone, name))
            heard[name] = ends.enter_context(browser.stream("GET", "/api/live")).iter_raw()
            next(heard[name])
        csrf = browsers["vera"].get("/api/me").json()["csrf"]
        assert browsers["vera"].post("/logout", data={"csrf": csrf}).status_code == 303
        users = tomllib.loads((alone.folder / "users.toml").read_text())["users"]
        users["otto"]["role"] = "viewer"
        del users["eva"]
        (alone.folder / "users.toml").write_text(tomli_w.dumps({"users": users}))
        began_s = time.monotonic()
        for name in ("vera", "otto", "eva"):
            list(heard[name])
            assert browsers[name].get("/api/me").status_code == 401
        assert time.monotonic() - began_s < 40.0
        assert next(heard["anna"])
        assert browsers["anna"].get("/api/me").json()["role"] == "approver"


REPORTED = (
    "wrong password or name", "a token that nobody has", "the request is for another host",
    "POST /api/sql as vera: the change lacks the secret", "a page of another site sent this change",
    "as vera: this needs the role operator", "too many logins have failed",
    "wrong password or name 'vera'", "login from 127.0.0.1: vera by password, viewer",
)  # fmt: skip


@pytest.mark.long
def test_what_is_refused_is_reported_in_one_line_each(alone: Alone) -> None:
    begin = len(alone.log.read_text())
    with httpx.Client(base_url=alone.url) as nobody, logged_in(alone, "vera") as vera:
        nobody.post(
            "/login", data={"name": "x\r\n2026-11-24T00:00:00Z login from 1.1.1.1: forged\x1b[2J", "password": "x"}
        )
        nobody.get("/api/me", headers={"Authorization": "Bearer wrong"})
        nobody.get("/api/me", headers={"Host": "evil.example"})
        vera.post("/api/sql", json={"sql": "select 1"})
        vera.post("/api/sql", json={"sql": "select 1"}, headers={"Origin": "https://evil.example"})
        vera.post("/api/notes", json={"run": "r", "text": "x"})
        for _ in range(11):
            nobody.post("/login", data={"name": "vera", "password": "wrong"})
    lines = alone.log.read_text()[begin:].splitlines()
    assert all(re.match(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ [a-z ]+ from 127\.0\.0\.1: ", line) for line in lines), lines
    text = "\n".join(lines)
    for part in REPORTED:
        assert part in text, part
    assert "\x1b" not in text
    assert not any(line.startswith("2026-11-24T00:00:00Z login from 1.1.1.1") for line in lines)
    assert PASSWORD not in text
