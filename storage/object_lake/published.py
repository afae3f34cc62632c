"""The manifest of a published lake: a small head that names immutable blocks of parts, replaced by conditional put.

The head is one object, ``manifest.json``. What it names was uploaded before it and is never written again, so that a
reader sees the lake as it was at one moment, whatever builders do meanwhile.
"""

import hashlib
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import NamedTuple
from uuid import uuid4

import msgspec

from storage.lake.drops import Drops
from storage.manifests.blocks import decode_block, encode_block, in_blocks, packed, unpacked
from storage.manifests.lake import Replaced
from storage.manifests.part import Part, in_order
from storage.object_lake.bucket import AT_ONCE, Bucket, Outdated, Unanswered
from stream.decoding import decode_json
from stream.errors import StoreError

PUBLISHED_FORMAT = 1
HEAD = "manifest.json"
BLOCKS = "manifest"
PARTS = "parts"


class BlockEntry(msgspec.Struct, frozen=True):
    """A block of the manifest: its object, and a summary of its parts."""

    number: int
    key: str
    bytes: int
    sha256: str
    parts: int
    segments: int
    samples: int
    t_first_ns: int | None = None
    t_last_ns: int | None = None


class Head(msgspec.Struct, frozen=True, kw_only=True):
    """The head: store, number of changes, unique mark of this change, blocks, and what was replaced or dropped.

    `dropped` and `restored` have ranges of segments by the document of it.
    """

    format: int = PUBLISHED_FORMAT
    store: str
    number: int = 0
    commit: str = ""
    blocks: tuple[BlockEntry, ...] = ()
    replaced: tuple[Replaced, ...] = ()
    dropped: dict[str, list[str]] = {}
    restored: dict[str, list[str]] = {}

    def drops(self) -> Drops:
        """Dropped and restored segments."""
        dropped = {segment: document for document, ranges in self.dropped.items() for segment in unpacked(ranges)}
        restored: dict[str, tuple[str, ...]] = {}
        for document, ranges in self.restored.items():
            for segment in unpacked(ranges):
                restored[segment] = (*restored.get(segment, ()), document)
        return Drops(dropped, restored)


class Published(NamedTuple):
    """A published lake as it is at one moment; `etag` is the version of its head, None if there is no lake yet."""

    head: Head
    etag: str | None
    parts: tuple[Part, ...]


def read_head(bucket: Bucket) -> tuple[Head, str] | None:
    """The head of a lake and its version; None if there is none."""
    found = bucket.get(HEAD)
    if found is None:
        return None
    content, etag = found
    try:
        head = decode_json(content, Head)
    except msgspec.MsgspecError as error:
        raise StoreError(f"{bucket.url}/{HEAD} is damaged ({error}); restore an earlier version of it") from error
    if head.format > PUBLISHED_FORMAT:
        raise StoreError(
            f"{bucket.url} has format {head.format}, this gyrofleet reads up to {PUBLISHED_FORMAT}: upgrade gyrofleet"
        )
    return head, etag


def read_published(
    bucket: Bucket, store: str = "", *, known: dict[str, list[Part]] | None = None, with_sources: bool = False
) -> Published:
    """The lake at an address; an empty one of the store of this identity if there is none.

    `known` keeps the parts of blocks by their keys, for the next time. StoreError if it is of another store.
    """
    known = {} if known is None else known
    found = read_head(bucket)
    if found is None:
        return Published(Head(store=store), None, ())
    head, etag = found
    if store and head.store != store:
        raise StoreError(
            f"{bucket.url} is the lake of another store ({head.store}, this one is {store}); give --lake another prefix"
        )

    def read(block: BlockEntry) -> None:
        known[block.key] = _read_block(bucket, block, with_sources=with_sources)

    with ThreadPoolExecutor(AT_ONCE) as pool:
        list(pool.map(read, [block for block in head.blocks if block.key not in known]))
    for key in known.keys() - {block.key for block in head.blocks}:
        del known[key]
    parts = in_order(part for block in head.blocks for part in known[block.key])
    return Published(head, etag, tuple(parts))


