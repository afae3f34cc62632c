"""Replication under faults: are all segments of the plant in the fleet store, each once, each verified?

``python -m tests.crash.replication_faults --faults 100``. A plant's server and passes of `gyrofleet replicate` are
processes of their own, with a line between them. At a random moment of each pass one fault strikes: SIGKILL of either
side, a cut of the line, a second server and a second pass at once (everything is answered twice), or a server whose
answers are doubled, in another order, or to another question. After each, everything that is visible in the fleet store
must be what the plant sealed. In the end a pass without a fault follows.
"""

import argparse
import json
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack, suppress
from itertools import islice
from pathlib import Path
from typing import Any

from storage.check.verify import verify
from storage.check.verify_fleet import verify_fleet
from storage.fleet_store import FleetStore
from storage.log.event_log import EventLog
from storage.manifests.log import manifest_path, read_log_manifest
from storage.segments.disk import sha256_of
from storage.sql.catalog import Catalog
from storage.store import Store, WriterLock
from tests.crash.relay import Relay
from tests.free_ports import free_endpoint
from tests.storage.log_records import append, samples

Start = Callable[..., "subprocess.Popen[str]"]
FAULTS = ("kill_receiver", "kill_server", "cut_line", "twice", "misordered")
_BATCHES = 40
_PIPES: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "start_new_session": True}


class Plant:
    """A plant that records, and its server."""

    def __init__(self, folder: Path, start: Start, seed: int) -> None:
        self.store, self._start, self._seed = Store.create(folder / "a"), start, seed
        self.endpoint, self.misordered = free_endpoint(), free_endpoint()
        self._batches = 0
        self._running: dict[str, subprocess.Popen[str]] = {}

    def record(self, segments: int) -> None:
        """Seal so many segments more."""
        with WriterLock(self.store, "the trial"):
            log = EventLog(self.store)
            for _ in range(segments):
                for _ in range(_BATCHES):
                    append(log, samples("U1", 1000 * self._batches, 1000))
                    self._batches += 1
                log.seal()

    def serve(self, role: str) -> None:
        """Start a server and wait until it serves."""
        if role == "misordered":
            words = [str(self.store.folder), self.misordered, str(self._seed)]
            command = [sys.executable, "-m", "tests.crash.misordered_server", *words]
            process = subprocess.Popen(command, text=True, **_PIPES)
        else:
            to = ("--listen", self.endpoint) if role == "server" else ("--connect", self.endpoint)
            process = self._start(["replicate", "--serve", "--store", str(self.store.folder), *to, "--json"], **_PIPES)
        assert process.stdout is not None
        assert json.loads(process.stdout.readline())["event"] == "serving"
        self._running[role] = process

    def kill(self, role: str) -> None:
        """SIGKILL a server."""
        process = self._running.pop(role)
        process.send_signal(signal.SIGKILL)
        process.communicate()

    def close(self) -> None:
        """Kill all of them."""
        for role in list(self._running):
            self.kill(role)


