"""What verify says of a store, and what recover does about it; damage byte by byte is in tests/crash/damage.py."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any
from uuid import UUID

import numpy as np
import pytest

from storage.event_log import EventLog
from storage.log_manifest import read_log_manifest
from storage.recorder import Recorder
from storage.recover import recover
from storage.store import Store, WriterLock
from storage.verify import verify
from stream.batch import SampleBatch
from stream.bus import LocalBus
from stream.delivery import DurablePublisher
from stream.errors import StoreError
from stream.events import RunEnded, StreamTotal
from stream.identity import Place, event_key, sample_key

PLACE = Place("plant", "bench")
KEY = sample_key(PLACE, "U1", "rate")


def batch(i: int, n: int = 100) -> SampleBatch:
    counts = np.random.default_rng(i).normal(0, 50, n).astype(np.int32)
    return SampleBatch("U1", "rate", "r1", UUID(int=1), i * n, i * n * 10**6, 10**6, "deg/s", counts=counts)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """Three segments of 1000 samples each, and their lake."""
    store = Store.create(tmp_path / "store")
    for segment in range(3):
        bus = LocalBus()
        with Recorder(store, bus, EventLog(store)), DurablePublisher(bus) as publisher:
            for i in range(10 * segment, 10 * segment + 10):
                publisher.send_batch(KEY, batch(i))
            publisher.drain()
    return store


def kinds(store: Store) -> list[str]:
    return sorted(finding.kind for finding in verify(store)[0].findings)


def test_a_sound_store_is_said_to_be_so(store: Store, gyrofleet: Callable[..., Any]) -> None:
    found, _ = verify(store)
    assert (found.segments, found.samples, found.parts, found.lake_samples) == (3, 3000, 3, 3000)
    assert found.is_sound
    assert list(recover(store)) == []
    told = gyrofleet("verify", "--store", store.folder)
    assert told.code == 0
    assert "the store is sound" in told.out


def test_what_a_killed_recorder_left_is_unfinished_and_then_sealed(store: Store, gyrofleet: Callable[..., Any]) -> None:
    bus = LocalBus()
    log = EventLog(store)
    recorder = Recorder(store, bus, log, sync_interval_s=0.01, builds_lake=False)
    with DurablePublisher(bus) as publisher:
        publisher.send_batch(KEY, batch(30))
        publisher.drain()
    del recorder
    assert kinds(store) == ["segment_unfinished"]
    assert gyrofleet("verify", "--store", store.folder).code == 1
    done = gyrofleet("recover", "--store", store.folder, "--json")
    assert done.code == 0
    assert [action["what"] for action in done.json["actions"]] == ["segment_sealed", "lake_built"]
    assert verify(store)[0].samples == 3100


def test_a_segment_that_has_gone_is_a_loss_that_the_log_comes_to_say(store: Store) -> None:
    (store.log / "00000002.mcap").unlink()
    found, _ = verify(store)
    by_kind = {finding.kind: finding for finding in found.findings}
    assert set(by_kind) == {"segment_missing", "numbers_missing", "lake_has_more"}
    assert "1,000 samples of unit U1, signal rate (numbers 1000 to 1999" in by_kind["numbers_missing"].what
    assert "between 999000000 ns and 2000000000 ns" in by_kind["numbers_missing"].what
    assert not found.is_sound
    actions = [action.what for action in recover(store)]
    assert actions == ["segment_missing", "manifest_written", "loss_documented", "lake_built"]
    after, _ = verify(store)
    assert after.is_sound
    assert {finding.kind for finding in after.findings} == {"loss_documented", "lake_has_more"}
    assert list(recover(store)) == []


def test_a_run_that_sent_more_than_is_there_is_incomplete(store: Store) -> None:
    bus = LocalBus()
    totals = (StreamTotal(unit="U1", signal="rate", epoch=str(UUID(int=1)), samples=3300),)
    with Recorder(store, bus, EventLog(store)), DurablePublisher(bus) as publisher:
        publisher.send_event(event_key(PLACE), RunEnded(run="r1", t_ns=5, totals=totals))
        publisher.drain()
    assert kinds(store) == ["numbers_missing", "run_incomplete"]


def test_a_segment_put_in_by_hand_twice_is_found(store: Store) -> None:
    shutil.copy(store.log / "00000003.mcap", store.log / "00000007.mcap")
    assert "numbers_repeated" in kinds(store)
    assert "segment_unlisted" in kinds(store)


def test_a_lost_lake_is_made_anew(store: Store) -> None:
    shutil.rmtree(store.lake)
    store.lake.mkdir()
    assert kinds(store) == ["lake_behind"]
    assert [action.what for action in recover(store)] == ["lake_built"] * 3
    assert verify(store)[0].is_sound


def test_recover_leaves_a_store_alone_that_is_being_written(store: Store) -> None:
    with WriterLock(store, "gyrofleet record"), pytest.raises(StoreError, match="is being written by gyrofleet record"):
        list(recover(store))


def test_the_manifest_is_written_anew_from_the_segments(store: Store) -> None:
    before = read_log_manifest(store).entries
    (store.log / "manifest.jsonl").write_text("nonsense\n")
    assert "manifest_damaged" in kinds(store)
    list(recover(store))
    after = read_log_manifest(store).entries
    assert {name: entry.sha256 for name, entry in after.items()} == {n: e.sha256 for n, e in before.items()}
    assert verify(store)[0].is_sound
