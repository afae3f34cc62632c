"""What a source sends is in the log and the lake, each sample once, whatever the bus does on the way."""

import random
from collections import Counter
from dataclasses import replace
from pathlib import Path
from uuid import UUID

import numpy as np
import pytest

from storage.log.event_log import EventLog
from storage.recording.recorder import Recorder
from storage.segments.reader import SegmentScan, read_marks, read_segment
from storage.segments.records import EVENTS, PREVIEW, REJECTED, SAMPLES
from storage.sql.catalog import Catalog
from storage.store import Store, WriterLock
from stream.delivery.publisher import DurablePublisher
from stream.errors import DeliveryError, StoreError
from stream.events import NoteAdded, RunEnded, RunStarted
from stream.identity import event_key, sample_key
from stream.transport.bus import LocalBus
from stream.wire.batches import decode_batch, encode_batch
from tests.storage.recorder_samples import KEY, PLACE, batch, lake_values


class FaultyBus(LocalBus):
    """Loses, doubles and delays messages, acknowledgements among them."""

    def __init__(self, seed: int) -> None:
        super().__init__()
        self._random = random.Random(seed)
        self._delayed: list[tuple[str, bytes]] = []

    def publish(self, key: str, payload: bytes) -> None:
        with self._lock:
            draw = self._random.random()
            if draw < 0.1:
                return
            if draw < 0.2:
                self._delayed.append((key, payload))
                return
            late, self._delayed = self._delayed, []
        for each in [(key, payload), *([(key, payload)] if draw > 0.9 else []), *late]:
            super().publish(*each)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(5))
def test_each_sample_once_over_a_bus_that_loses_doubles_and_delays(tmp_path: Path, seed: int) -> None:
    store = Store.create(tmp_path)
    bus = FaultyBus(seed)
    with (
        Recorder(store, bus, EventLog(store), sync_interval_s=0.01) as recorder,
        DurablePublisher(bus, resend_after_s=0.05, timeout_s=20) as publisher,
    ):
        publisher.send_event(event_key(PLACE), RunStarted(run="r1", t_ns=0))
        for i in range(200):
            publisher.send_batch(KEY, batch(i))
        publisher.send_event(event_key(PLACE), RunEnded(run="r1", t_ns=10**9))
        publisher.drain()
        assert publisher.resent > 0
        assert publisher.outstanding == 0
    assert recorder.counts.out_of_order > 0
    assert lake_values(store) == list(range(20_000))
    with Catalog(store) as catalog:
        assert catalog.rows("select count(*) from events") == [(2,)]


def test_a_source_gives_up_with_what_is_outstanding_when_nobody_records() -> None:
    with DurablePublisher(LocalBus(), timeout_s=0.3) as publisher:
        publisher.send_batch(KEY, batch(0))
        with pytest.raises(DeliveryError, match=r"1 messages of gyrofleet/plant/bench/U1/rate are outstanding.*record"):
            publisher.drain()


def test_the_window_bounds_what_is_unacknowledged() -> None:
    size = len(encode_batch(batch(3)))
    with DurablePublisher(LocalBus(), window_bytes=3 * size + 10, timeout_s=0.3) as publisher:
        for i in range(3):
            publisher.send_batch(KEY, batch(i))
        with pytest.raises(DeliveryError, match="no recorder"):
            publisher.send_batch(KEY, batch(3))
        assert publisher.outstanding == 3


@pytest.mark.long
def test_a_recorder_with_another_store_is_found_out(tmp_path: Path) -> None:
    bus = LocalBus()
    with DurablePublisher(bus, resend_after_s=0.05, timeout_s=1.0) as publisher:
        first = Store.create(tmp_path / "a")
        with Recorder(first, bus, EventLog(first), sync_interval_s=0.01):
            publisher.send_batch(KEY, batch(0))
            publisher.drain()
        bus._handlers["gyrofleet/**"].clear()
        second = Store.create(tmp_path / "b")
        with Recorder(second, bus, EventLog(second), sync_interval_s=0.01):
            publisher.send_batch(KEY, batch(1))
            with pytest.raises(DeliveryError, match="another store"):
                publisher.drain()


def test_what_cannot_be_read_is_counted_kept_aside_and_harms_nothing(tmp_path: Path) -> None:
    store = Store.create(tmp_path)
    bus = LocalBus()
    with Recorder(store, bus, EventLog(store)) as recorder, DurablePublisher(bus) as publisher:
        publisher.send_batch(KEY, batch(0))
        bus.publish(KEY, b"\xff\xff garbage")
        bus.publish("gyrofleet/plant/bench/U2/rate", encode_batch(batch(0)))
        bus.publish("gyrofleet/elsewhere", b"")
        publisher.send_batch(KEY, batch(1))
        publisher.drain()
    assert recorder.counts.rejected == 3
    assert any("U1/rate" in reported for reported in recorder.counts.rejections)
    (segment,) = store.log.glob("*.mcap")
    rejected = [record.data for record in read_segment(segment) if record.schema == REJECTED]
    assert rejected[0] == b"\xff\xff garbage"
    assert lake_values(store) == list(range(200))


@pytest.mark.long
def test_segments_rotate_and_carry_everything_once(tmp_path: Path) -> None:
    store = Store.create(tmp_path)
    bus = LocalBus()
    log = EventLog(store, rotate_bytes=20_000)
    with Recorder(store, bus, log, sync_interval_s=0.001) as recorder, DurablePublisher(bus) as publisher:
        for i in range(300):
            publisher.send_batch(KEY, batch(i))
            publisher.drain()
    segments = sorted(store.log.glob("*.mcap"))
    assert recorder.counts.segments == len(segments) > 5
    records = [record for segment in segments for record in read_segment(segment)]
    seqs = [decode_batch(record.data).seq for record in records if record.schema == SAMPLES]
    assert seqs == list(range(0, 30_000, 100))
    assert {record.schema for record in records} == {SAMPLES, PREVIEW}
    assert max(int(read_marks(segment)[f"{KEY} {UUID(int=1).hex}"]) for segment in segments) == 30_000
    assert lake_values(store) == list(range(30_000))


