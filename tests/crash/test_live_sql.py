"""What a recorder has acknowledged is in SQL at once, each once, while it records, seals, builds, and is killed."""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from storage.sql.door import SqlDoor
from storage.store import Store
from tests.live_source import ESTIMATOR, LiveSource

BY_UNIT = """
select unit, count(*)::int as n, count(distinct seq)::int as numbers, min(seq)::int as first, max(seq)::int as last,
  sum(counts)::bigint as total, count(distinct t_ns)::int as moments
from samples group by unit
"""
ESTIMATES = (
    f"select count(*)::int as n, count(distinct uid)::int as documents from estimates where estimator = '{ESTIMATOR}'"
)


class Seen:
    """Statements on a store that is recorded, compared with what its recorder has acknowledged before them."""

    def __init__(self, store: Path, source: LiveSource) -> None:
        self.store, self.source = store, source
        self.seconds: list[float] = []
        self.live: list[int] = []

    def look(self, ask: Callable[[str], list[dict[str, Any]]]) -> None:
        """Ask once; everything acknowledged before is there, each sample once and without a gap."""
        acknowledged, estimates = self.source.acknowledged()
        begin = time.monotonic()
        rows = {row.pop("unit"): row for row in ask(BY_UNIT)}
        self.seconds.append(time.monotonic() - begin)
        for unit, next_seq in acknowledged.items():
            n = rows[unit]["n"] if unit in rows else 0
            assert n >= next_seq
            if n:
                assert rows[unit] == {
                    "n": n, "numbers": n, "moments": n, "first": 0, "last": n - 1, "total": n * (n - 1) // 2
                }  # fmt: skip
        (found,) = ask(ESTIMATES)
        assert found["n"] == found["documents"] >= estimates
        self.live += [row["live"] for row in ask("select coalesce(sum(live), 0)::int as live from signals")]

    def look_through_door(self) -> None:
        """Ask through a door opened for it."""
        with SqlDoor(Store.open(self.store)) as door:
            self.look(lambda sql: door.ask(sql).read_all().to_pylist())


def recorder(start: Callable[..., Any], endpoint: str, *options: object) -> Any:
    service = start("record", "--connect", endpoint, "--store", "S", "--json", *options)
    service.said("recording")
    return service


@pytest.mark.long  # in the gate: `storage/sql/test_live.py`
def test_what_is_acknowledged_is_in_sql(
    start: Callable[..., Any], gyrofleet: Callable[..., Any], endpoint: str, tmp_path: Path
) -> None:
    start("record", "--listen", endpoint, "--store", "S", "--rotate-s", 2, "--json").said("recording")
    with LiveSource(endpoint, units=2) as source:
        seen = Seen(tmp_path / "S", source)
        time.sleep(0.5)
        for _ in range(2):
            seen.look(lambda sql: json.loads(gyrofleet("sql", sql, "--store", "S", "--json").out))
        source.stop()
        seen.look_through_door()
    assert any(seen.live)


@pytest.mark.long
def test_a_minute_of_sealing_every_second_and_killed_recorders(
    start: Callable[..., Any], gyrofleet: Callable[..., Any], endpoint: str, tmp_path: Path
) -> None:
    start("router", "--listen", endpoint, "--json").said("routing")
    recording = recorder(start, endpoint, "--rotate-s", 1)
    with LiveSource(endpoint) as source:
        seen = Seen(tmp_path / "S", source)
        until = time.monotonic() + 60.0
        while time.monotonic() < until:
            for _ in range(4):
                seen.look_through_door()
            seen.look(lambda sql: json.loads(gyrofleet("sql", sql, "--store", "S", "--json").out))
            recording.kill()
            seen.look_through_door()
            recording = recorder(start, endpoint, "--rotate-s", 1)
        source.stop()
        seen.look_through_door()
    assert any(seen.live)
    recording.stop()
    seen.look_through_door()
    verified = gyrofleet("verify", "--store", "S", "--json")
    assert verified.code == 0, verified.out


@pytest.mark.long
def test_a_run_in_one_process_is_seen_within_two_seconds(start: Callable[..., Any], tmp_path: Path) -> None:
    start(
        "run-simulated", "--run", "r1", "--simulate", 4, "--hours", 0.03, "--store", "S", "--json"
    ).said("running")  # fmt: skip
    newest = "select epoch_ns(now())::bigint - max(t_ns) as age_ns from samples"
    ages_s: list[float] = []
    estimates = 0
    until = time.monotonic() + 100.0
    while estimates == 0 and time.monotonic() < until:
        with SqlDoor(Store.open(tmp_path / "S")) as door:
            (age_ns,) = (row["age_ns"] for row in door.ask(newest).read_all().to_pylist())
            if age_ns is not None:  # the first look may come before the first sample
                ages_s.append(age_ns / 1e9)
            estimates += door.ask("from estimates").read_all().num_rows
        time.sleep(2.0)
    assert estimates > 0
    assert len(ages_s) > 5
    assert sorted(ages_s)[len(ages_s) // 4] < 2.0  # the others may have waited for a machine at work on other things
