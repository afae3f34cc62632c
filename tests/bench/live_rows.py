"""Rows that only the log has, in SQL: ``python -m tests.bench.live_rows [segment|latency]``.

`segment` writes an open segment of 1e8 samples (1000 signals, 1000 samples a message, noise of 50 counts) and starts
`gyrofleet sql` as a process for statements that need its channels, its samples or its rollups: time, CPU time and peak
memory of each, beside the same statements when the segment is in the lake. `latency` lets a source send 100 signals to
a `gyrofleet record` that seals every 10 s, and asks again and again, in SQL and through a server's API: every sample
is in each answer once, what was acknowledged before a statement is in its result, and for each acknowledgement it is
measured how long it took until an answer had its samples.
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
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from uuid import UUID

import httpx
import numpy as np

from storage.lake.builder import build_missing, builder_lock
from storage.log.event_log import EventLog
from storage.log.sequence import place_of
from storage.segments.records import SAMPLES, LogRecord
from storage.sql.door import SqlDoor
from storage.store import Store, WriterLock
from stream.batch import SampleBatch
from stream.closing import Closing
from stream.identity import Place, sample_key
from stream.wire.batches import encode_batch
from tests.bench.serve_record import TOKEN, serving
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
SEEN_OF_UNIT = SEEN.replace("group by", "where unit = 'U0' group by")


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
    """Seconds from an acknowledgement until an answer has the samples, over `seconds` for each way of asking."""
    endpoint = free_endpoint()
    store, command = folder / "store", program("record", "--listen", endpoint, "--rotate-s", 10, "--json", "--store")
    found: dict[str, Any] = {"samples_per_s": units * rate_hz}
    with subprocess.Popen([*command, str(store)], stdout=subprocess.PIPE, text=True) as recorder:
        assert recorder.stdout is not None
        recorder.stdout.readline()
        try:
            with LiveSource(endpoint, units=units, rate_hz=rate_hz) as source, serving(store) as (url, _):
                time.sleep(3.0)
                headers = {"Authorization": f"Bearer {TOKEN}"}
                with (
                    httpx.Client(base_url=url, headers=headers, timeout=60.0) as client,
                    Acknowledged(source) as acknowledged,
                ):
                    ways: dict[str, Callable[[], list[dict[str, Any]]]] = {
                        "gyrofleet sql, all samples": lambda: by_command(store, SEEN),
                        "gyrofleet sql, one unit": lambda: by_command(store, SEEN_OF_UNIT),
                        "a new door, all samples": lambda: by_door(store, SEEN),
                        "SQL of the page, all samples": lambda: by_page(client, SEEN),
                        "SQL of the page, one unit": lambda: by_page(client, SEEN_OF_UNIT),
                        "signal of the page": lambda: by_signal(client),
                    }
                    for how, ask in ways.items():
                        asked_of = source.units[:1] if "one unit" in how else source.units
                        found[how] = acknowledged.seen_by(ask, seconds, () if "of the page" in how else asked_of)
                source.stop()
        finally:
            recorder.terminate()
    return found


class Acknowledged(Closing):
    """When the samples of the first unit were acknowledged: moments and the number after the last one."""

    def __init__(self, source: LiveSource) -> None:
        self._source, self._ends = source, threading.Event()
        self.moments: list[tuple[float, int]] = []
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()

    def close(self) -> None:
        """Watch no more."""
        self._ends.set()
        self._thread.join()

    def _watch(self) -> None:
        unit = self._source.units[0]
        while not self._ends.wait(0.005):
            next_seq = self._source.acknowledged()[0][unit]
            if not self.moments or next_seq > self.moments[-1][1]:
                self.moments.append((time.monotonic(), next_seq))

    def seen_by(
        self, ask: Callable[[], list[dict[str, Any]]], seconds: float, exact: Sequence[str]
    ) -> dict[str, float]:
        """Ask for so long; each sample is there once, and all of the units `exact` that were acknowledged before are.

        A server may answer from what it had a second before.
        """
        unit, answers, took = self._source.units[0], [], []
        first_s = time.monotonic()
        while time.monotonic() < first_s + seconds:
            before, began_s = self._source.acknowledged()[0], time.monotonic()
            rows = ask()
            answers.append((time.monotonic(), next(row["last"] + 1 for row in rows if row["unit"] == unit)))
            took.append(answers[-1][0] - began_s)
            check(rows, {each: before[each] for each in exact})
        late = [
            next(at_s for at_s, shown in answers if shown >= next_seq) - acknowledged_s
            for acknowledged_s, next_seq in self.moments
            if first_s <= acknowledged_s and next_seq <= answers[-1][1]
        ]
        return {
            "answers": len(answers), "answer_median_s": float(np.median(took)), "median_s": float(np.median(late)),
            "p95_s": float(np.quantile(late, 0.95)), "most_s": max(late),
        }  # fmt: skip


def by_page(client: httpx.Client, statement: str) -> list[dict[str, Any]]:
    answer = client.post("/api/sql", json={"sql": statement})
    assert answer.status_code == 200, answer.text
    return list(answer.json()["rows"])


def by_signal(client: httpx.Client) -> list[dict[str, Any]]:
    """The first unit's record as the page draws it; the number of a sample is that of its period."""
    answer = client.get("/api/signals/U0/live/rate", params={"points": 1000})
    assert answer.status_code == 200, answer.text
    found = answer.json()
    numbers = round((found["last_ns"] - found["first_ns"]) / 1e9 / found["sample_interval_s"]) + 1
    return [{"unit": "U0", "n": found["samples"], "numbers": numbers, "last": numbers - 1}]


def by_command(store: Path, statement: str) -> list[dict[str, Any]]:
    done = subprocess.run(
        program("sql", statement, "--store", store, "--json"), check=True, capture_output=True, text=True
    )
    return list(json.loads(done.stdout))


def by_door(store: Path, statement: str) -> list[dict[str, Any]]:
    with SqlDoor(Store.open(store)) as door:
        return list(door.ask(statement).read_all().to_pylist())


def check(rows: list[dict[str, Any]], acknowledged: dict[str, int]) -> None:
    """Every sample is there once, and everything acknowledged before."""
    of_unit = {row["unit"]: row for row in rows}
    assert all(row["n"] == row["numbers"] == row["last"] + 1 for row in rows), rows
    for unit, next_seq in acknowledged.items():
        row = of_unit.get(unit, {"n": 0, "numbers": 0, "last": -1})
        assert row["n"] == row["numbers"] == row["last"] + 1 >= next_seq


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mode", nargs="?", choices=("segment", "latency"), default="segment")
    parser.add_argument("--samples", type=int, default=100_000_000)
    parser.add_argument("--signals", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each way of asking")
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
