"""A supervisor keeps processes at work: what dies is named with its reason and started again, with growing pauses."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from stream.roles import supervision
from stream.roles.supervision import Role, Supervisor, pause_s

PYTHON = [sys.executable, "-c"]
WORKS = "import signal, sys, time; signal.signal(signal.SIGTERM, lambda *_: sys.exit(0)); time.sleep(60)"


class Lines:
    """What was reported."""

    def __init__(self) -> None:
        self.lines: list[tuple[str, str, str]] = []

    def __call__(self, level: str, event: str, text: str) -> None:
        self.lines.append((level, event, text))

    def of(self, event: str) -> list[str]:
        return [text for _, name, text in self.lines if name == event]


def until(supervisor: Supervisor, is_so: Callable[[], bool], patience_s: float = 20.0) -> None:
    at = time.monotonic() + patience_s
    while not is_so():
        assert time.monotonic() < at
        supervisor.look()
        time.sleep(0.01)


def test_a_role_that_dies_is_named_and_started_again_later_each_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervision, "FIRST_PAUSE_S", 0.1)
    seen = Lines()
    dying = Role("record", ("import sys; print('error: the disk is full', file=sys.stderr); sys.exit(1)",))
    working = Role("serve", (WORKS,))
    supervisor = Supervisor([dying, working], PYTHON, seen)
    until(supervisor, lambda: dying.starts == 4)
    assert working.starts == 1
    died = seen.of("role_died")
    assert len(died) == 3
    assert all("exit code 1: the disk is full; it is started again in" in text for text in died)
    pauses = [float(text.rsplit(" ", 2)[1]) for text in died]
    for number, each in enumerate(pauses):
        assert 0.75 * 0.1 * 2**number - 0.06 <= each <= 0.1 * 2**number + 0.06
    supervisor.stop(10.0)
    assert working.process is None


def test_pauses_are_bounded_and_begin_anew_after_healthy_work(monkeypatch: pytest.MonkeyPatch) -> None:
    assert max(pause_s(deaths, 0.0) for deaths in range(1, 10_000)) == supervision.LONGEST_PAUSE_S
    monkeypatch.setattr(supervision, "HEALTHY_S", 0.0)
    monkeypatch.setattr(supervision, "FIRST_PAUSE_S", 0.01)
    role = Role("record", ("raise SystemExit(1)",))
    supervisor = Supervisor([role], PYTHON, Lines())
    until(supervisor, lambda: role.starts == 4)
    assert role.deaths == 1
    supervisor.stop(10.0)


def test_options_that_are_wrong_are_not_tried_again() -> None:
    seen = Lines()
    role = Role("record", ("import sys; print('Error: no such option: --x', file=sys.stderr); sys.exit(2)",))
    supervisor = Supervisor([role], PYTHON, seen)
    until(supervisor, lambda: role.gave_up)
    assert supervisor.look() is False
    assert role.starts == 1
    assert seen.of("gave_up") == [
        "record cannot be started, exit code 2: no such option: --x; correct it, and start again"
    ]


def test_a_killed_role_is_named_by_its_signal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervision, "FIRST_PAUSE_S", 0.05)
    seen = Lines()
    role = Role("estimate", (WORKS,))
    supervisor = Supervisor([role], PYTHON, seen)
    until(supervisor, lambda: role.process is not None)
    assert role.process is not None
    os.kill(role.process.pid, signal.SIGKILL)
    until(supervisor, lambda: role.starts == 2)
    assert "killed by SIGKILL" in seen.of("role_died")[0]
    time.sleep(0.3)
    assert supervisor.stop(10.0)


def test_what_does_not_end_is_killed_in_the_end() -> None:
    seen = Lines()
    deaf = "import signal, sys, time; signal.signal(signal.SIGTERM, signal.SIG_IGN)"
    role = Role("serve", (f"{deaf}; print('x', file=sys.stderr, flush=True); time.sleep(60)",))
    supervisor = Supervisor([role], PYTHON, seen)
    until(supervisor, lambda: bool(role.last))
    assert not supervisor.stop(0.5)
    assert seen.of("killed") == ["serve had not ended after 0.5 s, and was killed"]


@pytest.mark.long
def test_the_command_keeps_a_recorder_at_work(
    tmp_path: Path, spawn: Callable[..., subprocess.Popen[str]], endpoint: str, gyrofleet: Callable[..., Any]
) -> None:
    (tmp_path / "roles.toml").write_text(f'[record]\nstore = "S"\nlisten = "{endpoint}"\n')
    process = spawn("supervise", "roles.toml", "--log-format", "json")  # of the roles as well
    first = _writer(tmp_path)
    os.kill(first, signal.SIGKILL)
    at = time.monotonic() + 60.0
    while (second := _writer(tmp_path)) == first:
        assert time.monotonic() < at
        time.sleep(0.1)
    process.terminate()
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    lines = [json.loads(line) for line in err.splitlines()]
    assert {"supervise", "record"} == {line["role"] for line in lines}
    assert "role_died" in {line["event"] for line in lines}
    assert "killed by SIGKILL" in err
    assert not Path(f"/proc/{second}").exists()
    assert gyrofleet("verify", "--store", "S").code == 0


def _writer(folder: Path) -> int:
    at = time.monotonic() + 60.0
    while time.monotonic() < at:
        try:
            holder = json.loads((folder / "S/writer.lock").read_text())
        except (OSError, ValueError):
            holder = {}
        if holder.get("endpoint") and Path(f"/proc/{holder['process']}").exists():
            return int(holder["process"])
        time.sleep(0.05)
    raise AssertionError("no recorder writes the store")
