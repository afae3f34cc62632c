"""Segments of the log under another name than the one that they were sealed with: renamed, or swapped with others."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from storage.log.files import sealed_segments
from storage.manifests.log import LogManifest, read_log_manifest
from storage.segments.disk import sha256_of
from storage.store import Store
from stream.files.atomic_file import sync_folder

_FOUND = "found"  # listed since it lay there, without a line of its own


def misplaced_segments(
    store: Store, listed: LogManifest | None = None, *, with_equal_sizes: bool = False
) -> dict[str, str]:
    """Files of the log by name that are, by size and SHA-256, a listed segment of another name, which is not there.

    Files are read only where a listed segment is missing, or has another size; `with_equal_sizes` also those of which
    another has the same size, so that their names may have been exchanged.
    """
    found = read_log_manifest(store, whole=True) if listed is None else listed
    sizes = {path.name: path.stat().st_size for path in sealed_segments(store)}
    hashes: dict[str, str] = {}

    def hashed(name: str) -> str:
        if name not in hashes:
            hashes[name] = sha256_of(store.log / name)
        return hashes[name]

    often = Counter(entry.size for entry in found.entries.values()) if with_equal_sizes else Counter()
    exchanged = {
        name
        for name, entry in found.entries.items()
        if often[entry.size] > 1 and sizes.get(name) == entry.size and hashed(name) != entry.sha256
    }
    wanted = {
        (entry.size, entry.sha256): name
        for name, entry in found.entries.items()
        if sizes.get(name) != entry.size or name in exchanged
    }
    if not wanted:
        return {}
    wanted_sizes = {size for size, _ in wanted}
    misplaced = {}
    for name, size in sizes.items():
        entry = found.entries.get(name)
        is_its_own = entry is not None and entry.size == size and entry.origin != _FOUND and name not in exchanged
        if is_its_own or size not in wanted_sizes:
            continue
        target = wanted.get((size, hashed(name)))
        if target is not None and target != name:
            misplaced[name] = target
    return misplaced


def put_back(store: Store) -> Iterator[tuple[Path, Path]]:
    """Rename misplaced segments to their names; yields both paths. What is in the way gets a name that is free."""
    while misplaced := misplaced_segments(store, with_equal_sizes=True):
        name, target = next(
            ((name, target) for name, target in misplaced.items() if not (store.log / target).exists()),
            next(iter(misplaced.items())),
        )
        path, own = store.log / name, store.log / target
        if own.exists():
            numbers = [int(each.stem) for each in sealed_segments(store) if each.stem.isdigit()]
            taken = {*numbers, *(int(each.partition(".")[0]) for each in read_log_manifest(store, whole=True).entries)}
            own.rename(store.log / f"{max(taken) + 1:08}.mcap")
        path.rename(own)
        sync_folder(store.log)
        yield path, own
