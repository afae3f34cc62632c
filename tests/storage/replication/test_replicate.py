"""Replication from folder to folder: each segment once, resumed, verified, and what it gives in SQL."""

from pathlib import Path

import pytest

from storage.fleet_store import FleetStore
from storage.replication.arriving.bandwidth import Bandwidth
from storage.replication.fleet_status import fleet_status
from storage.replication.receiver import Receiver
from storage.replication.sources.folder_source import FolderSource
from storage.specifications.chain import append_document
from storage.sql.catalog import Catalog
from storage.store import Store, WriterLock
from stream.errors import BadInput, StoreError
from stream.events import SpecificationAction, SpecificationEntered
from tests.storage.replication.plants import CutOff, kinds, plant, received, replicated, segments_of, verified
from tests.storage.verified_store import fill

_ROWS = "select unit, signal, run, seq, t_ns, counts from samples order by all"


def test_a_copy_has_the_same_segments_and_rows_and_a_second_pass_adds_none(tmp_path: Path) -> None:
    store, fleet = plant(tmp_path / "a"), FleetStore.create(tmp_path / "fleet")
    first, second = replicated(fleet, store), replicated(fleet, store)
    assert (first.added, second.added) == (4, 0)
    assert first.added_bytes == sum(map(len, segments_of(store).values()))
    copy = fleet.replica("a").store
    assert segments_of(copy) == segments_of(store)
    assert (copy.log / "manifest.jsonl").read_bytes() == (store.log / "manifest.jsonl").read_bytes()
    with Catalog(store, live=True) as mine, Catalog(copy) as theirs:
        assert mine.user_reader(_ROWS).read_all().num_rows == 800
        assert mine.user_reader(_ROWS).read_all() == theirs.user_reader(_ROWS).read_all()
    assert verified(fleet).is_sound


def test_a_copy_follows_its_plant(tmp_path: Path) -> None:
    store, fleet = plant(tmp_path / "a", 1), FleetStore.create(tmp_path / "fleet")
    receiver = Receiver(FolderSource(store.folder), fleet)
    for number in range(1, 5):
        found = receiver.run()
        assert (found.added, found.segments, found.lag.segments) == (1, number, 0)
        fill(store, range(2 * number, 2 * number + 2))


def test_a_cut_link_resumes_at_its_byte(tmp_path: Path) -> None:
    store, fleet = plant(tmp_path / "a"), FleetStore.create(tmp_path / "fleet")
    whole = sum(map(len, segments_of(store).values()))
    total = passes = 0
    while True:
        found = received(CutOff(store.folder, 25_000), fleet)
        total, passes = total + found.transferred_bytes, passes + 1
        if found.trouble:
            assert (found.trouble, found.refused) == ("the link is cut", ())
            assert found.lag.segments == 4 - found.segments
            assert found.lag.seconds >= 0.0
            continue
        break
    assert passes > 3
    assert total == whole  # no byte twice
    assert segments_of(fleet.replica("a").store) == segments_of(store)


def test_what_was_left_of_an_attempt_is_not_believed(tmp_path: Path) -> None:
    store, fleet = plant(tmp_path / "a"), FleetStore.create(tmp_path / "fleet")
    assert received(CutOff(store.folder, 15_000), fleet).trouble
    (part,) = (fleet.replica("a").folder / "arriving").iterdir()
    part.write_bytes(b"\0" * part.stat().st_size)  # as after a power loss
    assert received(FolderSource(store.folder), fleet).is_well
    assert segments_of(fleet.replica("a").store) == segments_of(store)


def test_certificates_and_models_travel_once_and_nothing_else_does(tmp_path: Path) -> None:
    store, fleet = plant(tmp_path / "a", 1), FleetStore.create(tmp_path / "fleet")
    model, certificate = "models/FOG-1/0001-0123456789abcdef.json", "certificates/GYL-2026-0001.pdf"
    for name in (model, certificate, "seal.key", "users.json", "models/FOG-1/other.json", "certificates/.lock"):
        (store.folder / name).parent.mkdir(parents=True, exist_ok=True)
        (store.folder / name).write_text(name)
    assert [received(FolderSource(store.folder), fleet).added_files for _ in range(2)] == [2, 0]
    copy = fleet.replica("a").store.folder
    assert [(copy / name).read_text() for name in (model, certificate)] == [model, certificate]
    assert not (copy / "seal.key").exists()
    (store.folder / certificate).write_text("another")
    (refusal,) = received(FolderSource(store.folder), fleet).refused
    assert (refusal.kind, refusal.segment) == ("changed_file", certificate)
    assert (copy / certificate).read_text() == certificate


