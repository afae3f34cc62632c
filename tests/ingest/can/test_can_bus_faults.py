"""CAN buses that go wrong, are pulled out or stopped: what was received is kept, the rest counted and reported."""

import threading
import time
from collections.abc import Callable
from typing import Any

import can
import can.interfaces
import pytest

from ingest.can.frames import FrameBlock
from stream.batch import SampleBatch
from stream.errors import InstrumentError

MakeBench = Callable[..., Any]
MakeFrame = Callable[..., can.Message]
Until = Callable[..., None]
Plug = Any


def test_an_interface_that_goes_is_told_once_and_opened_again(
    channel: str, sender: can.BusABC, faulty: Plug, bus_bench: MakeBench, frame: MakeFrame, until: Until
) -> None:
    bench = bus_bench(channel, "faulty")
    with bench.bus:
        for i in range(100):
            sender.send(frame(i))
        until(lambda: bench.bus.counts.received == 100)
        faulty.pull()
        until(lambda: bench.bus.counts.outages == 1)
        until(lambda: not bench.bus.is_open)
        time.sleep(0.3)  # many attempts
        sender.send(frame(100))  # nobody hears it
        faulty.plug_in()
        until(lambda: faulty.opened == 2)
        for i in range(101, 200):
            sender.send(frame(i))
        until(lambda: bench.bus.counts.received == 199)
        until(lambda: bench.bus.is_open)
    assert bench.numbers == [*range(100), *range(101, 200)]
    assert len(bench.said) == 3, bench.said  # it is gone, it cannot be opened, it is back
    assert "device not configured" in bench.said[0]
    assert "no such device" in bench.said[1]
    assert "back after" in bench.said[2]
    assert bench.bus.counts.outages == 1


def test_what_came_just_before_an_interface_went_is_kept(
    channel: str, faulty: Plug, bus_bench: MakeBench, frame: MakeFrame, until: Until
) -> None:
    bench = bus_bench(channel, "faulty")
    with bench.bus:
        faulty.last_words = [frame(i) for i in range(10)]
        until(lambda: bench.bus.counts.outages == 1)
    assert bench.numbers == list(range(10))


@pytest.mark.long
def test_a_controller_that_is_off_the_bus_is_opened_again(
    channel: str, sender: can.BusABC, faulty: Plug, bus_bench: MakeBench, frame: MakeFrame, until: Until
) -> None:
    bench = bus_bench(channel, "faulty")
    with bench.bus:
        faulty.state = can.BusState.PASSIVE
        until(lambda: bench.bus.counts.error_passive == 1 or sender.send(frame(1)))
        faulty.state = can.BusState.ERROR
        until(lambda: bench.bus.counts.bus_off == 1)
        until(lambda: faulty.opened > 2)
        faulty.state = can.BusState.ACTIVE
        until(lambda: (bench.said and "back" in bench.said[-1]) or sender.send(frame(2)))
    assert sum("off the bus" in said for said in bench.said) == 1
    assert sum("error passive" in said for said in bench.said) == 1
    assert (bench.bus.counts.bus_off, bench.bus.counts.outages) == (1, 1)


def test_stop_does_not_wait_for_an_interface_that_is_gone(
    channel: str, sender: can.BusABC, faulty: Plug, bus_bench: MakeBench, frame: MakeFrame, until: Until
) -> None:
    bench = bus_bench(channel, "faulty", reopen_s=(60.0, 60.0))
    bench.bus.start()
    sender.send(frame(1))
    until(lambda: bench.bus.counts.received)
    faulty.pull()
    until(lambda: bench.bus.counts.outages)
    began_s = time.monotonic()
    bench.bus.stop()
    assert time.monotonic() - began_s < 5.0
    assert bench.numbers == [1]


def test_what_has_no_room_is_counted_and_told(
    channel: str, sender: can.BusABC, bus_bench: MakeBench, frame: MakeFrame, until: Until
) -> None:
    gate = threading.Event()
    delivered: list[SampleBatch] = []

    def deliver(batch: SampleBatch) -> None:
        gate.wait(20.0)
        delivered.append(batch)

    bench = bus_bench(channel, deliver=deliver, most_waiting=50)
    with bench.bus:
        sender.send(frame(0))
        until(lambda: bench.keeper.blocks)  # delivery hangs with the first
        for i in range(1, 201):
            sender.send(frame(i))
        until(lambda: bench.bus.counts.received == 201)
        assert any("had no room and were lost" in said for said in bench.said)  # while it happens
        gate.set()
    counts = bench.bus.counts
    assert counts.overrun == 201 - 1 - 50
    assert counts.decoded == counts.received - counts.overrun == sum(map(len, delivered))
    assert bench.numbers == list(range(51))


