"""The publisher: what it keeps, in which order it sends, how it goes back, and that it never ends quietly."""

import errno
import os
import random
import threading
import time
from collections.abc import Callable
from pathlib import Path
from uuid import UUID

import numpy as np
import pytest

from stream.batch import SampleBatch
from stream.delivery import spool as spool_module
from stream.delivery.outbox import Outbox
from stream.delivery.outgoing import Held
from stream.delivery.publisher import DurablePublisher
from stream.delivery.spool import Spool
from stream.errors import DeliveryError, WireError
from stream.events import NoteAdded, RunEnded, StreamTotal, decode_event
from stream.identity import ACKNOWLEDGEMENT_KEY, EVERYTHING, Place, event_key, sample_key
from stream.transport.bus import LocalBus
from stream.wire.acknowledgement import StreamId, StreamPosition, encode_acknowledgement
from stream.wire.batches import decode_batch, encode_batch

PLACE = Place("plant", "bench")
KEY = sample_key(PLACE, "U1", "rate")
N = 100


def batch(i: int, epoch: int = 1, unit: str = "U1") -> SampleBatch:
    values = np.arange(i * N, (i + 1) * N, dtype=np.float64)
    return SampleBatch(unit, "rate", "r1", UUID(int=epoch), i * N, i * N * 10**6, 10**6, "deg/s", values=values)


class StandIn:
    """Takes what a recorder takes, in memory; it can be stopped, paused, and made to forget what is not durable."""

    def __init__(self, bus: LocalBus, *, acknowledges: bool = True) -> None:
        self._bus = bus
        self._lock = threading.Lock()
        self.acknowledges = acknowledges
        self.is_stopped = False
        self.paused = ""
        self.marks: dict[StreamId, int] = {}
        self.values: dict[StreamId, list[float]] = {}
        self.arrived: list[tuple[StreamId, int]] = []
        self.duplicates = 0
        bus.subscribe(EVERYTHING, self._take)

    def _take(self, key: str, payload: bytes) -> None:
        if self.is_stopped:
            return
        with self._lock:
            answer = self._answer(key, payload)
        if answer is not None and (self.acknowledges or answer.rewind):
            self._bus.publish(ACKNOWLEDGEMENT_KEY, encode_acknowledgement("store", (answer,)))

    def _answer(self, key: str, payload: bytes) -> StreamPosition | None:
        if self.paused:
            return None
        try:
            sent = decode_batch(payload)
            stream, seq, after, values = StreamId(key, sent.epoch.hex), sent.seq, sent.next_seq, sent.value_array
        except WireError:
            event = decode_event(payload)
            stream, seq, after, values = StreamId(key, event.epoch), event.seq, event.seq + 1, np.zeros(1)
        self.arrived.append((stream, seq))
        expected = self.marks.get(stream, 0)
        if seq > expected:
            return StreamPosition(key, stream.epoch, expected, rewind=True)
        if seq == expected:
            self.marks[stream] = after
            self.values.setdefault(stream, []).extend(values.tolist())
        else:
            self.duplicates += 1
        return StreamPosition(key, stream.epoch, self.marks[stream])

    def say(self, *positions: StreamPosition, store: str = "store") -> None:
        self._bus.publish(ACKNOWLEDGEMENT_KEY, encode_acknowledgement(store, positions, self.paused))

    def samples(self, epoch: int = 1) -> list[float]:
        return self.values.get(StreamId(KEY, UUID(int=epoch).hex), [])


class LossyBus(LocalBus):
    """Loses, doubles and delays."""

    def __init__(self, seed: int) -> None:
        super().__init__()
        self._random = random.Random(seed)
        self._late: list[tuple[str, bytes]] = []

    def publish(self, key: str, payload: bytes) -> None:
        with self._lock:
            draw = self._random.random()
            if draw < 0.1:
                return
            if draw < 0.15:
                self._late.append((key, payload))
                return
            late, self._late = self._late, []
        for each in [(key, payload), *([(key, payload)] if draw > 0.9 else []), *late]:
            super().publish(*each)


def until(condition: Callable[[], object], patience_s: float = 20.0) -> None:
    deadline = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < deadline, "it did not come to it"
        time.sleep(0.005)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("is_spooled", [False, True])
def test_everything_arrives_once_and_in_order_over_a_bus_that_loses(
    tmp_path: Path, seed: int, *, is_spooled: bool
) -> None:
    bus = LossyBus(seed)
    recorder = StandIn(bus)
    spool = Spool(tmp_path) if is_spooled else None
    with DurablePublisher(bus, window_bytes=20_000, resend_after_s=0.05, timeout_s=20, spool=spool) as publisher:
        for i in range(200):
            publisher.send_batch(KEY, batch(i))
    assert recorder.samples() == list(range(200 * N))
    assert publisher.resent > 0
    if spool is not None:
        spool.close()
        assert not spool.unacknowledged


