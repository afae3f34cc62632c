"""One pass for one plant: what its list has beyond what was received is fetched, verified, and then visible."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec

from storage.fleet_store import FleetStore, PlantRefused, Replica
from storage.manifests.entries import SegmentEntry
from storage.manifests.log import LOST, ManifestWriter, manifest_path, rewrite_manifest
from storage.plant import checked
from storage.replication.addresses import recall_command
from storage.replication.arriving.arrival import ArrivalRefused, Arrivals, Wanted
from storage.replication.arriving.attestation_check import KIND as DISAGREES
from storage.replication.arriving.attestation_check import AttestationCheck
from storage.replication.arriving.bandwidth import Bandwidth
from storage.replication.arriving.carried_files import CarriedFiles, Stopped
from storage.replication.arriving.segment_check import check_segment, is_intact, set_aside
from storage.replication.lines_ahead import LinesAhead
from storage.replication.plant_list import ListRefused, PlantList, segment_named
from storage.replication.progress import Progress, Refusal, read_progress, write_progress
from storage.replication.sources.source import SegmentMissing, SegmentSource, SourceGone
from storage.segments.disk import DISK, Disk
from storage.store import REPLICATION, WriterLock
from storage.store_marker import RECEIVED
from stream.errors import BadInput, StoreError

ARRIVING = "arriving"
_MAX_LINES = 2_000_000  # a segment of 300 s each: 19 years
_REPORT_EVERY_S = 0.2
_KEEP_EVERY_S = 2.0
_MAX_LIST_BYTES = 2 << 30
_MAX_UNDELIVERED = 1_000  # in one pass; a list without segments has no end

Report = Callable[[Progress], object]


class Receiver:
    """A pass for a plant.

    Parameters
    ----------
    source : SegmentSource
        The plant.
    fleet : FleetStore
        Where its segments arrive.
    bandwidth : Bandwidth
        The limit.
    report : callable
        Gets the progress after each segment and range.
    stopped : callable
        Whether the pass is to end.
    rereads : bool
        Whether every segment that is here is read, and fetched again if it is damaged.
    claim : callable
        Takes a plant's name for where this source is; returns where it comes from in this pass.
    """

    def __init__(
        self, source: SegmentSource, fleet: FleetStore, *, bandwidth: Bandwidth | None = None,
        report: Report = lambda _progress: None, stopped: Callable[[], bool] = lambda: False, rereads: bool = False,
        disk: Disk = DISK, claim: Callable[[str, str], str] = lambda _plant, where: where,
    ) -> None:  # fmt: skip
        self._rereads, self._claim = rereads, claim
        self._source, self._fleet, self._disk = source, fleet, disk
        self._bandwidth, self._report, self._stopped = bandwidth or Bandwidth(), report, stopped
        self._name = ""  # of the plant, once it is known
        self._seen: tuple[object, ...] = ()
        self._attestations = AttestationCheck()
        self._begin()

    def _begin(self) -> None:
        self._began = self._reported = time.monotonic()
        self._kept = float("-inf")
        self._refused: list[Refusal] = []
        self._notes: list[str] = []
        self._added = self._added_bytes = self._transferred = self._undelivered = 0
        self._files = CarriedFiles()

    def run(self) -> Progress:
        """Do the pass. Nothing that the source returns raises; StoreError if the fleet store cannot be written."""
        self._begin()
        try:
            stated = self._source.plant()
            plant = None if stated is None else checked(stated)
        except (SourceGone, BadInput, StoreError) as error:
            return Progress(plant=self._name, trouble=f"{self._source.where}: {error}", at_ns=time.time_ns())
        if plant is None:
            note = f"{self._source.where} has no sealed segment yet"
            return Progress(plant="", notes=(note,), at_ns=time.time_ns())
        try:
            replica = self._fleet.admit(plant)
        except PlantRefused as error:
            refusal = Refusal(plant.name, "plant_identity", plant.first_segment, str(error))
            self._fleet.add_refusal(plant, str(error))
            return Progress(plant=plant.name, store=plant.store, refused=(refusal,), at_ns=time.time_ns())
        self._name, self._contact_ns = plant.name, time.time_ns()
        if (other := self._claim(plant.name, self._source.where)) != self._source.where:
            trouble = f"{self._source.where} is the plant that comes from {other} already; give each once"
            return Progress(plant=plant.name, store=plant.store, trouble=trouble, at_ns=time.time_ns())
        try:
            with WriterLock(replica.store, REPLICATION):
                return self._pass(replica)
        except (StoreError, OSError) as error:  # of this copy: the other plants go on
            before = read_progress(replica)
            return msgspec.structs.replace(
                before, at_ns=time.time_ns(), added=0, added_bytes=0, added_files=0, trouble=str(error)
            )

    def _pass(self, replica: Replica) -> Progress:
        self._open(replica)
        trouble = ""
        try:
            self._continue_list()
            if self._rereads:
                self._reread()
            self._fetch_pending()
            self._files.fetch(self._source, self._store.folder, self._arrivals, self._refuse, self._stopped)
            self._check_attestations()
        except Stopped:
            trouble = "stopped; the next pass resumes"
        except ListRefused as error:
            self._refuse(error.kind, error.segment, str(error))
        except (SourceGone, OSError) as error:
            trouble = str(error)
        except StoreError as error:  # of the fleet store's disk
            trouble = str(error)
        progress = self._progress(trouble)
        write_progress(replica, progress)
        self._seen = _marks(self._list.path, manifest_path(self._store))
        return progress

    def _open(self, replica: Replica) -> None:
        self._plant, self._store, self._replica = replica.plant, replica.store, replica
        for folder in (self._store.log, self._store.lake, self._store.tmp):
            folder.mkdir(exist_ok=True)
        self._before = read_progress(replica)
        path = replica.folder / RECEIVED
        if not self._seen or self._seen != _marks(path, manifest_path(self._store)):  # else as the last pass left them
            self._list = PlantList(path, self._disk)
            self._manifest = ManifestWriter(self._store, self._disk)
        self._ahead: LinesAhead | None = None
        self._pending: dict[str, SegmentEntry] = {}
        self._arrivals = Arrivals(replica.folder / ARRIVING, self._bandwidth, self._on_bytes, self._disk)

    def _continue_list(self) -> None:
        """Take the lines beyond those received, each after its segment has arrived."""
        # the last line received once more: a list that is continued still has it there
        known = min(self._list.count, 1)
        lines = self._lines(self._list.count - known)
        if known and next(lines, None) != self._list.last_line:
            self._compare_lists()
            lines = self._lines(self._list.count)
        while True:
            self._ahead = LinesAhead(lines, self._list.last)
            while (raw := self._ahead.next()) is not None:
                line = self._list.check(raw)
                if self._list.count >= _MAX_LINES:
                    raise ListRefused(
                        "endless_list", line.entry.segment, f"the list has more than {_MAX_LINES:,} lines"
                    )
                self._take(line.entry)
                self._list.append(line)
                self._ahead.arrived(line.entry.segment)
                self._now()
            if self._ahead.is_whole:
                return
            lines = self._lines(self._list.count)

    def _compare_lists(self) -> None:
        """The plant's list is not a continuation: it is shorter, rewritten with the same content, or another one."""
        content, size = [], 0
        for raw in self._lines(0):
            content.append(raw)
            size += len(raw)
            if len(content) > _MAX_LINES or size > _MAX_LIST_BYTES:
                raise ListRefused("endless_list", "", f"the list has more than {len(content) - 1:,} lines")
        received = self._list.path.read_bytes().split(b"\n")[:-1]
        if len(content) < len(received) and content == received[: len(content)]:
            first = segment_named(received[len(content)])
            raise ListRefused(
                "list_shortened", first,
                f"the plant's list ends before {first}, which was received of it: it was replaced by an older "
                f"copy, or its disk has lost the end; {self._recall()} brings it back",
            )  # fmt: skip
        self._list.replace(content, lambda name: (self._store.log / name).exists())
        self._notes.append("the plant has rewritten its list, with the same segments")

    def _recall(self) -> str:
        """The command that brings back what the plant has lost."""
        return recall_command(str(self._fleet.folder), self._source.where, self._plant.name)

    def _take(self, entry: SegmentEntry) -> None:
        """Bring the segment of the next line, if it is new."""
        name = entry.segment
        if entry.origin == LOST:
            if not (self._store.log / name).exists():
                self._manifest.add(entry)
                self._notes.append(f"the plant has lost segment {name}, and this fleet store never had it")
            else:
                self._notes.append(f"the plant has lost segment {name}; it is here: {self._recall()}")
        elif name not in self._list.entries:
            mine = self._manifest.found.entries.get(name)
            if mine is not None and mine.sha256 != entry.sha256:  # the list was lost here, the copy is not
                text = f"segment {name} is listed with SHA-256 {entry.sha256[:12]}, it is here with {mine.sha256[:12]}"
                raise ListRefused("changed_segment", name, text)
            self._bring(entry)
        elif entry.sha256 != self._list.entries[name].sha256:
            if (self._store.log / name).exists():
                self._notes.append(f"the plant has only a part of segment {name}; the whole is here: {self._recall()}")
            else:
                self._bring(entry)

    def _reread(self) -> None:
        """Set damaged segments aside, and list those that the manifest has lost."""
        if self._manifest.found.damage:
            rewrite_manifest(self._store, [*self._manifest.found.entries.values(), *self._manifest.found.lost.values()])
            self._manifest = ManifestWriter(self._store, self._disk)
        for name, listed in self._list.entries.items():
            entry = self._manifest.found.entries.get(name) or self._list.salvaged.get(name, listed)
            if (self._store.log / name).exists():
                self._bring(entry)

    def _fetch_pending(self) -> None:
        """Bring segments that are listed and not here: refused or missing at earlier passes, or lost here."""
        here = {path.name for path in self._store.log.glob("*.mcap")}
        refused = {each.segment for each in self._refused}
        self._pending = {
            name: self._list.salvaged.get(name, listed)
            for name, listed in self._list.entries.items()
            if name not in here and name not in self._list.lost
        }
        for name in [name for name in self._pending if name not in refused]:
            if self._bring(self._pending[name]):
                del self._pending[name]
            self._now()

    def _bring(self, entry: SegmentEntry) -> bool:
        """Fetch a segment and list it; whether it is here now."""
        name, target = entry.segment, self._store.log / entry.segment
        if self._stopped():
            raise Stopped
        if target.exists() and not is_intact(target, entry):
            self._notes.append(f"{name} is damaged here and fetched again; kept as {set_aside(self._store, target)}")
        if not target.exists():  # else a pass was killed before it could list it
            wanted = Wanted(name, entry.size, entry.sha256)
            try:
                self._arrivals.fetch(
                    self._source, wanted, target, lambda part: check_segment(part, self._plant.store, name)
                )
            except (ArrivalRefused, SegmentMissing) as error:
                kind = error.kind if isinstance(error, ArrivalRefused) else "segment_missing"
                self._refuse(kind, name, str(error))
                self._undelivered += 1
                if self._undelivered > _MAX_UNDELIVERED:
                    text = f"more than {_MAX_UNDELIVERED:,} segments of the list cannot be delivered"
                    raise ListRefused("endless_list", name, text) from error
                return False
            self._added += 1
            self._added_bytes += entry.size
        mine = self._manifest.found.entries.get(name)
        if mine is None or mine.sha256 != entry.sha256:
            self._manifest.add(entry)
        return True

    def _check_attestations(self) -> None:
        """Compare what is here with what the plant has signed."""
        has_changed = bool(self._added or self._files.added)
        found = self._attestations.check(self._store, len(self._manifest.found.entries), has_changed)
        for each in found.disagreements:
            self._refuse(DISAGREES, each.file, each.what)
        self._notes += found.notes

    def _lines(self, after: int) -> Iterator[bytes]:
        for raw in self._source.segments(after):
            if self._stopped():
                raise Stopped
            self._contact_ns = time.time_ns()
            yield raw

    def _refuse(self, kind: str, segment: str, what: str) -> None:
        self._refused.append(Refusal(self._plant.name, kind, segment, what))

    def _on_bytes(self, size: int) -> None:
        self._transferred += size
        self._contact_ns = time.time_ns()
        if self._stopped():
            raise Stopped
        self._now()

    def _now(self) -> None:
        if time.monotonic() - self._reported > _REPORT_EVERY_S:
            self._reported = time.monotonic()
            self._report(self._progress(""))
        if time.monotonic() - self._kept > _KEEP_EVERY_S:  # a pass may be killed
            self._kept = time.monotonic()
            write_progress(self._replica, self._progress(""))

    def _progress(self, trouble: str) -> Progress:
        held = self._manifest.found.entries
        return Progress(
            plant=self._plant.name, store=self._plant.store, at_ns=time.time_ns(),
            contact_ns=self._contact_ns, segments=len(held),
            bytes=sum(entry.size for entry in held.values()), added=self._added, added_bytes=self._added_bytes,
            added_files=self._files.added, transferred_bytes=self._transferred, seconds=time.monotonic() - self._began,
            lag=self._before.lag if self._ahead is None else self._ahead.lag(held, self._pending.values()),
            refused=tuple(self._refused), notes=tuple(self._notes), trouble=trouble,
        )  # fmt: skip


def _marks(*paths: Path) -> tuple[object, ...]:
    """What changes with files."""
    found = [path.stat() if path.exists() else None for path in paths]
    return tuple(each and (each.st_ino, each.st_size, each.st_mtime_ns) for each in found)
