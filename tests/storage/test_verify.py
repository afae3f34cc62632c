"""What verify says of a store, and what recover does about it; damage byte by byte is in tests/crash/damage.py."""

import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any
from uuid import UUID

import numpy as np
import pytest

from storage.check.recover import recover
from storage.check.verify import lake_findings, verify
from storage.check.verify_log import verify_log
from storage.lake.lake import Lake, builder_lock, parts
from storage.lake.rebuild import rebuild
from storage.log.event_log import EventLog
from storage.manifests.log import read_log_manifest
from storage.recording.recorder import Recorder
from storage.segments.disk import Disk
from storage.segments.reader import SegmentScan
from storage.segments.records import EVENTS
from storage.store import Store, WriterLock
from storage.upkeep.retention import Rule, apply_rule
from stream.batch import SampleBatch
from stream.delivery.publisher import DurablePublisher
from stream.errors import StoreError
from stream.events import RunEnded, StoreNoted, StreamTotal, decode_event
from stream.identity import Place, event_key, sample_key
from stream.transport.bus import LocalBus

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
        fill(store, range(10 * segment, 10 * segment + 10))
    return store


def fill(store: Store, batches: range) -> None:
    """A segment with a chunk for each batch."""
    bus = LocalBus()
    with Recorder(store, bus, EventLog(store), sync_interval_s=0.001), DurablePublisher(bus) as publisher:
        for i in batches:
            publisher.send_batch(KEY, batch(i))
            publisher.drain()


def damage_last_chunk(segment: Path) -> None:
    scan = SegmentScan(segment, sealed=True)
    list(scan)
    content = bytearray(segment.read_bytes())
    content[scan.summary.chunks[-1].chunk_start_offset + 100] ^= 1
    segment.write_bytes(content)


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


@pytest.mark.parametrize("how", ["folder", "files"])
def test_a_log_that_has_gone_is_damage_until_the_log_says_so(store: Store, how: str) -> None:
    shutil.rmtree(store.log)
    if how == "files":
        store.log.mkdir()
    first = "log_missing" if how == "folder" else "manifest_missing"
    assert kinds(store) == ["lake_has_more"] * 3 + [first]
    assert not verify(store)[0].is_sound
    assert [action.what for action in recover(store)] == ["segment_missing"] * 3 + ["lake_built"]
    found, _ = verify(store)
    assert found.is_sound
    assert [finding.kind for finding in found.findings] == ["lake_has_more"] * 3
    assert found.lake_samples == 3000
    assert list(recover(store)) == []
    with builder_lock(store), pytest.raises(StoreError, match="3 segments that the log no longer gives"):
        list(rebuild(store))


def test_a_lost_manifest_is_damage(store: Store) -> None:
    (store.log / "manifest.jsonl").unlink()
    assert "manifest_missing" in kinds(store)
    assert "manifest_written" in [action.what for action in recover(store)]
    assert verify(store)[0].findings == ()


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


class Killed(BaseException):
    """As a kill ends a process, but that this one goes on."""


@pytest.mark.parametrize("victim", ["00000002.mcap", "00000003.mcap"])
def test_recover_that_is_killed_anywhere_says_the_loss_once(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, victim: str
) -> None:
    damage_last_chunk(store.log / victim)
    folder = tmp_path / "copy"
    operations = ("create", "reopen", "write", "sync", "sync_data", "rename", "link", "remove", "sync_folder")
    for last in range(1000):
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(store.folder, folder)
        copy, left = Store.open(folder), iter(range(last))
        with monkeypatch.context() as patch:
            for name in operations:
                patch.setattr(Disk, name, _until(left, getattr(Disk, name)))
            try:
                list(recover(copy))
                is_done = True
            except Killed:
                is_done = False
        if not is_done:
            list(recover(copy))
        found, _ = verify(copy)
        assert found.is_sound, (last, found.findings)
        assert [f.kind for f in found.findings] == ["loss_documented", "lake_has_more"], last
        assert "signal rate (numbers" in found.findings[0].what
        said = [each for each in notes_of(copy) if each.what in ("segment_salvaged", "numbers_missing")]
        assert len(said) == 1, last
        if is_done:
            break
    assert last > 20


def _until(left: Iterator[int], method: Callable[..., Any]) -> Callable[..., Any]:
    def call(*arguments: Any) -> Any:
        if next(left, None) is None:
            raise Killed
        return method(*arguments)

    return call


def notes_of(store: Store) -> list[StoreNoted]:
    records = [record for path in sorted(store.log.glob("*.mcap")) for record in SegmentScan(path, sealed=True)]
    documents = [decode_event(record.data).document for record in records if record.schema == EVENTS]
    return [document for document in documents if isinstance(document, StoreNoted)]


def test_of_a_segment_that_nothing_is_left_of_the_numbers_stay_known(store: Store) -> None:
    segment = store.log / "00000003.mcap"
    scan = SegmentScan(segment, sealed=True)
    list(scan)
    content = bytearray(segment.read_bytes())
    for chunk in scan.summary.chunks:
        content[chunk.chunk_start_offset + 100] ^= 1
    segment.write_bytes(content)
    list(recover(store))
    found, _ = verify(store)
    assert [finding.kind for finding in found.findings] == ["loss_documented", "lake_has_more"]
    assert "1,000 samples of unit U1, signal rate (numbers 2000 to 2999" in found.findings[0].what
    assert next(mark for stream, mark in EventLog(store).marks.items() if stream.key == KEY) == 3000


def test_a_recovery_of_which_the_recorder_could_not_tell_is_found(store: Store) -> None:
    segment = store.log / "00000003.mcap"
    damage_last_chunk(segment)
    segment.rename(store.log / "00000003.mcap.open")
    manifest = store.log / "manifest.jsonl"
    manifest.write_bytes(b"".join(manifest.read_bytes().splitlines(keepends=True)[:2]))
    assert EventLog(store).recovered[0].damaged_chunks == 1
    assert "salvage_undocumented" in kinds(store)
    assert not verify(store)[0].is_sound
    actions = [action.what for action in recover(store)]
    assert "loss_documented" in actions
    assert verify(store)[0].is_sound


def test_verify_beside_rebuild_and_retain_finds_nothing(store: Store) -> None:
    state = verify_log(store)
    done = threading.Event()
    failures: list[BaseException] = []

    def change() -> None:
        try:
            while not done.is_set():
                with builder_lock(store):
                    list(rebuild(store))
        except BaseException as error:  # noqa: BLE001  it is judged below
            failures.append(error)

    thread = threading.Thread(target=change)
    thread.start()
    try:
        for _ in range(40):
            assert lake_findings(store, state) == []
    finally:
        done.set()
        thread.join()
    assert failures == []


def test_a_part_whose_rows_are_being_dropped_is_no_damage(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """As between the description of the part and the manifest."""
    commit, left = Lake.commit, iter(range(1))

    def first_only(lake: Lake, **changes: object) -> None:
        if "parts" in changes and next(left, None) is None:
            raise Killed
        commit(lake, **changes)

    monkeypatch.setattr(Lake, "commit", first_only)
    with builder_lock(store), suppress(Killed):
        apply_rule(Lake(store), Rule(max_bytes=0))
    assert sum(part.dropped is not None for part in parts(store)) == 1
    assert lake_findings(store, verify_log(store))[:-1] == []  # the last: the document is not in the lake yet


def test_recover_of_a_store_that_cannot_be_written_says_so(store: Store) -> None:
    (store.folder / "writer.lock").mkdir()
    with pytest.raises(StoreError, match="cannot be put right"):
        list(recover(store))