def test_what_a_request_begins_after_is_kept_until_it_is_acknowledged() -> None:
    bus = LocalBus()
    recorder = StandIn(bus, acknowledges=False)
    with DurablePublisher(bus, resend_after_s=60.0) as publisher:
        for i in range(10):
            publisher.send_batch(KEY, batch(i))
        stream = StreamId(KEY, UUID(int=1).hex)
        recorder.say(StreamPosition(*stream, 500, rewind=True))  # it has 0 to 499, but not on its disk
        assert publisher.outstanding == 10
        until(lambda: publisher.resent == 5)
        recorder.marks[stream] = 0  # power loss: what was not on the disk is gone
        recorder.values.clear()
        recorder.acknowledges = True
        recorder.say(StreamPosition(*stream, 0, rewind=True))
        publisher.drain()
    assert recorder.samples() == list(range(10 * N))


def test_one_request_is_answered_once_however_often_it_comes() -> None:
    bus = LocalBus()
    recorder = StandIn(bus, acknowledges=False)
    with DurablePublisher(bus, resend_after_s=60.0, window_bytes=32 << 20) as publisher:
        for i in range(3000):
            publisher.send_batch(KEY, batch(i))
        for _ in range(20):
            recorder.say(StreamPosition(KEY, UUID(int=1).hex, 100_000, rewind=True))
        until(lambda: publisher.resent == 2000)
        time.sleep(0.2)
        assert publisher.resent == 2000
        # 2000 messages of 0.9 kB are asked for; a megabyte goes at once, the rest little by little
        assert len(recorder.arrived) - 3000 < 1700
        recorder.say(StreamPosition(KEY, UUID(int=1).hex, 300_000))
        publisher.drain()


def test_a_silent_recorder_is_asked_and_not_flooded() -> None:
    bus = LocalBus()
    recorder = StandIn(bus)
    recorder.is_stopped = True
    sent = []
    bus.subscribe(EVERYTHING, lambda key, payload: sent.append(key))
    with DurablePublisher(bus, resend_after_s=0.1) as publisher:
        for i in range(1000):
            publisher.send_batch(KEY, batch(i))
        time.sleep(2.0)
        assert 1000 < len(sent) < 1020
        recorder.is_stopped = False
        publisher.drain()
    assert recorder.samples() == list(range(1000 * N))


def test_a_recorder_that_says_why_it_pauses_is_waited_for() -> None:
    bus = LocalBus()
    recorder = StandIn(bus)
    recorder.paused = "disk full"
    with DurablePublisher(bus, resend_after_s=0.1, timeout_s=0.5) as publisher:
        publisher.send_batch(KEY, batch(0))
        for _ in range(15):
            recorder.say()
            time.sleep(0.1)
            assert publisher.paused == "disk full"
        recorder.paused = ""
        recorder.say()
        assert publisher.paused is None
        publisher.drain()
    assert recorder.samples() == list(range(N))


def test_it_does_not_end_quietly(tmp_path: Path) -> None:
    bus = LocalBus()
    with (
        pytest.raises(DeliveryError, match=r"1 messages of .*U1/rate are outstanding"),
        DurablePublisher(bus, timeout_s=0.2) as publisher,
    ):
        publisher.send_batch(KEY, batch(0))
    publisher = DurablePublisher(bus)
    publisher.send_batch(KEY, batch(0))
    with pytest.raises(DeliveryError, match="closed before everything was acknowledged"):
        publisher.close()
    publisher.close()  # told once
    with (
        pytest.raises(DeliveryError, match=rf"kept in {tmp_path} and sent when the same source starts again"),
        Spool(tmp_path) as spool,
        DurablePublisher(bus, timeout_s=0.2, spool=spool) as publisher,
    ):
        publisher.send_batch(KEY, batch(0))
    with pytest.raises(ZeroDivisionError), DurablePublisher(bus) as publisher:  # an error is not hidden by another
        publisher.send_batch(KEY, batch(0))
        raise ZeroDivisionError


def test_what_is_lost_by_who_had_acknowledged_it_is_said() -> None:
    bus = LocalBus()
    recorder = StandIn(bus)
    with DurablePublisher(bus, resend_after_s=0.05) as publisher:
        publisher.send_batch(KEY, batch(0))
        publisher.drain()
        recorder.marks.clear()
        publisher.send_batch(KEY, batch(1))
        with pytest.raises(DeliveryError, match="it has lost what it had acknowledged"):
            publisher.drain()


def test_a_stream_that_begins_in_its_middle_is_refused() -> None:
    bus = LocalBus()
    StandIn(bus)
    with DurablePublisher(bus) as publisher:
        publisher.send_batch(KEY, batch(3))
        with pytest.raises(DeliveryError, match=r"from number 0, and this source has it from 300"):
            publisher.drain()


