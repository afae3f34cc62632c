"""The publisher's spool beside SQLite as a spool: messages a second that survive a killed process, and file sizes.

    .venv/bin/python -m tests.bench.spool_sqlite [--messages 20000] [--bytes 4000] [--json]

Both take one message after the other, sync to disk every 0.2 s, then read all in blocks and acknowledge them. SQLite
commits each message (write-ahead log, `synchronous = off`, so that a killed process loses none) and syncs its files as
the spool does.
"""

import argparse
import json
import os
import sqlite3
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from stream.delivery.spool import Spool
from stream.wire.acknowledgement import StreamId

STREAM = StreamId("gyrofleet/plant/bench/U1/rate", "e")
SYNC_S, READ_BYTES = 0.2, 1 << 20


def by_files(folder: Path, messages: int, payload: bytes) -> tuple[float, float, int]:
    with Spool(folder, sync_interval_s=SYNC_S) as spool:
        began = time.perf_counter()
        for number in range(messages):
            spool.append(STREAM, number, number + 1, payload)
        written = time.perf_counter()
        size = _size(folder)
        last = 0
        while taken := spool.read(READ_BYTES):
            last = taken[-1].next_seq
            spool.acknowledge("store", STREAM, last)
        assert last == messages, last
        return messages / (written - began), messages / (time.perf_counter() - written), size


def by_sqlite(folder: Path, messages: int, payload: bytes) -> tuple[float, float, int]:
    folder.mkdir()
    path = folder / "spool.sqlite"
    base = sqlite3.connect(path, isolation_level=None)
    base.executescript(
        "pragma journal_mode = wal; pragma synchronous = off; pragma page_size = 8192;"
        "create table message(id integer primary key, stream text, seq integer, next_seq integer, payload blob)"
    )
    began = synced = time.perf_counter()
    for number in range(messages):
        base.execute("insert into message values (null, ?, ?, ?, ?)", (STREAM.key, number, number + 1, payload))
        if time.perf_counter() - synced > SYNC_S:
            _sync(folder)
            synced = time.perf_counter()
    _sync(folder)
    written = time.perf_counter()
    size, last = _size(folder), 0
    while taken := base.execute(
        "select id, next_seq, payload from message where id > ? order by id limit ?", (last, READ_BYTES // len(payload))
    ).fetchall():
        last = taken[-1][0]
        base.execute("delete from message where id <= ?", (last,))
    assert last == messages, last
    done = time.perf_counter()
    base.close()
    return messages / (written - began), messages / (done - written), size


def _sync(folder: Path) -> None:
    for each in folder.iterdir():
        descriptor = os.open(each, os.O_RDONLY)
        os.fsync(descriptor)
        os.close(descriptor)


def _size(folder: Path) -> int:
    return sum(each.stat().st_size for each in folder.iterdir())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--messages", type=int, default=20_000)
    parser.add_argument("--bytes", type=int, default=4000)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    ways: dict[str, Callable[[Path, int, bytes], tuple[float, float, int]]] = {"files": by_files, "sqlite": by_sqlite}
    found: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as temporary:
        for turn in range(3):
            for name, way in ways.items():
                rates = way(Path(temporary) / f"{name}-{turn}", given.messages, os.urandom(given.bytes))
                best = found.setdefault(name, {"appended_per_s": 0.0, "drained_per_s": 0.0, "bytes": float(rates[2])})
                best["appended_per_s"] = max(best["appended_per_s"], rates[0])
                best["drained_per_s"] = max(best["drained_per_s"], rates[1])
    if given.json:
        print(json.dumps(found))
        return
    for name, each in found.items():
        print(f"{name:7} {each['appended_per_s']:9,.0f} appended/s {each['drained_per_s']:9,.0f} read+acknowledged/s "
              f"{each['bytes'] / given.messages / given.bytes:.3f} bytes on disk a byte")  # fmt: skip


if __name__ == "__main__":
    main()