class Trial:
    """A plant, a fleet store, and what was found wrong in it."""

    def __init__(self, folder: Path, start: Start, seed: int, *, is_quick: bool) -> None:
        self.plant, self._start = Plant(folder, start, seed), start
        # how long a pass takes, s, and until when the fault strikes: well before
        self._lasts_s, self._strikes_s = ((0.8, 1.5), 0.4) if is_quick else ((1.5, 3.0), 1.2)
        self.fleet = FleetStore.create(folder / "fleet")
        self.rng = random.Random(seed)
        self.wrong: list[str] = []
        self.counts: Counter[str] = Counter()

    def receive(self, endpoint: str, *options: str) -> "subprocess.Popen[str]":
        """Start a pass."""
        words = ["replicate", "--from", endpoint, "--plant", "a", "--to", str(self.fleet.folder), "--json", *options]
        return self._start(words, **_PIPES)

    def strike(self, fault: str, relay: Relay) -> None:
        """A pass with a fault."""
        line = f"tcp/127.0.0.1:{relay.port}"
        if fault == "twice":
            self.plant.serve("second server")
        # a second's worth passes at once: what is missing takes longer, and the fault strikes meanwhile
        slow = ("--no-lake", "--bandwidth", str(self._missing_bytes() / (1.0 + self.rng.uniform(*self._lasts_s))))
        passes = [self.receive(self.plant.misordered if fault == "misordered" else line, *slow)]
        if fault == "twice":
            passes.append(self.receive(line, *slow))
        self._wait_for_bytes(passes[0])
        time.sleep(self.rng.uniform(0.0, self._strikes_s))
        if fault == "kill_receiver":
            self.counts["struck"] += passes[0].poll() is None
            passes[0].send_signal(signal.SIGKILL)
        elif fault == "kill_server":
            self.counts["struck"] += passes[0].poll() is None
            self.plant.kill("server")
            self.plant.serve("server")
        elif fault == "cut_line":
            before = relay.cuts
            relay.cut()
            self.counts["struck"] += relay.cuts - before
        else:
            self.counts["struck"] += 1
        for each in passes:
            out, err = each.communicate(timeout=90)
            if each.returncode not in (0, 1, -signal.SIGKILL):
                self.wrong.append(f"{fault}: exit code {each.returncode}: {err[-500:]}")
            if each.returncode == 0 and fault != "kill_receiver":
                self.counts["completed"] += 1
            self.counts["refused"] += out.count('"kind":')
        if fault == "twice":
            self.plant.kill("second server")
        self.counts[fault] += 1
        self.check(fault)

    def _copy(self) -> Path:
        return self.fleet.folder / "plants" / "a"

    def _missing_bytes(self) -> int:
        """Bytes of the sealed segments that have not arrived."""
        here = {path.name for path in (self._copy() / "log").glob("*.mcap")}
        return sum(path.stat().st_size for path in self.plant.store.log.glob("*.mcap") if path.name not in here)

    def _wait_for_bytes(self, each: "subprocess.Popen[str]") -> None:
        """Wait until something arrives, or the pass has ended."""
        before, deadline_s = self._missing_bytes(), time.monotonic() + 30.0
        while each.poll() is None and self._missing_bytes() == before and time.monotonic() < deadline_s:
            with suppress(FileNotFoundError):  # it has arrived meanwhile
                if any(part.stat().st_size for part in (self._copy() / "replica" / "arriving").glob("*")):
                    return
            time.sleep(0.01)

    def check(self, after: str) -> None:
        """Whether everything visible is what the plant sealed, and is listed once."""
        listed = read_log_manifest(self.plant.store).entries
        for replica in self.fleet.replicas():
            for path in replica.store.log.glob("*.mcap"):
                if path.name not in listed or sha256_of(path) != listed[path.name].sha256:
                    self.wrong.append(f"after {after}: {path.name} is visible and not what the plant sealed")
            lines = manifest_path(replica.store)
            names = Counter(json.loads(line.rpartition(b"\t")[0])["segment"] for line in _lines(lines))
            self.wrong += [
                f"after {after}: {name} is listed {count} times" for name, count in names.items() if count > 1
            ]

    def finish(self) -> dict[str, Any]:
        """A pass without a fault; what is lost, doubled or unverified then."""
        out, err = self.receive(self.plant.endpoint).communicate(timeout=300)
        if not json.loads(out)["is_well"]:
            self.wrong.append(f"the last pass: {out[-500:]}{err[-500:]}")
        self.check("the last pass")
        found = verify_fleet(self.fleet)
        self.wrong += [str(each) for of in found.plants.values() for each in of.findings]
        copy = self.fleet.replica("a").store
        sealed = {path.name: sha256_of(path) for path in self.plant.store.log.glob("*.mcap")}
        arrived = {path.name: sha256_of(path) for path in copy.log.glob("*.mcap")}
        with Catalog(copy) as catalog:
            ((rows, distinct),) = catalog.rows(
                "select count(*), count(distinct (unit, signal, run, epoch, seq)) from samples"
            )
        samples_sealed = verify(self.plant.store)[0].samples
        return {
            "segments": len(sealed), "lost": len(sealed.keys() - arrived.keys()) + samples_sealed - distinct,
            "doubled": rows - distinct, "unverified": sum(sealed.get(name) != mark for name, mark in arrived.items()),
            "samples": rows, "counts": dict(self.counts), "wrong": self.wrong,
        }  # fmt: skip


def _lines(path: Path) -> list[bytes]:
    return path.read_bytes().splitlines() if path.exists() else []


def trial(folder: Path, faults: int, seed: int, start: Start, *, is_quick: bool = False) -> dict[str, Any]:
    """So many faults, all kinds equally often, in random order."""
    found = Trial(folder, start, seed, is_quick=is_quick)
    kinds = [kind for _ in range(-(-faults // len(FAULTS))) for kind in found.rng.sample(FAULTS, len(FAULTS))]
    found.plant.record(3)
    with ExitStack() as stack:
        stack.callback(found.plant.close)
        found.plant.serve("server")
        found.plant.serve("misordered")
        relay = stack.enter_context(Relay(int(found.plant.endpoint.rpartition(":")[2])))
        for fault in islice(kinds, faults):
            found.plant.record(found.rng.choice([1, 2, 3]))
            found.strike(fault, relay)
        return found.finish()


def start_program(words: list[str], **options: Any) -> "subprocess.Popen[str]":
    """Start the installed program."""
    return subprocess.Popen([str(Path(sys.executable).with_name("gyrofleet")), *words], text=True, **options)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--faults", type=int, default=100)
    parser.add_argument("--seed", type=int, default=20261125)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        print(json.dumps(trial(Path(folder), given.faults, given.seed, start_program)))


if __name__ == "__main__":
    main()
