"""What a plant sends and a fleet store refuses: the good part is kept, and no other plant's history is touched."""

import hashlib
from pathlib import Path

import msgspec
import pytest

from storage.check.recover import recover
from storage.fleet_store import FleetStore
from storage.manifests.entries import SegmentEntry
from storage.manifests.log import manifest_path, read_log_manifest
from storage.plant import Plant
from storage.replication import receiver
from storage.replication.plant_list import ListRefused, checked_line
from storage.replication.sources.folder_source import FolderSource
from storage.store import Store
from tests.storage.replication.plants import (
    Endless,
    Talker,
    kinds,
    plant,
    received,
    rechained,
    replicated,
    segments_of,
    verified,
)
from tests.storage.verified_store import damage_last_chunk, fill

SECOND = "00000002.mcap"


def entry_of(store: Store, name: str) -> SegmentEntry:
    return read_log_manifest(store).entries[name]


def test_a_changed_segment_is_refused_and_the_rest_kept(tmp_path: Path) -> None:
    store, fleet = plant(tmp_path / "a"), FleetStore.create(tmp_path / "fleet")
    replicated(fleet, store)
    before = segments_of(fleet.replica("a").store)
    changed = (store.log / SECOND).read_bytes() + b"x"
    (store.log / SECOND).write_bytes(changed)
    entry = msgspec.structs.replace(
        entry_of(store, SECOND), size=len(changed), sha256=hashlib.sha256(changed).hexdigest()
    )
    rechained(store, **{"00000002": entry})
    (refusal,) = received(FolderSource(store.folder), fleet).refused
    assert (refusal.plant, refusal.kind, refusal.segment) == ("a", "fork", SECOND)
    assert segments_of(fleet.replica("a").store) == before
    assert "replication_refused" in kinds(verified(fleet))


def test_a_segment_listed_again_with_another_hash_is_refused(tmp_path: Path) -> None:
    store, fleet = plant(tmp_path / "a"), FleetStore.create(tmp_path / "fleet")
    replicated(fleet, store)
    text = msgspec.json.encode(msgspec.structs.replace(entry_of(store, SECOND), sha256="ab" * 32))
    with manifest_path(store).open("r+b") as file:
        last = file.read().splitlines()[-1].rpartition(b"\t")[2]
        file.write(text + b"\t" + hashlib.sha256(last + text).hexdigest().encode() + b"\n")
    fill(store, range(8, 10))
    found = received(FolderSource(store.folder), fleet)
    assert [(each.kind, each.segment) for each in found.refused] == [("changed_segment", SECOND)]
    assert found.added == 0


def test_a_damaged_segment_is_refused_the_others_arrive_and_it_follows(tmp_path: Path) -> None:
    store, fleet = plant(tmp_path / "a"), FleetStore.create(tmp_path / "fleet")
    good = (store.log / SECOND).read_bytes()
    damage_last_chunk(store.log / SECOND)
    for _ in range(2):
        found = received(FolderSource(store.folder), fleet)
        assert [(each.kind, each.segment) for each in found.refused] == [("bad_hash", SECOND)]
        assert (found.segments, found.lag.segments) == (3, 1)
    assert not list((fleet.replica("a").folder / "arriving").iterdir())
    (store.log / SECOND).write_bytes(good)
    assert replicated(fleet, store).added == 1
    assert segments_of(fleet.replica("a").store) == segments_of(store)
    assert verified(fleet).is_sound


@pytest.mark.long
def test_a_plant_that_lost_or_salvaged_a_segment_does_not_take_it_from_the_copy(tmp_path: Path) -> None:
    store, fleet = plant(tmp_path / "a"), FleetStore.create(tmp_path / "fleet")
    replicated(fleet, store)
    before = segments_of(fleet.replica("a").store)
    (store.log / "00000001.mcap").unlink()
    damage_last_chunk(store.log / SECOND)
    list(recover(store))
    found = replicated(fleet, store)
    assert not found.plants[0].refused
    assert len(found.plants[0].notes) == 2
    after = segments_of(fleet.replica("a").store)
    assert {name: after[name] for name in before} == before
    assert after.keys() - before.keys() == {"00000005.mcap"}  # the documents of the loss
    assert verified(fleet).is_sound


@pytest.mark.long
def test_a_list_that_recover_has_rewritten_is_the_same_history(tmp_path: Path) -> None:
    store, fleet = plant(tmp_path / "a"), FleetStore.create(tmp_path / "fleet")
    replicated(fleet, store)
    content = bytearray(manifest_path(store).read_bytes())
    content[40] ^= 1
    manifest_path(store).write_bytes(content)
    damaged = received(FolderSource(store.folder), fleet)
    assert not damaged.is_well  # until it is repaired
    list(recover(store))
    fill(store, range(8, 10))
    found = replicated(fleet, store)
    assert found.is_well
    assert found.added >= 1
    assert any("rewritten" in note for note in found.plants[0].notes)


