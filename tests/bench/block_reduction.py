"""From the store to blocks and a verdict: ``python tests/bench/block_reduction.py --units 20 --days 10 --rate-hz 10``.

Makes a lake of a fleet at a station (rate and temperature of each unit, the table's rate, the chamber's temperature; a
run a day, four temperature cycles each, in which every unit's rate follows the square of its temperature) and reduces
all units, one after the other, to blocks of 30 s with their channels. It prints seconds a unit and the peak of memory
of the reduction, which runs in a process of its own, and what both would be for a fleet of 100 units over 10 days:
rollups count, not samples, so that the sample rate hardly matters above 2 Hz. With ``--trace`` it then runs ``gyrofleet
diagnose --fleet`` on the store, which reduces and traces all units, and prints its seconds, memory and verdict.
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

from analytics.loop.blocks.block_reducer import BlockReducer
from storage.lake.builder import build_missing, builder_lock
from storage.lake.compaction import compact
from storage.lake.lake import Lake
from storage.log.event_log import EventLog
from storage.log.sequence import place_of
from storage.segments.records import SAMPLES, LogRecord
from storage.sql.catalog import Catalog
from storage.store import Store, WriterLock
from stream.batch import FloatArray, SampleBatch
from stream.identity import Place, sample_key
from stream.wire.batches import encode_batch

PLACE = Place("plant", "chamber-1")
DAY_S = 86_400
START_NS = 1_763_683_200 * 10**9
FLEET, DAYS = 100, 10
CYCLE_S, SWING_DEGC = 21_600, 20.0
SQUARE_DEG_PER_S = 5e-6
"""What a rate gains where the temperature is farthest from its middle: a hundredth of the noise of a sample."""
SCALE = {"rate": 1e-5, "temperature": 1e-3, "table_rate": 1e-5, "chamber_temperature": 1e-3}
NOISE_COUNTS = {"rate": 50.0, "temperature": 5.0, "table_rate": 5.0, "chamber_temperature": 5.0}


def append(log: EventLog, batch: SampleBatch) -> None:
    record = LogRecord(
        sample_key(PLACE, batch.unit, batch.signal), SAMPLES, batch.last_ns + 10**6, batch.t0_ns, encode_batch(batch)
    )
    place = place_of(record)
    assert place is not None
    log.append(place, record)


def driven(signal: str, at_s: FloatArray) -> FloatArray:
    """What a signal is without its noise, in its unit."""
    swing = np.sin(2 * np.pi * at_s / CYCLE_S)
    if signal == "rate":
        return np.asarray(SQUARE_DEG_PER_S * swing**2)
    return np.asarray(25.0 + SWING_DEGC * swing) if signal.endswith("temperature") else np.zeros_like(at_s)


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
                at_s = chunk * chunk_s + np.arange(round(chunk_s * hz)) / hz
                noise = NOISE_COUNTS[signal] * rng.standard_normal(at_s.size)
                counts = np.round(driven(signal, at_s) / SCALE[signal] + noise).astype(np.int32)
                epoch = UUID(int=day * 10_000 + number + 1)
                first = seq[key] if chunk * chunk_s % DAY_S else 0
                append(
                    log,
                    SampleBatch(
                        owner, signal, f"day-{day}", epoch, first, start_ns, round(1e9 / hz), measure, counts=counts,
                        scale=SCALE[signal],
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


def peak_mb(process: int | None = None) -> float:
    """Of a process alone, by default this: the resource module counts what its parent had when it forked."""
    try:
        status = Path(f"/proc/{process or 'self'}/status").read_text()
    except FileNotFoundError:
        return 0.0
    lines = [line for line in status.splitlines() if line.startswith("VmHWM")]
    return int(lines[0].split()[1]) / 1024 if lines else 0.0


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


def trace_all(folder: Path) -> dict[str, Any]:
    """Run the command on all units together, and see what it takes and says."""
    command = [sys.executable, "-m", "gyrofleet", "diagnose", "--store", str(folder), "--fleet", "--json"]
    begin = time.perf_counter()
    with (
        tempfile.TemporaryFile("w+") as reported,
        subprocess.Popen(
            [*command, "--model", "rate = bias + temperature"], stdout=reported, cwd=Path(__file__).parents[2]
        ) as process,
    ):
        peak = 0.0
        while process.poll() is None:
            peak = max(peak, peak_mb(process.pid))
            time.sleep(0.2)
        reported.seek(0)
        found = json.load(reported)
    if process.returncode != 0:
        raise SystemExit(f"gyrofleet diagnose ended with {process.returncode}")
    alone = [each["verdict"] for each in found["units"].values()]
    return {
        "trace_s": time.perf_counter() - begin,
        "trace_peak_mb": peak,
        "trace_verdict": f"{found['verdict']}: {', '.join(each['name'] for each in found['effects'])}",
        "trace_alone": ", ".join(f"{alone.count(each)} {each}" for each in sorted(set(alone))),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--units", type=int, default=20)
    parser.add_argument("--days", type=int, default=1)
    parser.add_argument("--rate-hz", type=float, default=10.0)
    parser.add_argument("--folder", type=Path, help="where to work; kept then")
    parser.add_argument("--trace", action="store_true", help="trace the fleet as well")
    parser.add_argument("--reduce", type=Path, help="a store that is there")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if options.reduce is not None:
        print(json.dumps(reduce_all(options.reduce) | (trace_all(options.reduce) if options.trace else {})))
        return
    folder = options.folder or Path(tempfile.mkdtemp(prefix="gyrofleet-blocks-"))
    try:
        store = Store.create(folder / "store")
        samples = write(store, options.units, options.days, options.rate_hz)
        command = [sys.executable, __file__, "--reduce", str(store.folder)]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        traced = trace_all(store.folder) if options.trace else {}
    finally:
        if options.folder is None:
            shutil.rmtree(folder)
    found = {"samples": samples, **json.loads(done.stdout), **traced}
    found["fleet_of_100_over_10_days_min"] = found["unit_s"] * DAYS / options.days * FLEET / 60.0
    if options.json:
        print(json.dumps(found))
        return
    for name, value in found.items():
        number_format = {float: ",.4g", int: ","}.get(type(value), "")
        print(f"{name:32} {value:{number_format}}")


if __name__ == "__main__":
    main()
