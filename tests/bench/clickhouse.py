"""The peer for storing and asking: ClickHouse in this process (chdb), bulk inserts that are synced to the disk.

    .venv/bin/python -m tests.bench.clickhouse [--samples 2e7] [--units 1000] [--folder FOLDER] [--json]

Each insert has a million samples of an Arrow table: a second of each unit after another, as a recorder gets them, the
same counts as `durable_rate` (Gaussian, standard deviation 50). Columns have the codecs that store them in the fewest
bytes of those tried: DoubleDelta for times, T64 for counts, both with ZSTD. Reported are samples a second, the making
of the tables apart; bytes a sample once merged; and how long the standard deviation of the 10 s means of each unit
takes, the best of three.
"""

import argparse
import json
import tempfile
import time
from typing import Any

import numpy as np
import pyarrow as pa

INSERTED = 1_000_000
DT_NS = 10_000_000
TABLE = """CREATE TABLE bench.samples (
  unit LowCardinality(String), t_ns Int64 CODEC(DoubleDelta, ZSTD(1)), count Int32 CODEC(T64, ZSTD(1))
) ENGINE = MergeTree ORDER BY (unit, t_ns) SETTINGS fsync_after_insert = 1, fsync_part_directory = 1"""
ASKED = """select unit, stddevSamp(mean) from (
  select unit, intDiv(t_ns, 10000000000) as bucket, avg(count * 1e-5) as mean from bench.samples group by unit, bucket
) group by unit order by unit format Null"""


def measure(folder: str, samples: int, units: int) -> dict[str, float]:
    """Rates and sizes of one table."""
    from chdb import session

    rng = np.random.default_rng(1)
    made: Any = session.Session
    opened = made(folder)
    opened.query("CREATE DATABASE bench ENGINE = Atomic")
    opened.query(TABLE)
    each = INSERTED // units
    names = pa.array(np.repeat([f"U{i}" for i in range(units)], each))
    spent_s = 0.0
    for turn in range(samples // INSERTED):
        counts = np.round(rng.normal(0, 50, each * units)).astype(np.int32)
        times = np.tile(np.arange(turn * each, (turn + 1) * each) * DT_NS, units)
        rows = pa.table({"unit": names, "t_ns": times, "count": counts})
        began = time.perf_counter()
        opened.query("INSERT INTO bench.samples SELECT unit, t_ns, count FROM Python(rows)")
        spent_s += time.perf_counter() - began
        del rows
    opened.query("OPTIMIZE TABLE bench.samples FINAL")
    size = "select sum(bytes_on_disk) / sum(rows) from system.parts where active and table = 'samples'"
    bytes_a_sample = float(opened.query(size).bytes())
    asked_s = []
    for _ in range(3):
        began = time.perf_counter()
        opened.query(ASKED)
        asked_s.append(time.perf_counter() - began)
    return {
        "samples_per_s": samples // INSERTED * each * units / spent_s,
        "bytes_per_sample": bytes_a_sample,
        "asked_s": min(asked_s),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=float, default=2e7)
    parser.add_argument("--units", type=int, default=1000)
    parser.add_argument("--folder", help="where the table is made; empty")
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        found = measure(asked.folder or folder, int(asked.samples), asked.units)
    if asked.json:
        print(json.dumps(found))
        return
    for name, value in found.items():
        print(f"{name:20} {value:,.4g}")


if __name__ == "__main__":
    main()