def test_previews_of_signals_that_begin_together_come_in_turn(tmp_path: Path) -> None:
    store = Store.create(tmp_path)
    bus = LocalBus()
    signals = [f"s{i}" for i in range(30)]
    with Recorder(store, bus, EventLog(store)) as recorder, DurablePublisher(bus) as publisher:
        for i in range(90):  # of a second each
            for signal in signals:
                part = replace(batch(i, signal=signal), t0_ns=i * 10**9)
                publisher.send_batch(sample_key(PLACE, "U1", signal), part)
            publisher.drain()
    assert recorder.counts.rejected == 0
    seconds: dict[str, list[int]] = {}
    for segment in store.log.glob("*.mcap"):
        for record in read_segment(segment):
            if record.schema == PREVIEW:
                seconds.setdefault(record.topic, []).append(record.publish_ns // 10**9)
    assert len(seconds) == len(signals)
    for each in seconds.values():
        assert each[0] == 0  # the first at once
        assert max(np.diff([*each, 90])) <= 30
    # 30 signals in one of 30 s by chance: less than 1e-10 that more than 15 meet in one
    assert max(Counter(second for each in seconds.values() for second in each[1:]).values()) <= 15


def test_a_restarted_recorder_knows_how_far_each_stream_is(tmp_path: Path) -> None:
    store = Store.create(tmp_path)
    for _ in range(2):
        bus = LocalBus()
        with Recorder(store, bus, EventLog(store)) as recorder, DurablePublisher(bus) as publisher:
            for i in range(10):
                publisher.send_batch(KEY, batch(i))
            publisher.drain()
    assert recorder.counts.duplicates == 10
    assert recorder.counts.samples == 0
    assert lake_values(store) == list(range(1000))


def test_a_segment_left_open_is_recovered_without_its_damaged_chunk(tmp_path: Path) -> None:
    store = Store.create(tmp_path)
    bus = LocalBus()
    log = EventLog(store)
    recorder = Recorder(store, bus, log, sync_interval_s=0.001)
    with DurablePublisher(bus) as publisher:
        for i in range(30):
            publisher.send_batch(KEY, batch(i, 1000))
            publisher.drain()  # so that each batch is a chunk of its own
    (left_open,) = store.log.glob("*.mcap.open")
    content = bytearray(left_open.read_bytes())
    del recorder  # as if killed: never sealed
    scan = SegmentScan(left_open)
    list(scan)
    chunk = scan.summary.chunks[10]
    content[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 0xFF
    Store.create(tmp_path / "copy")
    for marker in ("store.json", "log/store.json"):
        (tmp_path / "copy" / marker).write_bytes((store.folder / marker).read_bytes())
    copy = Store.open(tmp_path / "copy")
    (copy.log / left_open.name).write_bytes(content[:-200])

    recovered = EventLog(copy)
    (recovery,) = recovered.recovered
    assert recovery.damaged_chunks == 1
    assert recovery.kept_aside is not None
    assert recovery.kept_aside.read_bytes() == content[:-200]
    with Recorder(copy, LocalBus(), recovered) as again:
        again.wait_for_lake()
    values = lake_values(copy)
    assert len(values) == len(set(values)) == 28_000  # one chunk damaged, one cut off
    assert EventLog(copy).recovered == []


def test_two_processes_cannot_write_one_store(tmp_path: Path) -> None:
    store = Store.create(tmp_path)
    with (
        WriterLock(store, "gyrofleet record", "tcp/127.0.0.1:7447"),
        pytest.raises(StoreError, match=r"written by gyrofleet record.*--connect tcp/127.0.0.1:7447"),
    ):
        WriterLock(store, "gyrofleet import")
    with WriterLock(store, "gyrofleet import"):
        pass


@pytest.mark.parametrize(
    ("prepare", "match"),
    [
        (lambda folder: None, "no such folder"),
        (lambda folder: folder.mkdir(), "holds no store.json"),
        (lambda folder: folder.write_text("x"), "is a file"),
        (lambda folder: (folder.mkdir(), (folder / "store.json").write_text("{}")), "cannot be read"),
        (
            lambda folder: (folder.mkdir(), (folder / "store.json").write_text('{"format": 99, "id": "x"}')),
            "upgrade gyrofleet",
        ),
    ],
)
def test_what_is_no_store_is_said_so(tmp_path: Path, prepare, match: str) -> None:  # type: ignore[no-untyped-def]
    folder = tmp_path / "store"
    prepare(folder)
    with pytest.raises(StoreError, match=match):
        Store.open(folder)


def test_a_folder_with_other_files_is_not_made_a_store(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("x")
    with pytest.raises(StoreError, match=r"holds other files.*empty or a new folder"):
        Store.create(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


def test_documents_sent_twice_are_one(tmp_path: Path) -> None:
    store = Store.create(tmp_path)
    bus = LocalBus()
    note = NoteAdded(run="r1", t_ns=5, text="door opened")
    with Recorder(store, bus, EventLog(store)), DurablePublisher(bus) as publisher:
        publisher.send_event(event_key(PLACE), note)
        publisher.send_event(event_key(PLACE), note)
        publisher.drain()
    (segment,) = store.log.glob("*.mcap")
    assert sum(record.schema == EVENTS for record in read_segment(segment)) == 2
    with Catalog(store) as catalog:
        assert catalog.rows("select kind, t_ns from events") == [("NoteAdded", 5)]
