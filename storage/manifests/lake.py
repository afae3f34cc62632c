"""The lake's manifest: the parts in force, and what was dropped of them.

``manifest.json`` alone says which parts are in force; it is replaced as a whole, and carries a hash of its content. In
a lake of many segments it is a head that names immutable blocks of parts (format 2), so that a change writes what is
near it and nothing else.
"""

import hashlib
import os
import shutil
import time
from contextlib import suppress
from pathlib import Path

import msgspec

from storage.manifests.blocks import decode_block, encode_block, in_blocks, packed, unpacked
from storage.manifests.part import (
    PART,
    REMEDY,
    Part,
    check_names,
    check_within,
    in_order,
    read_part,
    unsealed,
    write_sealed,
)
from storage.store import Store
from stream.decoding import decode_json
from stream.errors import StoreError
from stream.files.atomic_file import sync_folder, write_durably

LAKE_FORMAT = 2
MANIFEST = "manifest.json"
BLOCKS = "manifest"
NEW_LAKE = "lake-new"

_COMPLETE = "complete"  # mark in a new lake: it may replace the old one
_REMOVABLE = "removable"  # mark in an old lake: the new one holds everything in it

_BLOCK_GRACE_S = 30.0
_ATTEMPTS = 5  # to read blocks, while they are replaced


class LakeManifestDamaged(StoreError):
    """The lake's manifest is lost or damaged."""


class Replaced(msgspec.Struct, frozen=True):
    """A folder or file that is no longer in force and stays until its readers have ended."""

    path: str
    at_ns: int


class Block(msgspec.Struct, frozen=True):
    """A block of parts: its file below ``manifest/``, and the hash of it."""

    number: int
    file: str
    sha256: str


class _Loaded(msgspec.Struct, frozen=True):
    """A block as it was read or written."""

    block: Block
    parts: list[Part]


class Manifest(msgspec.Struct, frozen=True, kw_only=True):
    """What is in force: parts in the order of their first segments.

    `replaced` is removed later. `dropped` are segments whose raw rows are dropped, with the document of it, `restored`
    those restored, with the documents that no longer apply to them. `number` counts changes. `blocks` are those that it
    was read from.
    """

    number: int = 0
    parts: tuple[Part, ...] = ()
    replaced: tuple[Replaced, ...] = ()
    dropped: dict[str, str] = {}
    restored: dict[str, tuple[str, ...]] = {}
    blocks: tuple[_Loaded, ...] = ()

    @property
    def segments(self) -> set[str]:
        """Segments that are in the lake."""
        return {segment for part in self.parts for segment in part.segments}

    def part(self, name: str) -> Part:
        """The part of a name."""
        return next(part for part in self.parts if part.name == name)


class _Written(msgspec.Struct, frozen=True, kw_only=True):
    """The file. In format 2 parts of older segments stand in `blocks`, drops as ranges of segments by document."""

    format: int = 1
    number: int = 0
    parts: tuple[Part, ...] = ()
    replaced: tuple[Replaced, ...] = ()
    dropped: dict[str, str] = {}
    restored: dict[str, tuple[str, ...]] = {}
    blocks: tuple[Block, ...] = ()
    dropped_by: dict[str, list[str]] = {}
    restored_by: dict[str, list[str]] = {}


def read_manifest(store: Store, *, with_sources: bool = False) -> Manifest:
    """The manifest of a store's lake; an empty one if nothing has reached the lake yet.

    Parts of older segments have their `sources` only if these are asked for.
    """
    path = store.lake / MANIFEST
    for left in reversed(range(_ATTEMPTS)):
        content = _content(store, path)
        if content is None:
            return Manifest()
        try:
            return _decoded(path, content, with_sources=with_sources)
        except FileNotFoundError as error:  # a block that was replaced since
            if not left or _content(store, path) == content:
                raise LakeManifestDamaged(f"{error.filename}, a block of the manifest, is missing; {REMEDY}") from error
        except (OSError, ValueError, msgspec.MsgspecError) as error:
            raise LakeManifestDamaged(f"{path} is damaged ({error}); {REMEDY}") from error
    raise AssertionError


def _content(store: Store, path: Path) -> bytes | None:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        if store.lake.is_dir() and next(store.lake.glob(f"*/{PART}"), None) is not None:
            raise LakeManifestDamaged(f"{path} is missing; {REMEDY}") from None
        if (store.folder / NEW_LAKE / MANIFEST).exists() and not store.lake.is_dir():
            raise LakeManifestDamaged(f"{store.lake} is being rebuilt; run `gyrofleet rebuild` again") from None
        return None
    except OSError as error:
        raise LakeManifestDamaged(f"{path} cannot be read: {error}; {REMEDY}") from error


