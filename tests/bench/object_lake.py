"""A published lake against the same one in a folder: ``python -m tests.bench.object_lake``.

1e8 samples (200 units, 5 days, unless told otherwise) go through the log and the builder, and are published on moto's
server, a process of its own. The same statements are asked through the sandbox over the store, over the published lake
with an empty cache, and again with a warm one. The answers must be equal, floating-point sums to 1e-12: threads add in
any order. `--days 50` makes 1e9 rows.
"""

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

from storage.check.verify_published import verify_published
from storage.lake.builder import build_missing, builder_lock
from storage.lake.compaction import compact
from storage.lake.lake import Lake
from storage.object_lake.bucket import Bucket
from storage.object_lake.published_store import PublishedStore
from storage.object_lake.publisher import Publisher
from storage.sql.door import SqlDoor
from storage.store import Store
from tests.bench.lake_query import DAY_NS, START_NS, best_of, peak_mb, write_log
from tests.free_ports import free_endpoint

STATEMENTS = {
    "raw": "select unit, stddev(mean) as sd from (select unit, t_ns // 10000000000 as bucket, avg(value) as mean "
    "from samples group by unit, bucket) group by unit order by unit",
    "rollup": "select unit, stddev(mean) as sd from rollup_10s group by unit order by unit",
    "rows": "select unit, count(*) as n, sum(counts)::bigint as sum from samples group by unit order by unit",
    "one_unit": "select count(*) as n, sum(counts)::bigint as sum from samples "
    "where unit = 'FOG-0007' and run = 'run-1'",
}


@contextmanager
def object_store() -> Iterator[str]:
    """Endpoint of moto's server, with the bucket `fleet`."""
    port = free_endpoint().rpartition(":")[2]
    server = subprocess.Popen(
        [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", port], stderr=subprocess.DEVNULL
    )
    endpoint = f"http://127.0.0.1:{port}"
    try:
        for _ in range(200):
            with suppress(OSError):
                urllib.request.urlopen(urllib.request.Request(f"{endpoint}/fleet", method="PUT")).close()
                break
            time.sleep(0.1)
        yield endpoint
    finally:
        server.terminate()
        server.wait()


def answer(door: SqlDoor, sql: str) -> list[dict[str, Any]]:
    return list(door.ask(sql).read_all().to_pylist())


def same(mine: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether two rows are equal, values of floating point to 1e-12."""
    return mine.keys() == other.keys() and all(
        math.isclose(value, other[name], rel_tol=1e-12) if isinstance(value, float) else value == other[name]
        for name, value in mine.items()
    )


def asked(store: Store, count: int) -> dict[str, tuple[float, Any]]:
    """Seconds and rows of each statement through the sandbox, the best of `count`; its process runs already."""
    with SqlDoor(store) as door:
        door.ask("select 1").read_all()
        return {name: best_of(count, partial(answer, door, sql)) for name, sql in STATEMENTS.items()}


def compare(folder: Path, units: int, days: int, samples: int) -> dict[str, Any]:
    store = Store.create(folder / "store")
    begin = time.perf_counter()
    write_log(store, units, days, samples, rate_hz=100)
    logged_s = time.perf_counter() - begin
    begin = time.perf_counter()
    with builder_lock(store):
        list(build_missing(store, compacts=False))
        list(compact(Lake(store), now_ns=START_NS + (days + 30) * DAY_NS))
        Lake(store).purge(grace_s=0.0)
    built_s = time.perf_counter() - begin
    os.environ |= {"AWS_ACCESS_KEY_ID": "bench", "AWS_SECRET_ACCESS_KEY": "bench", "AWS_REGION": "us-east-1"}
    with object_store() as endpoint:
        bucket = Bucket("s3://fleet/bench", endpoint)
        begin = time.perf_counter()
        with builder_lock(store):
            lake = Publisher(store, bucket).publish()
        published_s = time.perf_counter() - begin
        size = sum(part.bytes for part in lake.parts)
        local = asked(store, 3)
        begin = time.perf_counter()
        remote_store = PublishedStore.open_url("s3://fleet/bench", endpoint, cache=folder / "cache")
        opened_s = time.perf_counter() - begin
        with SqlDoor(remote_store) as door:
            begin = time.perf_counter()
            one = door.ask(STATEMENTS["one_unit"]).read_all().to_pylist()
            one_s = time.perf_counter() - begin
        one_bytes = remote_store.cache.fetched_bytes
        cold = asked(remote_store, 1)
        warm = asked(PublishedStore.open_url("s3://fleet/bench", endpoint, cache=folder / "cache"), 3)
        verified = verify_published(bucket, store)
    for name, (_, rows) in local.items():
        for other in (cold[name][1], warm[name][1]):
            assert len(rows) == len(other) > 0, name
            assert all(same(mine, its) for mine, its in zip(rows, other, strict=True)), name
    assert one == local["one_unit"][1]
    assert verified.is_sound
    return {
        "rows": units * days * samples, "parts": len(lake.parts), "lake_mb": size / 1e6,
        "logged_million_a_s": units * days * samples / logged_s / 1e6,
        "built_and_merged_million_a_s": units * days * samples / built_s / 1e6,
        "published_mb_a_s": size / 1e6 / published_s, "verified_mb_a_s": size / 1e6 / verified.seconds,
        "opened_s": opened_s, "one_unit_first_s": one_s, "one_unit_fetched_mb": one_bytes / 1e6,
        **{f"{name}_local_s": seconds for name, (seconds, _) in local.items()},
        **{f"{name}_cold_s": seconds for name, (seconds, _) in cold.items()},
        **{f"{name}_warm_s": seconds for name, (seconds, _) in warm.items()},
        **{f"{name}_warm_over_local": warm[name][0] / local[name][0] for name in STATEMENTS},
        "peak_mb": peak_mb(),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--units", type=int, default=200)
    parser.add_argument("--days", type=int, default=5)
    parser.add_argument("--samples", type=int, default=100_000, help="a unit and day")
    parser.add_argument("--folder", type=Path, help="for the files, which are removed  [default: a temporary one]")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        print(json.dumps(compare(Path(folder), options.units, options.days, options.samples), indent=1))


if __name__ == "__main__":
    main()
