"""The lake's manifest: the parts in force, their files, and what was dropped of them.

A part is a folder of Parquet files made from one or more sealed segments, described in its ``part.json``, which is
written before the folder gets its name. ``manifest.json`` alone says which parts are in force; it is replaced as a
whole. Both files carry a hash of their content.
"""

import hashlib
import re
import shutil
import time
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from storage.store import Store
from stream.atomic_file import sync_folder, write_durably
from stream.errors import StoreError

LAKE_FORMAT = 1
MANIFEST = "manifest.json"
PART = "part.json"
NEW_LAKE = "lake-new"

_COMPLETE = "complete"  # mark in a new lake: it may replace the old one
_REMOVABLE = "removable"  # mark in an old lake: the new one holds everything in it

_HEAD = b'{"sha256":"'
_MIDDLE = b'","content":'
_TAIL = b"}\n"
# of a folder or file in the lake, or of a segment
_NAME = re.compile(r"\w[\w.-]*")


class LakeManifestDamaged(StoreError):
    """The lake's manifest is lost or damaged."""


class PartFile(msgspec.Struct, frozen=True):
    """A file of a part."""

    bytes: int
    rows: int
    sha256: str


class DroppedRows(msgspec.Struct, frozen=True):
    """Raw rows that a part no longer holds, and the document of it."""

    document: str
    samples: int
    bytes: int


