"""Passes over all plants of a fleet store: segments, then the lakes, then what plants state of the same units."""

from collections import deque
from collections.abc import Callable, Collection, Iterable
from concurrent.futures import ThreadPoolExecutor

import msgspec

from storage.fleet_store import FleetStore, Replica
from storage.lake.builder import build_missing, builder_lock
from storage.log.files import sealed_segments
from storage.manifests.lake import read_manifest
from storage.replication.arriving.bandwidth import Bandwidth
from storage.replication.identities import Conflict, conflicts
from storage.replication.progress import Progress
from storage.replication.receiver import Receiver, Report
from storage.replication.sources.source import SegmentSource
from storage.specifications.copies import write_missing_copies
from stream.errors import StoreError

_PATIENCE_S = 10.0
_AT_ONCE = 16


class Pass(msgspec.Struct, frozen=True):
    """Result of a pass over all plants: what was added, the state of each plant, and conflicting identities."""

    fleet: str
    added: int
    added_bytes: int
    added_files: int
    plants: tuple[Progress, ...]
    conflicts: tuple[Conflict, ...]
    lakes: dict[str, str]  # plants whose lake cannot be built, and why

    @property
    def is_well(self) -> bool:
        """Whether nothing was refused, and every plant and lake is complete."""
        return all(each.is_well for each in self.plants) and not self.lakes


class Replication:
    """Replication into a fleet store.

    Parameters
    ----------
    fleet : FleetStore
        Where segments arrive.
    bandwidth : Bandwidth
        The limit of all plants together.
    builds_lakes : bool
        Whether each plant's lake is built from what has arrived.
    report, stopped, rereads
        See `Receiver`.
    """

    def __init__(
        self, fleet: FleetStore, *, bandwidth: Bandwidth | None = None, builds_lakes: bool = True,
        report: Report = lambda _progress: None, stopped: Callable[[], bool] = lambda: False, rereads: bool = False,
    ) -> None:  # fmt: skip
        self._rereads = rereads
        self.fleet, self._bandwidth, self._builds_lakes = fleet, bandwidth or Bandwidth(), builds_lakes
        self._report, self._stopped = report, stopped
        self._receivers: dict[int, Receiver] = {}
        self._failed: dict[str, str] = {}
        self._claims: dict[str, str] = {}
        self._lakes: dict[str, int] | None = None
        self._conflicts: tuple[Conflict, ...] = ()

    def run(self, sources: Iterable[SegmentSource]) -> Pass:
        """One pass over the plants."""
        self._claims.clear()
        receivers = [self._receiver(source) for source in sources]
        with ThreadPoolExecutor(max(1, min(_AT_ONCE, len(receivers)))) as pool:  # one that is slow holds up no other
            done = list(pool.map(lambda each: each.run(), receivers))
        changed = {each.plant for each in done if each.added or self._lakes is None or each.plant in self._failed}
        self._failed = self._build_lakes(changed) if self._builds_lakes else {}
        return Pass(
            fleet=str(self.fleet.folder), added=sum(each.added for each in done),
            added_bytes=sum(each.added_bytes for each in done), added_files=sum(each.added_files for each in done),
            plants=tuple(done), conflicts=self._conflicting(), lakes=self._failed,
        )  # fmt: skip

    def _receiver(self, source: SegmentSource) -> Receiver:
        found = self._receivers.get(id(source))
        if found is None:
            found = self._receivers[id(source)] = Receiver(
                source,
                self.fleet,
                bandwidth=self._bandwidth,
                report=self._report,
                stopped=self._stopped,
                rereads=self._rereads,
                claim=self._claims.setdefault,  # one call: of two threads one is first
            )
        return found

    def _conflicting(self) -> tuple[Conflict, ...]:
        """Conflicting identities; looked for again where a lake has changed."""
        lakes = {each.plant.name: lake_number(each) for each in self.fleet.replicas()}
        if lakes != self._lakes:
            self._lakes, self._conflicts = lakes, tuple(fleet_conflicts(self.fleet))
        return self._conflicts

    def _build_lakes(self, changed: Collection[str]) -> dict[str, str]:
        failed = {}
        for replica in self.fleet.replicas():
            if replica.plant.name not in changed or self._stopped():
                continue
            try:
                if not behind(replica):
                    continue
                with builder_lock(replica.store, patience_s=_PATIENCE_S):
                    deque(build_missing(replica.store), maxlen=0)
                write_missing_copies(replica.store)
            except StoreError as error:
                failed[replica.plant.name] = str(error)
        return failed


def behind(replica: Replica) -> int:
    """Number of segments of a plant that are not in its lake."""
    return len({path.stem for path in sealed_segments(replica.store)} - read_manifest(replica.store).segments)


def fleet_conflicts(fleet: FleetStore) -> list[Conflict]:
    """Conflicting identities, of plants whose lake can be read."""
    return conflicts(each for each in fleet.replicas() if lake_number(each) >= 0)


def lake_number(replica: Replica) -> int:
    """Number of changes of a plant's lake; -1 if it cannot be read, which who builds or verifies it reports."""
    try:
        return read_manifest(replica.store).number
    except StoreError:
        return -1
