"""Every role of a station killed again and again: is each sample recorded once, and is every estimate the same.

``python tests/crash/kills.py --kills 200``. Router, recorder, builder of the lake, estimator and source run as
processes of their own. One or another of them is killed with SIGKILL at random moments, and started again with the same
command. Runs follow each other until the kills are done and the last run has ended. Then the store must be sound, and
equal to one that the same runs were recorded to undisturbed, in one process: samples, documents and estimates.
"""

import argparse
import json
import random
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from itertools import chain, count, islice
from pathlib import Path
from typing import Any, NamedTuple

import duckdb

from storage.sql.catalog import Catalog
from storage.store import Store
from stream.worker.compile_kernels import compile_kernels

ROLES = ("router", "record", "lake", "estimate", "run")
READY = {"router": "routing", "record": '"recording"', "lake": "building", "estimate": "estimating"}
UNITS = 2
EVERY_S = 60.0  # as estimates come where all is in one process
PATIENCE_S = 240.0
Start = Callable[..., "subprocess.Popen[Any]"]  # of a command with its arguments, and options as Popen has them
_MOST_FAILURES = 5

SAMPLE_COLUMNS = "unit, signal, run, epoch, seq, t_ns, counts, value, unit_of_measure, flags"
DOCUMENTS = (  # what a restart adds is not in an undisturbed store
    "select kind, run, unit, signal, document, site, station, t_ns, uid from events "
    "where kind not in ('RunResumed', 'StoreNoted')"
)


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


def disturb(station: Station, shape: Shape, kills: int, rng: random.Random) -> None:
    """Run a station under so many kills."""
    for role in ROLES:
        station.start(role)
        if role in READY:  # an estimator that never was takes no run that has ended
            station.wait_until_ready(role)
    # at random, and all of them equally often in the long run
    victims = chain.from_iterable(rng.sample(ROLES, len(ROLES)) for _ in count())
    for role in islice(victims, kills):
        until = time.monotonic() + rng.uniform(0.05, shape.kill_s)
        while (left_s := until - time.monotonic()) > 0:
            station.look()
            time.sleep(min(left_s, 0.05))
        station.kill(role)
        time.sleep(rng.uniform(0.0, shape.kill_s / 3))
        station.start(role)
    station.finish()


def compare(killed: Catalog, whole: Catalog, runs: int) -> tuple[dict[str, int], list[str]]:
    """How many rows there are, and which are in one of two stores only."""
    wrong: list[str] = []
    rows: Counter[str] = Counter()

    def same(what: str, sql: str) -> None:
        with duckdb.connect() as connection:
            connection.register("a", killed.reader(sql).read_all())
            connection.register("b", whole.reader(sql).read_all())
            for here, there, where in (("a", "b", "killed"), ("b", "a", "undisturbed")):
                only = connection.execute(f"select * from {here} except all select * from {there}").fetchmany(3)
                if only:
                    wrong.append(f"{what}: only in the {where} store: {only}")
            ((count,),) = connection.execute("select count(*) from a").fetchall()
            rows[what.split()[0]] += count

    for number in range(1, runs + 1):
        for unit in range(1, UNITS + 1):
            name = f"run = 'run-{number}' and unit = 'SIM-{unit:04d}'"
            same(f"samples of {name}", f"select {SAMPLE_COLUMNS} from samples where {name}")
    same("estimates", "select * from estimates")
    same("documents", DOCUMENTS)
    for view, name in (("events", "uid"), ("estimates", "uid, tau_s, estimator")):
        again = killed.rows(f"select {name}, count(*) from {view} group by all having count(*) > 1")
        if again:
            wrong.append(f"{view} that are there twice: {again[:3]}")
    return dict(rows), wrong


def trial(folder: Path, kills: int, seed: int, shape: Shape, start: Start) -> dict[str, Any]:
    """Kill so often, and hold what came of it against what would have been."""
    rng = random.Random(seed)
    began = time.monotonic()
    station = Station(folder, shape, start)
    compile_kernels(quiet=True)  # else no estimator lives long enough to have them
    try:
        disturb(station, shape, kills, rng)
    finally:
        station.close()
    disturbed_s = time.monotonic() - began
    wrong = station.failures if len(station.failures) > _MOST_FAILURES else []
    runs = len(station.finished)
    for number in range(1, runs + 1):
        run_to_end(start, folder, "run-simulated", *run_options(number, shape), "--store", folder / "whole")
    for store in (station.store, folder / "whole"):
        run_to_end(start, folder, "verify", "--store", store)
    with Catalog(Store.open(station.store)) as killed, Catalog(Store.open(folder / "whole")) as whole:
        rows, different = compare(killed, whole, runs)
        ((recovered,),) = killed.rows("select count(*) from events where document->>'$.what' = 'segment_recovered'")
        ((twice,),) = killed.rows("select count(*) - count(distinct uid) from internal.lake_events")
    wrong += different
    if rows.get("samples") != runs * shape.samples:
        wrong.append(f"{rows.get('samples')} samples, {runs} runs have {runs * shape.samples}")
    wrong += [f"{role} was killed {station.kills[role]} times" for role in ROLES if 10 * station.kills[role] < kills]
    return {
        "kills": sum(station.kills.values()),
        "by_role": dict(station.kills),
        "starts": dict(station.starts),
        "ended_by_themselves": station.failures,
        "runs": runs,
        "rows": rows,
        "resent": sum(each["resent"] for each in station.finished),
        "recovered_segments": recovered,
        "documents_sent_twice": twice,
        "seconds": round(time.monotonic() - began),
        "seconds_disturbed": round(disturbed_s),
        "wrong": wrong,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="Folder for the stores and what the processes said, to look at.")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        try:
            result = trial(folder.resolve(), arguments.kills, arguments.seed, Shape(), start_program)
        except Wrong as error:
            result = {"wrong": [str(error)]}
    if arguments.json:
        print(json.dumps(result))
    else:
        for name, value in result.items():
            print(f"{name}: {value}")
    sys.exit(1 if result["wrong"] else 0)


if __name__ == "__main__":
    main()
