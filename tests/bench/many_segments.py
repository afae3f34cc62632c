"""Manifests of a store with a million segments: ``python -m tests.bench.many_segments [--segments N]``.

`--catalogue PARTS UNITS` times the opening of SQL over so many parts, each with a power-on of so many units.
Synthetic: 288 segments of 5 min in a part, as a finished day has, or 32 of 128 MB, the largest parts; a line of the
log's manifest for each. Opening is timed in a process of its own, whose peak memory has Python and the libraries in it.
"""

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa

from storage.lake.tables import CHANNEL_COLUMNS, part_writers
from storage.manifests.entries import SegmentEntry
from storage.manifests.lake import Manifest, read_manifest, write_manifest
from storage.manifests.log import ManifestWriter, manifest_path, read_log_manifest, rewrite_manifest
from storage.manifests.part import Part, PartFile
from storage.sql.catalog import Catalog
from storage.store import Store

FILES = ("samples", "channels", "events", "estimates", "rollup_1s", "rollup_10s", "clocks")
START_NS = 1_763_683_200 * 10**9
SEGMENT_NS = 300 * 10**9


def digest(number: int) -> str:
    return hashlib.sha256(str(number).encode()).hexdigest()


def synthetic_lake(segments: int, in_part: int) -> Manifest:
    parts = []
    for first in range(1, segments + 1, in_part):
        names = tuple(f"{number:08d}" for number in range(first, min(first + in_part, segments + 1)))
        begin = START_NS + first * SEGMENT_NS
        parts.append(
            Part(
                name=f"2025-11-21-{first:08x}",
                segments=names,
                samples=120_000_000,
                files={f"{name}.parquet": PartFile(123_456_789, 120_000_000, digest(first)) for name in FILES},
                t_first_ns=begin,
                t_last_ns=begin + len(names) * SEGMENT_NS,
                arrival_first_ns=begin,
                arrival_last_ns=begin + len(names) * SEGMENT_NS,
                sources={name: digest(int(name)) for name in names},
            )
        )
    return Manifest(parts=tuple(parts))


def synthetic_log(store: Store, segments: int) -> None:
    rewrite_manifest(
        store,
        (
            SegmentEntry(
                f"{number:08d}.mcap", 130_000_000, digest(number), 1000, 100_000_000, START_NS + number * SEGMENT_NS,
                START_NS + (number + 1) * SEGMENT_NS, (f"run-{number // 288}",),
            )
            for number in range(1, segments + 1)
        ),
    )  # fmt: skip


def open_lake(store: Store) -> int:
    return len(read_manifest(store).segments)


def open_log(store: Store) -> int:
    return len(read_log_manifest(store).entries)


def start_recorder(store: Store) -> int:
    return len(ManifestWriter(store).found.entries)


def read_whole_log(store: Store) -> int:
    return len(read_log_manifest(store, whole=True).entries)


def opened(folder: Path, what: str) -> dict[str, float]:
    """Seconds and peak memory of opening, in a process of its own, the best of three."""
    command = [sys.executable, "-m", "tests.bench.many_segments", "--open", what, "--folder", str(folder)]
    found = [json.loads(subprocess.run(command, check=True, capture_output=True).stdout) for _ in range(3)]
    return dict(min(found, key=lambda each: float(each["s"])))


def write_channels(store: Store, parts: int, units: int) -> None:
    """A lake of channels alone: each part has a power-on of each unit of its own."""
    made = []
    for number in range(parts):
        begin = START_NS + number * SEGMENT_NS
        name = f"{number + 1:08d}"
        folder = store.lake / name
        folder.mkdir()
        rows = [
            {
                "channel": (number * units + unit + 1) * 7919, "site": "plant", "station": "chamber-1",
                "unit": f"FOG-{unit:06d}", "signal": "rate", "run": f"run-{number}", "epoch": f"{number}-{unit}",
                "unit_of_measure": "deg/s", "is_counts": True, "scale": 1e-5, "offset": 0.0, "dt_ns": 5_000_000,
                "irregular": False, "samples": 60_000, "seq_first": 0, "seq_next": 60_000, "t_first_ns": begin,
                "t_last_ns": begin + SEGMENT_NS, "arrival_first_ns": begin, "arrival_last_ns": begin + SEGMENT_NS,
                "overlapping": False,
            }
            for unit in range(units)
        ]  # fmt: skip
        with part_writers(folder) as writer:
            file = writer("channels").write_all([pa.Table.from_pylist(rows, schema=CHANNEL_COLUMNS)])
        made.append(Part(name=name, segments=(name,), files={"channels.parquet": file}, samples=0))
    write_manifest(store, Manifest(parts=tuple(made)))


def open_catalogue(store: Store) -> int:
    with Catalog(store) as catalog:
        return len(catalog.parts)


OPENINGS: dict[str, Callable[[Store], int]] = {
    each.__name__: each for each in (open_lake, open_log, start_recorder, read_whole_log, open_catalogue)
}


def measure_catalogue(parts: int, units: int) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as name:
        store = Store.create(Path(name) / "store")
        write_channels(store, parts, units)
        found = opened(store.folder, "open_catalogue")
    rows = parts * units
    return {"parts": parts, "rows": rows, **found, "us_a_row": found["s"] / rows * 1e6}


def measure(segments: int) -> dict[str, Any]:
    results: dict[str, Any] = {"segments": segments}
    with tempfile.TemporaryDirectory() as name:
        store = Store.create(Path(name) / "store")
        for in_part in (288, 32):
            manifest = write_manifest(store, synthetic_lake(segments, in_part))
            key = f"lake_{len(manifest.parts)}_parts"
            results[key] = opened(store.folder, "open_lake")
            before = set((store.lake / "manifest").iterdir())
            begin = time.perf_counter()
            write_manifest(store, Manifest(number=1, parts=manifest.parts[:-1], blocks=manifest.blocks))
            fresh = set((store.lake / "manifest").iterdir()) - before
            results[key] |= {
                "change_s": time.perf_counter() - begin,
                "change_bytes": sum(path.stat().st_size for path in (*fresh, store.lake / "manifest.json")),
                "bytes": sum(path.stat().st_size for path in store.lake.rglob("*") if path.is_file()),
            }
        synthetic_log(store, segments)
        results["log_bytes"] = manifest_path(store).stat().st_size
        results["log_whole"] = opened(store.folder, "read_whole_log")
        start_recorder(store)  # writes the snapshot
        results["log_snapshot_bytes"] = (store.folder / "log-manifest.snapshot").stat().st_size
        results |= {what: opened(store.folder, what) for what in ("open_log", "start_recorder")}
    return results


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--segments", type=int, default=1_000_000)
    parser.add_argument("--catalogue", type=int, nargs=2, metavar=("PARTS", "UNITS"), help="SQL over so many channels")
    parser.add_argument("--open", choices=OPENINGS, help="only this, of the store in --folder")
    parser.add_argument("--folder", type=Path)
    options = parser.parse_args()
    if options.catalogue is not None:
        print(json.dumps(measure_catalogue(*options.catalogue), indent=1))
        return
    if options.open is None:
        print(json.dumps(measure(options.segments), indent=1))
        return
    store = Store.open(options.folder)
    begin = time.perf_counter()
    count = OPENINGS[options.open](store)
    status = Path("/proc/self/status").read_text()  # the peak of getrusage has that of the process before exec in it
    peak_mb = int(status.split("VmHWM:")[1].split()[0]) / 1024
    print(json.dumps({"count": count, "s": time.perf_counter() - begin, "peak_mb": peak_mb}))


if __name__ == "__main__":
    main()
