"""Plants that replicate over a bucket: uploaded once, fetched once, whatever the line, the server and kills do."""

import random
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from storage.check.recover import recover
from storage.fleet_store import FleetStore
from storage.manifests.log import read_log_manifest, rewrite_manifest
from storage.object_lake.bucket import Bucket
from storage.replication.bucket_upload import BucketUpload, Uploaded
from storage.replication.progress import Progress
from storage.replication.recall import recall
from storage.replication.receiver import Receiver
from storage.replication.service import Replication
from storage.replication.sources.bucket_source import BucketSource
from storage.replication.sources.folder_source import FolderSource
from storage.store import Store
from stream.errors import BadInput
from tests.forked_commands import CommandServer
from tests.storage.object_lake.faulty_proxy import Fault, FaultyProxy
from tests.storage.replication.plants import plant, rechained, segments_of, verified
from tests.storage.verified_store import fill


def uploaded(store: Store, bucket: Bucket) -> Uploaded:
    return BucketUpload(FolderSource(store.folder), bucket).run()


def fetched(bucket: Bucket, fleet: FleetStore) -> Progress:
    """A pass with the lake."""
    (found,) = Replication(fleet).run([BucketSource(bucket)]).plants
    return found


def contents(bucket: Bucket) -> dict[str, str]:
    return {each.key: each.etag for each in bucket.objects()}


@pytest.fixture
def fleet(tmp_path: Path) -> FleetStore:
    return FleetStore.create(tmp_path / "fleet")


def test_each_segment_goes_up_and_arrives_once(tmp_path: Path, bucket: Bucket, fleet: FleetStore) -> None:
    store = plant(tmp_path / "a")
    model = store.folder / "models/FOG-1/0001-0123456789abcdef.json"
    model.parent.mkdir(parents=True)
    model.write_text("{}")
    (store.folder / "users.json").write_text("{}")
    first, second = uploaded(store, bucket), uploaded(store, bucket)
    assert (first.plant, first.added, first.added_files, first.segments) == ("a", 4, 1, 4)
    assert first.added_bytes == sum(map(len, segments_of(store).values()))
    assert second.is_well
    assert (second.added, second.added_files) == (0, 0)
    assert not any("users" in key or "seal" in key for key in contents(bucket))
    arrived, again = fetched(bucket, fleet), fetched(bucket, fleet)
    assert arrived.is_well
    assert (arrived.added, arrived.added_files, again.added, again.added_files) == (4, 1, 0, 0)
    copy = fleet.replica("a").store
    assert segments_of(copy) == segments_of(store)
    assert (copy.log / "manifest.jsonl").read_bytes() == (store.log / "manifest.jsonl").read_bytes()
    assert verified(fleet).is_sound


@pytest.mark.long
def test_both_sides_follow(tmp_path: Path, bucket: Bucket, fleet: FleetStore) -> None:
    store = plant(tmp_path / "a", 1)
    upload, source, replication = (
        BucketUpload(FolderSource(store.folder), bucket),
        BucketSource(bucket),
        Replication(fleet),
    )
    for number in range(1, 5):
        assert (upload.run().added, replication.run([source]).plants[0].segments) == (1, number)
        fill(store, range(2 * number, 2 * number + 2))
    assert verified(fleet).is_sound


@pytest.mark.long
def test_a_prefix_is_one_plants(tmp_path: Path, bucket: Bucket) -> None:
    assert uploaded(plant(tmp_path / "a"), bucket).is_well
    before = contents(bucket)
    other = uploaded(plant(tmp_path / "b"), bucket)
    assert other.trouble.startswith(f"{bucket.url} has the history of plant a (store ")
    assert contents(bucket) == before


def test_an_older_copy_of_a_store_changes_nothing(tmp_path: Path, bucket: Bucket) -> None:
    store = plant(tmp_path / "a", 2)
    assert uploaded(store, bucket).is_well  # the plant has its name now
    shutil.copytree(store.folder, tmp_path / "old")
    fill(store, range(4, 6))
    assert uploaded(store, bucket).added == 1
    before = contents(bucket)
    found = uploaded(Store.open(tmp_path / "old"), bucket)
    assert "ends before the one in" in found.trouble
    assert contents(bucket) == before


