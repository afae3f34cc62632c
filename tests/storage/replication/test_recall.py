"""Recall: what one side has lost comes back from the other, as the plant once sealed it."""

import shutil
from pathlib import Path

import pytest

from storage.backup.backup import back_up
from storage.backup.restore import restore
from storage.check.recover import recover
from storage.check.verify import verify
from storage.fleet_store import FleetStore
from storage.manifests.log import manifest_path
from storage.plant import FILE as PLANT
from storage.plant import read_plant
from storage.replication.recall import Recalled, recall
from storage.replication.receiver import Receiver
from storage.replication.service import Replication
from storage.replication.sources.folder_source import FolderSource
from storage.sql.catalog import Catalog
from storage.store import Store, WriterLock
from stream.errors import StoreError
from tests.storage.replication.plants import kinds, plant, replicated, segments_of, verified
from tests.storage.verified_store import damage_last_chunk, fill

FIRST, SECOND, THIRD = (f"{number:08d}.mcap" for number in (1, 2, 3))
_ROWS = "select count(*), count(distinct seq), sum(counts) from samples"


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return plant(tmp_path / "a")


@pytest.fixture
def fleet(tmp_path: Path, store: Store) -> FleetStore:
    found = FleetStore.create(tmp_path / "fleet")
    replicated(found, store)
    return found


def recalled(store: Store, fleet: FleetStore) -> Recalled:
    return recall(store.folder, FolderSource(fleet.replica("a").store.folder))


def test_a_plant_gets_back_what_it_lost_and_what_was_damaged(store: Store, fleet: FleetStore) -> None:
    before = segments_of(store)
    (store.log / FIRST).unlink()
    damage_last_chunk(store.log / SECOND)
    found = recalled(store, fleet)
    assert (found.is_well, found.segments, found.intact) == (True, (FIRST, SECOND), 2)
    assert segments_of(store) == before
    assert verify(store)[0].is_sound
    assert [Path(path).name.startswith(SECOND) for path in found.aside] == [True]
    assert recalled(store, fleet).segments == ()


@pytest.mark.long
def test_a_plant_gets_back_what_recover_has_given_up(store: Store, fleet: FleetStore) -> None:
    before = segments_of(store)
    (store.log / FIRST).unlink()
    damage_last_chunk(store.log / SECOND)
    list(recover(store))
    assert recalled(store, fleet).segments == (FIRST, SECOND)
    after = segments_of(store)
    assert {name: after[name] for name in before} == before
    assert verify(store)[0].is_sound
    with Catalog(store) as catalog:
        ((rows, distinct, _),) = catalog.rows(_ROWS)
    assert rows == distinct == 800
    found = replicated(fleet, store)  # the history goes on
    assert found.is_well
    assert verified(fleet).is_sound


@pytest.mark.long
def test_a_fleet_store_gets_back_what_it_lost_and_what_was_damaged(store: Store, fleet: FleetStore) -> None:
    copy = fleet.replica("a").store
    (copy.log / FIRST).unlink()
    damage_last_chunk(copy.log / SECOND)
    assert {"segment_missing", "segment_damaged"} <= set(kinds(verified(fleet)))
    assert Replication(fleet).run([FolderSource(store.folder)]).added == 1  # what is missing comes by itself
    assert Receiver(FolderSource(store.folder), fleet, rereads=True).run().added == 1
    assert segments_of(copy) == segments_of(store)
    assert verified(fleet).is_sound


def test_a_fleet_store_whose_manifest_or_list_is_lost_gets_them_back(store: Store, fleet: FleetStore) -> None:
    copy = fleet.replica("a").store
    content = bytearray(manifest_path(copy).read_bytes())
    content[40] ^= 1
    manifest_path(copy).write_bytes(content)
    (copy.folder / "replica" / "segments.jsonl").unlink()
    found = Receiver(FolderSource(store.folder), fleet, rereads=True).run()
    assert (found.is_well, found.added) == (True, 0)
    assert verified(fleet).is_sound


@pytest.mark.long
def test_a_plant_whose_disk_is_gone_comes_back_whole(tmp_path: Path, store: Store, fleet: FleetStore) -> None:
    before, identity = segments_of(store), read_plant(store.folder)
    shutil.rmtree(store.folder)
    found = recalled(store, fleet)
    assert (found.is_well, len(found.segments)) == (True, 4)
    back = Store.open(store.folder)
    assert (back.identity, read_plant(store.folder), segments_of(back)) == (store.identity, identity, before)
    assert verify(back)[0].is_sound
    fill(back, range(8, 10))
    assert replicated(fleet, back).added == 1
    assert verified(fleet).is_sound


def test_another_history_is_not_overwritten(tmp_path: Path, store: Store, fleet: FleetStore) -> None:
    for folder in (store.log, store.lake):  # the plant goes on without what it had
        shutil.rmtree(folder)
        folder.mkdir()
    fill(store, range(2))
    before = segments_of(store)
    found = recalled(store, fleet)
    assert [(each.kind, each.segment) for each in found.refused] == [("fork", FIRST)]
    assert segments_of(store)[FIRST] == before[FIRST]


def test_a_store_without_a_plant_is_not_named_by_a_refused_recall(store: Store, fleet: FleetStore) -> None:
    for folder in (store.log, store.lake):
        shutil.rmtree(folder)
        folder.mkdir()
    (store.folder / PLANT).unlink()
    fill(store, range(2))
    assert {each.kind for each in recalled(store, fleet).refused} == {"fork"}
    assert read_plant(store.folder) is None


def test_the_copy_of_another_plant_is_refused(tmp_path: Path, store: Store, fleet: FleetStore) -> None:
    other = plant(tmp_path / "other", 1)
    with pytest.raises(StoreError, match="has plant a of"):
        recall(other.folder, FolderSource(fleet.replica("a").store.folder))


def test_a_damaged_copy_is_not_taken(store: Store, fleet: FleetStore) -> None:
    (store.log / THIRD).unlink()
    damage_last_chunk(fleet.replica("a").store.log / THIRD)
    found = recalled(store, fleet)
    assert [(each.kind, each.segment) for each in found.refused] == [("bad_hash", THIRD)]
    assert not (store.log / THIRD).exists()


def test_a_store_that_is_being_written_is_left_alone(store: Store, fleet: FleetStore) -> None:
    with WriterLock(store, "gyrofleet record"), pytest.raises(StoreError, match="being written by gyrofleet record"):
        recalled(store, fleet)


@pytest.mark.long
def test_a_backup_of_a_copy_restores_the_plant_or_the_copy(tmp_path: Path, store: Store, fleet: FleetStore) -> None:
    copy = fleet.replica("a").store
    back_up(copy, tmp_path / "backup")
    restore(tmp_path / "backup", tmp_path / "again")
    again = Store.open(tmp_path / "again")
    assert (read_plant(again.folder), segments_of(again)) == (read_plant(store.folder), segments_of(store))
    fill(again, range(8, 10))  # it is the plant's store, which records
    shutil.rmtree(copy.folder)
    restore(tmp_path / "backup", copy.folder)
    assert replicated(fleet, again).added == 1
    assert verified(fleet).is_sound