class TestSpool:
    def test_hours_without_a_recorder_take_a_window_of_memory(self, tmp_path: Path) -> None:
        bus = LocalBus()
        size = len(encode_batch(batch(5)))
        with Spool(tmp_path, file_bytes=50_000) as spool:
            with DurablePublisher(bus, window_bytes=10 * size, resend_after_s=0.1, spool=spool) as publisher:
                for i in range(1000):
                    publisher.send_batch(KEY, batch(i))
                assert publisher._out.bytes <= 10 * size
                assert publisher.outstanding == 1000
                recorder = StandIn(bus)
                publisher.drain()
            assert publisher.outstanding == 0
            assert recorder.samples() == list(range(1000 * N))
            until(lambda: len(list(tmp_path.glob("*.spool"))) <= 2)

    def test_the_next_process_sends_what_is_left(self, tmp_path: Path) -> None:
        bus = LocalBus()
        recorder = StandIn(bus)
        for start in range(3):
            with Spool(tmp_path) as spool:
                publisher = DurablePublisher(bus, window_bytes=5000, resend_after_s=0.1, spool=spool)
                recorder.is_stopped = start != 1
                for i in range(start * 100, start * 100 + 100):
                    publisher.send_batch(KEY, batch(i))
                publisher.send_event(event_key(PLACE), NoteAdded(run="r1", t_ns=0, text=str(start)))
                publisher.abandon()  # as if killed
        recorder.is_stopped = False
        with Spool(tmp_path) as spool, DurablePublisher(bus, resend_after_s=0.1, spool=spool) as publisher:
            publisher.drain()
        assert recorder.samples() == list(range(300 * N))
        assert sum(stream.key == event_key(PLACE) for stream in recorder.marks) == 3

    def test_what_was_acknowledged_is_not_sent_again(self, tmp_path: Path) -> None:
        bus = LocalBus()
        recorder = StandIn(bus)
        with Spool(tmp_path) as spool, DurablePublisher(bus, spool=spool) as publisher:
            for i in range(50):
                publisher.send_batch(KEY, batch(i))
            publisher.drain()
            recorder.is_stopped = True
            publisher.send_batch(KEY, batch(50))
            publisher.abandon()
            recorder.is_stopped = False
            recorder.arrived.clear()
        with Spool(tmp_path) as spool, DurablePublisher(bus, spool=spool):
            pass
        assert recorder.arrived == [(StreamId(KEY, UUID(int=1).hex), 50 * N)]

    def test_a_disk_that_fails_leaves_the_window(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        def refuse(*_: object) -> int:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        bus = LocalBus()
        recorder = StandIn(bus)
        monkeypatch.setattr(spool_module, "_RETRY_S", 0.05)
        with Spool(tmp_path) as spool, DurablePublisher(bus, resend_after_s=0.1, spool=spool) as publisher:
            for i in range(100):
                if i == 20:
                    monkeypatch.setattr(os, "write", refuse)
                if i == 60:
                    assert publisher.warning is not None
                    assert "No space left" in publisher.warning
                    monkeypatch.undo()
                    monkeypatch.setattr(spool_module, "_RETRY_S", 0.0)
                publisher.send_batch(KEY, batch(i))
            assert publisher.warning is None
        assert recorder.samples() == list(range(100 * N))

    def test_a_full_spool_makes_its_source_wait(self, tmp_path: Path) -> None:
        bus = LocalBus()
        with Spool(tmp_path, max_bytes=100_000) as spool:
            publisher = DurablePublisher(bus, window_bytes=5000, resend_after_s=0.1, timeout_s=1.0, spool=spool)
            with pytest.raises(DeliveryError, match=r"the spool .* is full.*outstanding"):
                for i in range(1000):
                    publisher.send_batch(KEY, batch(i))
            reached = spool.position(StreamId(KEY, UUID(int=1).hex)) // N
            recorder = StandIn(bus)
            for i in range(reached, 1000):
                publisher.send_batch(KEY, batch(i))
            publisher.drain()
            publisher.close()
        assert recorder.samples() == list(range(1000 * N))

    def test_what_a_damaged_spool_still_has_goes_on_under_an_epoch_of_its_own(self, tmp_path: Path) -> None:
        bus = LocalBus()
        with Spool(tmp_path, file_bytes=20_000) as spool, DurablePublisher(bus, spool=spool) as publisher:
            for i in range(100):
                publisher.send_batch(KEY, batch(i))
            publisher.abandon()
        path = sorted(tmp_path.glob("*.spool"))[1]
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        path.write_bytes(content)
        recorder = StandIn(bus)
        for first in (100, 110):
            with Spool(tmp_path) as spool, DurablePublisher(bus, resend_after_s=0.1, spool=spool) as publisher:
                for i in range(first, first + 10):
                    publisher.send_batch(KEY, batch(i))
        assert spool.damages == [] or "damaged" in spool.damages[0]
        before, after = recorder.values.values()
        assert before == list(range(len(before)))
        assert after == list(range(len(before) + N, 120 * N))

    def test_it_goes_on_after_a_recorder_has_lost_what_it_had(self, tmp_path: Path) -> None:
        bus = LocalBus()
        recorder = StandIn(bus)
        stream = StreamId(KEY, UUID(int=1).hex)
        with Spool(tmp_path) as spool, DurablePublisher(bus, resend_after_s=0.05, timeout_s=10, spool=spool) as sender:
            for i in range(5):
                sender.send_batch(KEY, batch(i))
            sender.drain()
            recorder.marks[stream] = 2 * N  # a segment was lost
            for i in range(5, 10):
                sender.send_batch(KEY, batch(i))
            sender.drain()
            assert "the recorder has lost what it had acknowledged" in str(sender.warning)
            sender.send_batch(KEY, batch(10))
        with Spool(tmp_path) as spool, DurablePublisher(bus, resend_after_s=0.05, timeout_s=10, spool=spool) as sender:
            sender.send_batch(KEY, batch(11))
        assert recorder.values.pop(stream) == list(range(5 * N))
        assert list(recorder.values.values()) == [list(range(5 * N, 12 * N))]

    def test_documents_go_on_as_well(self, tmp_path: Path) -> None:
        bus = LocalBus()
        recorder = StandIn(bus)
        with Spool(tmp_path) as spool, DurablePublisher(bus, resend_after_s=0.05, timeout_s=10, spool=spool) as sender:
            for i in range(3):
                sender.send_event(event_key(PLACE), NoteAdded(run="r1", t_ns=i, text=""))
            sender.drain()
            (stream,) = recorder.marks
            recorder.marks[stream] = 1
            sender.send_event(event_key(PLACE), NoteAdded(run="r1", t_ns=3, text=""))
            sender.drain()
            sender.send_event(event_key(PLACE), NoteAdded(run="r1", t_ns=4, text=""))
            sender.drain()
        assert recorder.marks.pop(stream) == 1
        assert list(recorder.marks.values()) == [2]

    def test_an_answer_to_a_name_from_before_lets_go_of_nothing(self, tmp_path: Path) -> None:
        """Two holes in one stream of a damaged spool: it is renamed twice, and the first answer comes once more."""
        stream = StreamId(KEY, UUID(int=1).hex)
        with Spool(tmp_path) as spool:
            out = Outbox(1 << 20, 2.0, spool)
            sent = out.stream(stream)
            for seq in (5, 15, 20, 25):  # 0 to 4 and 10 to 14 are lost
                spool.append(stream, seq, seq + 5, b"x", taken=True)
                out.hold(sent, Held(seq, seq + 5, b"x"))
            out.answer("store", StreamPosition(*stream, 0, rewind=True), 1.0)
            first = sent.wire_id
            out.answer("store", StreamPosition(*first, 5), 2.0)
            out.answer("store", StreamPosition(*first, 5, rewind=True), 3.0)
            assert (sent.base, sent.wire_id == first) == (15, False)
            for late in (
                StreamPosition(*first, 5),
                StreamPosition(*first, 5, rewind=True),
                StreamPosition(*stream, 20),
            ):
                out.answer("store", late, 4.0)
            assert ([each.seq for each in sent.held], sent.acknowledged, sent.base) == ([15, 20, 25], 10, 15)
            out.answer("store", StreamPosition(*sent.wire_id, 15), 5.0)
            assert (list(sent.held), sent.acknowledged, out.bytes) == ([], 30, 0)


def test_only_the_store_that_is_meant_can_acknowledge() -> None:
    bus = LocalBus()
    recorder = StandIn(bus, acknowledges=False)
    stream = StreamId(KEY, UUID(int=1).hex)
    with DurablePublisher(bus, resend_after_s=60.0, only_store="own") as publisher:
        publisher.send_batch(KEY, batch(0))
        recorder.paused = "disk full"
        recorder.say(StreamPosition(*stream, N), store="other")
        assert (publisher.outstanding, publisher.paused) == (1, None)
        recorder.paused = ""
        recorder.say(StreamPosition(*stream, N), store="own")
        publisher.drain()


def test_a_document_that_no_recorder_would_take_is_not_sent() -> None:
    odd = RunEnded(run="r1", t_ns=0, totals=(StreamTotal(unit="a/b", signal="rate", epoch="zzz", samples=1),))
    with DurablePublisher(LocalBus()) as publisher, pytest.raises(WireError, match="run r1: RunEnded cannot be sent"):
        publisher.send_event(event_key(PLACE), odd)
