"""Speeds of two versions side by side: ``python -m tests.bench.versions OTHER [--rounds 2] [--only WORD] [--json]``.

OTHER is a checkout of another version with an environment of its own in ``.venv``. Both are measured in turn, in
processes of their own with the benches of their version, so that a slower hour of the machine meets both; of the rounds
the best of each counts. Files that are imported are the same. All rows take about 20 minutes and 5 GB of disk.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.bench.small_files import cpu, made
from tests.bench.table_rows import machine

HERE = Path(__file__).resolve().parents[2]
HIGHER, LOWER = "higher", "lower"


class Row(NamedTuple):
    """What is measured of a version; `values` gives it for a checkout and a folder with the files to import."""

    names: dict[str, tuple[str, str]]  # by work: unit, and which value is the better
    values: Callable[[Path, Path], dict[str, float]]


def bench(checkout: Path, name: str, *arguments: str) -> list[dict[str, Any]]:
    """The JSON lines of a bench of a checkout."""
    command = [".venv/bin/python", "-m", f"tests.bench.{name}", *arguments, "--json"]
    done = subprocess.run(command, cwd=checkout, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{checkout}: {' '.join(command)} failed:\n{done.stderr[-2000:]}")
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]


def imported(checkout: Path, files: Path) -> tuple[float, float]:
    """Processor seconds of `gyrofleet import` of the files of a folder into a new store, and peak memory in MB."""
    paths = sorted(map(str, files.iterdir()))
    with tempfile.TemporaryDirectory() as folder:
        words = ("import", *paths, "--unit", "U1", "--store", f"{folder}/store")
        cpu_s, _, peak_mb = cpu([str(checkout / ".venv/bin/gyrofleet"), *words])
    return cpu_s, peak_mb


def _import(folder: str, what: str) -> Row:
    def values(checkout: Path, files: Path) -> dict[str, float]:
        cpu_s, peak_mb = imported(checkout, files / folder)
        return {f"import of {what}": cpu_s, f"import of {what}, memory": peak_mb}

    return Row({f"import of {what}": ("s of CPU", LOWER), f"import of {what}, memory": ("MB", LOWER)}, values)


def _durable(checkout: Path, files: Path) -> dict[str, float]:
    del files
    found = bench(checkout, "durable_rate", "--seconds", "8", "--no-peer")[0]["gyrofleet"]
    return dict(zip(DURABLE, (found["samples_per_s"] / 1e6, found["bytes_per_sample"]), strict=True))


def _allan(checkout: Path, files: Path) -> dict[str, float]:
    del files
    return {ALLAN: bench(checkout, "estimators", "speed")[0]["speed"]["ns_per_sample"]}


def _worker(checkout: Path, files: Path) -> dict[str, float]:
    del files
    found = bench(checkout, "worker_rate", "--samples", "1e7")
    return dict(zip(WORKER, (each["samples_per_s"] / 1e6 for each in found), strict=True))


def _lake(checkout: Path, files: Path) -> dict[str, float]:
    del files
    found = bench(checkout, "lake_query")[0]
    keys = ("lake_built_million_a_s", "raw_s", "rollup_s", "samples_file_bytes_a_sample")
    return dict(zip(LAKE, (found[key] for key in keys), strict=True))


def _metrics(checkout: Path, files: Path) -> dict[str, float]:
    del files
    found = bench(checkout, "fleet_metrics", "fleet", "--tries", "1")[-1]
    return {METRICS: found["every_metric_s"]}


def _can(checkout: Path, files: Path) -> dict[str, float]:
    del files
    return {CAN: bench(checkout, "can_decode")[0]["batches_frames_per_s"] / 1e6}


DURABLE = ("durable, acknowledged, every estimate, 1000 signals", "log")
ALLAN = "Allan deviation, 24 octaves, 1000 a batch"
WORKER = ("every estimate of 1000 signals, 100 a batch", "every estimate of 1000 signals, 1000 a batch")
LAKE = ("lake built", "1e8 rows, deviation of 10 s means, raw", "the same from the rollup", "lake, file of samples")
OF_LAKE = (("M samples/s", HIGHER), ("s", LOWER), ("s", LOWER), ("bytes/sample", LOWER))
METRICS = "every metric of 1000 units, 30 days"
CAN = "CAN frames decoded into batches"
ROWS = (
    _import("one", "one CSV file of 200,000 rows x 6"),
    _import("small", "200 files of 720 rows x 21"),
    Row({DURABLE[0]: ("M samples/s", HIGHER), DURABLE[1]: ("bytes/sample", LOWER)}, _durable),
    Row({ALLAN: ("ns a sample", LOWER)}, _allan),
    Row(dict.fromkeys(WORKER, ("M samples/s", HIGHER)), _worker),
    Row(dict(zip(LAKE, OF_LAKE, strict=True)), _lake),
    Row({METRICS: ("s", LOWER)}, _metrics),
    Row({CAN: ("M frames/s", HIGHER)}, _can),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("other", type=Path, help="checkout of another version")
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--only", action="append", default=[], help="rows whose work contains this; several")
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    other = asked.other.resolve()
    if not (other / ".venv/bin/gyrofleet").exists():
        parser.error(f"{other}: no .venv/bin/gyrofleet; install that version in an environment of its own there")
    print(machine(), file=sys.stderr)
    rows = [row for row in ROWS if not asked.only or any(word in name for word in asked.only for name in row.names)]
    with tempfile.TemporaryDirectory() as folder:
        files = Path(folder)
        for name in ("one", "small"):
            (files / name).mkdir()
        made(files / "one", 1, 200_000, 6)
        made(files / "small", 200, 720, 21)
        for row in rows:
            found: dict[str, dict[Path, list[float]]] = {name: {other: [], HERE: []} for name in row.names}
            for _ in range(asked.rounds):
                for checkout in (other, HERE):
                    for name, value in row.values(checkout, files).items():
                        found[name][checkout].append(value)
            for name, (unit, better) in row.names.items():
                theirs, ours = ((max if better == HIGHER else min)(found[name][each]) for each in (other, HERE))
                times = ours / theirs if better == HIGHER else theirs / ours
                if asked.json:
                    line = {"work": name, "unit": unit, "other": theirs, "this": ours, "times_better": times}
                    print(json.dumps(line), flush=True)
                else:
                    print(f"{name:52} {unit:12} {theirs:10.4g} {ours:10.4g} {times:6.2f} times better", flush=True)


if __name__ == "__main__":
    main()
