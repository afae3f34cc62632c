"""Catalogues shared by requests: one of each version of the lake, replaced when its manifest changes."""

import hashlib
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic, TypeVar

import msgspec

from analytics.serve.metrics_process import LARGE_SAMPLES, MetricsProcess
from storage.manifests.lake import MANIFEST, read_manifest
from storage.manifests.part import Part
from storage.sql.catalog import Catalog, NotKept, layers
from storage.store import Store
from stream.closing import Closing

# what many requests ask, read from the files once
_PARTS = """
create table internal.served_parts as
  select channel, unit, signal, run, is_kept, filename, samples, t_first_ns, t_last_ns, is_counts, scale, "offset"
  from internal.lake_channel_parts
"""
SERVED = {
    "served_signals": "select * from signals",
    "served_runs": "select * from runs",
    "served_units": "select * from units",
    "served_verdicts": """
      select run, unit, arg_max(document->>'$.verdict', arrival_ns) as verdict, max(arrival_ns) as arrival_ns
      from internal.lake_documents where kind = 'VerdictGiven' group by run, unit""",
    "served_releases": """
      select run, unit, document->>'$.verdict' as verdict, t_ns, (document->>'$.planned_s')::double as planned_s,
        (document->>'$.recorded_s')::double as recorded_s
      from internal.lake_documents where kind = 'UnitReleased'""",
}

# those that are made of documents alone, of these kinds
SERVED_OF = {
    "served_units": ("RunStarted", "StationStated", "UnitMounted"),
    "served_verdicts": ("VerdictGiven",),
    "served_releases": ("UnitReleased",),
}
# documents that all of them are made of
SERVED_KINDS = (
    "RunStarted", "RunResumed", "RunEnded", "StationStated", "UnitMounted", "UnitReleased", "VerdictGiven",
    "ExclusionEntered",
)  # fmt: skip

Shared = TypeVar("Shared", bound=Closing)


@dataclass(frozen=True)
class LakeState:
    """A version of the lake; `tag` names it, also with the documents that specifications and models are read from.

    `log_version` is that of the rows beside it that only the log has, `log_documents` that of the documents among them,
    `entered` counts those documents that change limits, checks or models, `seen_ns` is when it was first seen.
    `metrics` is the version whose metrics are shown with it, None if none are open.
    """

    tag: str
    number: int
    parts: tuple[Part, ...]
    log_version: int = 0
    log_documents: int = 0
    entered: str = ""
    seen_ns: int = 0
    metrics: "LakeState | None" = None

    @property
    def lake(self) -> "LakeState":
        """The version of the lake by itself."""
        if not (self.log_version or self.metrics):
            return self
        return replace(self, log_version=0, log_documents=0, metrics=None)

    @property
    def documents_tag(self) -> str:
        """Names the documents of the lake and of the log: what follows from these alone is kept by it."""
        return f"{self.tag}-{self.log_documents}"

    @property
    def is_behind(self) -> bool:
        """Whether its metrics are of a version before, or not there yet."""
        return self.metrics is None or self.metrics.tag != self.tag

    @property
    def samples(self) -> int:
        """Samples in it."""
        return sum(part.samples for part in self.parts)

    @cached_property
    def segments(self) -> frozenset[str]:
        """Segments of the log that are in it."""
        return frozenset(segment for part in self.parts for segment in part.segments)

    def is_newer_than(self, other: "LakeState") -> bool:
        """Whether it is of a later manifest, or of the same one with later rows of the log."""
        return (self.number, self.log_version) > (other.number, other.log_version)

    def has_all_of(self, other: "LakeState") -> bool:
        """Whether it is of the same manifest, with the rows of the log that the other has, or more."""
        return self.tag == other.tag and self.log_version >= other.log_version


@dataclass
class _Opened(Generic[Shared]):
    state: LakeState
    catalog: Shared
    users: int = 0
    is_current: bool = True
    until_s: float = 0.0


