"""A cache of blocks of published files on the local disk, limited in size; the least recently used go first.

A block is known by the SHA-256 of its whole file, so that one of another version is never served, and carries a CRC.
It appears whole, by rename; several processes may share a cache, and a killed one leaves at most a file that the next
one removes.
"""

import os
import threading
import time
import zlib
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

BLOCK_BYTES = 1 << 20
DEFAULT_BYTES = 10 * 10**9
_IN_MEMORY = 64  # blocks
_CRC_BYTES = 4
_STALE_S = 3600.0  # of a file that a killed process left
_FILLED = 0.9  # of the limit, after the oldest are removed

Fetch = Callable[[int, int], bytes]  # offset and length to the content


def cache_folder() -> Path:
    """Folder of the cache: GYROFLEET_CACHE, else ``gyrofleet`` in the user's folder of caches."""
    own = os.environ.get("GYROFLEET_CACHE")
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(own) if own else Path(base) / "gyrofleet"


class BlockCache:
    """Blocks of files, fetched when they are first read.

    Parameters
    ----------
    folder: Of the cache.
    limit_bytes: Size that it may have on the disk.
    """

    def __init__(self, folder: Path, limit_bytes: int = DEFAULT_BYTES) -> None:
        self._folder, self._limit = folder / "blocks", limit_bytes
        self._folder.mkdir(parents=True, exist_ok=True)
        self._lock = threading.Lock()
        self._hot: OrderedDict[tuple[str, int], bytes] = OrderedDict()
        self._fetching: dict[tuple[str, int], threading.Lock] = {}
        self._ends: dict[str, tuple[int, int]] = {}  # of the last fetch of a file: the block after it, and how many
        self._added = 0
        self.fetched_bytes = 0
        self.trim()

    def read(self, sha256: str, size: int, offset: int, length: int, fetch: Fetch) -> bytes:
        """Bytes of the file with this SHA-256 and size; `fetch` gets those that the cache lacks."""
        end = min(offset + length, size)
        if end <= offset:
            return b""
        first, last = offset // BLOCK_BYTES, (end - 1) // BLOCK_BYTES
        blocks = [self._block(sha256, size, number, last, fetch) for number in range(first, last + 1)]
        start = offset - first * BLOCK_BYTES
        if len(blocks) == 1:
            return blocks[0][start : start + end - offset]
        return b"".join(blocks)[start : start + end - offset]

    def trim(self) -> None:
        """Remove the least recently used blocks beyond the limit, and what a killed process left."""
        found, stale_before = [], time.time() - _STALE_S
        for path in self._folder.rglob("*"):
            with suppress(OSError):  # another process removes it
                stat = path.stat()
                if path.suffix == ".part" and stat.st_mtime < stale_before:
                    path.unlink()
                elif path.suffix == ".block":
                    found.append((stat.st_mtime_ns, stat.st_size, path))
        total = sum(size for _, size, _ in found)
        if total > self._limit:
            for _, size, path in sorted(found):
                if total <= _FILLED * self._limit:
                    break
                with suppress(OSError):
                    path.unlink()
                total -= size
        with self._lock:
            self._added = 0

    def _block(self, sha256: str, size: int, number: int, last: int, fetch: Fetch) -> bytes:
        key = (sha256, number)
        with self._lock:
            block = self._hot.get(key)
            if block is not None:
                self._hot.move_to_end(key)
                return block
            fetching = self._fetching.setdefault(key, threading.Lock())
        with fetching:  # who asks for the same waits
            with self._lock:
                block = self._hot.get(key)
            if block is None:
                block = self._kept(sha256, number, min(BLOCK_BYTES, size - number * BLOCK_BYTES))
            if block is None:
                block = self._fetched(sha256, size, number, last, fetch)
            self._keep_hot(key, block)
        return block

    def _fetched(self, sha256: str, size: int, number: int, last: int, fetch: Fetch) -> bytes:
        """Fetch a block with those that are asked for after it; more at a time where a file is read in order."""
        with self._lock:
            after, before = self._ends.get(sha256, (-1, 1))
        ahead = min(2 * before, 8) if number == after else 1
        blocks_of_file = -(-size // BLOCK_BYTES)
        count = 1
        while count < max(ahead, last - number + 1) and number + count < blocks_of_file and count < 16:
            if self._path(sha256, number + count).exists():
                break
            count += 1
        start = number * BLOCK_BYTES
        content = fetch(start, min(count * BLOCK_BYTES, size - start))
        with self._lock:
            self._ends[sha256] = (number + count, count)
            self.fetched_bytes += len(content)
        for at in range(count):
            self._store(sha256, number + at, content[at * BLOCK_BYTES : (at + 1) * BLOCK_BYTES])
        return content[:BLOCK_BYTES]

    def _kept(self, sha256: str, number: int, length: int) -> bytes | None:
        path = self._path(sha256, number)
        try:
            content = path.read_bytes()
        except OSError:
            return None
        block, crc = content[:-_CRC_BYTES], content[-_CRC_BYTES:]
        if len(block) != length or zlib.crc32(block).to_bytes(_CRC_BYTES, "big") != crc:
            with suppress(OSError):  # damaged, as by a loss of power
                path.unlink()
            return None
        with suppress(OSError):
            os.utime(path)  # used now
        return block

    def _store(self, sha256: str, number: int, block: bytes) -> None:
        """Keep a block; without room on the disk it is only not kept."""
        path = self._path(sha256, number)
        fresh = path.with_name(f"{path.name}.{os.getpid()}.{threading.get_ident()}.part")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with fresh.open("wb") as file:
                file.write(block)
                file.write(zlib.crc32(block).to_bytes(_CRC_BYTES, "big"))
            fresh.replace(path)
        except OSError:
            with suppress(OSError):
                fresh.unlink(missing_ok=True)
            return
        with self._lock:
            self._added += len(block)
            is_due = self._added > self._limit // 20
        if is_due:
            self.trim()

    def _keep_hot(self, key: tuple[str, int], block: bytes) -> None:
        with self._lock:
            self._hot[key] = block
            self._fetching.pop(key, None)
            while len(self._hot) > _IN_MEMORY:
                self._hot.popitem(last=False)

    def _path(self, sha256: str, number: int) -> Path:
        return self._folder / sha256[:2] / f"{sha256}-{number}.block"
