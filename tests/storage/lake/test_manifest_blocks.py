"""The manifest of a lake of many segments: a head with blocks, of which a change writes what is near it."""

import json
import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from storage.check.verify import verify
from storage.check.verify_lake import lake_problems, repair_lake
from storage.lake.builder import builder_lock
from storage.lake.compaction import compact
from storage.lake.lake import Lake
from storage.lake.rebuild import rebuild
from storage.manifests.lake import BLOCKS, MANIFEST, LakeManifestDamaged, read_manifest
from storage.manifests.part import Part
from storage.sql.catalog import Catalog
from storage.store import Store
from storage.upkeep.retention import Rule, apply_rule
from tests.storage.conftest import DAY_NS, START_NS, Filler
from tests.storage.lake.exported_views import LATER_NS

TOTAL = 12 * 2525


@pytest.fixture
def in_blocks(days: Filler, monkeypatch: pytest.MonkeyPatch) -> Filler:
    """Twelve segments, of which four make a block."""
    monkeypatch.setattr("storage.manifests.blocks.SPAN", 4)
    days.build()
    return days


def head(store: Store) -> dict[str, object]:
    content: dict[str, object] = json.loads((store.lake / MANIFEST).read_bytes())["content"]
    return content


def files(store: Store) -> set[str]:
    return {path.name for path in (store.lake / BLOCKS).iterdir()}


def parts(store: Store) -> tuple[Part, ...]:
    return read_manifest(store, with_sources=True).parts


def test_a_store_of_the_earlier_format_opens_and_goes_on_in_blocks(
    days: Filler, monkeypatch: pytest.MonkeyPatch
) -> None:
    days.build()
    assert head(days.store)["format"] == 1
    before = parts(days.store)
    assert all(part.sources for part in before)
    monkeypatch.setattr("storage.manifests.blocks.SPAN", 4)
    assert parts(days.store) == before
    days.counts("rate", START_NS + 3 * DAY_NS, 100)
    days.seal()
    days.build()
    assert head(days.store)["format"] == 2
    assert parts(days.store)[:12] == before
    assert len(files(days.store)) == 3
    with Catalog(days.store) as catalog:
        assert catalog.rows("select count(*) from samples") == [(TOTAL + 100,)]
    days.release()
    assert verify(days.store)[0].is_sound


def test_a_change_writes_what_is_near_it(in_blocks: Filler) -> None:
    store = in_blocks.store
    before = files(store)
    assert sorted(name[:6] for name in before) == ["000000", "000001", "000002"]
    in_blocks.counts("rate", START_NS + 3 * DAY_NS, 100)
    in_blocks.seal()
    in_blocks.build()
    assert files(store) == before
    with builder_lock(store):
        lake = Lake(store)
        lake.rebuild_part("00000005")
        assert {name[:6] for name in files(store) - before} == {"000001"}
        assert files(store) >= before  # the block that was replaced stays for its readers
        for path in (store.lake / BLOCKS).iterdir():
            os.utime(path, (START_NS / 1e9, START_NS / 1e9))
        lake.commit()
    assert len(files(store)) == 3


@pytest.mark.long
def test_merging_retention_and_a_rebuild_keep_every_source(in_blocks: Filler) -> None:
    store = in_blocks.store
    expected = {segment: sha256 for part in parts(store) for segment, sha256 in part.sources.items()}
    in_blocks.release()
    with builder_lock(store):
        assert list(compact(Lake(store), now_ns=LATER_NS))
        assert apply_rule(Lake(store), Rule(older_than_s=86_400.0), now_ns=START_NS + 2 * DAY_NS + 10**9).samples
    assert {s: h for part in parts(store) for s, h in part.sources.items() if s in expected} == expected
    manifest = read_manifest(store)
    assert set(manifest.dropped) == {f"{i:08d}" for i in range(1, 5)}
    assert verify(store)[0].findings == () or all(each.kind == "lake_behind" for each in verify(store)[0].findings)
    with builder_lock(store):
        list(rebuild(store))
    assert {s: h for part in parts(store) for s, h in part.sources.items() if s in expected} == expected
    assert verify(store)[0].is_sound
    assert set(read_manifest(store).dropped) == set(manifest.dropped)


@pytest.mark.long
@pytest.mark.parametrize("damage", [lambda path: path.unlink(), lambda path: path.write_bytes(b"x"), None])
def test_a_damaged_block_is_found_and_made_anew(in_blocks: Filler, damage: Callable[[Path], None] | None) -> None:
    store = in_blocks.store
    before = parts(store)
    path = sorted((store.lake / BLOCKS).iterdir())[1]
    if damage is None:
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        path.write_bytes(content)
    else:
        damage(path)
    with pytest.raises(LakeManifestDamaged, match="gyrofleet recover"):
        read_manifest(store)
    with builder_lock(store):
        assert [problem.file for problem in repair_lake(store)] == [MANIFEST]
    assert parts(store) == before
    assert list(lake_problems(store)) == []


def test_a_reader_beside_a_builder_sees_one_manifest_or_the_next(in_blocks: Filler) -> None:
    store = in_blocks.store
    expected = {part.name for part in parts(store)}
    seen: list[set[str]] = []
    ended = threading.Event()

    def read() -> None:
        while not ended.is_set():
            seen.append({part.name for part in read_manifest(store).parts})

    reader = threading.Thread(target=read)
    reader.start()
    with builder_lock(store):
        lake = Lake(store)
        for number in range(30):
            manifest = lake.manifest
            whole = manifest.parts
            lake.commit(parts=tuple(part for at, part in enumerate(whole) if at != number % 12))
            lake.commit(parts=whole)
    ended.set()
    reader.join()
    assert len(seen) > 10
    assert all(len(expected - names) <= 1 for names in seen)
    assert {part.name for part in read_manifest(store).parts} == expected
    assert parts(store) == read_manifest(store, with_sources=True).parts
    assert all(part.sources for part in parts(store))
