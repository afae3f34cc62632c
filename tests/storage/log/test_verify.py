"""What verify says of a store, and what recover does about it; damage byte by byte is in tests/crash/damage.py."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any
from uuid import UUID

import pytest

from storage.check.recover import recover
from storage.check.verify import meanwhile, verify
from storage.lake.builder import builder_lock
from storage.lake.rebuild import rebuild
from storage.log.event_log import EventLog
from storage.manifests.lake import read_manifest
from storage.manifests.log import read_log_manifest
from storage.recording.recorder import Recorder
from storage.store import Store, WriterLock
from stream.delivery.publisher import DurablePublisher
from stream.errors import StoreError
from stream.events import RunEnded, StreamTotal
from stream.identity import event_key
from stream.transport.bus import LocalBus
from tests.storage.verified_store import KEY, PLACE, batch, fill, filled, kinds


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """Three segments of 1000 samples each, and their lake."""
    return filled(tmp_path / "store", range(10), range(10, 20), range(20, 30))


def test_a_sound_store_is_said_to_be_so(store: Store, gyrofleet: Callable[..., Any]) -> None:
    found, _ = verify(store)
    assert (found.segments, found.samples, found.parts, found.lake_samples) == (3, 3000, 3, 3000)
    assert found.is_sound
    assert list(recover(store)) == []
    reported = gyrofleet("verify", "--store", store.folder)
    assert reported.code == 0
    assert "the store is sound" in reported.out


@pytest.mark.long
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


@pytest.mark.long
def test_a_segment_that_has_gone_is_a_loss_that_the_log_comes_to_say(store: Store) -> None:
    (store.log / "00000002.mcap").unlink()
    found, _ = verify(store)
    by_kind = {finding.kind: finding for finding in found.findings}
    assert set(by_kind) == {"segment_missing", "numbers_missing", "lake_has_more"}
    assert "1,000 samples of unit U1, signal rate (numbers 1000 to 1999" in by_kind["numbers_missing"].what
    assert "between 999000000 ns and 2000000000 ns" in by_kind["numbers_missing"].what
    assert not found.is_sound
    actions = [action.what for action in recover(store)]
    assert actions == ["loss_documented", "segment_missing", "lake_built"]
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


@pytest.mark.long
@pytest.mark.parametrize("content", [b"", b"{}", None])
def test_another_copy_of_the_marker_is_damage_and_is_written_again(store: Store, content: bytes | None) -> None:
    marker, copy = store.folder / "store.json", store.log / "store.json"
    another = marker.read_bytes().replace(store.identity.encode(), b"f" * 32)
    copy.write_bytes(another if content is None else content)
    assert kinds(store) == ["marker_copy"]
    assert not verify(store)[0].is_sound
    assert [action.what for action in recover(store)] == ["marker_copied"]
    assert copy.read_bytes() == marker.read_bytes()
    copy.unlink()  # as in the oldest stores
    assert kinds(store) == ["marker_copy"]
    assert verify(store)[0].is_sound


def test_a_lost_lake_is_made_anew(store: Store) -> None:
    shutil.rmtree(store.lake)
    store.lake.mkdir()
    assert kinds(store) == ["lake_behind"]
    assert [action.what for action in recover(store)] == ["lake_built"] * 3
    assert verify(store)[0].is_sound


def test_beside_a_recorder_other_numbers_of_samples_in_the_lake_are_explained(store: Store) -> None:
    _, state = verify(store)
    with WriterLock(store, "gyrofleet record"):
        assert kinds(store) == []
        parts = read_manifest(store).parts
        del state.samples[max(state.samples)]  # as if the last one was sealed after the log was read
        (note,) = meanwhile(store, state, parts)
        assert "the lake has the samples of 1 segments that a recorder sealed after the log was read" in note.what
        shutil.rmtree(store.lake)
        store.lake.mkdir()
        found, _ = verify(store)
    assert found.is_sound
    (note,) = found.findings
    assert note.kind == "lake_follows"
    assert note.what.startswith("3,000 samples of 3 sealed segments are not in the lake yet: a recorder is at work")


def test_recover_leaves_a_store_alone_that_is_being_written(store: Store) -> None:
    with WriterLock(store, "gyrofleet record"), pytest.raises(StoreError, match="is being written by gyrofleet record"):
        list(recover(store))


@pytest.mark.long
def test_the_manifest_is_written_anew_from_the_segments(store: Store) -> None:
    before = read_log_manifest(store).entries
    (store.log / "manifest.jsonl").write_text("nonsense\n")
    assert "manifest_damaged" in kinds(store)
    list(recover(store))
    after = read_log_manifest(store).entries
    assert {name: entry.sha256 for name, entry in after.items()} == {n: e.sha256 for n, e in before.items()}
    assert verify(store)[0].is_sound


@pytest.mark.long
def test_the_number_of_a_lost_segment_is_not_given_again(store: Store) -> None:
    (store.log / "00000003.mcap").unlink()
    log = EventLog(store)
    assert any("00000003.mcap" in warning for warning in log.warnings)
    fill(store, range(20, 25))
    assert not (store.log / "00000003.mcap").exists()
    assert (store.log / "00000004.mcap").exists()
    assert "segment_missing" in kinds(store)
    list(recover(store))
    assert verify(store)[0].is_sound
    assert list(read_log_manifest(store).lost) == ["00000003.mcap"]
    with builder_lock(store), pytest.raises(StoreError, match="1 segments that the log no longer gives: 00000003"):
        list(rebuild(store))


def test_the_number_is_not_given_again_where_only_the_lake_knows_it(store: Store) -> None:
    shutil.rmtree(store.log)
    store.log.mkdir()
    fill(store, range(1))
    assert [path.name for path in store.log.glob("*.mcap")] == ["00000004.mcap"]


@pytest.mark.parametrize("how", ["folder", pytest.param("files", marks=pytest.mark.long)])
def test_a_log_that_has_gone_is_damage_until_the_log_says_so(store: Store, how: str) -> None:
    shutil.rmtree(store.log)
    if how == "files":
        store.log.mkdir()
    first = "log_missing" if how == "folder" else "manifest_missing"
    assert kinds(store) == ["lake_has_more"] * 3 + [first, "marker_copy"]
    assert not verify(store)[0].is_sound
    done = [action.what for action in recover(store)]
    assert done == ["marker_copied", *["segment_missing"] * 3, "lake_built"]
    found, _ = verify(store)
    assert found.is_sound
    assert [finding.kind for finding in found.findings] == ["lake_has_more"] * 3
    assert found.lake_samples == 3000
    assert list(recover(store)) == []
    with builder_lock(store), pytest.raises(StoreError, match="3 segments that the log no longer gives"):
        list(rebuild(store))


@pytest.mark.long
def test_a_lost_manifest_is_damage(store: Store) -> None:
    (store.log / "manifest.jsonl").unlink()
    assert "manifest_missing" in kinds(store)
    assert "manifest_written" in [action.what for action in recover(store)]
    assert verify(store)[0].findings == ()


@pytest.mark.long
def test_a_part_that_was_made_from_another_file_of_that_name_is_found(store: Store, tmp_path: Path) -> None:
    other = Store.create(tmp_path / "other")
    for i in range(3):
        fill(other, range(10 * i, 10 * i + 10))
    shutil.rmtree(store.lake)
    shutil.copytree(other.lake, store.lake)
    assert kinds(store) == ["lake_disagrees"] * 3
    list(recover(store))
    assert verify(store)[0].findings == ()
    assert len(list((store.folder / "lake-aside").iterdir())) == 3