class SharedCatalogue(Closing, Generic[Shared]):
    """The catalogue of the newest version that was asked for.

    The one before it stays open `lingers_s` longer, for requests that have begun, and as long as one of them uses it.
    """

    def __init__(self, open_catalogue: Callable[[LakeState], Shared], lingers_s: float = 3.0) -> None:
        self._open_catalogue, self._lingers_s = open_catalogue, lingers_s
        self.uses = 0  # leases so far
        self._current: _Opened[Shared] | None = None
        self._before: list[_Opened[Shared]] = []
        self._lock = threading.Lock()
        self._opening = threading.Lock()

    @property
    def state(self) -> LakeState | None:
        """The version of the newest one that is open."""
        opened = self._current
        return None if opened is None else opened.state

    @contextmanager
    def lease(self, state: LakeState) -> Iterator[Shared]:
        """A catalogue of that version, to read from any thread; it stays open within."""
        self.uses += 1
        opened = self._taken(state)
        if opened is None:
            with self._opening:  # others wait for it instead of opening another one
                opened = self._taken(state) or self._put(state, self._open_catalogue(state))
        try:
            yield opened.catalog
        finally:
            self._release(opened)

    def _taken(self, state: LakeState) -> _Opened[Shared] | None:
        with self._lock:
            for opened in (self._current, *self._before):
                if opened is not None and opened.state.has_all_of(state):
                    opened.users += 1
                    return opened
            return None

    def _put(self, state: LakeState, catalog: Shared) -> _Opened[Shared]:
        opened = _Opened(state, catalog, users=1)
        with self._lock:
            before = self._current
            if before is not None and before.state.is_newer_than(state):
                opened.is_current = False
                return opened
            self._current = opened
            if before is not None:
                before.is_current, before.until_s = False, time.monotonic() + self._lingers_s
                self._before.append(before)
        self.sweep()
        return opened

    def _release(self, opened: _Opened[Shared]) -> None:
        with self._lock:
            opened.users -= 1
            is_over = not opened.is_current and opened.users == 0 and opened not in self._before
        if is_over:
            opened.catalog.close()
        self.sweep()

    def sweep(self) -> None:
        """Close what was replaced a while ago, and is used no more."""
        now_s = time.monotonic()
        with self._lock:
            over = [each for each in self._before if each.users == 0 and each.until_s <= now_s]
            self._before = [each for each in self._before if each not in over]
        for each in over:
            each.catalog.close()

    def close(self) -> None:
        """Close it, at once or when the last request has ended."""
        with self._lock:
            opened = [each for each in (self._current, *self._before) if each is not None]
            self._current, self._before = None, []
            for each in opened:
                each.is_current = False
            over = [each for each in opened if each.users == 0]
        for each in over:
            each.catalog.close()


class SharedLake(Closing):
    """The lake of a store as requests see it.

    `views` are the store's own views, `metrics` have the tables of all layers as well, computed when they are first
    needed. `entered` counts the documents of specifications, checks and models that came since, which change the
    metrics' tables and not the lake.
    """

    def __init__(self, store: Store, entered: Callable[[], str]) -> None:
        self.store, self._entered = store, entered
        self._seen: tuple[tuple[int, int, int], LakeState] | None = None
        self._known: LakeState | None = None
        self._process = MetricsProcess(store)
        self.views = SharedCatalogue(self._viewed)
        self.metrics = SharedCatalogue(self._filled)

    def state(self) -> LakeState:
        """The version in force now; StoreError if its manifest is damaged."""
        path = self.store.lake / MANIFEST
        try:
            status = path.stat()
            stamp = (status.st_mtime_ns, status.st_size, status.st_ino)
        except OSError:
            stamp = (0, 0, 0)
        seen = self._seen
        if seen is None or seen[0] != stamp:
            manifest = read_manifest(self.store)
            digest = hashlib.sha256(msgspec.json.encode(manifest)).hexdigest()[:12]
            seen = stamp, LakeState(f"{manifest.number}-{digest}", manifest.number, manifest.parts)
            self._seen = seen
        entered, known = self._entered(), self._known
        if known is None or known.parts is not seen[1].parts or known.entered != entered:
            known = LakeState(
                f"{seen[1].tag}-{entered}", seen[1].number, seen[1].parts, entered=entered, seen_ns=time.time_ns()
            )
            self._known = known  # one for each version: what it knows of its parts is found once
        return known

    def _viewed(self, state: LakeState) -> Catalog:
        catalog = Catalog(self.store, parts=state.parts, frozen=True)
        try:
            for name, statement in SERVED.items():
                catalog.define(f"create table internal.{name} as {statement}")
            catalog.define(_PARTS)
            catalog.define("create or replace view signals as from internal.served_signals")
        except BaseException:
            catalog.close()
            raise
        return catalog

    def _filled(self, state: LakeState) -> Catalog:
        if state.samples >= LARGE_SAMPLES:
            with suppress(NotKept):
                return self._opened_filled(state, frozen=True)
            self._process.run()
        return self._opened_filled(state, frozen=False)

    def _opened_filled(self, state: LakeState, *, frozen: bool) -> Catalog:
        catalog = Catalog(self.store, parts=state.parts, frozen=frozen)
        try:
            # what they stand on is defined with them; other views when a page first names one
            catalog.fill([table for layer in layers() for table in layer.tables])
        except BaseException:
            catalog.close()
            raise
        return catalog

    def close(self) -> None:
        """Close all catalogues."""
        self._process.close()
        self.views.close()
        self.metrics.close()
