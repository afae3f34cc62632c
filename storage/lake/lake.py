"""The lake: columnar Parquet, made from sealed segments of the log and from nothing else.

A part is written under ``tmp/`` and renamed into place, so it is there once and whole, or not at all; the manifest
says which parts are in force. Whatever is no longer in force stays for its readers for a while.
"""

import shutil
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import msgspec

from storage.lake.compaction import FAN_IN, compact
from storage.lake.part import BuiltPart, Drops, build_part, noted_drops, without_samples
from storage.lake.tables import SAMPLES_FILE
from storage.log.files import sealed_segments
from storage.manifests.lake import (
    MANIFEST,
    PART,
    Manifest,
    Part,
    Replaced,
    found_parts,
    in_order,
    read_manifest,
    read_part,
    write_manifest,
    write_part,
)
from storage.manifests.lake_switch import NEW_LAKE, finish_switch
from storage.manifests.log import LogManifest, read_log_manifest
from storage.store import Store, only_one, sync_folder
from stream.errors import StoreError

GRACE_S = 3600.0
_TOGETHER_S = 0.5


class LakeBusy(StoreError):
    """Somebody else is at work on the lake."""


@contextmanager
def builder_lock(store: Store, *, patience_s: float = 0.0) -> Iterator[None]:
    """Held by whoever changes the lake of a store; waits so long for one who holds it.

    Raises
    ------
    LakeBusy: If another process, or another part of this one, still holds it.
    """
    until = time.monotonic() + patience_s
    with ExitStack() as stack:
        while True:
            try:
                stack.enter_context(only_one(store.folder / "lake.lock", "builder of the lake"))
                break
            except StoreError as error:
                if not isinstance(error.__context__, BlockingIOError):
                    raise
                if time.monotonic() >= until:
                    raise LakeBusy(str(error)) from None
            time.sleep(0.1)
        yield


def build_missing(store: Store, *, compacts: bool = True) -> Iterator[str]:
    """Bring every sealed segment that is not in the lake into it; yields their names. The caller holds `builder_lock`.

    Parameters
    ----------
    store: Whose.
    compacts: Whether to put small parts together on the way, and to remove what has been replaced for an hour.

    Raises
    ------
    StoreError: If a segment is damaged; the others are brought there first.
    """
    lake = Lake(store)
    failed: dict[str, StoreError] = {}
    for number, segment in enumerate(lake.bring(lake.missing(), failed), start=1):
        yield segment
        if compacts and number % FAN_IN == 0:
            deque(compact(lake), maxlen=0)
    if compacts:
        deque(compact(lake), maxlen=0)
        lake.purge()
    for error in failed.values():
        raise error


