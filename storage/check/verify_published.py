"""Verification of a published lake: every object by its manifest, and by a store's log where one is given."""

import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor

from storage.findings import Finding, Severity, Verification
from storage.lake.part import without_samples
from storage.manifests.log import read_log_manifest
from storage.manifests.part import PART, Part, decoded_part
from storage.object_lake.bucket import AT_ONCE, Bucket, StoredObject
from storage.object_lake.published import BLOCKS, HEAD, PARTS, Published, read_published
from storage.store import Store
from stream.errors import StoreError

_REMEDY = "`gyrofleet lake --once --repair --lake` of a store that has its segments publishes it again"
_DAMAGED = "lake_damaged"


def verify_published(
    bucket: Bucket, store: Store | None = None, progress: Callable[[float], None] | None = None
) -> Verification:
    """Read a published lake and report what is wrong, without changes; `progress` gets the fraction read."""
    began = time.monotonic()
    lake = read_published(bucket, "" if store is None else store.identity, with_sources=True)
    if lake.etag is None:
        raise StoreError(f"{bucket.url} holds no lake; `gyrofleet lake --once --lake {bucket.url}` publishes one")
    there = {found.key: found for found in bucket.objects()}
    findings = list(_doubled(bucket, lake.parts))
    total, done = sum(part.bytes for part in lake.parts) or 1, 0
    with ThreadPoolExecutor(AT_ONCE) as pool:
        for part, found in zip(
            lake.parts, pool.map(lambda each: list(_part_findings(bucket, each, there)), lake.parts), strict=True
        ):
            findings += found
            done += part.bytes
            if progress is not None:
                progress(done / total)
    findings += _unnamed(bucket, lake, there)
    if store is not None:
        findings += _compared_with_log(bucket, lake, store)
    return Verification(
        store=bucket.url, segments=sum(len(part.segments) for part in lake.parts), messages=0,
        samples=sum(part.samples for part in lake.parts), parts=len(lake.parts),
        lake_samples=sum(part.samples for part in lake.parts), findings=tuple(findings),
        seconds=time.monotonic() - began,
    )  # fmt: skip


def damaged_parts(bucket: Bucket, found: Verification) -> set[str]:
    """Names of the parts that a verification found damaged."""
    place = f"{bucket.url}/{PARTS}/"
    return {
        each.where.removeprefix(place).partition("/")[0]
        for each in found.findings
        if each.severity is Severity.DAMAGE and each.where.startswith(place)
    }


def _part_findings(bucket: Bucket, part: Part, there: dict[str, StoredObject]) -> Iterator[Finding]:
    for name, file in part.files.items():
        key = f"{PARTS}/{part.name}/{name}"
        found = there.get(key)
        if found is None:
            yield _damage(bucket, key, "it is missing")
        elif found.bytes != file.bytes:
            yield _damage(bucket, key, f"{found.bytes} bytes, {file.bytes} are expected")
        elif bucket.sha256(key) != (file.bytes, file.sha256):
            yield _damage(bucket, key, "its content does not match its hash")
    key = f"{PARTS}/{part.name}/{PART}"
    description = bucket.get(key)
    try:
        described = None if description is None else decoded_part(description[0])
    except ValueError as error:
        yield _damage(bucket, key, str(error))
        return
    if described is None:
        yield _damage(bucket, key, "it is missing")
    elif described != part and (part.dropped is None or without_samples(described, part.dropped.document) != part):
        yield _damage(bucket, key, "it does not match the manifest")


def _doubled(bucket: Bucket, parts: Iterable[Part]) -> Iterator[Finding]:
    seen: set[str] = set()
    for part in parts:
        again = seen.intersection(part.segments)
        if again:
            yield _damage(bucket, HEAD, f"segments {', '.join(sorted(again)[:5])} are in more than one part")
        seen.update(part.segments)


def _unnamed(bucket: Bucket, lake: Published, there: dict[str, StoredObject]) -> Iterator[Finding]:
    """Objects of uploads at work or abandoned; a builder removes the latter after a day."""
    named = {f"{PARTS}/{part.name}" for part in lake.parts} | {each.path for each in lake.head.replaced}
    blocks = {block.key for block in lake.head.blocks}
    loose = [
        key
        for key in there
        if key.split("/")[0] in {PARTS, BLOCKS}
        and "/".join(key.split("/")[:2]) not in named
        and key not in blocks | named
    ]
    if loose:
        what = f"{len(loose)} objects, of uploads at work or abandoned; a builder removes what is older than a day"
        yield Finding("objects_unnamed", Severity.NOTE, bucket.url, what)


def _compared_with_log(bucket: Bucket, lake: Published, store: Store) -> Iterator[Finding]:
    entries = {name.removesuffix(".mcap"): entry for name, entry in read_log_manifest(store).entries.items()}
    held = {segment for part in lake.parts for segment in part.segments}
    missing = sorted(entries.keys() - held)
    if missing:
        what = f"{len(missing)} sealed segments of {store.folder} are not in it: {', '.join(missing[:5])}"
        remedy = f"`gyrofleet lake --once --store {store.folder} --lake {bucket.url}` publishes them"
        yield Finding("lake_behind", Severity.UNFINISHED, bucket.url, what, remedy)
    for part in lake.parts:
        others = [
            segment
            for segment, sha256 in part.sources.items()
            if (entry := entries.get(segment)) is not None and entry.sha256 != sha256
        ]
        where = f"{bucket.url}/{PARTS}/{part.name}"
        if others:
            what = f"it was made from other files of these names: {', '.join(others[:5])}"
            yield Finding("lake_disagrees", Severity.DAMAGE, where, what, "compare the logs of both builders")
            continue
        own = [entries[segment] for segment in part.segments if segment in entries]
        expected = sum(entry.samples for entry in own)
        if len(own) == len(part.segments) and part.samples + part.quarantined_samples != expected:
            what = f"{part.samples + part.quarantined_samples:,} samples, its segments have {expected:,}"
            yield Finding("lake_disagrees", Severity.DAMAGE, where, what, _REMEDY)


def _damage(bucket: Bucket, key: str, what: str) -> Finding:
    return Finding(_DAMAGED, Severity.DAMAGE, f"{bucket.url}/{key}", what, _REMEDY)
