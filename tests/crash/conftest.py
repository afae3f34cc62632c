"""Real processes for the crash tests: started in the background, killed, stalled, and started again."""

import json
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests import free_ports as ports
from tests.forked_commands import CommandServer


class Service:
    """A command in the background whose lines of JSON are gathered."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process
        self.lines: list[dict[str, Any]] = []
        self.errors = ""
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self._errors = threading.Thread(target=self._drain, daemon=True)
        self._errors.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            try:
                self.lines.append(json.loads(line))
            except ValueError:
                self.errors += line  # the last words of one that was killed

    def _drain(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.errors += line

    def until(self, condition: Callable[[dict[str, Any]], bool], patience_s: float = 40.0) -> dict[str, Any]:
        deadline = time.monotonic() + patience_s
        while time.monotonic() < deadline:
            for line in list(self.lines):
                if condition(line):
                    return line
            time.sleep(0.02)
        raise AssertionError(f"not said: {self.lines[-5:]} {self.errors[-2000:]}")

    def said(self, event: str, patience_s: float = 40.0) -> dict[str, Any]:
        return self.until(lambda line: line.get("event") == event, patience_s)

    def send(self, number: signal.Signals) -> None:
        os.killpg(self.process.pid, number)

    def ended(self, patience_s: float = 60.0) -> int:
        code = self.process.wait(timeout=patience_s)
        self._reader.join(10)
        return code

    def stop(self) -> None:
        self.send(signal.SIGINT)
        self.ended()

    def kill(self) -> None:
        if self.process.poll() is None:
            self.send(signal.SIGKILL)
            self.process.wait()
        for reader, pipe in ((self._reader, self.process.stdout), (self._errors, self.process.stderr)):
            reader.join(10)
            assert pipe is not None
            pipe.close()


_BACKGROUND: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "start_new_session": True}


@pytest.fixture
def services() -> Iterator[list[Service]]:
    """Whatever of these still runs at the end of the test is killed."""
    running: list[Service] = []
    yield running
    for service in running:
        service.kill()


@pytest.fixture
def start(tmp_path: Path, command_server: CommandServer, services: list[Service]) -> Callable[..., Service]:
    """Start a command of gyrofleet."""

    def begin(*arguments: object) -> Service:
        words = [str(argument) for argument in arguments]
        services.append(Service(command_server.start(words, cwd=tmp_path, **_BACKGROUND)))
        return services[-1]

    return begin


@pytest.fixture
def start_program(tmp_path: Path, services: list[Service]) -> Callable[..., Service]:
    """Start any program."""

    def begin(*command: str) -> Service:
        services.append(Service(subprocess.Popen(command, cwd=tmp_path, text=True, **_BACKGROUND)))
        return services[-1]

    return begin


@pytest.fixture
def free_endpoint() -> Callable[[], str]:
    """Addresses on loopback at which nobody listens."""
    return ports.free_endpoint


@pytest.fixture
def endpoint(free_endpoint: Callable[[], str]) -> str:
    return free_endpoint()
