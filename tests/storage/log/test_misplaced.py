"""Segments that somebody renamed or swapped: each sample once before and after the repair, and the store as it was."""

from collections.abc import Mapping
from pathlib import Path

import pytest

from storage.check.recover import recover
from storage.lake.builder import build_missing, builder_lock
from storage.log.misplaced import misplaced_segments
from storage.segments.disk import sha256_of
from storage.sql.catalog import Catalog
from storage.store import Store
from tests.storage.verified_store import fill, filled, kinds

RENAMED = {"3": "9"}
SWAPPED = {"2": "3", "3": "2"}
AROUND = {"1": "2", "2": "3", "3": "1"}
TWO = {"2": "7", "3": "8"}


def name(number: str) -> str:
    return f"{int(number):08}.mcap"


def of_different_sizes(folder: Path) -> Store:
    return filled(folder, range(10), range(10, 24), range(24, 43))


def move(store: Store, names: Mapping[str, str]) -> None:
    for old in names:
        (store.log / name(old)).rename(store.folder / old)
    for old, new in names.items():
        (store.folder / old).rename(store.log / name(new))


def counted(store: Store) -> tuple[int, int]:
    with Catalog(store, live=True) as catalog:
        found = catalog.user_reader("select count(*) as n, count(distinct seq) as seqs from samples").read_all()
    return found["n"][0].as_py(), found["seqs"][0].as_py()


def hashes(folder: Path) -> dict[str, str]:
    return {path.name: sha256_of(path) for path in folder.glob("*.mcap")}


@pytest.mark.parametrize("is_built_before", [True, False])
@pytest.mark.parametrize("names", [RENAMED, SWAPPED, AROUND, TWO], ids=["renamed", "swapped", "around", "two"])
@pytest.mark.in_gate("around-True")
def test_what_was_renamed_gets_its_name_back(tmp_path: Path, names: Mapping[str, str], is_built_before: bool) -> None:
    store = of_different_sizes(tmp_path / "store")
    samples = 100 * (10 + 14 + 19)
    before = hashes(store.log)
    if is_built_before:
        with builder_lock(store):
            list(build_missing(store))
    move(store, names)
    assert misplaced_segments(store) == {name(new): name(old) for old, new in names.items()}
    assert kinds(store) == ["segment_misplaced"] * len(names)
    n, seqs = counted(store)
    assert n == seqs  # none twice
    with builder_lock(store):
        list(build_missing(store))
    n, seqs = counted(store)
    assert n == seqs
    done = list(recover(store))
    assert {each.what for each in done} <= {"segment_renamed", "lake_mended", "lake_built"}
    assert hashes(store.log) == before
    assert misplaced_segments(store) == {}
    assert kinds(store) == []
    assert counted(store) == (samples, samples)
    assert list(recover(store)) == []


def test_a_copy_of_a_sound_segment_is_not_misplaced(tmp_path: Path) -> None:
    store = Store.create(tmp_path / "store")
    fill(store, range(10))
    (store.log / name("5")).write_bytes((store.log / name("1")).read_bytes())
    assert misplaced_segments(store) == {}


@pytest.mark.long
def test_segments_of_equal_size_get_their_names_back(tmp_path: Path) -> None:
    store = Store.create(tmp_path / "store")
    by_size: dict[int, str] = {}
    for number in range(80):  # the sizes are about a hundred: two are the same after some twenty
        fill(store, range(5 * number, 5 * number + 5))
        path = store.log / name(str(number + 1))
        other = by_size.setdefault(path.stat().st_size, path.stem)
        if other != path.stem:
            break
    else:
        pytest.fail("no two segments have the same size")
    with builder_lock(store):
        list(build_missing(store))
    before = hashes(store.log)
    move(store, {other: path.stem, path.stem: other})
    assert kinds(store) == ["segment_misplaced"] * 2
    assert {each.what for each in recover(store)} <= {"segment_renamed", "lake_mended", "lake_built"}
    assert hashes(store.log) == before
    assert kinds(store) == []
    assert list(recover(store)) == []


def test_another_file_under_the_name_of_a_segment_costs_nothing(tmp_path: Path) -> None:
    store = of_different_sizes(tmp_path / "store")
    before = hashes(store.log)
    move(store, {"2": "7"})
    (store.log / name("2")).write_bytes((store.log / name("3")).read_bytes()[:-100])
    assert kinds(store) == ["segment_in_the_way", "segment_misplaced"]
    list(recover(store))
    assert before.items() <= hashes(store.log).items()
    assert counted(store) == (4300, 4300)
