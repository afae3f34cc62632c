"""Sampling of all signals of a file: those without empty cells have the times of their rows, and one grid."""

import copy

from ingest.tables.checks import GoodRows, Owner
from ingest.tables.grid import Sampling, SamplingGrid


class SignalGrids:
    """Finds the sampling of each signal of each unit and run, from their rows block by block.

    The times of a signal are judged by some thirty operations on arrays. Most signals of a file have a cell in every
    row: they share a grid until the first empty cell.
    """

    def __init__(self) -> None:
        self._grids: dict[tuple[Owner, str], SamplingGrid] = {}
        self._shared: dict[Owner, SamplingGrid] = {}

    def add(self, rows: GoodRows) -> None:
        """Add the times of the next rows of a unit and run."""
        grids, owner = self._grids, rows.owner
        is_first = owner not in self._shared
        shared = self._shared.setdefault(owner, SamplingGrid())
        leaving = [
            name for name, cells in rows.signals.items()
            if cells.valid is not None and grids.get((owner, name)) is shared
        ]  # fmt: skip
        for name in leaving:
            grids[owner, name] = copy.deepcopy(shared)
        followed: set[int] = set()
        for name, cells in rows.signals.items():
            times_ns = rows.times_ns if cells.valid is None else rows.times_ns[cells.valid]
            if not len(times_ns):
                continue
            grid = grids.get((owner, name))
            if grid is None:
                grid = grids[owner, name] = shared if is_first and cells.valid is None else SamplingGrid()
            if id(grid) not in followed:
                followed.add(id(grid))
                grid.add(times_ns)

    def finish(self) -> dict[tuple[Owner, str], Sampling]:
        """The sampling of each signal that has samples, in the order in which they come."""
        return {name: grid.finish() for name, grid in self._grids.items()}
