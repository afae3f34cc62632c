"""How fast the log is verified: ``python -m tests.bench.verify_rate [--samples 1e8] [--json]``.

`gyrofleet verify` of log and lake, as a process of its own, by the bytes of the segments: reading everything, and with
`--since` an attestation that was made after it. Beside it how fast the same segments are read and hashed (SHA-256) by
one thread, all with the files in the page cache. The start of the process, taken from a store with a thousand samples,
is subtracted. The bytes of the lake, which is hashed as well, do not count.
"""

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from storage.lake.builder import build_missing, builder_lock
from storage.store import Store
from tests.bench.lake_query import write_log

GYROFLEET = str(Path(sys.executable).with_name("gyrofleet"))


def seconds(store: Store, *words: str) -> float:
    """Wall-clock seconds of the command, the best of three."""
    command = [GYROFLEET, "verify", "--store", str(store.folder), "--json", *words]
    spent = []
    for _ in range(3):
        began = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True)
        spent.append(time.perf_counter() - began)
    return min(spent)


def measure(samples: int) -> dict[str, float]:
    """GB of the log a second."""
    with tempfile.TemporaryDirectory() as folder:
        least = Store.create(Path(folder) / "least")
        write_log(least, 1, 1, 1000, rate_hz=100)
        store = Store.create(Path(folder) / "store")
        write_log(store, 200, 5, samples // 1000, rate_hz=100)
        for each in (least, store):
            with builder_lock(each):
                for _ in build_missing(each):
                    pass
        files = sorted(store.log.glob("*.mcap"))
        spent_s = seconds(store) - seconds(least)
        for each in (least, store):
            words = ("attest", "--verify", "--key", f"{folder}/attest.pem", "--store", str(each.folder))
            subprocess.run([GYROFLEET, *words], check=True, capture_output=True)
        since_s = seconds(store, "--since", "last") - seconds(least, "--since", "last")
        began = time.perf_counter()
        for path in files:
            hashlib.sha256(path.read_bytes()).digest()
        read_s = time.perf_counter() - began
        size_gb = sum(path.stat().st_size for path in files) / 1e9
        lake_gb = sum(path.stat().st_size for path in store.lake.rglob("*.parquet")) / 1e9
    return {
        "gb": size_gb, "gb_per_s": size_gb / spent_s, "since_gb_per_s": size_gb / since_s, "lake_gb": lake_gb,
        "hashed_gb_per_s": size_gb / read_s,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=float, default=1e8)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    found = measure(int(asked.samples))
    print(json.dumps(found) if asked.json else ", ".join(f"{name} {value:.3g}" for name, value in found.items()))


if __name__ == "__main__":
    main()
