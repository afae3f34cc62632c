"""Rebuilding the lake from the log, beside the old one, which is replaced when the new one is complete."""

import shutil
from collections import deque
from collections.abc import Iterator
from contextlib import suppress

from storage.lake.compaction import FAN_IN, compact
from storage.lake.lake import Lake
from storage.manifests.lake import MANIFEST, NEW_LAKE, LakeManifestDamaged, finish_switch, read_manifest, switch
from storage.store import Store
from stream.errors import StoreError


def rebuild(store: Store, *, force: bool = False) -> Iterator[tuple[int, int]]:
    """Rebuild the lake of a store, under `builder_lock`; yields how many segments the new one has, of how many.

    After a kill it resumes. If a segment is damaged, or the old lake holds more than the log, StoreError is raised and
    the old lake stays in force; with `force` it is replaced, and quarantined.
    """
    try:
        yield from _rebuilt(store, force=force)
    except OSError as error:
        raise StoreError(
            f"the new lake of {store.folder} cannot be written: {error}; the old one stays in force, and the new "
            f"one is resumed: free the disk and run `gyrofleet rebuild` again"
        ) from error


def _rebuilt(store: Store, *, force: bool) -> Iterator[tuple[int, int]]:
    finish_switch(store)
    beside = Store(store.folder, store.identity)
    beside.lake = store.folder / NEW_LAKE
    lake = _begun(store, beside)
    missing = lake.missing()
    of = len(missing) + len(lake.manifest.segments)
    failed: dict[str, StoreError] = {}
    for number, _ in enumerate(lake.bring(missing, failed), start=1):
        yield of - len(missing) + number, of
        if number % FAN_IN == 0:
            deque(compact(lake), maxlen=0)
    problems = [str(error) for error in failed.values()]
    lost = _only_in_old(store, lake)
    if lost:
        problems.append(f"the lake holds {len(lost)} segments that the log no longer gives: {', '.join(lost[:5])}")
    if problems and not force:
        raise StoreError(
            f"{'; '.join(problems)}. The old lake stays in force, the new one waits in {beside.lake}: repair the log "
            f"(`gyrofleet recover`) and run the command again, or give --force to continue without"
        )
    deque(compact(lake), maxlen=0)
    lake.purge(grace_s=0.0)
    switch(store, keep_old=bool(problems))


def _begun(store: Store, beside: Store) -> Lake:
    try:
        lake = Lake(beside)
    except LakeManifestDamaged:
        shutil.rmtree(beside.lake)
        lake = Lake(beside)
    # the document of the restoration may be in a segment that is still being written
    with suppress(StoreError):
        if restored := read_manifest(store).restored:
            lake.restore_raw(restored)
    return lake


def _only_in_old(store: Store, new: Lake) -> list[str]:
    """Segments that only the old lake has, or that it has from another file; none if it cannot be read."""
    if not (store.lake / MANIFEST).exists():
        return []
    try:
        old = read_manifest(store, with_sources=True)
    except StoreError:
        return []
    before, now = (
        {segment: sha256 for part in manifest.parts for segment, sha256 in part.sources.items()}
        for manifest in (old, read_manifest(new.store, with_sources=True))
    )
    others = {segment for segment in before.keys() & now.keys() if before[segment] != now[segment]}
    return sorted(old.segments - new.manifest.segments | others)
