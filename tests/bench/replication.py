"""Throughput of replication beside copies of the same files: ``python -m tests.bench.replication [--segments 16]``.

A plant's log of segments of 32 MB of payload is brought to a fleet store over the bus on loopback and from folder to
folder, verified and durable, and copied by rsync and cp with a sync of the disk; three times each in turn, the fastest
counts. A pass in which nothing is new is timed too, and the most memory that each process took.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from storage.log.event_log import EventLog
from storage.store import Store
from tests.free_ports import free_endpoint
from tests.storage.log_records import append, samples

_GYROFLEET = str(Path(sys.executable).with_name("gyrofleet"))
_SEGMENT_BYTES = 32 << 20
_SAMPLES = 20_000


def plant(folder: Path, segments: int) -> Store:
    """A log of so many sealed segments of noise, which does not compress further."""
    store = Store.create(folder)
    log, number = EventLog(store), 0
    for _ in range(segments):
        size = 0
        while size < _SEGMENT_BYTES:
            record = samples("U1", number * _SAMPLES, _SAMPLES)
            append(log, record)
            size, number = size + len(record.data), number + 1
        log.seal()
    return store


def peak_of(process: int) -> float:
    """The most memory that a process has taken, in MB; 0 for one that has ended."""
    status = Path(f"/proc/{process}/status").read_text()
    return next((int(line.split()[1]) / 1024 for line in status.splitlines() if line.startswith("VmHWM")), 0.0)


def timed(command: list[str], *, syncs: Path | None = None) -> tuple[float, float, str]:
    """Seconds of a command, with the sync of a file system if asked; the peak of its memory in MB, and its output."""
    began = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    peak_mb = 0.0

    def watch() -> None:
        nonlocal peak_mb
        with suppress(OSError):
            while process.poll() is None:
                peak_mb = peak_of(process.pid) or peak_mb
                time.sleep(0.005)

    watching = threading.Thread(target=watch)
    watching.start()
    assert process.stdout is not None
    out = process.stdout.read()
    watching.join()
    assert process.returncode == 0, (command, out)
    if syncs is not None:
        descriptor = os.open(syncs, os.O_RDONLY)
        os.fsync(descriptor)
        os.close(descriptor)
        subprocess.run(["sync", "-f", str(syncs)], check=True)
    return time.perf_counter() - began, peak_mb, out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--segments", type=int, default=8)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=Path.cwd()) as folder:
        here = Path(folder)
        store = plant(here / "plant", given.segments)
        size_mb = sum(path.stat().st_size for path in store.log.glob("*.mcap")) / 1e6
        endpoint = free_endpoint()
        words = [_GYROFLEET, "replicate", "--serve", "--store", str(store.folder), "--listen", endpoint, "--json"]
        server = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        assert server.stdout is not None
        server.stdout.readline()
        try:
            print(json.dumps(figures(here, store, endpoint, size_mb, server.pid), indent=1))
        finally:
            server.terminate()
            server.wait()


def figures(here: Path, store: Store, endpoint: str, size_mb: float, server: int) -> dict[str, Any]:
    """Megabytes a second of each way, best of three rounds."""
    best: dict[str, float] = {}
    memory: dict[str, float] = {}
    inner: dict[str, float] = {}

    def take(way: str, command: Callable[[Path], list[str]], *, syncs: bool) -> None:
        target = here / way
        shutil.rmtree(target, ignore_errors=True)
        target.mkdir()
        seconds, peak, out = timed(command(target), syncs=target if syncs else None)
        best[way] = min(best.get(way, seconds), seconds)
        memory[way] = max(memory.get(way, 0.0), peak)
        with suppress(ValueError, KeyError):  # without the start of the process
            (plant,) = json.loads(out)["plants"]
            inner[way] = min(inner.get(way, seconds), plant["seconds"])

    def replicated(source: str) -> Callable[[Path], list[str]]:
        return lambda to: [_GYROFLEET, "replicate", "--from", source, "--to", str(to), "--no-lake", "--json"]

    for _ in range(3):
        take("bus", replicated(endpoint), syncs=False)
        take("folder", replicated(str(store.folder)), syncs=False)
        take("rsync", lambda to: ["rsync", "-a", f"{store.log}/", str(to)], syncs=True)
        take("cp", lambda to: ["cp", "-a", str(store.log), str(to)], syncs=True)
    again, _, out = timed(replicated(endpoint)(here / "bus"))
    assert json.loads(out)["added"] == 0
    return {
        "MB": round(size_mb, 1), "s": {way: round(seconds, 2) for way, seconds in best.items()},
        "MB/s": {way: round(size_mb / seconds) for way, seconds in best.items()},
        "MB/s without start": {way: round(size_mb / seconds) for way, seconds in inner.items()},
        "s of a pass without news": round(again, 2), "peak MB": {way: round(each) for way, each in memory.items()},
        "peak MB of the server": round(peak_of(server)),
    }  # fmt: skip


if __name__ == "__main__":
    main()