def _decoded(path: Path, content: bytes, *, with_sources: bool) -> Manifest:
    written = decode_json(unsealed(content), _Written)
    if written.format > LAKE_FORMAT:
        raise StoreError(
            f"{path} has lake format {written.format}, this gyrofleet reads up to {LAKE_FORMAT}: upgrade gyrofleet"
        )
    for part in written.parts:
        check_names(part)
    for each in written.replaced:
        check_within(each.path.split("/"))
    loaded = tuple(_loaded(path.parent, block, with_sources=with_sources) for block in written.blocks)
    parts = [*(part for each in loaded for part in each.parts), *written.parts]
    dropped, restored = dict(written.dropped), dict(written.restored)
    for document, ranges in written.dropped_by.items():
        dropped.update(dict.fromkeys(unpacked(ranges), document))
    for document, ranges in written.restored_by.items():
        for segment in unpacked(ranges):
            restored[segment] = (*restored.get(segment, ()), document)
    return Manifest(
        number=written.number, parts=tuple(in_order(parts)), replaced=written.replaced, dropped=dropped,
        restored=restored, blocks=loaded,
    )  # fmt: skip


def _loaded(lake: Path, block: Block, *, with_sources: bool) -> _Loaded:
    check_within([block.file])
    content = (lake / BLOCKS / block.file).read_bytes()
    if hashlib.sha256(content).hexdigest() != block.sha256:
        raise ValueError(f"the content of block {block.file} does not match its hash")
    return _Loaded(block, decode_block(content, with_sources=with_sources))


def write_manifest(store: Store, manifest: Manifest) -> Manifest:
    """Put a manifest in force, atomically; returns it with its blocks.

    While all segments are within one block it has none, and the format of earlier versions. Blocks that are no longer
    named are removed after 30 s, for who reads an old manifest meanwhile.
    """
    by_number = in_blocks(manifest.parts)
    newest = max(by_number, default=0)
    earlier = {each.block.number: each for each in manifest.blocks}
    loaded: list[_Loaded] = []
    for number, parts in sorted(by_number.items()):
        before = earlier.get(number)
        if number == newest:
            continue
        loaded.append(
            before if before is not None and before.parts == parts else _written(store, manifest, number, parts)
        )
    tail = tuple(_with_known_sources(store, earlier.get(newest), by_number.get(newest, [])))
    written = _Written(
        format=1, number=manifest.number, parts=tail, replaced=manifest.replaced, dropped=manifest.dropped,
        restored=manifest.restored,
    )  # fmt: skip
    if loaded:
        dropped_by, restored_by = _by_document(manifest)
        written = msgspec.structs.replace(
            written, format=LAKE_FORMAT, blocks=tuple(each.block for each in loaded), dropped={}, restored={},
            dropped_by=dropped_by, restored_by=restored_by,
        )  # fmt: skip
    write_sealed(store.lake / MANIFEST, written)
    named = {each.block.file for each in loaded}
    _remove_others(store, named, just_replaced={each.block.file for each in manifest.blocks} - named)
    return msgspec.structs.replace(manifest, blocks=tuple(loaded))


def _by_document(manifest: Manifest) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
    """Ranges of dropped and of restored segments by the document of it."""
    dropped: dict[str, list[str]] = {}
    restored: dict[str, list[str]] = {}
    for segment, document in manifest.dropped.items():
        dropped.setdefault(document, []).append(segment)
    for segment, documents in manifest.restored.items():
        for document in documents:
            restored.setdefault(document, []).append(segment)
    return (
        {document: packed(segments) for document, segments in dropped.items()},
        {document: packed(segments) for document, segments in restored.items()},
    )


def _written(store: Store, manifest: Manifest, number: int, parts: list[Part]) -> _Loaded:
    """Write a block, durably, under a name that no other has."""
    earlier = {each.block.number: each for each in manifest.blocks}
    content = encode_block(_with_known_sources(store, earlier.get(number), parts))
    file = f"{number:06d}-{manifest.number:08d}-{time.time_ns():x}.json.zst"
    folder = store.lake / BLOCKS
    if not folder.is_dir():
        folder.mkdir()
        sync_folder(store.lake)
    write_durably(folder / file, content)
    return _Loaded(Block(number, file, hashlib.sha256(content).hexdigest()), parts)


def _with_known_sources(store: Store, before: _Loaded | None, parts: list[Part]) -> list[Part]:
    """Parts with the SHA-256 of their segments; those read without them have them in their block or description."""
    if all(part.sources for part in parts):
        return parts
    earlier = [] if before is None else _loaded(store.lake, before.block, with_sources=True).parts
    known = {each.name: each.sources for each in earlier}
    found = []
    for part in parts:
        sources = part.sources or known.get(part.name)
        if not sources:
            with suppress(StoreError):  # a damaged part is rebuilt
                sources = read_part(store.lake / part.name).sources
        found.append(msgspec.structs.replace(part, sources=sources or {}))
    return found


def _remove_others(store: Store, named: set[str], just_replaced: set[str]) -> None:
    """Remove blocks that no manifest has named for a while; the time of a file is that of its replacement."""
    folder, now_s = store.lake / BLOCKS, time.time()
    if not folder.is_dir():
        return
    for path in folder.iterdir():
        if path.name in just_replaced:
            os.utime(path)
        elif path.name not in named and not now_s - _BLOCK_GRACE_S < path.stat().st_mtime <= now_s:
            path.unlink(missing_ok=True)


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