@pytest.mark.long
def test_a_damaged_segment_is_not_uploaded_and_comes_later(tmp_path: Path, bucket: Bucket, fleet: FleetStore) -> None:
    store = plant(tmp_path / "a")
    path = store.log / "00000002.mcap"
    whole = path.read_bytes()
    path.write_bytes(whole[:-100] + bytes(100))
    found = uploaded(store, bucket)
    assert [(each.kind, each.segment) for each in found.refused] == [("bad_hash", "00000002.mcap")]
    assert (found.added, found.segments) == (3, 4)
    assert [each.kind for each in fetched(bucket, fleet).refused] == ["segment_missing"]
    path.write_bytes(whole)
    assert uploaded(store, bucket).added == 1
    assert fetched(bucket, fleet).is_well
    assert segments_of(fleet.replica("a").store) == segments_of(store)


def test_what_the_plant_has_lost_comes_back_from_the_bucket(tmp_path: Path, bucket: Bucket) -> None:
    store = plant(tmp_path / "a")
    before = segments_of(store)
    assert uploaded(store, bucket).is_well
    path = store.log / "00000003.mcap"
    path.write_bytes(path.read_bytes()[:1000])
    assert uploaded(store, bucket).is_well  # what is listed stays
    with BucketSource(bucket) as source:
        assert recall(store.folder, source).is_well
    assert segments_of(store) == before


@pytest.mark.long
def test_a_list_that_the_plant_rewrites_is_a_new_generation(tmp_path: Path, bucket: Bucket, fleet: FleetStore) -> None:
    store = plant(tmp_path / "a")
    follower = BucketSource(bucket)
    assert uploaded(store, bucket).is_well
    assert Receiver(follower, fleet).run().is_well
    before = contents(bucket)
    entry = read_log_manifest(store).entries["00000002.mcap"]
    rechained(store, **{"00000002": msgspec.structs.replace(entry, origin="found")})  # as `gyrofleet recover` does
    found = uploaded(store, bucket)
    assert (found.is_well, found.added, found.segments) == (True, 0, 4)
    assert found.notes == ("the plant has rewritten its list",)
    assert before.items() <= contents(bucket).items()
    fill(store, range(8, 10))
    assert uploaded(store, bucket).segments == 5
    for source in (follower, BucketSource(bucket)):
        assert Receiver(source, fleet).run().is_well
    assert segments_of(fleet.replica("a").store) == segments_of(store)
    assert fetched(bucket, FleetStore.create(tmp_path / "fresh")).segments == 5


@pytest.mark.long
def test_another_history_of_a_store_is_refused_and_changes_nothing(
    tmp_path: Path, bucket: Bucket, fleet: FleetStore
) -> None:
    """Two copies of one store, both written: as after restoring a backup."""
    store = plant(tmp_path / "a", 2)
    assert uploaded(store, bucket).is_well
    shutil.copytree(store.folder, tmp_path / "restored")
    fill(store, range(4, 6))
    fill(Store.open(tmp_path / "restored"), range(4, 8))  # one segment, of more batches
    assert uploaded(store, bucket).is_well
    before = contents(bucket)
    for _ in range(2):
        found = uploaded(Store.open(tmp_path / "restored"), bucket)
        assert [(each.kind, each.segment) for each in found.refused] == [("fork", "00000003.mcap")]
    assert contents(bucket) == before
    assert fetched(bucket, fleet).is_well
    assert segments_of(fleet.replica("a").store) == segments_of(store)


@pytest.mark.long
@pytest.mark.parametrize("is_rewritten", [False, True])
def test_what_recover_has_given_up_comes_back_from_the_bucket(
    tmp_path: Path, bucket: Bucket, is_rewritten: bool
) -> None:
    store = plant(tmp_path / "a")
    before = segments_of(store)
    assert uploaded(store, bucket).is_well
    path = store.log / "00000003.mcap"
    path.write_bytes(before["00000003.mcap"][:3000] + bytes(len(before["00000003.mcap"]) - 3000))
    assert list(recover(store))
    assert uploaded(store, bucket).is_well
    if is_rewritten:
        listed = read_log_manifest(store)
        rewrite_manifest(store, [*listed.entries.values(), *listed.lost.values()])
        assert uploaded(store, bucket).notes == ("the plant has rewritten its list",)
    for folder in (store.folder, tmp_path / "new"):
        with BucketSource(bucket) as source:
            assert recall(folder, source).is_well
        assert segments_of(Store.open(folder))["00000003.mcap"] == before["00000003.mcap"]


