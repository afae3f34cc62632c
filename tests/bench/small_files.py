"""CPU time of `gyrofleet import` of many small files in one command.

    .venv/bin/python tests/bench/small_files.py [--files 200] [--rows 720] [--signals 21] [--json]

Each file holds one rate, and else channels such as a supply voltage. Beside it, in one run, a peer that does less:
polars reads each file and writes it as Parquet, in one process. Both are whole processes, Python's start included.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

PEER = """
import sys, polars as pl
for path in sys.argv[1:]:
    pl.read_csv(path).write_parquet(path + ".parquet", compression="zstd", compression_level=3)
"""


def made(folder: Path, files: int, rows: int, signals: int) -> list[str]:
    """Files of one run each, a row every 30 s."""
    rng = np.random.default_rng(1)
    names = ["rate[deg/h]", "temperature[degC]", *(f"voltage_{k}[V]" for k in range(signals - 2))]
    paths = []
    for number in range(files):
        time_s = 1.79e9 + 86400.0 * number + 30.0 * np.arange(rows)
        data = np.column_stack([time_s, rng.normal(size=(rows, signals))])
        path = folder / f"run{number:04}.csv"
        np.savetxt(path, data, delimiter=",", header=",".join(["time[s]", *names]), comments="", fmt="%.6f")
        paths.append(str(path))
    return paths


def cpu(command: list[str]) -> tuple[float, float, float]:
    """CPU seconds, wall-clock seconds and peak memory in MB of a process."""
    began = os.times()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        sys.exit(f"{' '.join(command[:4])} ... failed with exit code {process.returncode}")
    return usage.ru_utime + usage.ru_stime, os.times().elapsed - began.elapsed, usage.ru_maxrss / 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=200)
    parser.add_argument("--rows", type=int, default=720)
    parser.add_argument("--signals", type=int, default=21)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    program = str(Path(sys.executable).with_name("gyrofleet"))
    with tempfile.TemporaryDirectory() as folder:
        paths = made(Path(folder), asked.files, asked.rows, asked.signals)
        cpu([program, "import", paths[0], "--unit", "U1", "--store", f"{folder}/first"])  # compiles, once
        ours = cpu([program, "import", *paths, "--unit", "U1", "--store", f"{folder}/store"])
        peer = cpu([sys.executable, "-c", PEER, *paths])
    if asked.json:
        found = {
            "cpu_s": ours[0],
            "wall_s": ours[1],
            "memory_mb": ours[2],
            "peer_cpu_s": peer[0],
            "peer_wall_s": peer[1],
        }
        print(json.dumps(found))
        return
    for name, (spent_s, wall_s, memory_mb) in (("gyrofleet import", ours), ("polars to Parquet", peer)):
        print(f"{name:18} {spent_s:7.1f} s of CPU, {wall_s:7.1f} s, {memory_mb:6.0f} MB")
    print(
        f"{ours[0] / peer[0]:.1f} times the peer's CPU; {asked.files} files, {asked.rows} rows, {asked.signals} signals"
    )


if __name__ == "__main__":
    main()
