"""From the store to blocks: ``python tests/bench/block_reduction.py --units 20 --days 1 --rate-hz 10``.

Makes a lake of a fleet at a station (rate and temperature of each unit, the table's rate, the chamber's temperature; a
run a day) and reduces all units, one after the other, to blocks of 30 s with their channels. It prints seconds a unit
and the peak of memory of the reduction, which runs in a process of its own, and what both would be for a fleet of 100
units over 10 days: rollups count, not samples, so that the sample rate hardly matters above 2 Hz.
"""

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any
from uuid import UUID

import numpy as np

from analytics.block_reduction import BlockReducer
from storage.catalog import Catalog
from storage.compaction import compact
from storage.event_log import EventLog
from storage.lake import Lake, build_missing, builder_lock
from storage.mcap_records import SAMPLES, LogRecord
from storage.sequence import place_of
from storage.store import Store, WriterLock
from stream.batch import SampleBatch
from stream.identity import Place, sample_key
from stream.wire import encode_batch

PLACE = Place("plant", "chamber-1")
DAY_S = 86_400
START_NS = 1_763_683_200 * 10**9
FLEET, DAYS = 100, 10


def append(log: EventLog, batch: SampleBatch) -> None:
    record = LogRecord(
        sample_key(PLACE, batch.unit, batch.signal), SAMPLES, batch.last_ns + 10**6, batch.t0_ns, encode_batch(batch)
    )
    place = place_of(record)
    assert place is not None
    log.append(place, record)


def write(store: Store, units: int, days: int, rate_hz: float) -> int:
    """Batches of ten minutes; how many samples."""
    rng = np.random.default_rng(1)
    chunk_s = 600
    signals = [("table", "table_rate", "deg/s", 1.0), ("chamber", "chamber_temperature", "degC", 0.1)]
    for unit in range(units):
        signals += [(f"FOG-{unit:04d}", "rate", "deg/s", rate_hz), (f"FOG-{unit:04d}", "temperature", "degC", 1.0)]
    seq: dict[tuple[str, str, str, float], int] = dict.fromkeys(signals, 0)
    with WriterLock(store, "benchmark"):
        log = EventLog(store, rotate_bytes=32 << 20)
        for chunk in range(days * DAY_S // chunk_s):
            day, start_ns = chunk * chunk_s // DAY_S, START_NS + chunk * chunk_s * 10**9
            for number, key in enumerate(signals):
                owner, signal, measure, hz = key
                counts = np.round(rng.normal(0.0, 50.0, round(chunk_s * hz))).astype(np.int32)
                epoch = UUID(int=day * 10_000 + number + 1)
                first = seq[key] if chunk * chunk_s % DAY_S else 0
                append(
                    log,
                    SampleBatch(
                        owner, signal, f"day-{day}", epoch, first, start_ns, round(1e9 / hz), measure, counts=counts,
                        scale=1e-5,
                    ),
                )  # fmt: skip
                seq[key] = first + len(counts)
            if log.due:
                log.seal()
        log.seal()
    with builder_lock(store):
        for _ in build_missing(store, compacts=False):
            pass
        for _ in compact(Lake(store), now_ns=START_NS + (days + 30) * DAY_S * 10**9):
            pass
        Lake(store).purge(grace_s=0.0)
    return sum(round(days * DAY_S * hz) for _, _, _, hz in signals)


def peak_mb() -> float:
    """Of this process alone: the resource module counts what its parent had when it forked."""
    (line,) = [line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM")]
    return int(line.split()[1]) / 1024


def reduce_all(folder: Path) -> dict[str, Any]:
    """Reduce every unit of the store."""
    seconds = []
    blocks = 0
    with Catalog(Store.open(folder)) as catalog:
        units = [row[0] for row in catalog.rows("select distinct unit from signals where signal = 'rate' order by 1")]
        reducer = BlockReducer(catalog, "rate")
        for unit in units:
            begin = time.perf_counter()
            reduction = reducer.reduce(unit)
            seconds.append(time.perf_counter() - begin)
            blocks += sum(len(run) for run in reduction.runs)
    return {
        "units": len(units),
        "blocks": blocks,
        "first_unit_s": seconds[0],
        "unit_s": float(np.median(seconds[1:] or seconds)),
        "all_s": sum(seconds),
        "all_cpu_s": time.process_time(),
        "peak_mb": peak_mb(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--units", type=int, default=20)
    parser.add_argument("--days", type=int, default=1)
    parser.add_argument("--rate-hz", type=float, default=10.0)
    parser.add_argument("--folder", type=Path, help="where to work; kept then")
    parser.add_argument("--reduce", type=Path, help="a store that is there")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if options.reduce is not None:
        print(json.dumps(reduce_all(options.reduce)))
        return
    folder = options.folder or Path(tempfile.mkdtemp(prefix="gyrofleet-blocks-"))
    try:
        store = Store.create(folder / "store")
        samples = write(store, options.units, options.days, options.rate_hz)
        command = [sys.executable, __file__, "--reduce", str(store.folder)]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
    finally:
        if options.folder is None:
            shutil.rmtree(folder)
    found = {"samples": samples, **json.loads(done.stdout)}
    found["fleet_of_100_over_10_days_min"] = found["unit_s"] * DAYS / options.days * FLEET / 60.0
    if options.json:
        print(json.dumps(found))
        return
    for name, value in found.items():
        print(f"{name:32} {value:,.4g}" if isinstance(value, float) else f"{name:32} {value:,}")


if __name__ == "__main__":
    main()
