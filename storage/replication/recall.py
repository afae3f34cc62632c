"""Recall: segments that a plant has lost, or that are damaged there, come back from its copy in a fleet store.

A segment is taken only as the plant itself once sealed it: of the plant's store, in a chained list, with the SHA-256
that the plant's own manifest has for it, as far as that is left.
"""

from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec

from storage.lake.builder import build_missing, builder_lock
from storage.lake.lake import Lake
from storage.manifests.entries import SegmentEntry
from storage.manifests.log import FIRST, LogManifest, ManifestWriter
from storage.manifests.part import with_sources
from storage.plant import Plant, checked, read_plant, write_plant
from storage.replication.arriving.arrival import ArrivalRefused, Arrivals, Wanted
from storage.replication.arriving.bandwidth import Bandwidth
from storage.replication.arriving.carried_files import CarriedFiles, Stopped
from storage.replication.arriving.segment_check import check_segment, is_intact, set_aside
from storage.replication.plant_list import SALVAGED, ListRefused, checked_line
from storage.replication.progress import Refusal
from storage.replication.sources.source import SegmentMissing, SegmentSource, SourceGone
from storage.segments.disk import DISK
from storage.store import Store, WriterLock
from storage.store_marker import MARKER, is_unfinished, write_markers
from stream.errors import StoreError

_ROLE = "gyrofleet replicate --recall"
_ARRIVING = "recalled"
_STOPPED = "stopped; the same command resumes"


class Recalled(msgspec.Struct, frozen=True, kw_only=True):
    """Result: segments and files that came back, those that were refused, and what stays in ``log/aside``."""

    plant: str
    store: str
    segments: tuple[str, ...] = ()
    bytes: int = 0
    files: int = 0
    intact: int = 0
    aside: tuple[str, ...] = ()
    refused: tuple[Refusal, ...] = ()
    trouble: str = ""

    @property
    def is_well(self) -> bool:
        """Whether nothing was refused and all came."""
        return not self.refused and not self.trouble


