"""A drill: a store is backed up again and again while it is recorded, the recorder is killed, the backup restored."""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.live_source import LiveSource

BY_UNIT = (
    "select unit, count(*)::int as n, count(distinct seq)::int as numbers, max(seq)::int as last, "
    "sum(counts)::bigint as total from samples group by unit order by unit"
)


@pytest.mark.parametrize("backups", [2, pytest.param(3, marks=pytest.mark.long)])
def test_a_backup_under_load_holds_what_was_acknowledged(
    start: Callable[..., Any], gyrofleet: Callable[..., Any], endpoint: str, tmp_path: Path, backups: int
) -> None:
    recorder = start("record", "--listen", endpoint, "--store", "S", "--rotate-s", 1, "--json")
    recorder.said("recording")
    with LiveSource(endpoint, units=2) as source:
        added: list[int] = []
        deadline_s = time.monotonic() + 60.0
        while len(added) < backups or sum(added) < 2:  # a busy machine seals later
            assert time.monotonic() < deadline_s
            time.sleep(1.0)
            acknowledged, _ = source.acknowledged()
            done = gyrofleet("backup", "B", "--store", "S", "--json")
            assert done.code == 0, done.err
            added.append(json.loads(done.out)["added_segments"])
        source.stop()
    recorder.kill()
    done = gyrofleet("restore", "B", "--store", "R", "--json")
    assert done.code == 0, done.err
    restored = json.loads(done.out)
    assert restored["sound"]
    rows = {row["unit"]: row for row in json.loads(gyrofleet("sql", BY_UNIT, "--store", "R", "--json").out)}
    for unit, next_seq in acknowledged.items():
        n = rows[unit]["n"]
        assert n >= next_seq
        assert (rows[unit]["numbers"], rows[unit]["last"], rows[unit]["total"]) == (n, n - 1, n * (n - 1) // 2)
    assert sum(row["n"] for row in rows.values()) == restored["samples"]
    # the killed recorder's store has at least as much; the drill ends with both sound
    assert gyrofleet("recover", "--store", "S", "--json").code == 0
    own = {row["unit"]: row["n"] for row in json.loads(gyrofleet("sql", BY_UNIT, "--store", "S", "--json").out)}
    assert all(own[unit] >= row["n"] for unit, row in rows.items())
    shown = gyrofleet("backup", "B", "--store", "S")
    assert "in all; the open segment has" in shown.out
    assert gyrofleet("restore", "B", "--store", "R").code != 0  # it is there already
