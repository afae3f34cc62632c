"""One server for all tests of this folder, and browsers and programs that ask it."""

import fcntl
import json
import os
import re
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import httpx
import pytest

from analytics.serve.doors.roles import Role
from analytics.serve.doors.users_file import add_program
from tests.analytics.serve.served_store import make_store
from tests.forked_commands import CommandServer

TOKEN = "T-of-the-tests"
PASSWORD = "correct horse battery staple"
# scrypt at a cost that tests can afford; the cost is stored beside the hash
CHEAP_HASH = (
    "scrypt:2:8:1:00000000000000000000000000000000:8655ba825239b20ebf4aaa22a18a21d15bf17efa6cb0b15a33d4bd49478de152"
)
_START_S = 60.0


@dataclass(frozen=True)
class Served:
    """A running server, its store, its file of users, and tokens of programs by role."""

    url: str
    folder: Path
    tokens: dict[str, str]

    @property
    def store(self) -> Path:
        return self.folder / "S"

    def program(self, role: str = "") -> httpx.Client:
        """A client with the server's token, or that of a program in a role."""
        token = self.tokens[role] if role else TOKEN
        return httpx.Client(base_url=self.url, headers={"Authorization": f"Bearer {token}"}, timeout=60.0)

    def nobody(self, **headers: str) -> httpx.Client:
        return httpx.Client(base_url=self.url, headers=headers, timeout=60.0)

    @contextmanager
    def browser(self, name: str = "", password: str = PASSWORD) -> "Iterator[Browser]":
        """A client that has logged in with the token, or as a user."""
        headers = {"Accept": "text/html,*/*", "Sec-Fetch-Site": "same-origin"}
        with Browser(base_url=self.url, headers=headers, timeout=60.0, follow_redirects=True) as browser:
            fields = {"name": name, "password": password} if name else {"token": TOKEN}
            entered = browser.post("/login", data=fields)
            assert entered.status_code == 200, entered.text
            yield browser


class Browser(httpx.Client):
    """A client with cookies that sends what browsers send."""

    @property
    def csrf(self) -> str:
        found = re.search(r'<meta name="csrf-token" content="([^"]+)"', self.get("/login").text)
        assert found is not None
        return found[1]


def start(
    server: CommandServer, *words: object, cwd: Path, stderr: IO[str] | int = subprocess.PIPE
) -> tuple[subprocess.Popen[str], dict[str, Any]]:
    """Start a server; its process and the line that says it is ready."""
    process = server.start(
        ["serve", *(str(word) for word in words), "--json"], cwd=cwd, stdout=subprocess.PIPE, stderr=stderr
    )
    assert process.stdout is not None
    line = process.stdout.readline()
    assert line, process.communicate()[1]
    ready: dict[str, Any] = json.loads(line)
    assert ready["event"] == "ready", line
    return process, ready


def write_users(path: Path) -> dict[str, str]:
    """People Vera, Otto, Eva and Anna in the four roles, and a program in each; their tokens."""
    tokens = {role.word: add_program(path, f"{role.word}-program", role) for role in Role}
    content = path.read_text()
    for name, role in zip(("vera", "otto", "eva", "anna"), Role, strict=True):
        content += f'\n[users.{name}]\nrole = "{role.word}"\npassword = "{CHEAP_HASH}"\n'
    path.write_text(content)
    return tokens


@pytest.fixture(scope="session")
def served(
    tmp_path_factory: pytest.TempPathFactory, command_server: CommandServer, run_command: Callable[..., Any]
) -> Iterator[Served]:
    """The server of all tests, also of those in other processes of pytest; who started it waits for them."""
    base = tmp_path_factory.getbasetemp()
    note = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "served.json"
    process: subprocess.Popen[str] | None = None
    with _users_of(note) as found:
        if not found:
            folder = tmp_path_factory.mktemp("served")
            make_store(folder, run_command)
            tokens = write_users(folder / "users.toml")
            process, ready = start(
                command_server, "--store", "S", "--port", 0, "--token", TOKEN, "--token-role", "approver", "--users",
                "users.toml", cwd=folder,
            )  # fmt: skip
            found |= {"url": ready["url"], "folder": str(folder), "tokens": tokens, "users": 0}
        found["users"] += 1
        server = Served(found["url"], Path(found["folder"]), found["tokens"])
    yield server
    with _users_of(note) as found:
        found["users"] -= 1
    while process is not None:
        with _users_of(note) as found:
            if found["users"] == 0:
                found.clear()
                process.terminate()
                _, err = process.communicate(timeout=30)
                assert process.returncode == 0, err
                assert "Traceback" not in err, err
                return
        time.sleep(0.1)


@pytest.fixture(scope="session")
def api(served: Served) -> Iterator[httpx.Client]:
    """A program with the server's token."""
    with served.program() as client:
        yield client


@contextmanager
def _users_of(note: Path) -> Iterator[dict[str, Any]]:
    """The note on the server, for one process at a time."""
    with note.with_suffix(".lock").open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        found: dict[str, Any] = json.loads(note.read_text()) if note.exists() else {}
        yield found
        note.write_text(json.dumps(found))
