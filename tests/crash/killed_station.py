"""The five roles of a station, each a process that may be killed and is started again."""

import json
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple

from storage.store import Store

ROLES = ("router", "record", "lake", "estimate", "run")
READY = {"router": "routing", "record": '"recording"', "lake": "building", "estimate": "estimating"}
UNITS = 2
EVERY_S = 60.0  # as estimates come where all is in one process
PATIENCE_S = 240.0
Start = Callable[..., "subprocess.Popen[Any]"]  # of a command with its arguments, and options as Popen has them


class Wrong(Exception):
    """Something is not as it must be."""


class Shape(NamedTuple):
    """How long a run is, the rate of its samples, and the longest time until the next kill."""

    hours: float = 0.5
    rate_hz: float = 1000.0
    kill_s: float = 1.5

    @property
    def samples(self) -> int:
        """Samples of a run: its rates, and a temperature each second."""
        return UNITS * round(self.hours * 3600) * (round(self.rate_hz) + 1)


def start_program(arguments: list[str], **options: Any) -> "subprocess.Popen[Any]":
    """Start the installed command."""
    return subprocess.Popen([str(Path(sys.executable).with_name("gyrofleet")), *arguments], **options)


class Station:
    """The five roles of a store, each a process that is started again whenever it is not there."""

    def __init__(self, folder: Path, shape: Shape, start: Start) -> None:
        self.folder = folder
        self.store = folder / "killed"
        self._shape = shape
        self._start = start
        self.run = 1
        self.finished: list[dict[str, Any]] = []
        self.starts: Counter[str] = Counter()
        self.kills: Counter[str] = Counter()
        self.failures: list[str] = []
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self._endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
        self._processes: dict[str, subprocess.Popen[Any]] = {}
        self._output: dict[str, Path] = {}
        Store.create(self.store)

    def command(self, role: str) -> list[str]:
        """What is given to start a role."""
        at, store = ("--connect", self._endpoint), ("--store", str(self.store))
        options = {
            "router": ("--listen", self._endpoint),
            "record": (*at, *store, "--no-lake", "--rotate-mb", "2"),
            "lake": store,
            "estimate": (*at, *store, "--every", f"{EVERY_S:g}", "--checkpoint-every", "0.5"),
            "run": (*run_options(self.run, self._shape), *at, *store),
        }
        return ["run-simulated" if role == "run" else role, *options[role], "--json"]

    def start(self, role: str) -> None:
        """Start a role."""
        self.starts[role] += 1
        name = f"{role}-{self.starts[role]}"
        self._output[role] = self.folder / f"{name}.out"
        with self._output[role].open("wb") as out, (self.folder / f"{name}.err").open("wb") as err:
            self._processes[role] = self._start(self.command(role), stdout=out, stderr=err, cwd=self.folder)

    def wait_until_ready(self, role: str) -> None:
        """Wait until a role says that it is at work, or has ended."""
        output = self._output[role]
        deadline = time.monotonic() + 60.0
        while READY[role] not in output.read_text() + output.with_suffix(".err").read_text():
            if self._processes[role].poll() is not None:
                return
            if time.monotonic() > deadline:
                raise Wrong(f"{role} does not start")
            time.sleep(0.05)

    def kill(self, role: str) -> None:
        """End a role at once."""
        self.kills[role] += 1
        self._processes[role].kill()
        self._processes[role].wait()

    def look(self, *, goes_on: bool = True) -> bool:
        """Start what has ended by itself, as a supervisor does; whether the run has ended, and no other is begun."""
        for role, process in list(self._processes.items()):
            code = process.poll()
            if code is None:
                continue
            if role == "run" and code == 0:
                self.finished.append(json.loads(self._output[role].read_text().splitlines()[-1]))
                if not goes_on:
                    del self._processes[role]
                    return True
                self.run += 1
            else:
                output = self._output[role]
                reported = output.with_suffix(".err").read_text()[-500:] + output.read_text()[-500:]
                self.failures.append(f"{role} ended by itself with exit code {code}: {reported}")
            self.start(role)
        return False

    def pass_time(self, lasts_s: float) -> None:
        """Look at the roles for so long."""
        until = time.monotonic() + lasts_s
        while (left_s := until - time.monotonic()) > 0:
            self.look()
            time.sleep(min(left_s, 0.05))

    def wait_for_samples(self) -> None:
        """Wait until more is recorded: all are at work again, and a kill meets them there."""
        deadline, before = time.monotonic() + PATIENCE_S, self._recorded_bytes()
        while self._recorded_bytes() <= before:
            if time.monotonic() > deadline:
                raise Wrong(f"nothing is recorded for {PATIENCE_S:.0f} s")
            self.pass_time(0.05)

    def _recorded_bytes(self) -> int:
        return sum(path.stat().st_size for path in (self.store / "log").glob("*.mcap*"))

    def finish(self) -> None:
        """Wait until the run has ended that goes on, and stop everything in its order."""
        deadline = time.monotonic() + PATIENCE_S
        while not self.look(goes_on=False):
            if time.monotonic() > deadline:
                raise Wrong(f"run-{self.run} has not ended after {PATIENCE_S:.0f} s without a kill")
            time.sleep(0.05)
        for role in ("estimate", "record", "router", "lake"):
            self.stop(role)
        run_to_end(self._start, self.folder, "lake", "--store", self.store, "--once")

    def stop(self, role: str) -> None:
        """End a role in order, once it says that it is at work."""
        self.wait_until_ready(role)
        process = self._processes.pop(role)
        process.send_signal(signal.SIGINT)
        code = process.wait(PATIENCE_S)
        if code != 0:
            reported = self._output[role].with_suffix(".err").read_text()[-2000:]
            raise Wrong(f"{role} stopped with exit code {code}: {reported}")

    def close(self) -> None:
        """End whatever is left."""
        for process in self._processes.values():
            process.kill()
            process.wait()


def run_options(number: int, shape: Shape) -> tuple[str, ...]:
    """A run that is the same whenever and however often it is made."""
    begin = datetime(2026, 1, 1, tzinfo=UTC) + timedelta(days=number)
    size = ("--simulate", f"{UNITS}", "--hours", f"{shape.hours:g}", "--rate-hz", f"{shape.rate_hz:g}", "--speed", "0")
    return ("--run", f"run-{number}", "--seed", f"{number}", "--start", begin.isoformat(), *size)


def run_to_end(start: Start, folder: Path, *arguments: object) -> None:
    """Run a command, which must succeed."""
    words = [*map(str, arguments), "--json"]
    with start(words, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        out, errors = process.communicate(timeout=600)
    if process.returncode != 0:
        raise Wrong(f"{' '.join(words)} ended with exit code {process.returncode}: {out[-2000:]} {errors}")
