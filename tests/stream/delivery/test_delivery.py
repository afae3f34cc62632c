"""The publisher: what it keeps, in which order it sends, how it goes back, and that it never ends quietly."""

import time
from pathlib import Path
from uuid import UUID

import pytest

from stream.delivery.publisher import DurablePublisher
from stream.delivery.spool import Spool
from stream.errors import DeliveryError, WireError
from stream.events import RunEnded, StreamTotal
from stream.identity import EVERYTHING, event_key
from stream.transport.bus import LocalBus
from stream.wire.acknowledgement import StreamId, StreamPosition
from tests.stream.stand_in_recorder import KEY, PLACE, LossyBus, N, StandIn, batch, until


@pytest.mark.long
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


@pytest.mark.long
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


@pytest.mark.long
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
    publisher.close()  # reported once
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
