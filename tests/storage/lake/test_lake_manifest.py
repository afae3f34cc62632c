"""The manifest says what is in force: whole or not at all, and any damage to it is found and mended."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from storage.check.verify_lake import lake_problems, repair_lake
from storage.lake.builder import LakeBusy, build_missing, builder_lock
from storage.lake.lake import Lake
from storage.lake.part import build_part
from storage.manifests.lake import MANIFEST, LakeManifestDamaged, read_manifest, write_manifest
from storage.manifests.part import PART
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.errors import StoreError
from tests.storage.conftest import Filler

TOTAL = 12 * 2525


def total(store: Store) -> int:
    with Catalog(store) as catalog:
        ((count,),) = catalog.rows("select count(*) from samples")
    return int(count)


def test_every_segment_once_and_every_file_described(days: Filler) -> None:
    days.build()
    found = read_manifest(days.store).parts
    assert [part.segments for part in found] == [(f"{i:08d}",) for i in range(1, 13)]
    assert [part.samples for part in found] == [2525] * 12
    assert list(lake_problems(days.store)) == []
    assert total(days.store) == TOTAL


@pytest.mark.long
@pytest.mark.parametrize("seed", range(4))
def test_any_damage_to_the_manifest_is_found_and_mended(days: Filler, seed: int) -> None:
    days.build()
    store, rng = days.store, np.random.default_rng(seed)
    path = store.lake / MANIFEST
    whole = path.read_bytes()
    for _ in range(150):
        content = bytearray(whole)
        at = int(rng.integers(len(content)))
        match rng.integers(3):
            case 0:
                content[at] ^= 1 << int(rng.integers(8))
            case 1:
                del content[at:]
            case _:
                content[at : at + 512] = bytes(len(content[at : at + 512]))
        path.write_bytes(content)
        with pytest.raises(LakeManifestDamaged, match="gyrofleet recover"):
            read_manifest(store)
    with builder_lock(store):
        assert [problem.file for problem in repair_lake(store)] == [MANIFEST]
    assert total(store) == TOTAL
    assert len(list((store.folder / "lake-aside").iterdir())) == 1


def test_a_lost_manifest_is_reported_and_made_anew_from_the_parts(days: Filler) -> None:
    days.build()
    before = read_manifest(days.store).parts
    (days.store.lake / MANIFEST).unlink()
    with pytest.raises(LakeManifestDamaged, match="missing"):
        Catalog(days.store)
    with builder_lock(days.store):
        assert len(list(repair_lake(days.store))) == 1
    assert read_manifest(days.store).parts == before


def test_a_part_that_was_renamed_but_not_listed_is_taken_in(days: Filler) -> None:
    """As a kill between the rename and the manifest leaves it."""
    store = days.store
    built = build_part(store.log / "00000003.mcap", store.tmp / "lake-00000003", "00000003", store=store.identity)
    write_manifest(store, read_manifest(store))
    built.folder.rename(store.lake / "00000003")
    (store.tmp / "lake-00000009").mkdir()
    with builder_lock(store):
        lake = Lake(store)
        assert lake.manifest.segments == {"00000003"}
        assert "00000003" not in list(build_missing(store, compacts=False))
    assert not list(store.tmp.glob("lake-*"))
    assert total(store) == TOTAL


def test_a_folder_that_is_gone_or_not_whole_is_made_anew(days: Filler) -> None:
    days.build()
    store = days.store
    shutil.rmtree(store.lake / "00000002")
    (store.lake / "00000005" / PART).unlink()
    (store.lake / "notes").mkdir()
    days.build()
    assert total(store) == TOTAL
    assert list(lake_problems(store)) == []
    assert (store.lake / "notes").is_dir()


@pytest.mark.long
def test_every_damaged_file_is_found_kept_aside_and_made_anew(days: Filler) -> None:
    days.build()
    store, rng = days.store, np.random.default_rng(5)
    files = sorted(store.lake.glob("0*/*"))
    for _ in range(200):
        path = files[int(rng.integers(len(files)))]
        whole = path.read_bytes()
        content = bytearray(whole)
        at = int(rng.integers(len(content)))
        content[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(content if rng.random() < 0.7 else content[:at])
        found = list(lake_problems(store))
        assert {problem.part for problem in found} == {path.parent.name}, path
        path.write_bytes(whole)
    (store.lake / "00000004" / "samples.parquet").write_bytes(b"PAR1")
    (store.lake / "00000007" / "rollup_1s.parquet").unlink()
    with builder_lock(store):
        assert {problem.part for problem in repair_lake(store)} == {"00000004", "00000007"}
    assert list(lake_problems(store)) == []
    assert total(store) == TOTAL
    assert len(list((store.folder / "lake-aside").iterdir())) == 2


@pytest.mark.long
def test_a_part_whose_segment_is_damaged_too_stays_as_it_is(days: Filler) -> None:
    days.build()
    store = days.store
    (store.lake / "00000004" / "events.parquet").unlink()
    segment = store.log / "00000004.mcap"
    segment.write_bytes(segment.read_bytes()[:-1000])
    with builder_lock(store), pytest.raises(StoreError, match=r"segment .*00000004.mcap is damaged"):
        list(repair_lake(store))
    assert (store.lake / "00000004" / "samples.parquet").exists()
    assert total(store) == TOTAL


def test_only_one_builder_at_a_time(tmp_path: Path) -> None:
    store = Store.create(tmp_path / "store")
    with builder_lock(store), pytest.raises(LakeBusy, match="another builder of the lake"), builder_lock(store):
        pass