def test_callbacks_that_raise_stop_nothing_and_are_told_once(
    channel: str, sender: can.BusABC, bus_bench: MakeBench, frame: MakeFrame, until: Until
) -> None:
    def deliver(_: SampleBatch) -> None:
        raise RuntimeError("the log is full")

    bench = bus_bench(channel, deliver=deliver)
    with bench.bus:
        for i in range(5):
            sender.send(frame(i))
            until(lambda i=i: bench.bus.counts.decoded > i)
    assert bench.bus.counts.undelivered == 5
    assert len(bench.said) == 1
    assert "the log is full" in bench.said[0]


def test_a_decoder_that_raises_costs_its_block_only(
    channel: str, sender: can.BusABC, bus_bench: MakeBench, frame: MakeFrame, until: Until, keeper: Any
) -> None:
    class Breaks:
        def take(self, block: FrameBlock) -> Any:
            if block.length[0] == 1:
                raise ValueError("not this one")
            return keeper.take(block)

        def finish(self) -> Any:
            return keeper.finish()

    bench = bus_bench(channel, decoder=Breaks())
    with bench.bus:
        sender.send(can.Message(arbitration_id=1, data=[1]))
        until(lambda: bench.bus.counts.undecoded == 1)
        sender.send(frame(7))
    assert (bench.bus.counts.decoded, sum(map(len, bench.delivered))) == (1, 1)
    assert any("not this one" in said for said in bench.said)


def test_a_report_that_raises_stops_nothing(
    channel: str,
    sender: can.BusABC,
    faulty: Plug,
    monkeypatch: pytest.MonkeyPatch,
    bus_bench: MakeBench,
    frame: MakeFrame,
    until: Until,
) -> None:
    raised: list[Any] = []
    monkeypatch.setattr(threading, "excepthook", raised.append)

    def report(text: str) -> None:
        raise RuntimeError(text)

    bench = bus_bench(channel, "faulty", report=report)
    with bench.bus:
        faulty.pull()
        until(lambda: raised)
        faulty.plug_in()
        until(lambda: faulty.opened == 2)
        sender.send(frame(9))
    assert bench.numbers == [9]


def test_stop_under_full_load_keeps_what_was_received(
    channel: str, sender: can.BusABC, bus_bench: MakeBench, frame: MakeFrame, until: Until
) -> None:
    bench = bus_bench(channel)
    is_over = threading.Event()

    def send() -> None:
        i = 0
        while not is_over.is_set():
            sender.send(frame(i))
            i += 1

    thread = threading.Thread(target=send)
    thread.start()
    try:
        until(lambda: sender.channel, 1.0)  # type: ignore[attr-defined]
        bench.bus.start()
        until(lambda: bench.bus.counts.received > 5000)
        stoppers = [threading.Thread(target=bench.bus.stop) for _ in range(3)]
        began_s = time.monotonic()
        for stopper in stoppers:
            stopper.start()
        for stopper in stoppers:
            stopper.join(10.0)
        assert time.monotonic() - began_s < 5.0
    finally:
        is_over.set()
        thread.join()
    counts = bench.bus.counts
    got = bench.numbers
    assert counts.overrun == 0
    assert counts.received == counts.decoded == len(got) == sum(map(len, bench.delivered))
    assert got == list(range(got[0], got[0] + len(got)))
    assert not any(thread.name.startswith(f"gyrofleet-can-{channel}") for thread in threading.enumerate())


def test_stop_from_a_callback_and_start_only_once(
    channel: str, sender: can.BusABC, bus_bench: MakeBench, frame: MakeFrame, until: Until
) -> None:
    def deliver(_: SampleBatch) -> None:
        bench.bus.stop()

    bench = bus_bench(channel, deliver=deliver)
    bench.bus.start()
    with pytest.raises(InstrumentError, match="started before"):
        bench.bus.start()
    sender.send(frame(1))
    until(lambda: not any(f"gyrofleet-can-{channel}" in thread.name for thread in threading.enumerate()))
    bench.bus.stop()
    assert bench.bus.counts.undelivered == 0
    with pytest.raises(InstrumentError, match="started before"):
        bench.bus.start()
