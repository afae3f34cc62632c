"""Replication of a plant that is served over the bus."""

import threading
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from storage.fleet_store import FleetStore
from storage.replication.sources import bus_source
from storage.replication.sources.bus_server import KEYS, PlantServer
from storage.replication.sources.bus_source import BusSource
from storage.replication.sources.folder_source import FolderSource
from storage.replication.sources.source import CarriedFile, SegmentMissing, SourceGone
from stream.errors import BadInput, BusError
from stream.transport.zenoh_bus import ZenohBus
from tests.free_ports import free_endpoint
from tests.storage.replication.plants import plant, received, segments_of
from tests.storage.verified_store import fill


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


@pytest.fixture
def bus(endpoint: str) -> Iterator[ZenohBus]:
    with ZenohBus(listen=[endpoint]) as opened:
        yield opened


def test_a_served_plant_is_as_its_folder(tmp_path: Path, bus: ZenohBus, endpoint: str) -> None:
    store, fleet = plant(tmp_path / "a"), FleetStore.create(tmp_path / "fleet")
    (store.folder / "models" / "U1").mkdir(parents=True)
    (store.folder / "models" / "U1" / "0001-0123456789abcdef.json").write_text("{}")
    folder = FolderSource(store.folder)
    PlantServer(bus, folder)
    with BusSource(endpoint) as source:
        assert source.plant() == folder.plant()
        assert list(source.segments(1)) == list(folder.segments(1))
        assert list(source.files()) == list(folder.files()) != []
        first, second = received(source, fleet), received(source, fleet)
        assert (first.added, first.added_files, second.added, second.is_well) == (4, 1, 0, True)
        fill(store, range(8, 10))
        assert received(source, fleet).added == 1
    assert segments_of(fleet.replica("a").store) == segments_of(store)


def test_long_segments_come_in_ranges_that_are_asked_for_ahead(tmp_path: Path, bus: ZenohBus, endpoint: str) -> None:
    store = plant(tmp_path / "a", 1)
    content = bytes(range(256)) * 20_000  # 5 MB
    (store.folder / "models" / "U1").mkdir(parents=True)
    path = store.folder / "models" / "U1" / "0001-0123456789abcdef.json"
    path.write_bytes(content)
    PlantServer(bus, FolderSource(store.folder))
    fleet = FleetStore.create(tmp_path / "fleet")
    with BusSource(endpoint) as source:
        assert received(source, fleet).transferred_bytes == len(content) + sum(map(len, segments_of(store).values()))
    assert (fleet.replica("a").store.folder / path.relative_to(store.folder)).read_bytes() == content


@pytest.mark.long
def test_a_server_that_ends_is_gone_and_one_that_comes_back_is_resumed(
    tmp_path: Path, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bus_source, "_PAUSE_S", 0.1)
    store, fleet = plant(tmp_path / "a"), FleetStore.create(tmp_path / "fleet")
    with BusSource(endpoint) as source:
        assert "cannot connect" in received(source, fleet).trouble
        with ZenohBus(listen=[endpoint]) as bus:
            PlantServer(bus, FolderSource(store.folder))
            assert received(source, fleet).added == 4
        assert received(source, fleet).trouble


def test_only_segments_and_files_that_travel_can_be_asked_for(tmp_path: Path, bus: ZenohBus, endpoint: str) -> None:
    store = plant(tmp_path / "a", 1)
    (store.folder / "seal.key").write_bytes(b"secret")
    PlantServer(bus, FolderSource(store.folder))
    with BusSource(endpoint) as source:
        source.plant()
        for name in ("seal.key", "../seal.key", "store.json", "manifest.jsonl", "00000009.mcap"):
            with pytest.raises(SegmentMissing):
                source.read(name, 0, 100)
        with pytest.raises(SourceGone, match="at most"):
            source.read("00000001.mcap", 0, 100_000_000)
        with pytest.raises(SourceGone, match="at most"):
            source.read("00000001.mcap", -1, 10)
        with ZenohBus(connect=[endpoint]) as asking, pytest.raises(BusError, match="cannot be read"):
            asking.ask(f"{KEYS}/a/read", b"\xff").all()


def test_of_several_plants_at_an_endpoint_one_is_named(tmp_path: Path, bus: ZenohBus, endpoint: str) -> None:
    for name in ("a", "b"):
        PlantServer(bus, FolderSource(plant(tmp_path / name, 1).folder))
    with BusSource(endpoint) as source, pytest.raises(BadInput, match=r"several plants answer \(a, b\)"):
        source.plant()
    with BusSource(endpoint, "b") as source:
        found = source.plant()
        assert found is not None
        assert found.name == "b"


def test_files_with_names_of_paths_are_refused(tmp_path: Path, bus: ZenohBus, endpoint: str) -> None:
    class Crafty(FolderSource):
        def files(self) -> Iterator[CarriedFile]:
            for name in ("models/../../store.json", "/etc/passwd", "certificates/../seal.key", "models/U/0001-00.json"):
                yield CarriedFile(name, 5, "ab" * 32)

    store, fleet = plant(tmp_path / "a", 1), FleetStore.create(tmp_path / "fleet")
    PlantServer(bus, Crafty(store.folder))
    with BusSource(endpoint) as source:
        found = received(source, fleet)
    assert [each.kind for each in found.refused] == ["file_invalid"] * 4
    assert found.segments == 1


def test_an_identity_that_is_none_is_not_believed(tmp_path: Path, bus: ZenohBus, endpoint: str) -> None:
    fleet = FleetStore.create(tmp_path / "fleet")
    stated = {"name": "../a", "store": "5e" * 16, "first_segment": "00000001.mcap", "first_sha256": "ab" * 32}
    asked = threading.Event()

    def answer(_key: str, _payload: bytes) -> bytes:
        asked.set()
        return msgspec.json.encode(stated)

    bus.answer(f"{KEYS}/a/plant", answer)
    with BusSource(endpoint) as source:
        assert "cannot be the name of a plant" in received(source, fleet).trouble
    assert asked.is_set()
    assert not fleet.replicas()
