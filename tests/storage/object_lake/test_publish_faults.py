"""Publishing through a line and a server that fail: nothing is lost, nothing half a lake, whatever was answered."""

import shutil
import threading
import time
from pathlib import Path

import pytest

from storage.object_lake.bucket import Bucket
from storage.object_lake.published import HEAD, PARTS, check_conditional_puts, read_published
from storage.store import Store
from stream.errors import StoreError
from tests.storage.conftest import DAY_NS, START_NS, Filler
from tests.storage.object_lake.faulty_proxy import Fault, FaultyProxy
from tests.storage.object_lake.publishing import keys, problems, publish, segments

ALL = ["00000001", "00000002", "00000003"]


@pytest.fixture
def small(filler: Filler) -> Store:
    """Three segments."""
    for number in range(3):
        filler.counts("rate", START_NS + number * 10**9, 100)
        filler.seal()
    filler.build()
    filler.release()
    return filler.store


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "method", "path"),
    [
        ("refused", "PUT", "manifest.json"),
        ("failed", "PUT", "manifest.json"),
        ("lost", "PUT", "manifest.json"),
        ("late", "PUT", "manifest.json"),
        ("half", "PUT", "manifest.json"),
        ("refused", "PUT", "/manifest/"),
        ("lost", "PUT", "/manifest/"),
        ("failed", "PUT", "samples.parquet"),
        ("lost", "PUT", "samples.parquet"),
        ("late", "PUT", "samples.parquet"),
        ("half", "PUT", "samples.parquet"),
        ("cut", "GET", "manifest.json"),
        ("lost", "GET", "manifest.json"),
        ("cut", "GET", "list-type=2"),
        ("lost", "PUT", "/probes/"),
    ],
)
def test_one_fault_costs_nothing(
    small: Store, faulty: Bucket, proxy: FaultyProxy, bucket: Bucket, kind: str, method: str, path: str
) -> None:
    proxy.faults.append(Fault(kind, method, path))
    publish(small, faulty)
    assert proxy.faults[0].times == 0
    assert problems(bucket, small) == []
    assert segments(read_published(bucket)) == ALL
    again = len(proxy.seen)
    publish(small, faulty)
    assert not any(method == "PUT" and "/probes/" not in path for method, path in proxy.seen[again:])


@pytest.mark.long
def test_an_upload_that_arrives_changed_is_noticed_and_sent_again(
    small: Store, faulty: Bucket, proxy: FaultyProxy, bucket: Bucket
) -> None:
    proxy.faults.append(Fault("flipped", "PUT", "00000002.*events.parquet"))
    publish(small, faulty)
    sent = [path for method, path in proxy.seen if method == "PUT" and path.endswith("/events.parquet")]
    assert sorted(path.split("/")[-2][:8] for path in sent) == ["00000001", "00000002", "00000002", "00000003"]
    assert problems(bucket, small) == []


@pytest.mark.long
def test_a_line_that_stays_down_leaves_the_old_lake_whole_and_the_rest_is_resumed(
    filler: Filler, faulty: Bucket, proxy: FaultyProxy, bucket: Bucket
) -> None:
    filler.counts("rate", START_NS, 100)
    filler.seal()
    filler.build()
    before = publish(filler.store, faulty)
    for number in range(2):
        filler.counts("rate", START_NS + DAY_NS + number * 10**9, 100)
        filler.seal()
    filler.build()
    filler.release()
    down = Fault("refused", "PUT", "manifest.json", times=10**6)
    proxy.faults.append(down)
    with pytest.raises(StoreError):
        publish(filler.store, faulty)
    assert read_published(bucket).head == before.head
    assert problems(bucket, filler.store)[0].kind == "lake_behind"
    down.times = 0
    began = len(proxy.seen)
    publish(filler.store, faulty)  # in a process of its own, or after a kill
    assert not [path for method, path in proxy.seen[began:] if method == "PUT" and path.endswith(".parquet")]
    assert problems(bucket, filler.store) == []