@pytest.mark.long
def test_two_plants_with_the_same_units_and_runs_stay_apart(tmp_path: Path) -> None:
    one, two = plant(tmp_path / "a", 2), plant(tmp_path / "b", 3)
    fleet = FleetStore.create(tmp_path / "fleet")
    assert replicated(fleet, one, two).added == 5
    assert [len(segments_of(each.store)) for each in fleet.replicas()] == [2, 3]
    assert verified(fleet).is_sound


def test_a_copy_is_written_by_replication_alone(tmp_path: Path) -> None:
    fleet = FleetStore.create(tmp_path / "fleet")
    replicated(fleet, plant(tmp_path / "a", 1))
    with pytest.raises(StoreError, match="record, enter and repair at the plant"):
        WriterLock(fleet.replica("a").store, "gyrofleet record")
    with pytest.raises(StoreError, match="fleet store of many plants"):
        Store.open(fleet.folder)
    with pytest.raises(StoreError, match="the store of one plant"):
        FleetStore.create(tmp_path / "a")


def test_a_plant_keeps_its_name(tmp_path: Path) -> None:
    store = plant(tmp_path / "a", 1)
    assert (found := FolderSource(store.folder, "hangzhou").plant()) is not None
    assert found.name == "hangzhou"
    assert FolderSource(store.folder).plant() == found
    with pytest.raises(BadInput, match="a plant keeps its name"):
        FolderSource(store.folder, "other").plant()


def test_a_pass_takes_the_time_that_its_bandwidth_allows(tmp_path: Path) -> None:
    store, fleet = plant(tmp_path / "a"), FleetStore.create(tmp_path / "fleet")
    size = sum(map(len, segments_of(store).values()))
    waited: list[float] = []
    limit = Bandwidth(10_000.0, clock=lambda: sum(waited), sleep=waited.append)
    Receiver(FolderSource(store.folder), fleet, bandwidth=limit).run()
    assert sum(waited) == pytest.approx((size - 10_000) / 10_000)  # a second's worth passes at once


@pytest.mark.long
def test_the_status_says_how_far_a_copy_is_behind(tmp_path: Path) -> None:
    store, fleet = plant(tmp_path / "a"), FleetStore.create(tmp_path / "fleet")
    received(CutOff(store.folder, 60_000), fleet)
    (found,) = fleet_status(fleet).plants
    assert found.lag.segments > 0
    assert any("behind the plant" in trouble for trouble in found.troubles)
    assert "segments_not_arrived" not in kinds(verified(fleet))  # nothing is listed before it is there
    replicated(fleet, store)
    assert fleet_status(fleet).troubles == ()


def test_a_plant_without_segments_is_no_plant_yet(tmp_path: Path) -> None:
    fleet = FleetStore.create(tmp_path / "fleet")
    found = received(FolderSource(Store.create(tmp_path / "a").folder), fleet)
    assert (found.is_well, found.added, fleet.replicas()) == (True, 0, [])


@pytest.mark.long
@pytest.mark.parametrize("name", ["../../../../stolen", "/tmp/stolen", "..", ".hidden/x"])
def test_a_name_within_a_document_is_never_a_path(tmp_path: Path, name: str) -> None:
    store, fleet = plant(tmp_path / "a", 1), FleetStore.create(tmp_path / "fleet")
    for each in (name, "fog"):
        document = SpecificationEntered(
            run="", t_ns=5, action=SpecificationAction.ADDED, name=each, revision="1", content='revision = "1"', by="Li"
        )
        append_document(store, document)
    assert replicated(fleet, store).is_well
    copy = fleet.replica("a").store.folder
    assert [path.name for path in (copy / "products").iterdir()] == ["fog-1.toml"]
    assert not list(tmp_path.rglob("*stolen*"))


class Killed(BaseException):
    """The process ends here."""


class Dies(FolderSource):
    """A source at whose last range the process is killed."""

    left = 3

    def read(self, name: str, offset: int, length: int) -> bytes:
        self.left -= name.endswith(".mcap")
        if self.left < 0:
            raise Killed
        return super().read(name, offset, length)


@pytest.mark.long
def test_a_pass_that_was_killed_or_cut_off_leaves_when_the_plant_answered(tmp_path: Path) -> None:
    store, fleet = plant(tmp_path / "hangzhou"), FleetStore.create(tmp_path / "fleet")
    with pytest.raises(Killed):
        received(Dies(store.folder), fleet)
    (found,) = fleet_status(fleet).plants
    assert found.contact_age_s is not None
    assert 0.0 <= found.contact_age_s < 300.0
    assert found.lag.segments > 0
    other = plant(tmp_path / "suzhou")
    cut = received(CutOff(other.folder, 20_000), fleet)
    assert "cut" in cut.trouble
    ages = {each.plant: each.contact_age_s for each in fleet_status(fleet).plants}
    assert ages["suzhou"] is not None
