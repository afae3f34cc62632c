"""The lake: columnar Parquet, derived from the sealed segments of the log alone.

A part is written under ``tmp/`` and renamed into place, so that it exists whole or not at all; the manifest says which
parts are in force. Replaced files stay for their readers for a while.
"""

import shutil
import time
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from storage.lake.drops import Drops
from storage.lake.tables import SAMPLES_FILE
from storage.log.files import sealed_segments
from storage.log.misplaced import misplaced_segments
from storage.manifests import lake as manifests
from storage.manifests import part as descriptions
from storage.manifests.log import LogManifest, read_log_manifest
from storage.store import Store
from stream.errors import StoreError
from stream.files.atomic_file import sync_folder

if TYPE_CHECKING:
    from storage.lake.part import BuiltPart

GRACE_S = 3600.0
_TOGETHER_S = 0.5


class Lake:
    """The lake of a store, open for changes. The caller holds `builder_lock`.

    Interrupted work is finished first: complete parts that the manifest does not name are adopted, partial ones
    removed, and parts whose folder is missing are rebuilt.
    """

    def __init__(self, store: Store) -> None:
        self.store = store
        if store.lake.name != manifests.NEW_LAKE:
            manifests.finish_switch(store)
        store.lake.mkdir(exist_ok=True)
        self.manifest = manifests.read_manifest(store)
        for left in store.tmp.glob("lake-*"):
            shutil.rmtree(left, ignore_errors=True)
        if not (store.lake / manifests.MANIFEST).exists():
            manifests.write_manifest(store, self.manifest)
        self._adopt_parts()
        self._apply_dropped()

    def missing(self) -> list[str]:
        """Sealed segments that are not in the lake, without those that are in it under another name."""
        missing = {path.stem for path in sealed_segments(self.store)} - self.manifest.segments
        if missing:
            missing -= {name.removesuffix(".mcap") for name in misplaced_segments(self.store)}
        return sorted(missing)

    def drop_of_segments(self, names: Collection[str]) -> list[str]:
        """Take parts out of force that are made of these segments alone; returns their names."""
        dropped = [part.name for part in self.manifest.parts if part.segments and set(names).issuperset(part.segments)]
        if dropped:
            self.swap(dropped, [])
        return dropped

    def bring(self, segments: Iterable[str], failed: dict[str, StoreError]) -> Iterator[str]:
        """Build sealed segments; yields each that is in force, collects damaged ones in `failed`.

        Parts built within half a second are put in force together; after a kill the next builder adopts them.
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

    def swap(self, old: Iterable[str], new: "Iterable[BuiltPart]") -> None:
        """Put parts in force, replacing the `old` ones; effective with the manifest."""
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
            parts=tuple(descriptions.in_order([*kept, *(each.part for each in new)])),
            replaced=(*self.manifest.replaced, *(manifests.Replaced(name, now_ns) for name in sorted(gone))),
            **drops._asdict(),
        )
        if is_changed:
            self._apply_dropped()

    def commit(self, **changes: object) -> None:
        """Write a changed manifest."""
        manifest = msgspec.structs.replace(self.manifest, number=self.manifest.number + 1, **changes)
        self.manifest = manifests.write_manifest(self.store, manifest)

    def drop_raw(self, dropped: Mapping[str, str]) -> None:
        """Drop the raw rows of segments; `dropped` names the document of each, which must be in the log."""
        self.commit(dropped={**dropped, **self.manifest.dropped})
        self._apply_dropped()

    def restore_raw(self, restored: Mapping[str, tuple[str, ...]]) -> None:
        """Restore raw rows of segments from the log; `restored` names the documents that no longer apply to each."""
        self.commit(**self._drops().join(Drops({}, dict(restored)))._asdict())
        self._apply_dropped()

    def rebuild_part(self, name: str, *, aside: bool = False) -> None:
        """Rebuild a part from the log, one per segment; the old one is quarantined if `aside`, else removed later."""
        part = self.manifest.part(name)
        self.swap([name], [self._built(segment) for segment in part.segments])
        if aside and (self.store.lake / name).is_dir():
            quarantine(self.store, self.store.lake / name)

    def free_name(self, wanted: str) -> str:
        """`wanted`, with a number if the lake has such a folder."""
        name, number = wanted, 1
        while (self.store.lake / name).exists():
            number += 1
            name = f"{wanted}-{number}"
        return name

    def purge(self, grace_s: float = GRACE_S) -> list[str]:
        """Remove what was replaced at least `grace_s` ago; returns its paths within the lake."""
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

    def _put_in_force(self, built: "list[BuiltPart]") -> list[str]:
        if built:
            self.swap((), built)
        return [segment for each in built for segment in each.part.segments]

    def _built(self, segment: str) -> "BuiltPart":
        from storage.lake.part import build_part

        return build_part(
            self.store.log / f"{segment}.mcap", self.store.tmp / f"lake-{segment}", self.free_name(segment),
            store=self.store.identity, without_raw=self.manifest.dropped.get(segment),
        )  # fmt: skip

    def _adopt_parts(self) -> None:
        known = {part.name for part in self.manifest.parts} | {each.path for each in self.manifest.replaced}
        covered = self.manifest.segments
        found, drops = [], self._drops()
        listed = read_log_manifest(self.store)
        for path in sorted(self.store.lake.iterdir()):
            if path.name in known or path.name == manifests.BLOCKS or not path.is_dir():
                continue
            if not (path / descriptions.PART).exists() and not path.name.isdecimal():
                continue  # not a part
            try:
                part = descriptions.read_part(path)
            except StoreError:
                quarantine(self.store, path)
                continue
            if not is_from_log(part, listed):
                quarantine(self.store, path)
            elif covered.isdisjoint(part.segments) and all((path / name).is_file() for name in part.files):
                found.append(part)
                covered |= set(part.segments)
                from storage.lake.part import documented_drops

                drops = drops.join(documented_drops(path, self.store.identity))
            else:
                shutil.rmtree(path)
        lost = {
            part.name for part in self.manifest.parts if not (self.store.lake / part.name / descriptions.PART).exists()
        }
        if found or lost:
            kept = [part for part in self.manifest.parts if part.name not in lost]
            self.commit(parts=tuple(descriptions.in_order([*kept, *found])), **drops._asdict())

    def _drops(self) -> Drops:
        return Drops(self.manifest.dropped, self.manifest.restored)

    def _apply_dropped(self) -> None:
        """Drop raw rows by the manifest; a part of which only some segments are dropped is split."""
        for part in self.manifest.parts:
            due = [segment for segment in part.segments if segment in self.manifest.dropped]
            if part.dropped is None and due and len(due) == len(part.segments):
                described = descriptions.with_sources(self.store.lake, part)
                from storage.lake.part import without_samples

                without = without_samples(described, self.manifest.dropped[due[-1]])
                descriptions.write_part(self.store.lake / part.name, without)
                parts = tuple(without if each.name == part.name else each for each in self.manifest.parts)
                gone = manifests.Replaced(f"{part.name}/{SAMPLES_FILE}", time.time_ns())
                self.commit(parts=parts, replaced=(*self.manifest.replaced, gone))
            elif len(due) < len(part.segments) and (due or part.dropped is not None):
                with suppress(StoreError):  # a segment is missing or damaged: the part stays as it is
                    self.rebuild_part(part.name)


def is_from_log(part: descriptions.Part, log: LogManifest) -> bool:
    """Whether a part was made from segments of this log, as far as that is known."""
    known = {name.removesuffix(".mcap"): entry for name, entry in (*log.lost.items(), *log.entries.items())}
    return not known or all(
        segment in known and known[segment].sha256 in {"", sha256} for segment, sha256 in part.sources.items()
    )


def rebuilt_manifest(store: Store) -> manifests.Manifest:
    """A manifest from the parts' own descriptions, to replace one that is lost or damaged."""
    listed = read_log_manifest(store)
    from storage.lake.part import documented_drops

    parts = [part for part in manifests.found_parts(store) if is_from_log(part, listed)]
    drops = Drops({}, {})
    for part in parts:
        with suppress(StoreError):  # a damaged part is rebuilt, with its documents
            drops = drops.join(documented_drops(store.lake / part.name, store.identity))
    return manifests.Manifest(parts=tuple(parts), **drops._asdict())


def quarantine(store: Store, path: Path) -> Path:
    """Move a derived file or folder to ``lake-aside/``; returns its new path."""
    aside = store.folder / "lake-aside"
    aside.mkdir(exist_ok=True)
    target = path.rename(aside / f"{path.name}.{time.time_ns()}")
    sync_folder(aside)
    sync_folder(path.parent)
    return target
