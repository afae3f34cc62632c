"""A clock that leaps drops nothing, and what was dropped comes back from the log."""

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from storage.check.verify import verify
from storage.check.verify_lake import lake_problems
from storage.lake.builder import build_missing, builder_lock
from storage.lake.compaction import compact
from storage.lake.lake import Lake
from storage.lake.rebuild import rebuild
from storage.manifests.lake import read_manifest
from storage.sql.catalog import Catalog
from storage.store import Store
from storage.upkeep.retention import Rule, apply_rule, restore_raw
from storage.upkeep.retention_clock import RetentionPaused, trust_clock
from tests.conftest import Outcome
from tests.storage.conftest import DAY_NS, START_NS, Filler
from tests.storage.lake.exported_views import LATER_NS, export

RULE = Rule(older_than_s=86_400.0)
NOW_NS = START_NS + 2 * DAY_NS + 10**9
YEAR_NS = 365 * DAY_NS


class Machine:
    """Both clocks of a machine, set by hand."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.machine_ns, self.boot = 10**12, "first"
        monkeypatch.setattr("storage.upkeep.retention_clock._machine_ns", lambda: self.machine_ns)
        monkeypatch.setattr("storage.upkeep.retention_clock._boot", lambda: self.boot)


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Machine:
    return Machine(monkeypatch)


@pytest.fixture
def store(days: Filler) -> Store:
    """Three days of samples in the lake, and nobody who writes."""
    days.build()
    days.release()
    return days.store


def kept(store: Store) -> int:
    with Catalog(store) as catalog:
        return int(catalog.rows("select count(*) from samples")[0][0])


ALL = 12 * 2525


@pytest.mark.long
@pytest.mark.parametrize("leap_ns", [10 * YEAR_NS, 31 * DAY_NS, -10 * DAY_NS])
@pytest.mark.parametrize("is_seen", [True, False])
def test_an_implausible_clock_drops_nothing(store: Store, machine: Machine, leap_ns: int, is_seen: bool) -> None:
    with builder_lock(store):
        lake = Lake(store)
        if is_seen:
            assert apply_rule(lake, Rule(older_than_s=10 * 86_400.0), now_ns=NOW_NS).parts == 0
            machine.boot = "second"
        for _ in range(2):  # and it is not taken for true the second time
            with pytest.raises(RetentionPaused, match="--trust-clock"):
                apply_rule(lake, RULE, now_ns=NOW_NS + leap_ns)
        assert kept(store) == ALL
        assert apply_rule(lake, Rule(max_bytes=10**9), now_ns=NOW_NS + leap_ns).parts == 0  # sizes need no clock
        assert apply_rule(lake, RULE, now_ns=NOW_NS).parts == 4


def test_a_clock_that_is_set_while_the_machine_runs_is_noticed(store: Store, machine: Machine) -> None:
    with builder_lock(store):
        lake = Lake(store)
        apply_rule(lake, Rule(older_than_s=10 * 86_400.0), now_ns=NOW_NS)
        machine.machine_ns += 3600 * 10**9
        with pytest.raises(RetentionPaused, match=r"set by 2\.0 days while the machine was running"):
            apply_rule(lake, RULE, now_ns=NOW_NS + 2 * DAY_NS + 3600 * 10**9)
        machine.machine_ns += 2 * DAY_NS
        assert apply_rule(lake, RULE, now_ns=NOW_NS + 2 * DAY_NS + 3600 * 10**9).parts == 12


def test_samples_that_arrived_under_a_wrong_clock_do_not_make_the_others_old(days: Filler, machine: Machine) -> None:
    days.counts("rate", START_NS, 100, arrival_ns=START_NS + 10 * YEAR_NS)
    days.seal()
    days.build()
    days.release()
    with builder_lock(days.store):
        lake = Lake(days.store)
        with pytest.raises(RetentionPaused, match=r"arrival leap by 3,6\d\d\.\d days"):
            apply_rule(lake, RULE, now_ns=START_NS + 10 * YEAR_NS + 10**9)
        trust_clock(days.store, START_NS + 10 * YEAR_NS)
        assert apply_rule(lake, RULE, now_ns=START_NS + 10 * YEAR_NS + 10**9).parts == 12


@pytest.mark.long
def test_what_was_dropped_comes_back_from_the_log(store: Store, machine: Machine, tmp_path: Path) -> None:
    export(store, tmp_path / "before")
    with builder_lock(store):
        lake = Lake(store)
        apply_rule(lake, RULE, now_ns=NOW_NS)
        list(compact(lake, now_ns=LATER_NS))
        lake.purge(grace_s=0)
        (store.log / "00000002.mcap").rename(tmp_path / "archived")
        list(build_missing(store))
        assert kept(store) == 8 * 2525
        lake = Lake(store)
        restored = restore_raw(lake)
        assert sorted(lake.manifest.dropped) == ["00000002"]
        (tmp_path / "archived").rename(store.log / "00000002.mcap")
        restored = restore_raw(lake)
        assert restore_raw(lake).samples == 0
        list(build_missing(store))
    assert kept(store) == ALL
    assert restored.samples > 0
    assert list(lake_problems(store)) == []
    with builder_lock(store):
        list(rebuild(store))
    assert read_manifest(store).dropped == {}
    assert kept(store) == ALL
    assert verify(store)[0].is_sound
    with builder_lock(store):  # and it can go again
        assert apply_rule(Lake(store), Rule(max_bytes=0)).samples == ALL
        list(build_missing(store))
        list(rebuild(store))
    assert kept(store) == 0


@pytest.mark.long
def test_the_command_brings_raw_rows_back(store: Store, gyrofleet: Callable[..., Outcome]) -> None:
    assert gyrofleet("retain", "--max-size", "1B", "--store", store.folder, "--json").json["segments"] == 12
    assert kept(store) == 0
    done = gyrofleet("rebuild", "--raw", "--store", store.folder, "--json")
    assert done.json == {"segments": 12, "segments_gone": 0, "samples": ALL}
    assert kept(store) == ALL
    reported = gyrofleet(
        "sql", "select document->>'$.what' as what from events order by time", "--store", store.folder, "--json"
    ).json
    assert [row["what"] for row in reported] == ["raw_rows_dropped", "raw_rows_restored"]


def test_without_a_leap_the_real_clock_is_believed(days: Filler) -> None:
    days.counts("temperature", START_NS, 10, arrival_ns=time.time_ns())
    days.seal()
    days.build()
    days.release()
    trust_clock(days.store, time.time_ns())
    with builder_lock(days.store):
        assert apply_rule(Lake(days.store), RULE).parts == 12