def test_a_list_that_ends_earlier_is_refused(tmp_path: Path) -> None:
    store, fleet = plant(tmp_path / "a"), FleetStore.create(tmp_path / "fleet")
    replicated(fleet, store)
    manifest_path(store).write_bytes(b"".join(manifest_path(store).read_bytes().splitlines(keepends=True)[:2]))
    (refusal,) = received(FolderSource(store.folder), fleet).refused
    assert (refusal.kind, refusal.segment) == ("list_shortened", "00000003.mcap")


@pytest.mark.long
def test_another_plant_cannot_take_a_name(tmp_path: Path) -> None:
    fleet = FleetStore.create(tmp_path / "fleet")
    store = plant(tmp_path / "one" / "a", 2)
    replicated(fleet, store)
    before = segments_of(fleet.replica("a").store)
    found = replicated(fleet, plant(tmp_path / "two" / "a", 3))
    assert [each.kind for each in found.plants[0].refused] == ["plant_identity"]
    assert segments_of(fleet.replica("a").store) == before
    assert kinds(verified(fleet)) == ["plant_refused"]


class Renamed(FolderSource):
    """A plant that states another name."""

    stated = "b"

    def plant(self) -> Plant | None:
        found = super().plant()
        return None if found is None else msgspec.structs.replace(found, name=self.stated)


def test_a_plant_cannot_take_another_name(tmp_path: Path) -> None:
    store, fleet = plant(tmp_path / "a", 1), FleetStore.create(tmp_path / "fleet")
    replicated(fleet, store)
    (refusal,) = received(Renamed(store.folder), fleet).refused
    assert refusal.kind == "plant_identity"
    assert [each.plant.name for each in fleet.replicas()] == ["a"]


@pytest.mark.long
@pytest.mark.parametrize("name", ["../a", "/tmp/x", "a/b", ".hidden", "", "x" * 65, "a\nb", "e\u0301"])
def test_a_name_is_never_a_path(tmp_path: Path, name: str) -> None:
    store, fleet = plant(tmp_path / "a", 1), FleetStore.create(tmp_path / "fleet")
    source = Renamed(store.folder)
    source.stated = name
    found = received(source, fleet)
    assert "cannot be the name of a plant" in found.trouble
    assert sorted(path.name for path in fleet.folder.iterdir()) == ["fleet.json", "plants"]
    assert not list((fleet.folder / "plants").iterdir())


@pytest.mark.long
@pytest.mark.parametrize("name", ["../../00000009.mcap", "00000002.mcap.open", "1.mcap", "00000002.mcap/x"])
def test_a_segment_name_is_never_a_path(tmp_path: Path, name: str) -> None:
    store, fleet = plant(tmp_path / "a"), FleetStore.create(tmp_path / "fleet")
    rechained(store, **{"00000002": msgspec.structs.replace(entry_of(store, SECOND), segment=name)})
    found = received(FolderSource(store.folder), fleet)
    assert [each.kind for each in found.refused] == ["line_invalid"]
    assert found.segments == 1  # the good part


@pytest.mark.long
def test_a_segment_of_another_store_is_refused(tmp_path: Path) -> None:
    store, fleet = plant(tmp_path / "a"), FleetStore.create(tmp_path / "fleet")
    foreign = (plant(tmp_path / "b").log / SECOND).read_bytes()
    (store.log / SECOND).write_bytes(foreign)
    sha256 = hashlib.sha256(foreign).hexdigest()
    rechained(store, **{"00000002": msgspec.structs.replace(entry_of(store, SECOND), size=len(foreign), sha256=sha256)})
    found = received(FolderSource(store.folder), fleet)
    assert [(each.kind, each.segment) for each in found.refused] == [("foreign_segment", SECOND)]
    assert found.segments == 3


def test_a_source_that_returns_more_than_asked_is_refused(tmp_path: Path) -> None:
    fleet = FleetStore.create(tmp_path / "fleet")
    found = received(Talker(plant(tmp_path / "a").folder), fleet)
    assert {each.kind for each in found.refused} == {"too_long"}
    assert found.segments == 0


@pytest.mark.long
def test_an_endless_list_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(receiver, "_MAX_UNDELIVERED", 20)
    fleet = FleetStore.create(tmp_path / "fleet")
    found = received(Endless(plant(tmp_path / "a").folder), fleet)
    assert found.refused[-1].kind == "endless_list"
    assert found.segments == 4  # the good part


def test_a_line_is_bounded() -> None:
    with pytest.raises(ListRefused, match="at most"):
        checked_line(b"x" * 2_000_000, "0" * 64)
