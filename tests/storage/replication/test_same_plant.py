"""One plant that is given twice, however it is written: refused, since its copy would be written twice at once."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from storage.fleet_store import FleetStore
from storage.replication.addresses import check_distinct
from storage.replication.fleet_target import fleet_target
from storage.replication.service import Replication
from storage.replication.sources.folder_source import FolderSource
from storage.store import Store
from stream.errors import BadInput
from tests.storage.replication.plants import plant, segments_of


@pytest.mark.long
@pytest.mark.parametrize(
    "again", ["night", "./night", "day/../night", "link", "night/", "ABSOLUTE"],
)  # fmt: skip
def test_a_folder_that_is_given_twice_is_refused_and_nothing_is_made(
    again: str, tmp_path: Path, gyrofleet: Callable[..., Any]
) -> None:
    plant(tmp_path / "night", 1)
    (tmp_path / "day").mkdir()
    (tmp_path / "link").symlink_to("night")
    again = again.replace("ABSOLUTE", str(tmp_path / "night"))
    done = gyrofleet("replicate", "--from", "night", "--from", again, "--to", "F")
    assert done.code == 1
    assert f"--from {again} is the same plant as --from night; give each once" in " ".join(done.err.split())
    assert not (tmp_path / "F").exists()


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("tcp/127.0.0.1:7448", "tcp/127.0.0.1:7448"),
        ("tcp/localhost:7448", "tls/[::1]:7448"),
        ("tcp/Plant.example:7448", "tcp/plant.example:7448?rel=1"),
        ("s3://gyros/a", "s3://gyros/a/"),
        ("serial//dev/ttyS0", "serial//dev/ttyS0"),
    ],
)
def test_addresses_of_one_place(one: str, other: str) -> None:
    with pytest.raises(BadInput, match="is the same plant as --from"):
        check_distinct([one, other])


def test_addresses_of_two_places(tmp_path: Path) -> None:
    check_distinct([
        "tcp/10.0.0.7:7448", "tcp/10.0.0.7:7449", "tcp/10.0.0.8:7448", "s3://gyros/a", "s3://gyros/b", str(tmp_path),
        str(tmp_path / "nowhere"), str(tmp_path / "elsewhere"),
    ])  # fmt: skip


def test_a_plant_that_comes_by_two_ways_is_taken_by_one(tmp_path: Path) -> None:
    """What addresses do not show: one store, and a copy of it elsewhere."""
    store = plant(tmp_path / "night", 3)
    fleet = FleetStore.create(tmp_path / "F")
    first, second = FolderSource(store.folder, "night"), FolderSource(store.folder, "night")
    second.where = "second"
    replication = Replication(fleet)
    for added in (3, 0):
        found = replication.run([first, second])
        troubles = [each.trouble for each in found.plants if each.trouble]
        ways = {str(store.folder), "second"}
        assert len(troubles) == 1
        said = {f"{each} is the plant that comes from {(ways - {each}).pop()} already; give each once" for each in ways}
        assert troubles[0] in said
        assert (found.added, found.is_well) == (added, False)
    assert segments_of(fleet.replica("night").store) == segments_of(store)


@pytest.mark.long
def test_a_fleet_store_that_no_plant_has_come_to_is_not_left(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    plant(tmp_path / "night", 1)
    for words in (
        ("--from", "tcp/127.0.0.1:1", "--to", "F"),
        ("--from", "night", "--to", "F", "--plant", "../x"),
        ("--from", "nowhere", "--to", "F"),
    ):
        assert gyrofleet("replicate", *words).code == 1
        assert not (tmp_path / "F").exists()
    (tmp_path / "F").mkdir()
    assert gyrofleet("replicate", "--from", "tcp/127.0.0.1:1", "--to", "F").code == 1
    assert list((tmp_path / "F").iterdir()) == []  # this folder was there before


def test_a_fleet_store_with_a_plant_or_of_before_stays(tmp_path: Path) -> None:
    store: Store = plant(tmp_path / "night", 1)
    FleetStore.create(tmp_path / "old")
    with fleet_target(tmp_path / "old"):
        pass
    assert (tmp_path / "old/fleet.json").exists()
    with fleet_target(tmp_path / "F") as fleet:
        Replication(fleet).run([FolderSource(store.folder)])
    assert segments_of(fleet.replica("night").store) == segments_of(store)


@pytest.mark.long
def test_a_plant_without_a_name_is_reported_without_one(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    Store.create(tmp_path / "night")
    done = gyrofleet("replicate", "--from", "night", "--to", "F")
    assert done.code == 0
    assert "note: night has no sealed segment yet" in done.err
    silent = gyrofleet("replicate", "--from", "tcp/127.0.0.1:1", "--to", "F")
    said = " ".join(silent.err.split())
    assert "trouble: tcp/127.0.0.1:1: cannot connect to tcp/127.0.0.1:1: connection refused, nobody listens" in said
