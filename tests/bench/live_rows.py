"""Rows that only the log has, in SQL: ``python -m tests.bench.live_rows [segment|latency]``.

`segment` writes an open segment of 1e8 samples (1000 signals, 1000 samples a message, noise of 50 counts) and starts
`gyrofleet sql` as a process for statements that need its channels, its samples or its rollups: time, CPU time and peak
memory of each, beside the same statements when the segment is in the lake. `latency` lets a source send 100 signals to
a `gyrofleet record` that seals every few seconds, and asks at once, again and again: what was acknowledged before a
statement must be in its result, and the time of the statement bounds how late that is.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any
from uuid import UUID

import numpy as np

from storage.lake.builder import build_missing, builder_lock
from storage.log.event_log import EventLog
from storage.log.sequence import place_of
from storage.segments.records import SAMPLES, LogRecord
from storage.sql.door import SqlDoor
from storage.store import Store, WriterLock
from stream.batch import SampleBatch
from stream.identity import Place, sample_key
from stream.wire.batches import encode_batch
from tests.free_ports import free_endpoint
from tests.live_source import LiveSource

PLACE = Place("plant", "chamber-1")
START_NS = 1_763_683_200 * 10**9
SIZE = 1000
STATEMENTS = {
    "nothing of the log": "select count(*) from unit_metrics",
    "channels": "select count(*), sum(samples) from signals",
    "one signal": "select count(*), avg(value) from samples where unit = 'FOG-0007'",
    "all samples": "select count(*), avg(value), min(seq), max(seq) from samples",
    "rollups": "select count(*), avg(mean) from rollup_1s",
}
SEEN = "select unit, count(*) as n, count(distinct seq) as numbers, max(seq) as last from samples group by unit"


def program(*arguments: object) -> list[str]:
    return [str(Path(sys.executable).with_name("gyrofleet")), *(str(each) for each in arguments)]


def write_open_segment(store: Store, samples: int, signals: int) -> EventLog:
    """A segment that is not sealed, of so many samples in all."""
    rng = np.random.default_rng(1)
    pool = np.round(rng.normal(0, 50.0, (997, SIZE))).astype(np.int32)
    log = EventLog(store, rotate_bytes=1 << 40, rotate_s=1e9)
    for turn in range(samples // signals // SIZE):
        for signal in range(signals):
            unit, first = f"FOG-{signal:04d}", turn * SIZE
            counts = pool[(turn * signals + signal) % len(pool)] + signal
            t0_ns = START_NS + first * 10**6
            batch = SampleBatch(
                unit, "rate", "run-1", UUID(int=signal + 1), first, t0_ns, 10**6, "deg/s", counts=counts, scale=1e-5
            )
            record = LogRecord(
                sample_key(PLACE, unit, "rate"), SAMPLES, batch.last_ns + 10**6, t0_ns, encode_batch(batch)
            )
            place = place_of(record)
            assert place is not None
            log.append(place, record)
        log.sync()
    return log


def asked(store: Store, statement: str) -> dict[str, float]:
    """Seconds, CPU seconds and peak memory of `gyrofleet sql`, the process of the statement included."""
    begin = time.perf_counter()
    with subprocess.Popen(
        program("sql", statement, "--store", store.folder, "--csv"), stdout=subprocess.DEVNULL
    ) as run:
        _, status, used = os.wait4(run.pid, 0)
        run.returncode = os.waitstatus_to_exitcode(status)
    assert run.returncode == 0
    return {
        "seconds": time.perf_counter() - begin,
        "cpu_s": used.ru_utime + used.ru_stime,
        "peak_mb": used.ru_maxrss / 1024,
    }


def segment(folder: Path, samples: int, signals: int) -> dict[str, Any]:
    store = Store.create(folder)
    with WriterLock(store, "benchmark"):
        log = write_open_segment(store, samples, signals)
        (path,) = store.log.glob("*.open")
        found: dict[str, Any] = {"samples": samples, "segment_mb": path.stat().st_size / 2**20}
        found |= {f"open: {name}": asked(store, sql) for name, sql in STATEMENTS.items()}
        with SqlDoor(store) as door:
            for name, sql in STATEMENTS.items():
                door.ask(sql).read_all()
                begin = time.perf_counter()
                door.ask(sql).read_all()
                found[f"open, again through one door: {name}"] = {"seconds": time.perf_counter() - begin}
        log.seal()
    with builder_lock(store):
        list(build_missing(store, compacts=False))
    found |= {f"in the lake: {name}": asked(store, sql) for name, sql in STATEMENTS.items()}
    return found


def latency(folder: Path, seconds: float, units: int, rate_hz: int) -> dict[str, Any]:
    endpoint = free_endpoint()
    store, command = folder / "store", program("record", "--listen", endpoint, "--rotate-s", 10, "--json", "--store")
    with subprocess.Popen([*command, str(store)], stdout=subprocess.PIPE, text=True) as recorder:
        assert recorder.stdout is not None
        recorder.stdout.readline()
        took: dict[str, list[float]] = {"gyrofleet sql": [], "a new door": []}
        try:
            with LiveSource(endpoint, units=units, rate_hz=rate_hz) as source:
                time.sleep(2.0)
                until = time.monotonic() + seconds
                while time.monotonic() < until:
                    for how, times in took.items():
                        acknowledged, _ = source.acknowledged()
                        begin = time.monotonic()
                        rows = by_command(store) if how == "gyrofleet sql" else by_door(store)
                        times.append(time.monotonic() - begin)
                        check(rows, acknowledged)
                source.stop()
        finally:
            recorder.terminate()
    figures = {how: {"median_s": float(np.median(times)), "most_s": max(times)} for how, times in took.items()}
    return {"statements": sum(map(len, took.values())), "samples_per_s": units * rate_hz, **figures}


def by_command(store: Path) -> list[dict[str, Any]]:
    done = subprocess.run(program("sql", SEEN, "--store", store, "--json"), check=True, capture_output=True, text=True)
    return list(json.loads(done.stdout))


def by_door(store: Path) -> list[dict[str, Any]]:
    with SqlDoor(Store.open(store)) as door:
        return list(door.ask(SEEN).read_all().to_pylist())


def check(rows: list[dict[str, Any]], acknowledged: dict[str, int]) -> None:
    """Everything acknowledged before is there, once."""
    of_unit = {row["unit"]: row for row in rows}
    for unit, next_seq in acknowledged.items():
        row = of_unit.get(unit, {"n": 0, "numbers": 0, "last": -1})
        assert row["n"] == row["numbers"] == row["last"] + 1 >= next_seq


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mode", nargs="?", choices=("segment", "latency"), default="segment")
    parser.add_argument("--samples", type=int, default=100_000_000)
    parser.add_argument("--signals", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--units", type=int, default=100)
    parser.add_argument("--rate-hz", type=int, default=1000)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="gyrofleet-live-"))
    try:
        if options.mode == "segment":
            found = segment(folder / "store", options.samples, options.signals)
        else:
            found = latency(folder, options.seconds, options.units, options.rate_hz)
    finally:
        shutil.rmtree(folder)
    if options.json:
        print(json.dumps(found))
        return
    for name, value in found.items():
        figures = value if isinstance(value, dict) else {"": value}
        print(f"{name:45} {'  '.join(f'{what} {figure:,.4g}' for what, figure in figures.items())}")


if __name__ == "__main__":
    main()
