"""A store of which only the published lake is at hand: read through the cache, never written."""

import hashlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Self

from storage.manifests.part import Part
from storage.object_lake.block_cache import DEFAULT_BYTES, BlockCache, cache_folder
from storage.object_lake.bucket import AT_ONCE, Bucket
from storage.object_lake.published import PARTS, Published, read_published
from storage.store import Store
from stream.errors import StoreError


class PublishedStore(Store):
    """A published lake as it is when it is opened.

    Its `folder` is in the cache and keeps what is computed from the lake, as that of another store does; it has no log.
    """

    def __init__(self, bucket: Bucket, lake: Published, cache: BlockCache, folder: Path) -> None:
        super().__init__(folder, lake.head.store)
        self.label = bucket.url
        self.is_local = False
        self.parts: tuple[Part, ...] = lake.parts
        self.cache = cache
        self._bucket = bucket
        self._files = {f"{part.name}/{name}": file for part in lake.parts for name, file in part.files.items()}

    @classmethod
    def open_url(
        cls, url: str, endpoint_url: str | None = None, *, cache_bytes: int | None = None, cache: Path | None = None
    ) -> Self:
        """Open the lake at an address; StoreError if there is none, or it cannot be read."""
        bucket = Bucket(url, endpoint_url)
        lake = read_published(bucket)
        if lake.etag is None:
            raise StoreError(f"{bucket.url} holds no lake; `gyrofleet lake --lake {bucket.url}` publishes one")
        base = cache_folder() if cache is None else cache
        mark = hashlib.sha256(f"{bucket.url} {lake.head.store}".encode()).hexdigest()[:16]
        folder = base / "lakes" / mark
        try:
            folder.mkdir(parents=True, exist_ok=True)
            blocks = BlockCache(base, DEFAULT_BYTES if cache_bytes is None else cache_bytes)
        except OSError as error:
            raise StoreError(f"the cache {base} cannot be written: {error}; set GYROFLEET_CACHE to a folder") from error
        return cls(bucket, lake, blocks, folder)

    def read(self, name: str, offset: int, length: int) -> bytes:
        """Bytes of a file ``PART/FILE`` of the lake; StoreError if it cannot be read."""
        file = self._files.get(name)
        if file is None:
            raise StoreError(f"{self.label} has no file {name}")
        key = f"{PARTS}/{name}"
        return self.cache.read(
            file.sha256, file.bytes, offset, length, lambda start, size: self._bucket.get_range(key, start, size)
        )

    def bring(self, names: list[str]) -> None:
        """Bring files to the cache, several at a time; for small ones of many parts."""

        def fetch(name: str) -> None:
            self.read(name, 0, self._files[name].bytes)

        with ThreadPoolExecutor(2 * AT_ONCE) as pool:
            list(pool.map(fetch, names))
