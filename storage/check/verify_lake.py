"""Verification and repair of the lake by its manifest, the hashes of its files, and the log."""

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import pyarrow as pa

from storage.lake.lake import Lake, quarantine, rebuilt_manifest
from storage.lake.part import without_samples
from storage.lake.tables import open_table
from storage.manifests import lake as manifests
from storage.manifests import part as descriptions
from storage.segments.disk import HASHED_AT_ONCE, sha256_of
from storage.store import Store
from stream.errors import StoreError

_SETTLED_WITHIN_S = 60.0


class LakeProblem(NamedTuple):
    """Damage in the lake; `part` is empty for the manifest, `remedy` is what `repair_lake` does."""

    part: str
    file: str
    what: str
    remedy: str


def lake_problems(store: Store) -> Iterator[LakeProblem]:
    """All damage in the lake: every file is compared with its hash. Segments that are not in it yet are no damage."""
    yield from _problems(store, {})


def lasting_problems(store: Store) -> list[LakeProblem]:
    """As `lake_problems`, for a lake that may change meanwhile: changed parts are checked again."""
    sound: dict[str, descriptions.Part] = {}
    until = time.monotonic() + _SETTLED_WITHIN_S
    while True:
        before = _version(store)
        found = list(_problems(store, sound))
        if found and not store.lake.is_dir() and (store.folder / manifests.NEW_LAKE).is_dir():
            time.sleep(0.05)  # it is being replaced
        now = _version(store)
        if not found or before == now or time.monotonic() >= until:
            return found
        if before[0] != now[0]:
            sound.clear()


def _version(store: Store) -> tuple[int, int, int]:
    """Identity of the lake and of its manifest; 0 for what is missing at this moment."""
    folder, _ = _stamp(store.lake)
    return folder, *_stamp(store.lake / manifests.MANIFEST)


def _stamp(path: Path) -> tuple[int, int]:
    try:
        found = path.stat()
    except OSError:
        return 0, 0
    return found.st_ino, found.st_mtime_ns  # inode numbers are reused


def _problems(store: Store, sound: dict[str, descriptions.Part]) -> Iterator[LakeProblem]:
    """Damage of the parts that are not in `sound`; intact parts are added to it."""
    try:
        manifest = manifests.read_manifest(store, with_sources=True)
    except manifests.LakeManifestDamaged as error:
        remedy = "rebuild the manifest from the parts' descriptions, and missing parts from the log"
        yield LakeProblem("", manifests.MANIFEST, str(error), remedy)
        manifest = manifests.Manifest(parts=tuple(manifests.found_parts(store)))
    seen: set[str] = set()
    with ThreadPoolExecutor(HASHED_AT_ONCE) as pool:
        unknown = [part for part in manifest.parts if sound.get(part.name) != part]
        checked = {id(part): pool.submit(lambda each: list(_part_problems(store, each)), part) for part in unknown}
        for part in manifest.parts:
            if id(part) in checked:
                found = checked[id(part)].result()
                yield from found
                if not found:
                    sound[part.name] = part
            again = seen.intersection(part.segments)
            if again:
                what = f"segments {', '.join(sorted(again))} are in another part as well"
                yield _problem(part, manifests.MANIFEST, what)
            seen.update(part.segments)


def repair_lake(store: Store) -> Iterator[LakeProblem]:
    """Repair what `lake_problems` finds, and yield it. The caller holds `builder_lock`.

    Damaged files are moved to ``lake-aside/``, parts rebuilt from the log. If that fails for a part, StoreError is
    raised after all others are repaired.
    """
    found = list(lake_problems(store))
    for problem in found:
        if not problem.part:
            if (store.lake / manifests.MANIFEST).exists():
                quarantine(store, store.lake / manifests.MANIFEST)
            manifests.write_manifest(store, rebuilt_manifest(store))
            yield problem
    if not any(problem.part for problem in found):
        return
    lake, failure = Lake(store), None
    for name in dict.fromkeys(problem.part for problem in found if problem.part):
        try:
            if name in {part.name for part in lake.manifest.parts}:  # else it is built as a new one
                lake.rebuild_part(name, aside=True)
        except StoreError as error:
            failure = failure or error
            continue
        yield from (problem for problem in found if problem.part == name)
    if failure is not None:
        raise failure


def _part_problems(store: Store, part: descriptions.Part) -> Iterator[LakeProblem]:
    folder = store.lake / part.name
    if not folder.is_dir():
        yield _problem(part, "", "its folder is missing")
        return
    try:
        described = descriptions.read_part(folder)
        if described.dropped is not None and part.dropped is None:
            is_as_listed = described == without_samples(part, described.dropped.document)  # written before the manifest
        else:
            is_as_listed = described == part
        if not is_as_listed:
            yield _problem(part, descriptions.PART, "it does not match the manifest")
    except StoreError as error:
        yield _problem(part, descriptions.PART, str(error))
    for name, file in part.files.items():
        wrong = _wrong_with(folder / name, file)
        if wrong is not None:
            yield _problem(part, name, wrong)
    raw = part.files.get("samples.parquet")
    if raw is not None and raw.rows != part.samples:
        yield _problem(part, "samples.parquet", f"{raw.rows} rows, its segments have {part.samples} samples")


def _wrong_with(path: Path, file: descriptions.PartFile) -> str | None:
    try:
        size = path.stat().st_size
        if size != file.bytes:
            return f"{size} bytes, {file.bytes} are expected"
        if sha256_of(path) != file.sha256:
            return "its content does not match its hash"
        with open_table(path) as table:
            rows = table.metadata.num_rows
    except FileNotFoundError:
        return "it is missing"
    except (StoreError, OSError, pa.ArrowException) as error:
        return str(error)
    return None if rows == file.rows else f"{rows} rows, {file.rows} are expected"


def _problem(part: descriptions.Part, file: str, what: str) -> LakeProblem:
    remedy = f"quarantine {part.name} and rebuild its {len(part.segments)} segments from the log"
    return LakeProblem(part.name, file, what, remedy)