@pytest.mark.long
def test_half_an_upload_is_completed_under_its_name(
    small: Store, faulty: Bucket, proxy: FaultyProxy, bucket: Bucket
) -> None:
    down = Fault("half", "PUT", "00000002.*rollup_1s.parquet", times=10**6)
    proxy.faults.append(down)
    with pytest.raises(StoreError):
        publish(small, faulty)
    down.times = 0
    began = len(proxy.seen)
    publish(small, faulty)
    sent = [path for method, path in proxy.seen[began:] if method == "PUT" and path.endswith(".parquet")]
    assert [path.rpartition("/")[2] for path in sent] == ["rollup_1s.parquet"]
    assert problems(bucket, small) == []
    assert len({key.split("/")[1] for key in keys(bucket) if key.startswith(PARTS)}) == 3


@pytest.mark.long
def test_two_builders_at_once_lose_nothing(days: Filler, bucket: Bucket, aws: str, tmp_path: Path) -> None:
    days.build()
    stores = []
    for number in range(3):  # each has another third of the lake
        shutil.copytree(days.store.folder, tmp_path / str(number))
        stores.append(Store.open(tmp_path / str(number)))
        for segment in range(1, 7):
            if segment % 3 != number:
                shutil.rmtree(stores[-1].lake / f"{segment:08d}")
                (stores[-1].log / f"{segment:08d}.mcap").unlink()
    days.release()
    failures: list[StoreError] = []

    def run(store: Store) -> None:
        try:
            publish(store, Bucket(bucket.url, aws))
        except StoreError as error:
            failures.append(error)

    threads = [threading.Thread(target=run, args=(store,)) for store in stores]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []
    assert len(segments(read_published(bucket))) == 6
    assert problems(bucket, days.store) == []


@pytest.mark.long
def test_another_builder_comes_first_at_the_last_moment(
    small: Store, faulty: Bucket, proxy: FaultyProxy, bucket: Bucket, tmp_path: Path
) -> None:
    other = tmp_path / "other"
    shutil.copytree(small.folder, other)
    (other / "log" / "00000001.mcap").unlink()
    shutil.rmtree(other / "lake" / "00000001")
    proxy.faults.append(
        Fault("before", "PUT", "manifest.json", action=lambda: publish(Store.open(other), bucket) and None)
    )
    publish(small, faulty)
    assert proxy.faults[0].times == 0
    assert segments(read_published(bucket)) == ALL
    assert problems(bucket, small) == []


@pytest.mark.long
def test_a_put_that_arrives_after_the_next_one_has_no_effect(
    filler: Filler, faulty: Bucket, proxy: FaultyProxy, bucket: Bucket, aws: str
) -> None:
    filler.counts("rate", START_NS, 100)
    filler.seal()
    filler.build()
    publish(filler.store, bucket)
    filler.counts("rate", START_NS + 10**9, 100)
    filler.seal()
    filler.build()
    filler.release()
    proxy.late_s = 1.5
    proxy.faults.append(Fault("late", "PUT", f"/{HEAD}"))
    lake = publish(filler.store, Bucket(bucket.url, proxy.url, timeout_s=0.5, retries=0))
    assert proxy.faults[0].times == 0
    time.sleep(2.0)
    assert read_published(bucket).head == lake.head
    assert segments(read_published(bucket)) == ["00000001", "00000002"]
    assert problems(bucket, filler.store) == []


def test_a_server_that_ignores_conditions_is_refused(bucket: Bucket, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = Bucket.put_if
    monkeypatch.setattr(Bucket, "put_if", lambda self, key, content, etag: self.put(key, content))
    with pytest.raises(StoreError, match="ignores If-None-Match or If-Match"):
        check_conditional_puts(bucket, "probes/x")
    monkeypatch.setattr(Bucket, "put_if", plain)
    check_conditional_puts(bucket, "probes/y")