class Lake:
    """The lake of a store, open for changes. The caller holds `builder_lock`.

    What an earlier process left half done is put in order first: a whole part that the manifest does not name yet is
    taken in, what it was made from in part is removed, and a part whose folder has gone is rebuilt.

    Parameters
    ----------
    store: Whose.

    Attributes
    ----------
    manifest: What is in force now.

    Raises
    ------
    LakeManifestDamaged: If it is damaged or lost.
    """

    def __init__(self, store: Store) -> None:
        self.store = store
        if store.lake.name != NEW_LAKE:
            finish_switch(store)
        store.lake.mkdir(exist_ok=True)
        self.manifest = read_manifest(store)
        for left in store.tmp.glob("lake-*"):
            shutil.rmtree(left, ignore_errors=True)
        if not (store.lake / MANIFEST).exists():
            write_manifest(store, self.manifest)
        self._take_in_left_over()
        self._apply_dropped()

    def missing(self) -> list[str]:
        """Sealed segments that are not in the lake."""
        return sorted({path.stem for path in sealed_segments(self.store)} - self.manifest.segments)

    def bring(self, segments: Iterable[str], failed: dict[str, StoreError]) -> Iterator[str]:
        """Bring sealed segments to the lake; yields each that is there, notes in `failed` each that is damaged.

        What is made within half a second is put in force together; a kill before leaves whole parts, which the next
        one takes in.
        """
        built: list[BuiltPart] = []
        since = time.monotonic()
        for segment in segments:
            try:
                built.append(self._built(segment))
            except StoreError as error:
                failed[segment] = error
            if time.monotonic() - since > _TOGETHER_S:
                yield from self._put_in_force(built)
                built, since = [], time.monotonic()
        yield from self._put_in_force(built)

    def swap(self, old: Iterable[str], new: Iterable[BuiltPart]) -> None:
        """Put parts in force, in the place of others if there are any; the manifest is where it takes effect."""
        gone, new = set(old), list(new)
        for each in new:
            each.folder.rename(self.store.lake / each.part.name)
        sync_folder(self.store.lake)
        now_ns = time.time_ns()
        drops = self._drops()
        for each in new:
            drops = drops.join(each.drops)
        is_changed = drops != self._drops()
        kept = [part for part in self.manifest.parts if part.name not in gone]
        self.commit(
            parts=tuple(in_order([*kept, *(each.part for each in new)])),
            replaced=(*self.manifest.replaced, *(Replaced(name, now_ns) for name in sorted(gone))),
            **drops._asdict(),
        )
        if is_changed:
            self._apply_dropped()

    def commit(self, **changes: object) -> None:
        """Put a changed manifest in force."""
        manifest = msgspec.structs.replace(self.manifest, number=self.manifest.number + 1, **changes)
        write_manifest(self.store, manifest)
        self.manifest = manifest

    def drop_raw(self, dropped: Mapping[str, str]) -> None:
        """Let go of the raw rows of segments; `dropped` names the document of each, which must be in the log."""
        self.commit(dropped={**dropped, **self.manifest.dropped})
        self._apply_dropped()

    def restore_raw(self, restored: Mapping[str, tuple[str, ...]]) -> None:
        """Bring the raw rows of segments back from the log; `restored` names the documents that count no more of each.

        The document that says so must be in the log.
        """
        self.commit(**self._drops().join(Drops({}, dict(restored)))._asdict())
        self._apply_dropped()

    def remake(self, name: str, *, aside: bool = False) -> None:
        """Make a part anew from the log, one for each of its segments; the old one is kept `aside`, or removed later.

        Raises
        ------
        StoreError: If a segment of it is damaged; the part stays as it was.
        """
        part = self.manifest.part(name)
        self.swap([name], [self._built(segment) for segment in part.segments])
        if aside and (self.store.lake / name).is_dir():
            self.set_aside(name)

    def free_name(self, wanted: str) -> str:
        """`wanted`, or the next like it that no folder of the lake has."""
        name, number = wanted, 1
        while (self.store.lake / name).exists():
            number += 1
            name = f"{wanted}-{number}"
        return name

    def purge(self, grace_s: float = GRACE_S) -> list[str]:
        """Remove what has been out of force for so long; returns its paths within the lake."""
        before_ns = time.time_ns() - round(grace_s * 1e9)
        due = [each for each in self.manifest.replaced if each.at_ns <= before_ns]
        for each in due:
            path = self.store.lake / each.path
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)
        if due:
            self.commit(replaced=tuple(each for each in self.manifest.replaced if each.at_ns > before_ns))
        return [each.path for each in due]

    def set_aside(self, name: str) -> Path:
        """Move a folder or file of the lake out of it, to be looked at; where it is then."""
        aside = self.store.folder / "lake-aside"
        aside.mkdir(exist_ok=True)
        target = aside / f"{name}.{time.time_ns()}"
        (self.store.lake / name).rename(target)
        sync_folder(aside)
        sync_folder(self.store.lake)
        return target

    def _put_in_force(self, built: list[BuiltPart]) -> list[str]:
        if built:
            self.swap((), built)
        return [segment for each in built for segment in each.part.segments]

    def _built(self, segment: str) -> BuiltPart:
        return build_part(
            self.store.log / f"{segment}.mcap",
            self.store.tmp / f"lake-{segment}",
            self.free_name(segment),
            store=self.store.identity,
            without_raw=self.manifest.dropped.get(segment),
        )

    def _take_in_left_over(self) -> None:
        known = {part.name for part in self.manifest.parts} | {each.path for each in self.manifest.replaced}
        covered = self.manifest.segments
        found, drops = [], self._drops()
        listed = read_log_manifest(self.store)
        for path in sorted(self.store.lake.iterdir()):
            if path.name in known or not path.is_dir():
                continue
            if not (path / PART).exists() and not path.name.isdecimal():
                continue  # not ours
            try:
                part = read_part(path)
            except StoreError:
                self.set_aside(path.name)
                continue
            if not is_of_log(part, listed):
                self.set_aside(path.name)
            elif covered.isdisjoint(part.segments) and all((path / name).is_file() for name in part.files):
                found.append(part)
                covered |= set(part.segments)
                drops = drops.join(noted_drops(path, self.store.identity))
            else:
                shutil.rmtree(path)
        lost = {part.name for part in self.manifest.parts if not (self.store.lake / part.name / PART).exists()}
        if found or lost:
            kept = [part for part in self.manifest.parts if part.name not in lost]
            self.commit(parts=tuple(in_order([*kept, *found])), **drops._asdict())

    def _drops(self) -> Drops:
        return Drops(self.manifest.dropped, self.manifest.restored)

    def _apply_dropped(self) -> None:
        """Let go of raw rows that documents say are dropped; a part that they are only a share of is split first."""
        for part in self.manifest.parts:
            due = [segment for segment in part.segments if segment in self.manifest.dropped]
            if part.dropped is not None and len(due) < len(part.segments):
                with suppress(StoreError):  # of a segment that is gone or damaged: it stays without its rows
                    self.remake(part.name)
                continue
            if part.dropped is not None or not due:
                continue
            if len(due) == len(part.segments):
                self._drop_raw_of(part, self.manifest.dropped[due[-1]])
            else:
                with suppress(StoreError):  # of a damaged segment: it keeps its rows until that is mended
                    self.remake(part.name)

    def _drop_raw_of(self, part: Part, document: str) -> None:
        without = without_samples(part, document)
        write_part(self.store.lake / part.name, without)
        parts = tuple(without if each.name == part.name else each for each in self.manifest.parts)
        gone = Replaced(f"{part.name}/{SAMPLES_FILE}", time.time_ns())
        self.commit(parts=parts, replaced=(*self.manifest.replaced, gone))


def is_of_log(part: Part, log: LogManifest) -> bool:
    """Whether a part was made from segments of this log, as far as both say."""
    known = {name.removesuffix(".mcap"): entry for name, entry in (*log.lost.items(), *log.entries.items())}
    return not known or all(
        segment in known and known[segment].sha256 in {"", sha256} for segment, sha256 in part.sources.items()
    )


def remade_manifest(store: Store) -> Manifest:
    """A manifest made from what the parts say of themselves, for one that is lost or damaged."""
    listed = read_log_manifest(store)
    parts = [part for part in found_parts(store) if is_of_log(part, listed)]
    drops = Drops({}, {})
    for part in parts:
        with suppress(StoreError):  # a damaged part is rebuilt, and what it says comes again
            drops = drops.join(noted_drops(store.lake / part.name, store.identity))
    return Manifest(parts=tuple(parts), **drops._asdict())


def parts(store: Store) -> list[Part]:
    """Parts of the lake that are in force, in the order of their segments."""
    return list(read_manifest(store).parts)
