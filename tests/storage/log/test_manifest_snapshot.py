"""The snapshot of a long manifest of the log: the same entries, and never those of another manifest."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from storage.manifests import entries as entries_module
from storage.manifests.entries import SegmentEntries, SegmentEntry
from storage.manifests.log import (
    LOST,
    SNAPSHOT,
    LogManifest,
    ManifestWriter,
    manifest_path,
    read_log_manifest,
    rewrite_manifest,
)
from storage.store import Store


def entry(number: int, origin: str = "recorded", size: int = 1) -> SegmentEntry:
    return SegmentEntry(
        f"{number:08d}.mcap", size, f"{number:064x}", 1, 10, number, number, ("r1",), ("chamber-1",), (), origin
    )


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks and snapshots of four entries."""
    monkeypatch.setattr("storage.manifests.entries.SPAN", 4)
    monkeypatch.setattr("storage.manifests.log.SPAN", 4)


def content(found: LogManifest) -> tuple[object, ...]:
    return list(found.entries.values()), found.lost, found.damage, found.last, found.lines, found.whole_bytes


def filled(folder: Path, count: int = 50) -> Store:
    store = Store.create(folder)
    writer = ManifestWriter(store)
    for number in range(1, count + 1):
        writer.add(entry(number))
        if number % 10 == 0:
            writer.add(entry(number - 7, LOST))
        if number % 20 == 0:
            writer.add(entry(number - 7, "found", size=2))
    return store


@pytest.mark.usefixtures("small")
def test_the_snapshot_and_the_lines_after_it_are_the_manifest(tmp_path: Path) -> None:
    store = filled(tmp_path / "store")
    assert (store.folder / SNAPSHOT).exists()
    short, whole = read_log_manifest(store), read_log_manifest(store, whole=True)
    assert sorted(short.entries) == sorted(whole.entries)
    assert dict(short.entries) == dict(whole.entries)
    assert content(short)[1:] == content(whole)[1:]
    assert sorted(whole.lost) == ["00000003.mcap", "00000023.mcap", "00000043.mcap"]
    assert whole.entries["00000013.mcap"].size == 2
    writer = ManifestWriter(store)
    writer.add(entry(51))
    assert "00000051.mcap" in read_log_manifest(store).entries


@pytest.mark.usefixtures("small")
def test_a_snapshot_that_is_damaged_or_of_another_manifest_is_not_used(tmp_path: Path) -> None:
    store = filled(tmp_path / "store")
    path = store.folder / SNAPSHOT
    good = path.read_bytes()
    expected = dict(read_log_manifest(store, whole=True).entries)
    for at in range(0, len(good), 37):
        path.write_bytes(good[:at] + bytes([good[at] ^ 1]) + good[at + 1 :])
        assert dict(read_log_manifest(store).entries) == expected
    other = filled(tmp_path / "other", 40)
    path.write_bytes((other.folder / SNAPSHOT).read_bytes())
    manifest = manifest_path(store)
    manifest.write_bytes(manifest.read_bytes())
    assert dict(read_log_manifest(store).entries) == expected  # the first 40 lines are the same: it holds for both
    path.write_bytes(good)
    rewrite_manifest(store, [entry(number, size=3) for number in range(1, 90)])
    found = read_log_manifest(store)
    assert {each.size for each in found.entries.values()} == {3}
    assert len(found.entries) == 89
    manifest.write_bytes(b"")
    assert len(read_log_manifest(store).entries) == 0
    manifest.unlink()
    assert len(read_log_manifest(store).entries) == 0


@pytest.mark.usefixtures("small")
def test_damage_before_the_snapshot_is_found_by_who_reads_the_whole(tmp_path: Path) -> None:
    store = filled(tmp_path / "store")
    path = manifest_path(store)
    lines = path.read_bytes().splitlines(keepends=True)
    lines[5] = lines[5].replace(b'"samples":10', b'"samples":11')
    path.write_bytes(b"".join(lines))
    assert [each.line for each in read_log_manifest(store, whole=True).damage] == [6]
    assert read_log_manifest(store).entries["00000006.mcap"].samples == 10


OPERATIONS = st.lists(
    st.tuples(st.sampled_from(["set", "set", "next", "next", "del"]), st.integers(0, 30)), max_size=80
)


@given(OPERATIONS)
def test_entries_are_those_of_a_dict(operations: list[tuple[str, int]]) -> None:
    packed, plain, last = SegmentEntries(), {}, 100
    before = entries_module.SPAN
    entries_module.SPAN = 3
    try:
        for size, (what, number) in enumerate(operations):
            if what == "next":
                last += 1
                packed[f"{last:08d}.mcap"] = plain[f"{last:08d}.mcap"] = entry(last, size=size)
                continue
            name = f"{number + 90:08d}.mcap"
            if what == "set":
                packed[name] = plain[name] = entry(number + 90, size=size)
            else:
                assert packed.pop(name, None) == plain.pop(name, None)
            assert len(packed) == len(plain)
        again = SegmentEntries(packed.state())
        assert dict(packed) == dict(again) == plain
        for number in range(90, 121):
            assert packed.get(f"{number:08d}.mcap") == plain.get(f"{number:08d}.mcap")
    finally:
        entries_module.SPAN = before