def commit(
    bucket: Bucket, before: Published, parts: Iterable[Part], replaced: Iterable[Replaced], drops: Drops
) -> Published:
    """Put a changed lake in force; Outdated if another builder was first, and nothing has changed then."""
    parts = in_order(parts)
    mark, number, now_ns = uuid4().hex, before.head.number + 1, time.time_ns()
    earlier = {block.number: block for block in before.head.blocks}
    was, fresh, blocks = in_blocks(before.parts), {}, []
    for at, own in sorted(in_blocks(parts).items()):
        if at in earlier and was.get(at) == own:
            blocks.append(earlier.pop(at))
            continue
        content = encode_block(own)
        sha256 = hashlib.sha256(content).hexdigest()
        key = f"{BLOCKS}/{at:06d}-{number:08d}-{mark[:8]}.json.zst"
        fresh[key] = content
        blocks.append(_entry(at, key, content, sha256, own))
    gone = [Replaced(block.key, now_ns) for block in earlier.values()]
    head = Head(
        store=before.head.store, number=number, commit=mark, blocks=tuple(blocks), replaced=(*replaced, *gone),
        dropped=_by_document(drops.dropped.items()),
        restored=_by_document((each, document) for each, documents in drops.restored.items() for document in documents),
    )  # fmt: skip
    with ThreadPoolExecutor(AT_ONCE) as pool:
        list(pool.map(bucket.put, fresh.keys(), fresh.values()))
    content = msgspec.json.encode(head)
    try:
        return Published(head, bucket.put_if(HEAD, content, before.etag), tuple(parts))
    except (Outdated, Unanswered) as error:
        # the put may have succeeded and its answer been lost; the client's next attempt then finds "another" version
        found = read_head(bucket)
        if found is not None and found[0].commit == mark:
            return Published(head, found[1], tuple(parts))
        if isinstance(error, Unanswered) and (found is None or found[1] == before.etag):
            raise  # nobody was first: the line or the server fails
        raise Outdated(HEAD) from None


def check_conditional_puts(bucket: Bucket, probe: str) -> None:
    """Write the object `probe`, and see that the server refuses a second one and a change of another version."""
    with suppress(Outdated):  # an answer was lost
        bucket.put_if(probe, b"1", None)
    for etag in (None, '"00000000000000000000000000000000"'):
        try:
            bucket.put_if(probe, b"2", etag)
        except Outdated:
            continue
        raise StoreError(
            f"{bucket.url}: this server ignores If-None-Match or If-Match, so that two builders at once would lose "
            f"each other's parts; nothing is published there"
        )


def _read_block(bucket: Bucket, block: BlockEntry, *, with_sources: bool) -> list[Part]:
    found = bucket.get(block.key)
    where = f"{bucket.url}/{block.key}"
    if found is None:
        raise StoreError(
            f"{where}, a block of the manifest, is missing; `gyrofleet lake --once --lake` publishes again"
        )
    if hashlib.sha256(found[0]).hexdigest() != block.sha256:
        raise StoreError(f"{where}, a block of the manifest, is damaged: its content does not match its hash")
    try:
        return decode_block(found[0], with_sources=with_sources)
    except ValueError as error:
        raise StoreError(f"{where}, a block of the manifest, is damaged ({error})") from error


def _entry(number: int, key: str, content: bytes, sha256: str, parts: list[Part]) -> BlockEntry:
    return BlockEntry(
        number=number, key=key, bytes=len(content), sha256=sha256, parts=len(parts),
        segments=sum(len(part.segments) for part in parts), samples=sum(part.samples for part in parts),
        t_first_ns=min((part.t_first_ns for part in parts if part.t_first_ns is not None), default=None),
        t_last_ns=max((part.t_last_ns for part in parts if part.t_last_ns is not None), default=None),
    )  # fmt: skip


def _by_document(pairs: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for segment, document in pairs:
        found.setdefault(document, []).append(segment)
    return {document: packed(segments) for document, segments in sorted(found.items())}