def recall(
    folder: Path, source: SegmentSource, *, bandwidth: Bandwidth | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> Recalled:  # fmt: skip
    """Bring back what the store of a plant has lost; into an empty or missing folder all of it.

    StoreError if the copy is of another store, or the store is being written.
    """
    stated = source.plant()
    if stated is None:
        raise StoreError(f"{source.where} has no segment of a plant")
    plant = checked(stated)
    store = _opened(folder, plant)
    if store.identity != plant.store:
        raise StoreError(
            f"{folder} is the store {store.identity}, {source.where} has plant {plant.name} of {plant.store}"
        )
    with WriterLock(store, _ROLE):
        return _Recall(store, plant, source, bandwidth or Bandwidth(), stopped).run()


def _opened(folder: Path, plant: Plant) -> Store:
    if (folder / MARKER).exists() or (folder.exists() and not is_unfinished(folder)):
        store = Store.open_or_repair(folder)[0]
        for part in (store.log, store.lake, store.tmp):
            part.mkdir(exist_ok=True)
        return store
    for part in (folder, folder / "tmp", folder / "log", folder / "lake"):
        part.mkdir(parents=True, exist_ok=True)
    write_markers(folder, plant.store)
    return Store.open(folder)


class _Recall:
    def __init__(
        self, store: Store, plant: Plant, source: SegmentSource, bandwidth: Bandwidth, stopped: Callable[[], bool]
    ) -> None:
        self._store, self._plant, self._source, self._stopped = store, plant, source, stopped
        self._manifest = ManifestWriter(store)
        self._arrivals = Arrivals(store.tmp / _ARRIVING, bandwidth)
        self._refused: list[Refusal] = []
        self._segments: list[str] = []
        self._aside: list[str] = []
        self._bytes = self._files = self._intact = 0

    def run(self) -> Recalled:
        trouble = ""
        try:
            if self._manifest.found.damage:
                raise StoreError("the log's manifest is damaged: `gyrofleet recover` rewrites it; then recall again")
            listed = list(self._listed())
            forks = [entry for entry in listed if self._is_fork(entry)]
            for entry in forks:
                mine = self._manifest.found.entries[entry.segment].sha256[:12]
                what = f"segment {entry.segment} has SHA-256 {mine} here, {entry.sha256[:12]} there"
                self._refuse("fork", entry.segment, f"{what}; both histories stay, nothing is brought back")
            if not forks:
                self._take_all(listed)
        except Stopped:
            trouble = _STOPPED
        except ListRefused as error:
            self._refuse(error.kind, error.segment, str(error))
        except (SourceGone, StoreError, OSError) as error:
            trouble = str(error)
        if self._segments:
            self._build_lake()
        return Recalled(
            plant=self._plant.name, store=str(self._store.folder), segments=tuple(self._segments), bytes=self._bytes,
            files=self._files, intact=self._intact, aside=tuple(self._aside), refused=tuple(self._refused),
            trouble=trouble,
        )  # fmt: skip

    def _listed(self) -> Iterator[SegmentEntry]:
        """The segments of the copy: the originals that it has kept, else as last listed there."""
        last, entries = FIRST, LogManifest()
        for raw in self._source.segments(0):
            line = checked_line(raw, last)
            last = line.chained
            entries.take(line.entry)
        found = dict(entries.entries)
        found.update((entry.segment, entry) for entry in self._source.originals())
        yield from sorted(found.values(), key=lambda entry: entry.segment)

    def _is_fork(self, entry: SegmentEntry) -> bool:
        """Whether this store once sealed another segment under that name."""
        mine = self._manifest.found.entries.get(entry.segment)
        return mine is not None and mine.sha256 != entry.sha256 and mine.origin != SALVAGED

    def _take_all(self, listed: list[SegmentEntry]) -> None:
        for entry in listed:
            if self._stopped():
                raise Stopped
            self._take(entry)
        files = CarriedFiles()
        files.fetch(self._source, self._store.folder, self._arrivals, self._refuse, self._stopped)
        self._files = files.added

    def _take(self, entry: SegmentEntry) -> None:
        name, path = entry.segment, self._store.log / entry.segment
        found = self._manifest.found
        mine = found.entries.get(name)
        lost = found.lost.get(name)
        if mine is not None and mine.sha256 == entry.sha256:
            if is_intact(path, entry):
                self._intact += 1
                self._name_plant()
                return
        elif mine is None and lost is not None and lost.sha256 not in ("", entry.sha256):
            self._refuse("fork", name, f"segment {name} was lost with SHA-256 {lost.sha256[:12]}, the copy has another")
            return
        elif mine is None and path.exists() and not is_intact(path, entry):
            self._refuse("fork", name, f"segment {name} is here with another content; both stay")
            return
        if self._fetched(entry, path) and (mine is None or mine.sha256 != entry.sha256):
            self._manifest.add(entry)

    def _fetched(self, entry: SegmentEntry, path: Path) -> bool:
        """Bring a segment to its place; what is there is kept in ``log/aside``."""
        if not is_intact(path, entry):
            fresh = self._store.tmp / f"recalled-{entry.segment}"
            fresh.unlink(missing_ok=True)
            try:
                self._arrivals.fetch(
                    self._source, Wanted(entry.segment, entry.size, entry.sha256), fresh,
                    lambda part: check_segment(part, self._plant.store, entry.segment),
                )  # fmt: skip
            except (ArrivalRefused, SegmentMissing) as error:
                kind = error.kind if isinstance(error, ArrivalRefused) else "segment_missing"
                self._refuse(kind, entry.segment, str(error))
                return False
            if path.exists():
                self._aside.append(str(set_aside(self._store, path)))
            DISK.rename(fresh, path)
            DISK.sync_folder(self._store.log)
            self._bytes += entry.size
        self._segments.append(entry.segment)
        self._name_plant()
        return True

    def _name_plant(self) -> None:
        """State in a store without a plant whose it is, as soon as it has a segment of that plant."""
        if read_plant(self._store.folder) is None:
            write_plant(self._store.folder, self._plant)

    def _build_lake(self) -> None:
        """Parts made of what was left of a segment are made of the whole one."""
        with builder_lock(self._store, patience_s=10.0):
            lake = Lake(self._store)
            entries = self._manifest.found.entries
            for part in lake.manifest.parts:
                marks = {segment: entries.get(f"{segment}.mcap") for segment in part.segments}
                sources = with_sources(self._store.lake, part).sources
                if any(entry is not None and sources.get(each) != entry.sha256 for each, entry in marks.items()):
                    lake.rebuild_part(part.name)
            deque(build_missing(self._store), maxlen=0)

    def _refuse(self, kind: str, segment: str, what: str) -> None:
        self._refused.append(Refusal(self._plant.name, kind, segment, what))