@pytest.mark.long
def test_an_object_of_another_size_is_uploaded_again(tmp_path: Path, bucket: Bucket, fleet: FleetStore) -> None:
    store = plant(tmp_path / "a")
    assert uploaded(store, bucket).is_well
    bucket.put("log/00000003.mcap", b"cut")
    found = uploaded(store, bucket)
    assert (found.added, found.notes) == (1, (f"{bucket.url}/log/00000003.mcap has 3 bytes, it is uploaded again",))
    assert fetched(bucket, fleet).is_well


@pytest.mark.long
@pytest.mark.parametrize("nonsense", [b"[]\n{}\nnull\n", b"nonsense\n", b"", b"\xff\xfe", b"no end of line"])
@pytest.mark.parametrize("is_appended", [False, True])
def test_a_list_of_nonsense_is_named_on_both_sides(
    tmp_path: Path, bucket: Bucket, fleet: FleetStore, nonsense: bytes, is_appended: bool
) -> None:
    store, key = plant(tmp_path / "a"), "list/0001/000000000000.jsonl"
    assert uploaded(store, bucket).is_well
    whole, _ = bucket.get(key) or (b"", "")
    bucket.put(key, whole * is_appended + nonsense)
    found = uploaded(store, bucket)
    assert found.is_well == (is_appended and not nonsense)
    if not found.is_well:
        assert "list" in found.trouble
        assert "an older copy" not in found.trouble
    fetched(bucket, fleet)
    bucket.delete([key])
    assert uploaded(store, bucket).is_well
    assert fetched(bucket, fleet).is_well
    assert segments_of(fleet.replica("a").store) == segments_of(store)


def test_an_empty_prefix_and_a_missing_list_are_no_plant_that_is_well(
    tmp_path: Path, bucket: Bucket, fleet: FleetStore
) -> None:
    assert "nothing of a plant is there; is the address right?" in fetched(bucket, fleet).trouble
    store = plant(tmp_path / "a")
    assert uploaded(store, bucket).is_well
    bucket.delete(["list/0001/000000000000.jsonl"])
    assert "has no list of segments" in fetched(bucket, fleet).trouble


@pytest.mark.parametrize("endpoint", ["127.0.0.1:5555", "foo", "ftp://foo", "http://"])
def test_an_endpoint_is_an_address(endpoint: str) -> None:
    with pytest.raises(BadInput, match="begins with http:// or https://"):
        Bucket("s3://fleet/a", endpoint)


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "method", "path"),
    [
        ("refused", "PUT", "/plant.json"), ("failed", "PUT", "/plant.json"), ("lost", "PUT", "/plant.json"),
        ("refused", "PUT", "/list/"), ("failed", "PUT", "/list/"), ("lost", "PUT", "/list/"), ("late", "PUT", "/list/"),
        ("half", "PUT", "/list/"), ("failed", "PUT", "/log/"), ("lost", "PUT", "/log/"), ("half", "PUT", "/log/"),
        ("cut", "GET", "/list/"), ("cut", "GET", "/log/"), ("lost", "GET", "/log/"), ("refused", "HEAD", "/log/"),
        ("cut", "GET", "list-type=2"), ("lost", "GET", "/plant.json"),
    ],
)  # fmt: skip
def test_one_fault_costs_nothing(
    tmp_path: Path, faulty: Bucket, proxy: FaultyProxy, fleet: FleetStore, kind: str, method: str, path: str
) -> None:
    store = plant(tmp_path / "a")
    proxy.faults.append(Fault(kind, method, path))
    if kind == "late":  # it takes effect while the next pass is at work, or after it
        assert "no answer in time" in uploaded(store, faulty).trouble
    assert uploaded(store, faulty).is_well
    assert fetched(faulty, fleet).is_well
    assert proxy.faults[0].times == 0
    assert segments_of(fleet.replica("a").store) == segments_of(store)
    assert (uploaded(store, faulty).added, fetched(faulty, fleet).added) == (0, 0)


