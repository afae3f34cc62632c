"""The fleet store that a command copies to: made for the plants that come, and not left behind without any."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from storage.fleet_store import PLANTS, FleetStore, is_fleet
from storage.store_marker import FLEET_MARKER, alone_in


@contextmanager
def fleet_target(folder: Path) -> Iterator[FleetStore]:
    """The fleet store in a folder, created if there is none; one that was created goes again if no plant has come."""
    was_fleet, was_there = is_fleet(folder), folder.exists()
    fleet = FleetStore.create(folder)
    try:
        yield fleet
    finally:
        if not was_fleet:
            with suppress(OSError):  # then it is left, which harms nobody
                _remove_empty(folder, is_whole=not was_there)


def _remove_empty(folder: Path, *, is_whole: bool) -> None:
    with alone_in(folder):  # another command may bring a plant
        if {path.name for path in folder.iterdir()} != {PLANTS, FLEET_MARKER}:
            return
        (folder / PLANTS).rmdir()  # refused where a plant is
        (folder / FLEET_MARKER).unlink()
        if is_whole:
            folder.rmdir()
