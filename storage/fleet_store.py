"""A fleet store: one folder that holds the copies of many plants' stores, each apart from the others.

``fleet.json`` marks it. ``plants/NAME`` is a store with the identity of the plant's own; its folder ``replica`` has
what is known of the plant.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, Self
from uuid import uuid4

import msgspec

from storage.plant import Plant, read_plant, write_plant
from storage.store import Store
from storage.store_marker import (
    FLEET_MARKER,
    MARKER,
    REPLICA,
    alone_in,
    check_folder,
    identity_of_copy,
    identity_of_segments,
    write_markers,
)
from stream.decoding import decode_json
from stream.errors import StoreError
from stream.files.atomic_file import sync_folder, write_durably

_FORMAT = 1
PLANTS = "plants"
_REFUSED = "refused.json"
_MOST_REFUSED = 1_000


class Replica(NamedTuple):
    """A plant and the copy of its store."""

    plant: Plant
    store: Store

    @property
    def folder(self) -> Path:
        """Folder of what is known of the plant."""
        return self.store.folder / REPLICA


class PlantRefused(StoreError):
    """A plant whose identity contradicts that of another one, or its own earlier one."""


class FleetStore:
    """The folder of a fleet store."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @classmethod
    def open(cls, folder: Path) -> Self:
        """Open an existing fleet store; StoreError if the folder is none."""
        marker = folder / FLEET_MARKER
        try:
            found = json.loads(marker.read_text())
            if int(found["format"]) > _FORMAT:
                raise StoreError(f"{marker} has a newer format than this gyrofleet reads: upgrade gyrofleet")
        except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
            raise StoreError(
                f"{folder} is not a fleet store ({marker}: {error}); `gyrofleet replicate` creates one"
            ) from error
        return cls(folder)

    @classmethod
    def create(cls, folder: Path) -> Self:
        """Open a fleet store, or create it in an empty or missing folder."""
        check_folder(folder)
        if (folder / FLEET_MARKER).exists():
            return cls.open(folder)
        if (folder / MARKER).exists():
            raise StoreError(f"{folder} is the store of one plant, not a fleet store; give --to another folder")
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with alone_in(folder):
                others = {path.name for path in folder.iterdir()} - {PLANTS, FLEET_MARKER, f"{FLEET_MARKER}.part"}
                if others:
                    raise StoreError(f"{folder} holds other files and is no fleet store; give --to an empty folder")
                (folder / PLANTS).mkdir(exist_ok=True)
                content = json.dumps({"format": _FORMAT, "id": uuid4().hex}) + "\n"
                write_durably(folder / FLEET_MARKER, content.encode())
                sync_folder(folder.parent)
        except OSError as error:
            raise StoreError(
                f"cannot write the fleet store {folder}: {error}; give --to a folder you can write"
            ) from error
        return cls(folder)

    def replicas(self) -> list[Replica]:
        """The plants by name; StoreError if what identifies one is damaged."""
        return list(self._found())

    def replica(self, name: str) -> Replica:
        """The plant of a name; StoreError if there is none."""
        found = {each.plant.name: each for each in self.replicas()}
        if name not in found:
            raise StoreError(f"{self.folder} has no plant {name!r}; it has {', '.join(found) or 'none yet'}")
        return found[name]

    def admit(self, plant: Plant) -> Replica:
        """The copy of a plant's store, created at its first use.

        PlantRefused if another plant has its name, or this plant has another name here.
        """
        known = next((each for each in self.replicas() if each.plant == plant), None)
        if known is not None:
            return known
        folder = self.folder / PLANTS / plant.name
        try:
            with alone_in(self.folder):  # of several processes and threads one creates it
                self._check_new(plant)
                for part in (folder, folder / "tmp", folder / REPLICA, folder / "log", folder / "lake"):
                    part.mkdir(exist_ok=True)
                write_plant(folder, plant)
                write_markers(folder, plant.store)
                sync_folder(folder)
                sync_folder(folder.parent)
        except OSError as error:
            raise StoreError(f"cannot write {folder}: {error}; free or repair the disk of the fleet store") from error
        return Replica(plant, Store.open(folder))

    def _check_new(self, plant: Plant) -> None:
        for each in self.replicas():
            if each.plant == plant:
                continue
            if each.plant.name == plant.name:
                raise PlantRefused(
                    f"plant {plant.name} of store {plant.store}, first segment {plant.first_sha256[:12]}: another "
                    f"plant has this name here, of store {each.plant.store}, first segment "
                    f"{each.plant.first_sha256[:12]}; nothing of it is taken. Name the new plant by --plant at its "
                    "first use"
                )
            if each.plant.store == plant.store:
                raise PlantRefused(
                    f"plant {plant.name} has the store {plant.store}, which is plant {each.plant.name}'s here; nothing "
                    "of it is taken. A plant keeps its name"
                )
        folder = self.folder / PLANTS / plant.name
        if any((folder / "log").glob("*.mcap")):  # a copy whose marks are lost
            left, origin = read_plant(folder), identity_of_copy(folder) or identity_of_segments(folder)
            if left not in (None, plant) or origin not in (None, plant.store):
                raise PlantRefused(f"{folder} holds segments of store {origin}, plant {plant.name} has {plant.store}")

    def add_refusal(self, plant: Plant, what: str) -> None:
        """Keep that a plant was not admitted, for `refusals`."""
        path = self.folder / _REFUSED
        kept = {(each.name, *each.chain): (each, text) for each, text in self.refusals()}
        kept[plant.name, *plant.chain] = (plant, what)
        write_durably(path, msgspec.json.encode(list(kept.values())[-_MOST_REFUSED:]))

    def refusals(self) -> list[tuple[Plant, str]]:
        """Plants that were not admitted, the last 1000, and why; delete ``refused.json`` to forget them."""
        try:
            return decode_json((self.folder / _REFUSED).read_bytes(), list[tuple[Plant, str]])
        except (OSError, msgspec.MsgspecError):
            return []

    def _found(self) -> Iterator[Replica]:
        for path in sorted((self.folder / PLANTS).iterdir()):
            plant = read_plant(path) if path.is_dir() else None
            if plant is None or not (path / MARKER).exists():  # its creation was interrupted
                continue
            if plant.name != path.name:
                raise StoreError(f"{path} holds plant {plant.name}; give the folder its name again")
            yield Replica(plant, Store.open(path))


def is_fleet(folder: Path) -> bool:
    """Whether a folder is a fleet store."""
    return (folder / FLEET_MARKER).exists()
