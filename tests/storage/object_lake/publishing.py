"""Publishing in tests, and what is there afterwards."""

from typing import Any

from storage.check.verify_published import verify_published
from storage.findings import Finding
from storage.lake.builder import builder_lock
from storage.lake.lake import Lake
from storage.object_lake.bucket import Bucket
from storage.object_lake.published import Published
from storage.object_lake.publisher import Publisher
from storage.store import Store


def publish(store: Store, bucket: Bucket, **options: Any) -> Published:
    with builder_lock(store):
        Lake(store)
        return Publisher(store, bucket, **options).publish()


def segments(lake: Published) -> list[str]:
    return sorted(segment for part in lake.parts for segment in part.segments)


def keys(bucket: Bucket) -> set[str]:
    return {each.key for each in bucket.objects()}


def problems(bucket: Bucket, store: Store) -> list[Finding]:
    """What is wrong with a published lake, compared with the log of a store; objects of other uploads are not."""
    return [each for each in verify_published(bucket, store).findings if each.kind != "objects_unnamed"]
