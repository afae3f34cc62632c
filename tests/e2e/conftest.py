"""A simulated station in processes of its own, and what the tests of procedures there ask of it and of the store."""

import json
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from ingest.commands.run import run
from storage.check.verify import verify
from storage.sql.catalog import Catalog
from storage.store import Store
from tests.forked_commands import CommandServer


class Bench:
    """A simulated station, and what a test asks of its instruments behind the back of the run."""

    room_deg_c = 25.0

    def __init__(self, folder: Path, process: subprocess.Popen[str]) -> None:
        self.folder = folder
        self.process = process
        self.simulation = json.loads((folder / "simulation.json").read_bytes())

    @property
    def files(self) -> tuple[object, ...]:
        return ("--station", self.folder / "station.toml", "--units", self.folder / "units.csv")

    def run(self, procedure: str, *more: object) -> tuple[object, ...]:
        return ("run", procedure, *self.files, "--yes", "--store", "S", "--json", *more)

    def ask(self, instrument: str, query: str) -> str:
        return self.tell(instrument, query)

    def tell(self, instrument: str, command: str) -> str:
        """Have a line done; what was answered by the time the instrument closed the connection."""
        with socket.create_connection(("127.0.0.1", self.simulation["ports"][instrument]), timeout=10) as line:
            line.sendall(f"{command}\n".encode())
            line.shutdown(socket.SHUT_WR)
            return line.makefile("r").read().strip()

    def is_safe(self) -> bool:
        time.sleep(3.0 / self.simulation["speed"] + 0.05)  # the table brakes with 100 deg/s2
        return (
            float(self.ask("table", "RATE:ACT?")) == 0.0
            and float(self.ask("chamber", "TEMP:SETP?")) == self.room_deg_c
            and self.ask("supply", "OUTP?") == "0"
        )

    def role(self, name: str) -> int:
        """Process of the instruments, or of the gyros."""
        children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
        return int(children[("instruments", "gyros").index(name)])  # in the order in which they were started

    @staticmethod
    def ended(process: subprocess.Popen[str], code: int = 0, timeout_s: float = 60.0) -> tuple[dict[str, Any], str]:
        out, err = process.communicate(timeout=timeout_s)
        assert process.returncode == code, (out, err)
        assert "Traceback" not in err, err
        reported: dict[str, Any] = json.loads(out.splitlines()[-1])
        return reported, err

    @staticmethod
    def refused(words: tuple[object, ...], store: Path) -> str:
        """Why a command is refused; in this process, since starting one takes longer than what is tested."""
        done = CliRunner().invoke(run, [*(str(word) for word in words[1:]), "--store", str(store)])
        assert done.exit_code == 1, done.output
        message: str = json.loads(done.output.splitlines()[-1])["error"]["message"]
        return message


class Kept:
    """What the store of a test holds."""

    def __init__(self, store: Path) -> None:
        self._store = store

    def rows(self, sql: str) -> list[dict[str, Any]]:
        with Catalog(Store.open(self._store)) as catalog:
            return [row for batch in catalog.batches(sql) for row in batch.to_pylist()]

    def sound(self) -> None:
        """Nothing is there twice, every step that was begun has an end, and the store is whole."""
        (row,) = self.rows("select count(*) as n, count(distinct (unit, signal, epoch, seq)) as once from samples")
        assert row["n"] == row["once"] > 0
        found, _ = verify(Store.open(self._store))
        assert found.is_sound, found.findings
        (open_,) = self.rows("select count(*) as n from steps where outcome = 'open'")
        assert open_["n"] == 0
        # what the last document of a run promises is what is there, whichever process sent it
        (ended,) = self.rows("select document from events where kind = 'RunEnded'")
        totals = json.loads(ended["document"])["totals"]
        promised = {(each["unit"], each["signal"], each["epoch"]): each["samples"] for each in totals}
        kept = self.rows("select unit, signal, epoch, count(*) as n from samples group by all")
        assert promised == {(row["unit"], row["signal"], str(row["epoch"])): row["n"] for row in kept}

    def completed(self, steps: int = 24) -> None:
        """Every recorded step of each unit was completed once."""
        found = self.rows(
            "select unit, step, rate_command, repeat, count(*) as n from steps where outcome = 'completed' group by all"
        )
        by_unit = {unit: sum(r["n"] for r in found if r["unit"] == unit) for unit in ("SIM-0001", "SIM-0002")}
        assert by_unit == {"SIM-0001": steps, "SIM-0002": steps}
        assert all(r["n"] == 1 for r in found)


def finish(bench: Bench) -> None:
    bench.process.send_signal(signal.SIGINT)
    try:
        bench.process.communicate(timeout=20)
    finally:
        bench.process.kill()


@pytest.fixture(scope="session")
def simulated(command_server: CommandServer) -> Callable[..., Bench]:
    """Start a simulated station; whoever does ends it."""

    def simulate(folder: Path, *more: object) -> Bench:
        words = [str(word) for word in ("simulate", folder, "--units", 2, "--json", *more)]
        process = command_server.start(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line, process.communicate()[1]
        assert json.loads(line)["event"] == "ready"
        return Bench(folder, process)

    return simulate


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory, simulated: Callable[..., Bench]) -> Iterator[Bench]:
    """A hundred times real time."""
    found = simulated(tmp_path_factory.mktemp("bench") / "sim", "--speed", 100, "--rate-hz", 10)
    yield found
    finish(found)


@pytest.fixture
def slow(tmp_path: Path, simulated: Callable[..., Bench]) -> Iterator[Bench]:
    """Twenty times real time: what a busy machine delays by a tenth of a second is two seconds late, and not ten."""
    found = simulated(tmp_path / "slow", "--speed", 20, "--rate-hz", 10)
    yield found
    finish(found)


@pytest.fixture(scope="module")
def fast(tmp_path_factory: pytest.TempPathFactory, simulated: Callable[..., Bench]) -> Iterator[Bench]:
    """A thousand times real time: for what takes hours."""
    found = simulated(tmp_path_factory.mktemp("fast") / "sim", "--speed", 1000, "--rate-hz", 1)
    yield found
    finish(found)


@pytest.fixture
def state(tmp_path: Path) -> Callable[[Callable[[dict[str, Any]], bool]], dict[str, Any]]:
    """Wait until the run of this test's store has come so far, by the file in which it is remembered."""

    def wait(has_come: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        until = time.monotonic() + 40
        while time.monotonic() < until:
            for path in sorted((tmp_path / "S" / "spool").glob("*/procedure.json")):
                found: dict[str, Any] = json.loads(path.read_bytes())
                if found["phase"] != "ended" and has_come(found):
                    return found
            time.sleep(0.005)
        raise AssertionError("the run did not come so far")

    return wait


@pytest.fixture
def store(tmp_path: Path) -> Path:
    """The store of this test's runs."""
    return tmp_path / "S"


@pytest.fixture
def kept(store: Path) -> Kept:
    """What the store of this test's runs holds."""
    return Kept(store)
