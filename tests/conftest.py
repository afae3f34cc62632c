"""Fixtures for all tests: the measured recordings, and the command line as a user runs it."""

import gc
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import httpx._transports.default
import pytest
from hypothesis import settings

from tests import free_ports as ports
from tests.forked_commands import SHARED_SERVER, CommandServer
from tests.longest_first import longest_first

# machines are loaded while tests run
settings.register_profile("gyrofleet", deadline=None)
settings.load_profile("gyrofleet")
# each client would read a file of certificates, 30 ms, also for addresses without TLS
_transports = vars(httpx._transports.default)
_transports["create_ssl_context"] = cache(_transports["create_ssl_context"])
# tables are as wide as in a file, wherever the tests run
os.environ.pop("COLUMNS", None)

SHARED = Path(__file__).resolve().parents[2] / "shared"


def pytest_configure(config: pytest.Config) -> None:
    """Where several processes run the tests, begin the server of commands that all of them ask."""
    if getattr(config.option, "numprocesses", None) and not hasattr(config, "workerinput"):
        server = CommandServer().__enter__()
        config.add_cleanup(server.__exit__)
        os.environ[SHARED_SERVER] = server.begin()


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """While thousands of tests are collected nothing becomes garbage; what is made then is not looked at again."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> Iterator[None]:
    """Of a test with the mark `in_gate(*ids)`, mark the parameters of other ids as long; order those of the run."""
    for item in items:
        mark = item.get_closest_marker("in_gate")
        if mark is not None and isinstance(item, pytest.Function) and item.callspec.id not in mark.args:
            item.add_marker("long")
    yield  # `-m "not long"` is applied
    if hasattr(config, "workerinput"):
        items[:] = [items[place] for place in longest_first([item.nodeid for item in items])]


@pytest.fixture(scope="session")
def measured() -> Path:
    """Folder of the measured recordings; the test is skipped where it is absent."""
    folder = SHARED / "data"
    if not folder.is_dir():
        pytest.skip(f"the measured recordings are not in {folder}")
    return folder


@dataclass(frozen=True)
class Outcome:
    """How a command ended."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        return json.loads(self.out)


@pytest.fixture(scope="session")
def command_line() -> Callable[..., list[str]]:
    """The installed console script with arguments, for a process that a test starts itself."""
    program = str(Path(sys.executable).with_name("gyrofleet"))
    return lambda *arguments: [program, *(str(argument) for argument in arguments)]


@pytest.fixture(scope="session")
def command_server() -> Iterator[CommandServer]:
    with CommandServer() as server:
        yield server


@pytest.fixture(scope="session", autouse=True)
def forked_sandbox(command_server: CommandServer) -> Iterator[None]:
    """Processes that answer statements of tests are forked, but where a test asks for `own_sandbox`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("storage.sql.door.subprocess", command_server.forking())
        yield


@pytest.fixture
def own_sandbox(monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes that answer statements are started as for users."""
    monkeypatch.setattr("storage.sql.door.subprocess", subprocess)


@pytest.fixture(scope="session")
def run_command(command_server: CommandServer) -> Callable[..., Outcome]:
    """Run a command in a process of its own, which must not fail with a traceback."""

    def run(*arguments: object, cwd: Path, timeout_s: float = 120.0) -> Outcome:
        words = [str(argument) for argument in arguments]
        done = command_server.run(words, timeout_s=timeout_s, cwd=cwd, env={**os.environ, "COLUMNS": "200"})
        assert "Traceback" not in done.stderr, done.stderr
        return Outcome(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture
def gyrofleet(tmp_path: Path, run_command: Callable[..., Outcome]) -> Callable[..., Outcome]:
    """Run a command in a process of its own, in an empty folder."""
    return partial(run_command, cwd=tmp_path)


@pytest.fixture
def endpoint() -> str:
    return ports.free_endpoint()


@pytest.fixture
def spawn(tmp_path: Path, command_server: CommandServer) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Start a command in the background; whatever still runs at the end of the test is killed."""
    running: list[subprocess.Popen[str]] = []

    def start(*arguments: object) -> subprocess.Popen[str]:
        words = [str(argument) for argument in arguments]
        process = command_server.start(words, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        running.append(process)
        return process

    yield start
    for process in running:
        if process.poll() is None:
            process.kill()
        process.communicate()
