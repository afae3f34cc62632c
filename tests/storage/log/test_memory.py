"""What is held in memory is bounded, whatever is sent; and where memory runs out nothing is called damaged."""

import time
from pathlib import Path
from uuid import UUID

import numpy as np
import pytest
import zstandard

from storage.check.recover import recover
from storage.check.verify import verify
from storage.lake.builder import build_missing, builder_lock
from storage.log.event_log import EventLog
from storage.recording.intake import MAX_REJECT_BYTES
from storage.recording.recorder import Recorder
from storage.segments.reader import read_segment
from storage.segments.records import REJECTED
from storage.store import Store
from stream.batch import SampleBatch
from stream.bounds import MAX_MESSAGE_BYTES
from stream.delivery.publisher import DurablePublisher
from stream.errors import OutOfMemory, StoreError
from stream.identity import Place, sample_key
from stream.transport.bus import LocalBus
from stream.transport.zenoh_bus import ZenohBus
from stream.worker.worker import EstimationWorker

PLACE = Place("plant", "bench")
KEY = sample_key(PLACE, "U1", "rate")


def filled(folder: Path) -> Store:
    """A store with one segment, which is in no lake yet."""
    store, bus = Store.create(folder), LocalBus()
    with Recorder(store, bus, EventLog(store), builds_lake=False), DurablePublisher(bus) as publisher:
        values = np.arange(1000.0)
        publisher.send_batch(KEY, SampleBatch("U1", "rate", "r1", UUID(int=1), 0, 0, 10**6, "deg/s", values=values))
        publisher.drain()
    return store


@pytest.mark.long
@pytest.mark.parametrize("size", [0, 48_000])
def test_a_flood_of_long_keys_fills_no_queue(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, size: int) -> None:
    monkeypatch.setattr("storage.recording.recorder._ROOM_PATIENCE_S", 0.0)
    monkeypatch.setattr("storage.recording.recorder._QUEUE_BYTES", 1 << 20)
    bus = LocalBus()
    store = Store.create(tmp_path)
    # as one that is far behind
    monkeypatch.setattr(Recorder, "_next_messages", lambda recorder: ([], recorder._closing))
    recorder = Recorder(store, bus, EventLog(store))
    for number in range(5000):
        bus.publish(f"gyrofleet/{number}/{'x' * size}/U1/rate", b"")
    held = sum(len(key) + len(payload) for key, payload, _ in recorder._incoming)
    assert held < (1 << 20) + size + 100
    assert len(recorder._incoming) < 5000
    assert recorder.counts.left_to_sources == 5000 - len(recorder._incoming)
    with recorder._state:
        recorder._incoming.clear()
    recorder.close()


def test_the_estimators_queue_counts_keys_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stream.worker.worker._MOST_BYTES", 1 << 20)
    monkeypatch.setattr(EstimationWorker, "_work", lambda worker: not worker._closing)
    bus = LocalBus()
    with DurablePublisher(bus) as publisher:
        worker = EstimationWorker(bus, publisher)
        for number in range(1000):
            bus.publish(f"gyrofleet/{number}/{'x' * 48_000}/U1/rate", b"")
        assert len(worker._incoming) < 30
        worker.kill()


def test_rejected_messages_take_bounded_room_on_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("storage.recording.intake._REJECTS_BYTES", 10 * MAX_REJECT_BYTES)
    monkeypatch.setattr("storage.recording.intake._REJECTS_BYTES_PER_S", 1)
    store, bus = Store.create(tmp_path), LocalBus()
    rng = np.random.default_rng(1)
    with Recorder(store, bus, EventLog(store)) as recorder:
        recorder._intake._rejects_room = 10 * MAX_REJECT_BYTES
        for _ in range(50):
            bus.publish(KEY, rng.bytes(1 << 20))
        bus.publish(KEY, bytes(MAX_MESSAGE_BYTES + 1))
    assert (recorder.counts.rejected, recorder.counts.rejected_not_kept) == (51, 41)
    (segment,) = store.log.glob("*.mcap")
    kept = [record.data for record in read_segment(segment) if record.schema == REJECTED]
    assert [len(data) for data in kept] == [MAX_REJECT_BYTES] * 10
    # the rest is the schemas, of samples and of all kinds of documents, and the index
    assert segment.stat().st_size < 12 * MAX_REJECT_BYTES


def test_no_memory_is_not_damage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = filled(tmp_path)
    before = {path.name: path.read_bytes() for path in store.log.iterdir()}

    def none_left(*_: object) -> bytes:
        raise MemoryError

    with monkeypatch.context() as patch:
        patch.setattr(zstandard, "decompress", none_left)
        with pytest.raises(OutOfMemory, match="may be intact"):
            verify(store)
        with pytest.raises(OutOfMemory, match="free some"):
            list(recover(store))
        with builder_lock(store), pytest.raises(StoreError, match="not enough memory"):
            list(build_missing(store))
    assert {path.name: path.read_bytes() for path in store.log.iterdir()} == before
    with builder_lock(store):
        assert list(build_missing(store)) == ["00000001"]
    assert verify(store)[0].is_sound


def test_a_message_too_large_for_the_bus_goes_and_the_rest_comes(endpoint: str) -> None:
    sizes: list[int] = []
    with ZenohBus(listen=[endpoint]) as far, ZenohBus(connect=[endpoint]) as near:
        far.subscribe("gyrofleet/**", lambda _key, payload: sizes.append(len(payload)))
        until = time.monotonic() + 20.0
        while not sizes and time.monotonic() < until:
            near.publish(KEY, b"1")
            time.sleep(0.05)
        sizes.clear()
        near.publish(KEY, bytes(MAX_MESSAGE_BYTES + 1))
        near.publish(KEY, bytes(2 * MAX_MESSAGE_BYTES))
        near.publish(KEY, b"22")
        while 2 not in sizes and time.monotonic() < until:
            time.sleep(0.05)
    assert [size for size in sizes if size != 1] == [MAX_MESSAGE_BYTES + 1, 2]
