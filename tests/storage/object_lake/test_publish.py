"""A lake published on an object store: whole, once, joined with what other builders published."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from storage.check.verify_published import damaged_parts, verify_published
from storage.lake.builder import build_missing, builder_lock
from storage.lake.compaction import compact
from storage.lake.lake import Lake
from storage.object_lake.bucket import Bucket
from storage.object_lake.published import HEAD, PARTS, read_published
from storage.store import Store
from storage.upkeep.retention import Rule, apply_rule, restore_raw
from stream.errors import BadInput, StoreError
from tests.conftest import Outcome
from tests.storage.conftest import DAY_NS, START_NS, Filler
from tests.storage.lake.exported_views import LATER_NS
from tests.storage.object_lake.publishing import keys, problems, publish, segments

NOW_NS = START_NS + 2 * DAY_NS + 10**9
ALL = [f"{i:08d}" for i in range(1, 7)]


@pytest.fixture
def built(days: Filler) -> Store:
    """Six segments of three days, each a part."""
    days.build()
    days.release()
    return days.store


def copy_of(store: Store, folder: Path) -> Store:
    """The same store on another machine."""
    shutil.copytree(store.folder, folder)
    return Store.open(folder)


def compacted(store: Store) -> None:
    with builder_lock(store):
        assert list(compact(Lake(store), now_ns=LATER_NS))


def test_a_lake_is_published_once_with_everything_in_it(built: Store, bucket: Bucket) -> None:
    lake = publish(built, bucket)
    assert segments(lake) == ALL
    assert problems(bucket, built) == []
    assert {key.partition("/")[0] for key in keys(bucket)} == {HEAD, "manifest", PARTS}
    assert publish(built, bucket).head == lake.head
    read = read_published(bucket, with_sources=True)
    assert read.parts == lake.parts
    assert read.head.store == built.identity
    assert [part.samples for part in read.parts] == [2525] * 6


@pytest.mark.long
def test_merged_parts_replace_theirs_which_stay_for_their_readers(built: Store, bucket: Bucket) -> None:
    before = publish(built, bucket)
    compacted(built)
    after = publish(built, bucket)
    assert segments(after) == ALL
    assert len(after.parts) == 3
    assert problems(bucket, built) == []
    there = keys(bucket)
    for part in before.parts:  # a reader that has the manifest of before
        assert {f"{PARTS}/{part.name}/{name}" for name in part.files} <= there
    cleaned = publish(built, bucket, grace_s=0.0)
    assert cleaned.head.replaced == ()
    assert {key.split("/")[1] for key in keys(bucket) if key.startswith(PARTS)} == {part.name for part in after.parts}
    assert problems(bucket, built) == []


@pytest.mark.long
def test_a_builder_with_a_stale_view_changes_nothing(built: Store, bucket: Bucket, tmp_path: Path) -> None:
    stale = copy_of(built, tmp_path / "stale")
    compacted(built)
    lake = publish(built, bucket)
    assert publish(stale, bucket).head == lake.head


@pytest.mark.long
def test_builders_that_have_different_segments_lose_none(days: Filler, bucket: Bucket, tmp_path: Path) -> None:
    days.build()
    one = copy_of(days.store, tmp_path / "one")
    for more in range(4):  # the other has a fourth day, merged with nothing of the first builder
        days.counts("rate", START_NS + 3 * DAY_NS + more * 10**9, 100)
        days.seal()
    days.build()
    days.release()
    compacted(one)
    publish(one, bucket)
    assert len(segments(publish(days.store, bucket))) == 10
    assert len(segments(publish(one, bucket))) == 10
    assert problems(bucket, days.store) == []


@pytest.mark.long
def test_a_merged_part_that_overlaps_another_is_published_by_segments(
    filler: Filler, bucket: Bucket, tmp_path: Path
) -> None:
    for number in range(3):
        filler.counts("rate", START_NS + number * 10**9, 100)
        filler.seal()
    filler.build()
    other = copy_of(filler.store, tmp_path / "other")
    with builder_lock(other):  # it has merged 2 and 3
        lake = Lake(other)
        from storage.lake.compaction import merge_parts

        merge_parts(lake, list(lake.manifest.parts[1:]))
    with builder_lock(filler.store):  # this one 1 and 2, and never had 3
        lake = Lake(filler.store)
        merge_parts(lake, list(lake.manifest.parts[:2]))
        lake.commit(parts=lake.manifest.parts[:1])
        shutil.rmtree(filler.store.lake / "00000003")
        (filler.store.log / "00000003.mcap").unlink()
        lake = Lake(filler.store)
    filler.release()
    publish(filler.store, bucket)
    found = publish(other, bucket)
    assert segments(found) == ["00000001", "00000002", "00000003"]
    assert sorted(len(part.segments) for part in found.parts) == [1, 2]
    assert problems(bucket, other) == []


@pytest.mark.long
def test_dropped_raw_rows_go_and_restored_ones_return(built: Store, bucket: Bucket) -> None:
    publish(built, bucket)
    with builder_lock(built):
        apply_rule(Lake(built), Rule(older_than_s=86_400.0), now_ns=NOW_NS)
        list(build_missing(built, compacts=False))  # the document of it
    dropped = publish(built, bucket, grace_s=0.0)
    assert sum(part.dropped is not None for part in dropped.parts) == 2
    assert sum(key.endswith("samples.parquet") for key in keys(bucket)) == 7 - 2
    assert set(dropped.head.drops().dropped) == set(ALL[:2])
    assert problems(bucket, built) == []
    with builder_lock(built):
        assert restore_raw(Lake(built)).samples == 2 * 2525
        list(build_missing(built, compacts=False))
    restored = publish(built, bucket, grace_s=0.0)
    assert all(part.dropped is None for part in restored.parts)
    assert restored.head.drops().dropped == {}
    assert problems(bucket, built) == []


@pytest.mark.long
def test_a_damaged_object_is_found_and_published_anew(built: Store, bucket: Bucket) -> None:
    lake = publish(built, bucket)
    names = [part.name for part in lake.parts]
    key = f"{PARTS}/{names[0]}/samples.parquet"
    found_object = bucket.get(key)
    assert found_object is not None
    content = bytearray(found_object[0])
    content[len(content) // 2] ^= 1
    bucket.put(key, bytes(content))
    bucket.delete([f"{PARTS}/{names[1]}/events.parquet", f"{PARTS}/{names[2]}/part.json"])
    found = verify_published(bucket, built)
    assert not found.is_sound
    assert sorted(finding.what for finding in found.findings) == [
        "it is missing", "it is missing", "its content does not match its hash",
    ]  # fmt: skip
    assert damaged_parts(bucket, found) == set(names[:3])
    publish(built, bucket, damaged=damaged_parts(bucket, found))
    assert problems(bucket, built) == []
    assert segments(read_published(bucket)) == ALL


@pytest.mark.long
def test_a_damaged_part_here_is_not_published_and_the_others_are(built: Store, bucket: Bucket) -> None:
    path = built.lake / "00000005" / "rollup_1s.parquet"
    content = bytearray(path.read_bytes())
    content[40] ^= 1
    path.write_bytes(content)
    with pytest.raises(StoreError, match=r"rollup_1s.parquet does not match its hash; `gyrofleet recover`"):
        publish(built, bucket)
    assert segments(read_published(bucket)) == [each for each in ALL if each != "00000005"]
    assert [each.kind for each in verify_published(bucket, built).findings if each.severity == "unfinished"] == [
        "lake_behind"
    ]


@pytest.mark.long
def test_an_address_of_another_store_and_other_files_of_a_name_are_refused(
    built: Store, bucket: Bucket, tmp_path: Path
) -> None:
    publish(built, bucket)
    other = Filler(tmp_path / "other")
    other.counts("rate", START_NS, 10)
    other.seal()
    other.build()
    other.release()
    with pytest.raises(StoreError, match=r"is the lake of another store .*give --lake another prefix"):
        publish(other.store, bucket)
    twin = Store(other.store.folder, built.identity)  # a store whose identity was copied
    with pytest.raises(StoreError, match="1 segments were published from other files"):
        publish(twin, bucket)
    assert problems(bucket, built) == []


@pytest.mark.parametrize(
    "url", ["s3:/x", "http://bucket/x", "s3://b", "s3://bucket/../x", "s3://bucket//x", "s3://Bucket/x"]
)
def test_what_is_no_address_is_refused(url: str) -> None:
    with pytest.raises(BadInput, match="give s3://BUCKET/PREFIX"):
        Bucket(url)


@pytest.mark.long
def test_the_commands_publish_and_verify(built: Store, aws: str, url: str, gyrofleet: Callable[..., Outcome]) -> None:
    where = ("--lake", url, "--endpoint-url", aws)
    first = gyrofleet("lake", "--once", "--store", built.folder, *where, "--json")
    assert first.code == 0, first.out
    again = gyrofleet("lake", "--once", "--store", built.folder, *where)
    assert "0 parts published, 0 bytes sent" in again.err
    found = gyrofleet("verify", "--store", built.folder, *where, "--json").json
    assert (found["sound"], found["segments"], found["samples"]) == (True, 6, 6 * 2525)
    assert gyrofleet("verify", *where).code == 0
    nowhere = gyrofleet("verify", "--lake", f"{url}/nothing", "--endpoint-url", aws)
    assert nowhere.code == 1
    assert "holds no lake" in nowhere.err
    gone = gyrofleet(
        "lake", "--once", "--store", built.folder, "--lake", "s3://no-such-bucket/x", "--endpoint-url", aws
    )
    assert gone.code == 1
    everything = "".join(each.out + each.err for each in (first, again, nowhere, gone))
    assert "AKIATESTKEY" not in everything
    assert "a-secret" not in everything
