"""Which station a run is of: with security, another station may not add to it."""

from collections.abc import Iterable

from storage.manifests.entries import SegmentEntry
from stream.errors import WireError


class OfAnotherStation(WireError):
    """A message of a station about a run that another station began."""


class RunOwners:
    """Stations of runs: of each the one whose samples, or whose start of the run, came first.

    Runs that an older gyrofleet recorded are of nobody.

    >>> owners = RunOwners([])
    >>> owners.add("night", "chamber-2")
    >>> owners.add("night", "chamber-3")
    >>> print(owners.reason_against("night", "chamber-3"))
    run night is of station chamber-2; choose another name for a run of station chamber-3
    >>> owners.reason_against("day", "chamber-3")
    """

    def __init__(self, entries: Iterable[SegmentEntry]) -> None:
        self._stations: dict[str, str] = {}
        for entry in sorted(entries, key=lambda each: each.segment):
            for run, station in zip(entry.runs, entry.stations, strict=False):
                if station:
                    self._stations.setdefault(run, station)

    def add(self, run: str, station: str) -> None:
        """Let a run be of a station, if it is of nobody."""
        self._stations.setdefault(run, station)

    def reason_against(self, run: str, station: str) -> str | None:
        """Why a station may not add to a run; None if it may."""
        owner = self._stations.get(run, station)
        if owner == station:
            return None
        return f"run {run} is of station {owner}; choose another name for a run of station {station}"

    def check(self, run: str, station: str) -> None:
        """Raise OfAnotherStation if a station may not add to a run."""
        if self._stations.get(run, station) != station:
            raise OfAnotherStation(self.reason_against(run, station))
