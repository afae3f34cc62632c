"""The lake's speed and size: ``python tests/bench/lake_query.py [query|segments]``.

`query` sends 1e8 samples (200 units, 5 days) through the log and the builder of the lake, and asks for the standard
deviation of 10 s means of each unit, from raw rows and from rollups, beside polars on the same Parquet files.
`segments` makes a lake of 10,000 segments and times `gyrofleet sql` as a process, before and after compaction.
"""

import argparse
import json
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from uuid import UUID

import numpy as np

from storage.lake.builder import build_missing, builder_lock
from storage.lake.compaction import compact
from storage.lake.lake import Lake
from storage.log.event_log import EventLog
from storage.log.sequence import place_of
from storage.manifests.lake import read_manifest
from storage.segments.records import EVENTS, SAMPLES, LogRecord
from storage.sql.catalog import Catalog
from storage.store import Store, WriterLock
from stream.batch import SampleBatch
from stream.events import RunEnded, RunStarted, encode_event
from stream.identity import Place, event_key, sample_key
from stream.wire.batches import encode_batch

PLACE = Place("plant", "chamber-1")
DAY_NS = 86_400 * 10**9
START_NS = 1_763_683_200 * 10**9
RAW = """select unit, stddev(mean) as sd from (
  select unit, t_ns // 10000000000 as bucket, avg(value) as mean from samples group by unit, bucket
) group by unit order by unit"""
ROLLED = "select unit, stddev(mean) as sd from rollup_10s group by unit order by unit"


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def best_of(count: int, ask: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds of the fastest of some tries, and what came out."""
    seconds, found = [], None
    for _ in range(count):
        begin = time.perf_counter()
        found = ask()
        seconds.append(time.perf_counter() - begin)
    return min(seconds), found


def append(log: EventLog, record: LogRecord) -> None:
    place = place_of(record)
    assert place is not None
    log.append(place, record)


def write_log(store: Store, units: int, days: int, samples: int, rate_hz: int) -> None:
    """A run a day of every unit: FOG-like counts, white noise of 50 counts about a bias."""
    rng = np.random.default_rng(1)
    size = 1000
    dt_ns = 10**9 // rate_hz
    with WriterLock(store, "benchmark"):
        log = EventLog(store, rotate_bytes=32 << 20)
        for day in range(days):
            day_ns = START_NS + day * DAY_NS
            bias = rng.integers(-20_000, 20_000, units)
            for first in range(0, samples, size):
                for unit in range(units):
                    counts = np.round(rng.normal(bias[unit], 50.0, size)).astype(np.int32)
                    t0_ns = day_ns + first * dt_ns
                    name, run = f"FOG-{unit:04d}", f"run-{day}"
                    epoch = UUID(int=day * 1000 + unit + 1)
                    batch = SampleBatch(
                        name, "rate", run, epoch, first, t0_ns, dt_ns, "deg/s", counts=counts, scale=1e-5
                    )
                    arrival_ns = batch.last_ns + 1_000_000
                    key = sample_key(PLACE, name, "rate")
                    append(log, LogRecord(key, SAMPLES, arrival_ns, t0_ns, encode_batch(batch)))
                if log.due:
                    log.seal()
        log.seal()


def query(folder: Path, units: int, days: int, samples: int) -> dict[str, Any]:
    store = Store.create(folder)
    begin = time.perf_counter()
    write_log(store, units, days, samples, rate_hz=100)
    logged_s = time.perf_counter() - begin
    begin = time.perf_counter()
    with builder_lock(store):
        segments = len(list(build_missing(store, compacts=False)))
        built_s = time.perf_counter() - begin
        built_mb = peak_mb()
        begin = time.perf_counter()
        compacted = sum(each.parts for each in compact(Lake(store), now_ns=START_NS + 30 * DAY_NS))
        compacted_s = time.perf_counter() - begin
        compacted_mb = peak_mb()
        Lake(store).purge(grace_s=0.0)
    rows = units * days * samples
    files: dict[str, int] = {}
    for part in read_manifest(store).parts:
        for name, file in part.files.items():
            files[name] = files.get(name, 0) + file.bytes
    with Catalog(store) as catalog:
        raw_s, raw = best_of(3, lambda: catalog.rows(RAW))
        rolled_s, rolled = best_of(5, lambda: catalog.rows(ROLLED))
    polars_s, peer = best_of(3, lambda: ask_polars(store))
    assert np.allclose([sd for _, sd in raw], [sd for _, sd in rolled], rtol=1e-9)
    assert np.allclose([sd for _, sd in raw], peer, rtol=1e-9)
    return {
        "rows": rows,
        "segments": segments,
        "parts_compacted": compacted,
        "log_bytes_a_sample": sum(path.stat().st_size for path in store.log.glob("*.mcap")) / rows,
        "samples_file_bytes_a_sample": files["samples.parquet"] / rows,
        "lake_bytes_a_sample": sum(files.values()) / rows,
        "log_written_million_a_s": rows / logged_s / 1e6,
        "lake_built_million_a_s": rows / built_s / 1e6,
        "compacted_million_a_s": rows / compacted_s / 1e6,
        "peak_mb_built": built_mb,
        "peak_mb_compacted": compacted_mb,
        "raw_s": raw_s,
        "polars_raw_s": polars_s,
        "polars_over_raw": polars_s / raw_s,
        "rollup_s": rolled_s,
        "raw_over_rollup": raw_s / rolled_s,
        "peak_mb": peak_mb(),
    }


def ask_polars(store: Store) -> list[float]:
    """The same question to polars, over the same files."""
    import polars as pl

    folders = [store.lake / part.name for part in read_manifest(store).parts]
    channels = pl.concat([pl.read_parquet(folder / "channels.parquet") for folder in folders]).unique("channel")
    samples = pl.scan_parquet([folder / "samples.parquet" for folder in folders])
    found = (
        samples.join(channels.lazy().select("channel", "unit", "run", "scale", "offset"), on="channel")
        .with_columns(
            ((pl.col("base") + pl.col("above")) * pl.col("scale") + pl.col("offset")).alias("x"),
            (pl.col("t_ns") // 10_000_000_000).alias("bucket"),
        )
        .group_by("unit", "bucket")
        .agg(pl.col("x").mean())
        .group_by("unit")
        .agg(pl.col("x").std())
        .sort("unit")
        .collect(engine="streaming")
    )
    return [float(each) for each in found["x"]]


def write_segments(store: Store, count: int, units: int) -> None:
    """Segments of five minutes, 288 a day, of one sample a second."""
    rng = np.random.default_rng(1)
    with WriterLock(store, "benchmark"):
        log = EventLog(store)
        for number in range(count):
            run = f"run-{number // 288}"
            t0_ns = START_NS + number * 300 * 10**9
            if number % 288 == 0:
                started = encode_event(RunStarted(run=run, t_ns=t0_ns), "00", 2 * (number // 288))
                append(log, LogRecord(event_key(PLACE), EVENTS, t0_ns, t0_ns, started))
            for unit in range(units):
                name = f"FOG-{unit:04d}"
                counts = np.round(rng.normal(0, 50.0, 300)).astype(np.int32)
                epoch = UUID(int=number // 288 * 1000 + unit + 1)
                seq = number % 288 * 300
                batch = SampleBatch(name, "rate", run, epoch, seq, t0_ns, 10**9, "deg/s", counts=counts)
                key = sample_key(PLACE, name, "rate")
                append(log, LogRecord(key, SAMPLES, batch.last_ns, t0_ns, encode_batch(batch)))
            if number % 288 == 287:
                ended = encode_event(RunEnded(run=run, t_ns=t0_ns), "00", 2 * (number // 288) + 1)
                append(log, LogRecord(event_key(PLACE), EVENTS, t0_ns, t0_ns, ended))
            log.seal()


def cold_start(store: Store) -> float:
    """Seconds of a process that counts the runs, the best of three."""
    program = str(Path(sys.executable).with_name("gyrofleet"))
    command = [program, "sql", "select count(*) from runs", "--store", str(store.folder), "--json"]
    seconds, done = best_of(3, lambda: subprocess.run(command, check=True, capture_output=True, text=True))
    assert json.loads(done.stdout)[0]["count_star()"] > 0
    return seconds


def segments(folder: Path, count: int, units: int) -> dict[str, Any]:
    store = Store.create(folder)
    begin = time.perf_counter()
    write_segments(store, count, units)
    logged_s = time.perf_counter() - begin
    begin = time.perf_counter()
    with builder_lock(store):
        for _ in build_missing(store, compacts=False):
            pass
        built_s = time.perf_counter() - begin
        before_s = cold_start(store)
        begin = time.perf_counter()
        for _ in compact(Lake(store), now_ns=START_NS + 365 * DAY_NS):
            pass
        compacted_s = time.perf_counter() - begin
        Lake(store).purge(grace_s=0.0)
    return {
        "segments": count,
        "log_written_s": logged_s,
        "lake_built_s": built_s,
        "cold_start_uncompacted_s": before_s,
        "compacted_s": compacted_s,
        "parts": len(read_manifest(store).parts),
        "cold_start_s": cold_start(store),
        "peak_mb": peak_mb(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mode", nargs="?", choices=("query", "segments"), default="query")
    parser.add_argument("--units", type=int, default=None, help="200 for query, 8 for segments")
    parser.add_argument("--days", type=int, default=5)
    parser.add_argument("--samples", type=int, default=100_000, help="a unit and day")
    parser.add_argument("--count", type=int, default=10_000, help="of segments")
    parser.add_argument("--folder", type=Path, help="where to work; kept then")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    folder = options.folder or Path(tempfile.mkdtemp(prefix="gyrofleet-lake-"))
    try:
        if options.mode == "query":
            found = query(folder / "store", options.units or 200, options.days, options.samples)
        else:
            found = segments(folder / "store", options.count, options.units or 8)
    finally:
        if options.folder is None:
            shutil.rmtree(folder)
    if options.json:
        print(json.dumps(found))
    else:
        for name, value in found.items():
            print(f"{name:30} {value:,.4g}" if isinstance(value, float) else f"{name:30} {value:,}")


if __name__ == "__main__":
    main()