@pytest.mark.long
@pytest.mark.parametrize(
    "seed", [pytest.param(1), *(pytest.param(seed, marks=pytest.mark.long) for seed in range(2, 9))]
)
def test_random_faults_lose_nothing_and_double_nothing(
    tmp_path: Path, faulty: Bucket, proxy: FaultyProxy, fleet: FleetStore, seed: int
) -> None:
    """Segments are sealed while both sides run into faults that last longer than their patience."""
    rng = random.Random(seed)
    store = plant(tmp_path / "a", 1)
    for number in range(1, 6):
        for _ in range(rng.randint(1, 3)):
            method, kinds = rng.choice([("PUT", ["refused", "failed", "lost", "half"]), ("GET", ["cut", "lost"])])
            path, times = rng.choice(["/log/", "list", "/"]), rng.randint(1, 9)
            proxy.faults.append(Fault(rng.choice(kinds), method, path, times))
        uploaded(store, faulty)
        fetched(faulty, fleet)
        fill(store, range(2 * number, 2 * number + 2))
    for fault in proxy.faults:
        fault.times = 0
    assert uploaded(store, faulty).is_well
    assert fetched(faulty, fleet).is_well
    assert segments_of(fleet.replica("a").store) == segments_of(store)
    assert verified(fleet).is_sound
    assert (uploaded(store, faulty).added, fetched(faulty, fleet).added) == (0, 0)


@pytest.mark.long
def test_what_somebody_changes_in_the_bucket_is_refused(tmp_path: Path, bucket: Bucket, fleet: FleetStore) -> None:
    store = plant(tmp_path / "a")
    assert uploaded(store, bucket).is_well
    content, _ = bucket.get("log/00000002.mcap") or (b"", "")
    bucket.put("log/00000002.mcap", content[:500] + b"\1" + content[501:])
    found = fetched(bucket, fleet)
    assert [each.kind for each in found.refused] == ["bad_hash"]
    assert found.segments == 3
    lines, _ = bucket.get("list/0001/000000000000.jsonl") or (b"", "")
    bucket.put("list/0001/000000000000.jsonl", lines.replace(b'"segment":"00000003', b'"segment":"00000009', 1))
    assert fetched(bucket, FleetStore.create(tmp_path / "other")).refused
    assert verified(fleet).plants["a"].segments == 3


@pytest.mark.long
def test_an_upload_that_is_killed_goes_on(
    tmp_path: Path, aws: str, url: str, bucket: Bucket, fleet: FleetStore, command_server: CommandServer
) -> None:
    store = plant(tmp_path / "a")
    size = sum(map(len, segments_of(store).values()))
    words = ["replicate", "--from", str(store.folder), "--to", url, "--endpoint-url", aws]
    for _ in range(2):
        slow = ["--bandwidth", str(size / 20), "--json"]
        with command_server.start([*words, *slow], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
            before = len(bucket.objects("log"))
            while len(bucket.objects("log")) == before:
                assert process.poll() is None
            process.kill()
    assert 2 <= len(bucket.objects("log")) < 4
    assert uploaded(store, bucket).is_well
    assert fetched(bucket, fleet).is_well
    assert segments_of(fleet.replica("a").store) == segments_of(store)


@pytest.mark.long
def test_the_command_uploads_fetches_and_says_what_is_wrong(
    tmp_path: Path, aws: str, url: str, gyrofleet: Callable[..., Any]
) -> None:
    plant(tmp_path / "night", 2)
    up = ("replicate", "--from", "night", "--to", url, "--endpoint-url", aws, "--json")
    assert [gyrofleet(*up).json["added"] for _ in range(2)] == [2, 0]
    down = ("replicate", "--from", url, "--to", "fleet", "--endpoint-url", aws, "--json")
    assert [gyrofleet(*down).json["added"] for _ in range(2)] == [2, 0]
    assert gyrofleet("sql", "select count(*) as n from samples", "--store", "fleet", "--json").json[0]["n"] > 0
    twice = gyrofleet("replicate", "--from", "night", "--from", url, "--to", url, "--endpoint-url", aws)
    assert twice.code == 1
    assert "give one --from with its folder" in twice.err
    assert (
        "--endpoint-url is of an object store"
        in gyrofleet("replicate", "--from", "night", "--to", "fleet", "--endpoint-url", aws).err
    )
    nowhere = gyrofleet("replicate", "--from", "s3://no-such-bucket/a", "--to", "fleet", "--endpoint-url", aws)
    assert nowhere.code == 1
    assert "there is no such bucket" in nowhere.err
