"""Recovery that is killed, runs beside other commands, or cannot write."""

import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from storage.check.recover import recover
from storage.check.verify import lake_findings, verify
from storage.check.verify_log import verify_log
from storage.lake.builder import builder_lock
from storage.lake.lake import Lake
from storage.lake.rebuild import rebuild
from storage.log.event_log import EventLog
from storage.manifests.lake import read_manifest
from storage.segments.disk import Disk
from storage.segments.reader import SegmentScan
from storage.segments.records import EVENTS
from storage.store import Store
from storage.upkeep.retention import Rule, apply_rule
from stream.errors import StoreError
from stream.events import StoreNoted, decode_event
from tests.storage.verified_store import KEY, damage_last_chunk, filled, kinds


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """Three segments of 1000 samples each, and their lake."""
    return filled(tmp_path / "store", range(10), range(10, 20), range(20, 30))


class Killed(BaseException):
    """As a kill ends a process, but that this one goes on."""


@pytest.mark.in_gate("00000002.mcap-11")
@pytest.mark.parametrize(
    "every", [11, pytest.param(4, marks=pytest.mark.long), pytest.param(1, marks=pytest.mark.long)]
)
@pytest.mark.parametrize("victim", ["00000002.mcap", "00000003.mcap"])
def test_recover_that_is_killed_anywhere_says_the_loss_once(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, victim: str, every: int
) -> None:
    damage_last_chunk(store.log / victim)
    folder = tmp_path / "copy"
    operations = ("create", "reopen", "write", "sync", "sync_data", "rename", "link", "remove", "sync_folder")
    for last in range(0, 1000, every):
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


@pytest.mark.long
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


@pytest.mark.long
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
    assert sum(part.dropped is not None for part in read_manifest(store).parts) == 1
    assert lake_findings(store, verify_log(store))[:-1] == []  # the last: the document is not in the lake yet


def test_recover_of_a_store_that_cannot_be_written_says_so(store: Store) -> None:
    (store.folder / "writer.lock").mkdir()
    with pytest.raises(StoreError, match="cannot be repaired"):
        list(recover(store))