class Part(msgspec.Struct, frozen=True, kw_only=True):
    """A part of the lake: the folder `name`, made from the sealed `segments`, in order.

    `samples` are those in its segments, `sources` their SHA-256 (empty in parts of an older gyrofleet). `dropped` is
    set once its raw rows are. `quarantined` messages cannot be built; the log keeps them and their samples.
    """

    name: str
    segments: tuple[str, ...]
    files: dict[str, PartFile]
    samples: int
    t_first_ns: int | None = None
    t_last_ns: int | None = None
    arrival_first_ns: int | None = None
    arrival_last_ns: int | None = None
    dropped: DroppedRows | None = None
    sources: dict[str, str] = {}
    quarantined: int = 0
    quarantined_samples: int = 0

    @property
    def bytes(self) -> int:
        """Size of its files."""
        return sum(file.bytes for file in self.files.values())

    @property
    def day(self) -> str:
        """UTC day of its first arrival; empty for an empty part."""
        if self.arrival_first_ns is None:
            return ""
        return datetime.fromtimestamp(self.arrival_first_ns // 10**9, UTC).strftime("%Y-%m-%d")


class Replaced(msgspec.Struct, frozen=True):
    """A folder or file that is no longer in force and stays until its readers have ended."""

    path: str
    at_ns: int


class Manifest(msgspec.Struct, frozen=True, kw_only=True):
    """What is in force: parts in the order of their first segments.

    `replaced` is removed later. `dropped` are segments whose raw rows are dropped, with the document of it, `restored`
    those restored, with the documents that no longer apply to them. `number` counts changes.
    """

    format: int = LAKE_FORMAT
    number: int = 0
    parts: tuple[Part, ...] = ()
    replaced: tuple[Replaced, ...] = ()
    dropped: dict[str, str] = {}
    restored: dict[str, tuple[str, ...]] = {}

    @property
    def segments(self) -> set[str]:
        """Segments that are in the lake."""
        return {segment for part in self.parts for segment in part.segments}

    def part(self, name: str) -> Part:
        """The part of a name."""
        return next(part for part in self.parts if part.name == name)


def hull(parts: Iterable[Part], name: str, files: dict[str, PartFile]) -> Part:
    """The description of a part that holds what `parts` hold."""
    parts = list(parts)

    def known(field: str) -> list[int]:
        return [value for part in parts if (value := getattr(part, field)) is not None]

    dropped = [part.dropped for part in parts if part.dropped is not None]
    return Part(
        name=name,
        segments=tuple(sorted(segment for part in parts for segment in part.segments)),
        files=files,
        samples=sum(part.samples for part in parts),
        sources={segment: sha256 for part in parts for segment, sha256 in sorted(part.sources.items())},
        t_first_ns=min(known("t_first_ns"), default=None),
        t_last_ns=max(known("t_last_ns"), default=None),
        arrival_first_ns=min(known("arrival_first_ns"), default=None),
        arrival_last_ns=max(known("arrival_last_ns"), default=None),
        dropped=None
        if not dropped
        else DroppedRows(dropped[-1].document, sum(d.samples for d in dropped), sum(d.bytes for d in dropped)),
        quarantined=sum(part.quarantined for part in parts),
        quarantined_samples=sum(part.quarantined_samples for part in parts),
    )


def read_manifest(store: Store) -> Manifest:
    """The manifest of a store's lake; an empty one if nothing has reached the lake yet."""
    path = store.lake / MANIFEST
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        if store.lake.is_dir() and next(store.lake.glob(f"*/{PART}"), None) is not None:
            raise LakeManifestDamaged(f"{path} is missing; {_REMEDY}") from None
        if (store.folder / NEW_LAKE / MANIFEST).exists() and not store.lake.is_dir():
            raise LakeManifestDamaged(f"{store.lake} is being rebuilt; run `gyrofleet rebuild` again") from None
        return Manifest()
    except OSError as error:
        raise LakeManifestDamaged(f"{path} cannot be read: {error}; {_REMEDY}") from error
    try:
        manifest = msgspec.json.decode(_unsealed(content), type=Manifest)
        if manifest.format > LAKE_FORMAT:
            raise StoreError(
                f"{path} has lake format {manifest.format}, this gyrofleet reads up to {LAKE_FORMAT}: upgrade gyrofleet"
            )
        for part in manifest.parts:
            check_names(part)
        for each in manifest.replaced:
            _check_within(each.path.split("/"))
        return manifest
    except (ValueError, msgspec.MsgspecError) as error:
        raise LakeManifestDamaged(f"{path} is damaged ({error}); {_REMEDY}") from error


def write_manifest(store: Store, manifest: Manifest) -> None:
    """Put a manifest in force, atomically."""
    _write(store.lake / MANIFEST, manifest)


def read_part(folder: Path) -> Part:
    """The description in a part's folder."""
    path = folder / PART
    try:
        return decoded_part(path.read_bytes())
    except (OSError, ValueError) as error:
        raise StoreError(f"{path} is damaged ({error}); {_REMEDY}") from error


def write_part(folder: Path, part: Part) -> None:
    """Write a part's description into its folder."""
    _write(folder / PART, part)


def found_parts(store: Store) -> list[Part]:
    """Parts by their own descriptions alone; of parts that share segments, the one made from the others."""
    found = []
    for path in sorted(store.lake.glob(f"*/{PART}")):
        try:
            part = read_part(path.parent)
        except StoreError:
            continue
        if part.name == path.parent.name and all((path.parent / name).is_file() for name in part.files):
            found.append(part)
    taken: set[str] = set()
    chosen = []
    for part in sorted(found, key=lambda each: (-len(each.segments), each.dropped is None, each.name)):
        if taken.isdisjoint(part.segments):
            taken.update(part.segments)
            chosen.append(part)
    return in_order(chosen)


def in_order(parts: Iterable[Part]) -> list[Part]:
    """Parts in the order of their first segments."""
    return sorted(parts, key=lambda part: (part.segments[0], part.name))


def switch(store: Store, *, keep_old: bool) -> None:
    """Replace the old lake by the new one, which is complete; the old one is quarantined or removed."""
    mark = store.folder / NEW_LAKE / _COMPLETE
    mark.write_text("keep" if keep_old else "remove")
    sync_folder(mark.parent)
    finish_switch(store)


def finish_switch(store: Store) -> None:
    """Finish an interrupted switch, if there is one."""
    fresh = store.folder / NEW_LAKE
    if (fresh / _COMPLETE).exists():
        keep_old = (fresh / _COMPLETE).read_text() != "remove"
        if store.lake.exists() and any(store.lake.iterdir()):
            if not keep_old:
                (store.lake / _REMOVABLE).touch()
            store.lake.rename(store.folder / f"lake-aside-{time.time_ns()}")
        fresh.rename(store.lake)
        sync_folder(store.folder)
    (store.lake / _COMPLETE).unlink(missing_ok=True)
    for mark in store.folder.glob(f"lake-aside-*/{_REMOVABLE}"):
        shutil.rmtree(mark.parent)


def left_aside(store: Store) -> list[Path]:
    """Quarantined lakes, which hold more than the log gives, and damaged parts."""
    return sorted(store.folder.glob("lake-aside*"))


def check_names(part: Part) -> None:
    """Refuse, by a ValueError, names that lead out of the lake."""
    for name in (part.name, *part.segments, *part.files):
        _check_within([name])


def _check_within(names: list[str]) -> None:
    """Refuse paths that lead out of the lake: folders and files are removed by these names."""
    if len(names) > 2 or any(_NAME.fullmatch(name) is None for name in names):
        raise ValueError(f"{'/'.join(names)!r} is not a path within the lake")


def sealed(value: Manifest | Part) -> bytes:
    """The content of a description's file, with its hash."""
    content = msgspec.json.encode(value)
    return _HEAD + hashlib.sha256(content).hexdigest().encode() + _MIDDLE + content + _TAIL


def decoded_part(content: bytes) -> Part:
    """The part that the content of a ``part.json`` describes; ValueError if that is damaged."""
    try:
        part = msgspec.json.decode(_unsealed(content), type=Part)
    except msgspec.MsgspecError as error:
        raise ValueError(str(error)) from error
    check_names(part)
    return part


def _write(path: Path, value: Manifest | Part) -> None:
    write_durably(path, sealed(value), fresh=path.with_name(f"{path.name}.{time.time_ns()}.new"))


def _unsealed(content: bytes) -> bytes:
    begin = len(_HEAD) + 64
    inner = content[begin + len(_MIDDLE) : -len(_TAIL)]
    digest = hashlib.sha256(inner).hexdigest().encode()
    if content != _HEAD + digest + _MIDDLE + inner + _TAIL:
        raise ValueError("its content does not match its hash")
    return inner


_REMEDY = "`gyrofleet recover` rebuilds it from the parts and the log; no sample is lost"
