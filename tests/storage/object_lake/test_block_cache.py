"""The cache of blocks: limited, least recently used go first, never a block of another version or a damaged one."""

import os
import threading
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from hypothesis import given, settings
from hypothesis import strategies as st

from storage.object_lake.block_cache import BLOCK_BYTES, BlockCache


class Remote:
    """A file of three and a half blocks, and what was fetched of it."""

    def __init__(self, seed: int) -> None:
        self.content = bytes((seed + i * i) % 251 for i in range(997)) * 3700
        self.content = self.content[: 3 * BLOCK_BYTES + BLOCK_BYTES // 2]
        self.sha256 = f"{seed:064x}"
        self.fetched: list[tuple[int, int]] = []

    def fetch(self, offset: int, length: int) -> bytes:
        self.fetched.append((offset, length))
        return self.content[offset : offset + length]

    def read(self, cache: BlockCache, offset: int, length: int) -> bytes:
        return cache.read(self.sha256, len(self.content), offset, length, self.fetch)


REMOTE = Remote(1)


@settings(max_examples=30)
@given(offset=st.integers(0, 4 * BLOCK_BYTES), length=st.integers(0, 4 * BLOCK_BYTES))
def test_any_range_is_that_of_the_file(offset: int, length: int) -> None:
    with TemporaryDirectory() as folder:
        assert REMOTE.read(BlockCache(Path(folder)), offset, length) == REMOTE.content[offset : offset + length]


def test_a_block_is_fetched_once_also_by_another_process(tmp_path: Path) -> None:
    remote = Remote(2)
    remote.read(BlockCache(tmp_path), 5, 10)
    assert remote.fetched == [(0, BLOCK_BYTES)]
    assert remote.read(BlockCache(tmp_path), 100, 10) == remote.content[100:110]
    assert len(remote.fetched) == 1


def test_a_file_that_is_read_in_order_is_fetched_in_growing_pieces(tmp_path: Path) -> None:
    remote, cache = Remote(3), BlockCache(tmp_path)
    for at in range(0, len(remote.content), BLOCK_BYTES // 2):
        remote.read(cache, at, BLOCK_BYTES // 2)
    assert remote.fetched == [(0, BLOCK_BYTES), (BLOCK_BYTES, 2 * BLOCK_BYTES), (3 * BLOCK_BYTES, BLOCK_BYTES // 2)]


def test_damaged_and_cut_blocks_are_fetched_again(tmp_path: Path) -> None:
    remote = Remote(4)
    remote.read(BlockCache(tmp_path), 0, 1)
    (block,) = tmp_path.rglob("*.block")
    whole = block.read_bytes()
    for content in (whole[:1000], b"", bytes(len(whole)), whole[:77] + bytes([whole[77] ^ 4]) + whole[78:]):
        block.write_bytes(content)
        assert remote.read(BlockCache(tmp_path), 0, 2000) == remote.content[:2000]
    assert len(remote.fetched) == 5
    assert block.read_bytes() == whole


def test_the_least_recently_used_blocks_go_beyond_the_limit(tmp_path: Path) -> None:
    cache = BlockCache(tmp_path)
    remotes = [Remote(10 + number) for number in range(6)]
    for age, remote in enumerate(remotes):
        remote.read(cache, 0, 1)
        (block,) = tmp_path.rglob(f"{remote.sha256}-0.block")
        os.utime(block, (time.time() - 1000 + age, time.time() - 1000 + age))
    remotes[0].read(BlockCache(tmp_path), 0, 1)  # used again
    BlockCache(tmp_path, limit_bytes=3 * BLOCK_BYTES + 100)
    left = {path.name.partition("-")[0] for path in tmp_path.rglob("*.block")}
    assert left == {remotes[0].sha256, remotes[5].sha256}
    small = BlockCache(tmp_path, limit_bytes=2 * BLOCK_BYTES)
    for remote in remotes:
        assert remote.read(small, 0, 3 * BLOCK_BYTES) == remote.content[: 3 * BLOCK_BYTES]
        assert sum(path.stat().st_size for path in tmp_path.rglob("*.block")) <= 3 * BLOCK_BYTES


def test_many_threads_fetch_a_block_once(tmp_path: Path) -> None:
    remote, cache = Remote(30), BlockCache(tmp_path)
    threads = [threading.Thread(target=remote.read, args=(cache, at, 10)) for at in range(20)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert remote.fetched == [(0, BLOCK_BYTES)]


def test_what_a_killed_process_left_is_removed_once_it_is_old(tmp_path: Path) -> None:
    (tmp_path / "blocks" / "ab").mkdir(parents=True)
    left = tmp_path / "blocks" / "ab" / "abc-0.block.1.2.part"
    left.write_bytes(b"x")
    BlockCache(tmp_path)
    assert left.exists()
    os.utime(left, (time.time() - 7200, time.time() - 7200))
    BlockCache(tmp_path)
    assert not left.exists()
