"""The lake's manifest: which parts are in force, what their files hold, and what was dropped of them.

A part is a folder of Parquet files made from one or more sealed segments. It describes itself in ``part.json``, written
before the folder gets its name; ``manifest.json`` in front of all parts is the one place that says which are in
force, and is replaced as a whole. Both carry a hash of their own content.
"""

import hashlib
import re
import time
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from storage.store import Store
from stream.atomic_file import write_durably
from stream.errors import StoreError

LAKE_FORMAT = 1
MANIFEST = "manifest.json"
PART = "part.json"

_HEAD = b'{"sha256":"'
_MIDDLE = b'","content":'
_TAIL = b"}\n"
# of a folder or file within the lake, or of a segment
_NAME = re.compile(r"\w[\w.-]*")


class LakeManifestDamaged(StoreError):
    """The lake's manifest is lost or damaged."""


class PartFile(msgspec.Struct, frozen=True):
    """What a file of a part holds."""

    bytes: int
    rows: int
    sha256: str


class DroppedRows(msgspec.Struct, frozen=True):
    """Raw rows that a part no longer holds, and the document that says so."""

    document: str
    samples: int
    bytes: int


class Part(msgspec.Struct, frozen=True, kw_only=True):
    """A part of the lake.

    Parameters
    ----------
    name: Of its folder.
    segments: Sealed segments that it was made from, in order.
    files: By file name.
    samples: Samples in its segments.
    t_first_ns, t_last_ns: Source time of its samples.
    arrival_first_ns, arrival_last_ns: Arrival of everything in it.
    dropped: Set once its raw rows are dropped.
    sources: SHA-256 of the segments it was made from; an older gyrofleet did not note it.
    quarantined, quarantined_samples: Messages of its segments that cannot be built, and the samples in them; the log
        keeps them.
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
        """UTC day of its first arrival; empty for a part of nothing.

        Examples
        --------
        >>> Part(name="00000001", segments=("00000001",), files={}, samples=0, arrival_first_ns=0).day
        '1970-01-01'
        """
        if self.arrival_first_ns is None:
            return ""
        return datetime.fromtimestamp(self.arrival_first_ns // 10**9, UTC).strftime("%Y-%m-%d")


class Replaced(msgspec.Struct, frozen=True):
    """A folder or file of the lake that is no longer in force and waits for its readers to end."""

    path: str
    at_ns: int


class Manifest(msgspec.Struct, frozen=True, kw_only=True):
    """What is in force.

    Parameters
    ----------
    parts: In the order of their first segments.
    replaced: What is to be removed later.
    dropped: Segments whose raw rows are not kept, and the document that says so.
    restored: Segments whose raw rows came back, and the documents that count for them no more.
    number: Counts the changes.
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

    def least(field: str) -> int | None:
        return min((value for part in parts if (value := getattr(part, field)) is not None), default=None)

    def most(field: str) -> int | None:
        return max((value for part in parts if (value := getattr(part, field)) is not None), default=None)

    dropped = [part.dropped for part in parts if part.dropped is not None]
    return Part(
        name=name,
        segments=tuple(sorted(segment for part in parts for segment in part.segments)),
        files=files,
        samples=sum(part.samples for part in parts),
        sources={segment: sha256 for part in parts for segment, sha256 in sorted(part.sources.items())},
        t_first_ns=least("t_first_ns"),
        t_last_ns=most("t_last_ns"),
        arrival_first_ns=least("arrival_first_ns"),
        arrival_last_ns=most("arrival_last_ns"),
        dropped=None
        if not dropped
        else DroppedRows(dropped[-1].document, sum(d.samples for d in dropped), sum(d.bytes for d in dropped)),
        quarantined=sum(part.quarantined for part in parts),
        quarantined_samples=sum(part.quarantined_samples for part in parts),
    )


def read_manifest(store: Store) -> Manifest:
    """The manifest of a store's lake; one of no parts where nothing has reached the lake yet.

    Raises
    ------
    LakeManifestDamaged: If it is damaged, or lost while there are parts.
    StoreError: If a newer gyrofleet wrote it.
    """
    path = store.lake / MANIFEST
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        if store.lake.is_dir() and next(store.lake.glob(f"*/{PART}"), None) is not None:
            raise LakeManifestDamaged(f"{path} is missing; {_REMEDY}") from None
        if (store.folder / "lake-new" / MANIFEST).exists() and not store.lake.is_dir():
            raise LakeManifestDamaged(f"{store.lake} is being rebuilt; give `gyrofleet rebuild` again") from None
        return Manifest()
    except OSError as error:
        raise LakeManifestDamaged(f"{path} cannot be read: {error}; {_REMEDY}") from error
    try:
        manifest = _checked(msgspec.json.decode(_unsealed(content), type=Manifest), path)
        for part in manifest.parts:
            _check_names(part)
        for each in manifest.replaced:
            _check_within(each.path.split("/"))
        return manifest
    except (ValueError, msgspec.MsgspecError) as error:
        raise LakeManifestDamaged(f"{path} is damaged ({error}); {_REMEDY}") from error


def write_manifest(store: Store, manifest: Manifest) -> None:
    """Put a manifest in force: it is there whole, or the one before is."""
    _write(store.lake / MANIFEST, manifest)


def read_part(folder: Path) -> Part:
    """What a part says of itself.

    Raises
    ------
    StoreError: If it says nothing, or its description is damaged.
    """
    path = folder / PART
    try:
        part = msgspec.json.decode(_unsealed(path.read_bytes()), type=Part)
        _check_names(part)
        return part
    except (OSError, ValueError, msgspec.MsgspecError) as error:
        raise StoreError(f"{path} is damaged ({error}); {_REMEDY}") from error


def write_part(folder: Path, part: Part) -> None:
    """Write a part's description into its folder."""
    _write(folder / PART, part)


def found_parts(store: Store) -> list[Part]:
    """Parts that describe themselves, without regard to the manifest; no two share a segment.

    Where some do, those of more segments count: they were made from the others.
    """
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


def _check_names(part: Part) -> None:
    for name in (part.name, *part.segments, *part.files):
        _check_within([name])


def _check_within(names: list[str]) -> None:
    """Refuse what would lead out of the lake, whoever wrote it: folders and files are removed by these names."""
    if len(names) > 2 or any(_NAME.fullmatch(name) is None for name in names):
        raise ValueError(f"{'/'.join(names)!r} is not a path within the lake")


def _checked(manifest: Manifest, path: Path) -> Manifest:
    if manifest.format > LAKE_FORMAT:
        raise StoreError(
            f"{path} has lake format {manifest.format}, this gyrofleet reads up to {LAKE_FORMAT}: upgrade gyrofleet"
        )
    return manifest


def _write(path: Path, value: Manifest | Part) -> None:
    content = msgspec.json.encode(value)
    fresh = path.with_name(f"{path.name}.{time.time_ns()}.new")
    sealed = _HEAD + hashlib.sha256(content).hexdigest().encode() + _MIDDLE + content + _TAIL
    write_durably(path, sealed, fresh=fresh)


def _unsealed(content: bytes) -> bytes:
    begin = len(_HEAD) + 64
    inner = content[begin + len(_MIDDLE) : -len(_TAIL)]
    digest = hashlib.sha256(inner).hexdigest().encode()
    if content != _HEAD + digest + _MIDDLE + inner + _TAIL:
        raise ValueError("its content does not agree with its hash")
    return inner


_REMEDY = "`gyrofleet recover` makes it anew from the parts and the log; no sample is lost"
