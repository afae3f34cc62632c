"""End-to-end rate of `gyrofleet import`: file -> Zenoh -> log -> lake and online estimates.

    .venv/bin/python tests/bench/import_rate.py [FILE] [--runs 5] [--rows 1000000] [--json]

Without FILE it makes one: three rates and three accelerations at 100 Hz, the rates on a grid of 0.05 deg/s.
Each run is a process of its own into a fresh store. Reported are the rate from the first pass over the file to
the counted lake, the rate of the whole process (starting Python included), and the peak memory. Beside it, in
turn, runs a peer that does less: polars reads the file and writes one Parquet file, with no bus, log or estimates.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

PEER = """
import sys, polars as pl
pl.scan_parquet(sys.argv[1]).sink_parquet(sys.argv[2], compression="zstd", compression_level=3)
"""


def timed(command: list[str]) -> tuple[float, float, str]:
    """Wall-clock seconds, peak memory in MB and output of a process."""
    began = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    out = process.stdout.read()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        sys.exit(f"{' '.join(command)} failed:\n{out}")
    return time.perf_counter() - began, usage.ru_maxrss / 1024, out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, nargs="?")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        file = arguments.file or made(Path(folder) / "made.parquet", arguments.rows)
        measure(file, arguments.runs, as_json=arguments.json)


def made(path: Path, rows: int) -> Path:
    """A file of simulated samples, written piece by piece."""
    rng = np.random.default_rng(1)
    writer: pq.ParquetWriter | None = None
    for begin in range(0, rows, 1_000_000):
        n = min(1_000_000, rows - begin)
        columns = {"time[s]": np.arange(begin, begin + n) * 0.01}
        columns |= {f"rate_{axis}[deg/s]": np.round(rng.standard_normal(n) * 7) * 0.05 for axis in "xyz"}
        columns |= {f"acceleration_{axis}[g_0]": rng.standard_normal(n) for axis in "xyz"}
        table = pa.table(columns)
        writer = writer or pq.ParquetWriter(path, table.schema)
        writer.write_table(table)
    assert writer is not None
    writer.close()
    return path


def measure(file: Path, runs: int, *, as_json: bool) -> None:
    program = str(Path(sys.executable).with_name("gyrofleet"))
    rates, whole, memory, ratios = [], [], [], []
    samples = 0
    for turn in range(runs + 1):
        with tempfile.TemporaryDirectory() as folder:
            command = [program, "import", str(file), "--unit", "U1", "--store", f"{folder}/store", "--json"]
            seconds, peak_mb, out = timed(command)
            peer_seconds, _, _ = timed([sys.executable, "-c", PEER, str(file), f"{folder}/peer.parquet"])
        (imported,) = json.loads(out)["files"]
        samples = sum(signal["in_lake"] for signal in imported["signals"])
        if turn == 0:
            continue  # the first compiles and fills caches
        rates.append(samples / imported["seconds"] / 1e6)
        whole.append(samples / seconds / 1e6)
        memory.append(peak_mb)
        ratios.append(seconds / peer_seconds)
    if as_json:
        found = {"samples_per_s": rates, "process_samples_per_s": whole, "memory_mb": memory, "times_peer": ratios}
        print(json.dumps({name: statistics.median(each) for name, each in found.items()}))
        return
    print(f"{file.name}: {samples:,} samples, {runs} runs, {os.cpu_count()} cores")
    for name, unit, values in (
        ("import", "M samples/s", rates),
        ("whole process", "M samples/s", whole),
        ("peak memory", "MB", memory),
        ("time, as a multiple of polars' copy", "x", ratios),
    ):
        print(f"  {name:36} median {statistics.median(values):8.2f}  {min(values):8.2f} to {max(values):8.2f} {unit}")


if __name__ == "__main__":
    main()
