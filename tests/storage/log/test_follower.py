"""Following a log: what is acknowledged is read at once, each message once, whatever happens to its segment."""

import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from storage.check.recover import recover
from storage.lake.builder import build_missing, builder_lock
from storage.log.event_log import EventLog
from storage.log.follower import LogFollower
from storage.log.recovery import abandoned_name, recover_segment
from storage.log.sequence import place_of
from storage.manifests.lake import read_manifest
from storage.segments.reader import SegmentScan
from storage.store import Store, WriterLock
from stream.wire.acknowledgement import StreamId
from tests.storage.interrupted_log import SEND, STREAMS, TORN, TURNS, UNITS, InterruptedLog
from tests.storage.log_records import append, document, samples, written

steps = st.one_of(SEND, TURNS, TORN, st.just(("poll",)), st.tuples(st.just("poll"), st.integers(0, 5)))


class Followed(InterruptedLog):
    """And what a follower has read of it."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.follower = LogFollower(self.store, unread=True)
        self.read: dict[StreamId, list[int]] = defaultdict(list)

    def poll(self, most: int | None = None) -> None:
        """Read what is new, all of it or the first messages only; all that is acknowledged is among it."""
        for message in islice(self.follower.poll(), most):
            assert message.place is not None
            self.read[message.place.stream].append(message.place.seq)
        if most is None:
            self.check(self.read)

    def check(self, read: dict[StreamId, list[int]]) -> None:
        """Each number once, in order, without a gap, and all that is acknowledged."""
        for stream in STREAMS:
            numbers = read.get(stream, [])
            assert numbers == list(range(0, len(numbers) * 10, 10)), stream
            assert len(numbers) * 10 >= self.acknowledged.get(stream, 0)


@given(st.lists(steps, max_size=40))
@settings(max_examples=60, deadline=None)
def test_whatever_happens_to_a_segment_each_message_is_read_once(schedule: list[tuple[str, int]]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        recording = Followed(Path(folder))
        for name, *given_ in schedule:
            recording.apply(name, *given_)
        recording.sync()
        recording.poll()
        recording.follower.close()
        recording.follower, recording.read = LogFollower(recording.store), defaultdict(list)  # reads each in full
        recording.poll()
        with LogFollower(recording.store, read_manifest(recording.store).segments) as beyond:
            assert all(message.segment not in read_manifest(recording.store).segments for message in beyond.poll())
        recording.follower.close()


def test_messages_are_read_as_they_were_written(tmp_path: Path) -> None:
    store, records = written(tmp_path)
    with LogFollower(store) as follower:
        found = list(follower.poll())
        assert [message.record for message in found] == records
        assert [message.place for message in found] == [place_of(record) for record in records]
        assert {message.segment for message in found} == {"00000001"}
        assert list(follower.poll()) == []


def test_only_wanted_keys_and_other_segments_are_read(tmp_path: Path) -> None:
    store, records = written(tmp_path)
    with LogFollower(store, wanted=lambda key: key.endswith("event")) as follower:
        assert len(list(follower.poll())) == sum(record.topic.endswith("event") for record in records) == 20
    with LogFollower(store, without={"00000001"}) as follower:
        assert list(follower.poll()) == []


def test_a_look_at_a_log_in_which_nothing_happens_is_cheap(tmp_path: Path) -> None:
    store, _ = written(tmp_path, seal=False)
    with LogFollower(store) as follower:
        assert len(list(follower.poll())) == 120
        time.sleep(0.15)
        assert list(follower.poll()) == []
        begin = time.process_time()
        for _ in range(1000):
            assert list(follower.poll()) == []
        assert time.process_time() - begin < 0.5


def test_a_damaged_chunk_is_left_out_and_counted(tmp_path: Path) -> None:
    store, records = written(tmp_path)
    path = store.log / "00000001.mcap"
    chunks = list(range(0, len(records), 6))
    content = bytearray(path.read_bytes())
    at = content.index(b"zstd", len(content) // 3)
    content[at + 50] ^= 0xFF
    path.write_bytes(content)
    intact = len(list(SegmentScan(path, sealed=True)))
    with LogFollower(store) as follower:
        assert len(list(follower.poll())) == intact == len(records) - len(records) // len(chunks)
        assert 0 < follower.damaged_bytes["00000001"] < len(content) // 3
        recovered = recover(store)
        assert recovered
        assert list(follower.poll()) == []


def test_damage_in_an_open_segment_waits_for_no_end(tmp_path: Path) -> None:
    store, records = written(tmp_path, seal=False)
    (path,) = store.log.glob("*.open")
    content = bytearray(path.read_bytes())
    at = content.index(b"zstd", len(content) // 3)
    content[at + 50] ^= 0xFF
    path.write_bytes(content)
    with LogFollower(store) as follower:
        assert len(list(follower.poll())) == len(records) - 6
        # a record that is not complete is no damage, until nothing more can come
        with path.open("ab") as file:
            file.write(content[100:100])
            file.write(b"\x06" + bytes(5))
        assert list(follower.poll()) == []
        damaged = follower.damaged_bytes["00000001"]
        EventLog(store)  # copies what can be read, and quarantines the original
        assert list(follower.poll()) == []
        assert follower.damaged_bytes["00000001"] >= damaged


def test_a_copy_beside_its_original_counts_once(tmp_path: Path) -> None:
    store, records = written(tmp_path)
    sealed = store.log / "00000001.mcap"
    left = abandoned_name(sealed, sealed.stat().st_size)
    left.write_bytes(sealed.read_bytes())
    for without in ((), ("00000001",)):
        with LogFollower(store, without) as follower:
            assert len(list(follower.poll())) == (0 if without else len(records))
    recover_segment(store, left, {})
    with LogFollower(store) as follower:
        assert len(list(follower.poll())) == len(records)


def test_files_that_are_not_the_stores_are_not_read(tmp_path: Path) -> None:
    store, records = written(tmp_path / "a")
    other, _ = written(tmp_path / "b", syncs=3)
    (store.log / "00000009.mcap").write_bytes((other.log / "00000001.mcap").read_bytes())
    (store.log / "notes.txt").write_text("not a segment")
    with LogFollower(store) as follower:
        assert len(list(follower.poll())) == len(records)


@pytest.fixture
def busy(tmp_path: Path) -> Iterator[tuple[Store, threading.Event]]:
    """A store whose log is written, sealed and built without a pause until the event is set."""
    store, stop = Store.create(tmp_path / "store"), threading.Event()

    def write() -> None:
        with WriterLock(store, "test"):
            log, number = EventLog(store), 0
            while not stop.is_set():
                for unit in UNITS:
                    append(log, samples(unit, number * 10, n=10))
                append(log, document(f"note {number}", number))
                number += 1
                log.sync()
                if number % 3 == 0:
                    log.seal()
                if number % 30 == 0:
                    with builder_lock(store):
                        list(build_missing(store))
            log.seal()

    thread = threading.Thread(target=write)
    thread.start()
    yield store, stop
    stop.set()
    thread.join()


def test_a_follower_beside_a_writer_misses_nothing(busy: tuple[Store, threading.Event]) -> None:
    store, _ = busy
    read: dict[StreamId, list[int]] = defaultdict(list)
    until = time.monotonic() + 60.0
    with LogFollower(store) as follower:
        while len(read[STREAMS[0]]) < 70 and time.monotonic() < until:
            for message in follower.poll():
                assert message.place is not None
                read[message.place.stream].append(message.place.seq)
    assert len(read) == 4
    for stream, numbers in read.items():
        step = 10 if stream in STREAMS else 1
        assert numbers == list(range(0, len(numbers) * step, step))
        assert len(numbers) >= 69
