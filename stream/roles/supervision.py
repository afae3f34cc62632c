"""Supervision of processes: a role that dies is reported with its reason, and started again with growing pauses."""

import json
import re
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from secrets import SystemRandom
from signal import Signals
from typing import IO, Literal

FIRST_PAUSE_S = 1.0
LONGEST_PAUSE_S = 60.0
HEALTHY_S = 60.0  # a role that worked so long begins with the first pause again
_WRONG_USE = 2  # exit code of options that are wrong: starting again does not help
_ENDED_WELL = (0, 130, -Signals.SIGTERM)  # also interrupted to be resumed, and not yet begun
_KEPT_LINES = 20
_ERROR = re.compile(r"^(?:error|Error): ")
Report = Callable[[Literal["info", "error"], str, str], None]  # level, event, text


def pause_s(deaths: int, draw: float) -> float:
    """Pause before a start after so many deaths in a row: doubled each time, less up to a quarter by `draw` (0 to 1).

    >>> [pause_s(deaths, 0.0) for deaths in (1, 2, 3, 7, 100)]
    [1.0, 2.0, 4.0, 60.0, 60.0]
    """
    longest = min(FIRST_PAUSE_S * 2.0 ** min(deaths - 1, 16), LONGEST_PAUSE_S)
    return longest * (1.0 - 0.25 * draw)


def describe_end(code: int, last: Sequence[str]) -> str:
    """Why a process has ended: its exit code or signal, and its last error, else its last line.

    >>> describe_end(-9, []), describe_end(1, ["error: the disk is full", "bye"])
    ('killed by SIGKILL', 'exit code 1: the disk is full')
    >>> describe_end(1, ['{"level": "error", "text": "the disk is full"}', "bye"])
    'exit code 1: the disk is full'
    """
    if code < 0:
        try:
            end = f"killed by {Signals(-code).name}"
        except ValueError:
            end = f"killed by signal {-code}"
    else:
        end = f"exit code {code}"
    last = [_as_text(line) for line in last]
    errors = [line for line in last if _ERROR.match(line)]
    why = _ERROR.sub("", errors[-1]) if errors else (last[-1] if last else "")
    return f"{end}: {why}" if why else end


def _as_text(line: str) -> str:
    """A line of a log in JSON as the same line is in text; any other line as it is."""
    try:
        found = json.loads(line) if line.startswith("{") else None
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict) or "text" not in found:
        return line
    return f"{'error: ' if found.get('level') == 'error' else ''}{found['text']}"


@dataclass
class Role:
    """One process that is kept at work; `arguments` are those of the program."""

    name: str
    arguments: tuple[str, ...]
    deaths: int = 0
    starts: int = 0
    gave_up: bool = False
    process: subprocess.Popen[str] | None = None
    started_at: float = 0.0
    due_at: float = 0.0
    last: deque[str] = field(default_factory=lambda: deque(maxlen=_KEPT_LINES))
    reader: threading.Thread | None = None


class Supervisor:
    """Keeps roles at work until `stop`; `command` is the program before their arguments.

    What a role writes on standard error goes on to this process's, with its last lines kept as the reason of its death.
    """

    def __init__(self, roles: Sequence[Role], command: Sequence[str], report: Report) -> None:
        self.roles = list(roles)
        self._command, self._report = list(command), report
        self._draw = SystemRandom().random

    def look(self) -> bool:
        """Start what is due, and see what has ended; whether any role is at work or will be."""
        now = time.monotonic()
        for role in self.roles:
            if role.process is not None and (code := role.process.poll()) is not None:
                self._ended(role, code, now)
            if role.process is None and not role.gave_up and now >= role.due_at:
                self._start(role, now)
        return any(not role.gave_up for role in self.roles)

    def stop(self, patience_s: float) -> bool:
        """End all roles, sources before the recorder, those beyond their time by force; whether all ended well."""
        is_well = True
        until = time.monotonic() + patience_s
        for role in reversed(self.roles):
            process = role.process
            if process is None:
                continue
            process.terminate()
            try:
                code = process.wait(max(0.1, until - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                code = process.wait()
                self._report("error", "killed", f"{role.name} had not ended after {patience_s:g} s, and was killed")
            has_ended_well = code in _ENDED_WELL
            is_well &= has_ended_well
            self._join(role)
            why = "" if code == 0 else f": {describe_end(code, list(role.last))}"
            self._report("info" if has_ended_well else "error", "role_ended", f"{role.name} has ended{why}")
            role.process = None
        return is_well

    def _start(self, role: Role, now: float) -> None:
        role.last.clear()
        role.process = subprocess.Popen(  # noqa: S603  our own program
            [*self._command, *role.arguments], stderr=subprocess.PIPE, text=True, errors="replace"
        )
        role.started_at, role.starts = now, role.starts + 1
        assert role.process.stderr is not None
        reader = threading.Thread(target=_pass_on, args=(role.process.stderr, role.last), daemon=True)
        role.reader = reader
        reader.start()
        self._report("info", "role_started", f"{role.name} is at work, process {role.process.pid}")

    def _ended(self, role: Role, code: int, now: float) -> None:
        self._join(role)
        role.process = None
        why = describe_end(code, list(role.last))
        if code == _WRONG_USE:
            role.gave_up = True
            self._report("error", "gave_up", f"{role.name} cannot be started, {why}; correct it, and start again")
            return
        worked_s = now - role.started_at
        role.deaths = 1 if worked_s >= HEALTHY_S else role.deaths + 1
        wait_s = pause_s(role.deaths, self._draw())
        role.due_at = now + wait_s
        text = f"{role.name} has died after {worked_s:.1f} s, {why}; it is started again in {wait_s:.1f} s"
        self._report("error", "role_died", text)

    @staticmethod
    def _join(role: Role) -> None:
        if role.reader is not None:
            role.reader.join(2.0)  # a process that it has left behind may hold the pipe


def _pass_on(lines: IO[str], last: deque[str]) -> None:
    with lines:
        for line in lines:
            last.append(line.rstrip("\n"))
            sys.stderr.write(line)
            sys.stderr.flush()
