"""Numbers of segments: one that was ever given is not given again, even where its file has gone."""

from collections.abc import Iterator
from pathlib import Path

from storage.manifests.lake import LakeManifestDamaged, found_parts, read_manifest
from storage.manifests.lake_switch import NEW_LAKE
from storage.manifests.log import read_log_manifest
from storage.store import Store


def highest_number(store: Store) -> int:
    """The highest number that a segment of the log has or had, by all that the store still knows of it; 0 for none.

    Segments that are lost are known from the manifest, the lake, and what is quarantined: were their numbers given
    again, the lake would take the new ones for those it has.
    """
    return max((int(name) for name in _known(store) if name.isdecimal()), default=0)


def next_free(path: Path) -> Path:
    """The name behind all segments beside `path`, open and abandoned ones among them.

    Examples
    --------
    >>> next_free(Path("/nowhere/00000041.mcap")).name
    '00000042.mcap'
    """
    taken = [each.name.partition(".")[0] for each in path.parent.glob("*.mcap*")]
    highest = max(int(name) for name in [*taken, path.name.partition(".")[0]] if name.isdecimal())
    return path.with_name(f"{highest + 1:08d}.mcap")


def _known(store: Store) -> Iterator[str]:
    for folder in (store.log, store.aside, store.folder / "lake-aside"):
        yield from (path.name.partition(".")[0] for path in folder.glob("*"))
    manifest = read_log_manifest(store)
    yield from (name.partition(".")[0] for name in (*manifest.entries, *manifest.lost))
    for folder in (store.lake, store.folder / NEW_LAKE):
        lake = Store(store.folder, store.identity)
        lake.lake = folder
        try:
            in_force = read_manifest(lake)
        except LakeManifestDamaged:
            parts = tuple(found_parts(lake))
        else:
            parts = in_force.parts
            yield from in_force.dropped
        yield from (segment for part in parts for segment in part.segments)
