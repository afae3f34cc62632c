"""Live CAN buses: what is received arrives once, in order and with its time; what goes wrong is counted and told."""

import importlib.util
import re
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar
from uuid import UUID, uuid4

import can
import can.interfaces
import cantools
import msgspec
import numpy as np
import pytest
from can.interfaces.udp_multicast.bus import GeneralPurposeUdpMulticastBus
from can.interfaces.virtual import VirtualBus
from hypothesis import given, settings
from hypothesis import strategies as st

from ingest.instruments.can_bus import CanBus, CanBusOptions
from ingest.instruments.can_bus_clock import ReceiveClock
from ingest.instruments.can_bus_columns import kernel_columns, message_columns
from ingest.instruments.can_bus_intake import SocketIntake
from ingest.instruments.can_bus_open import filter_in_interface
from ingest.instruments.can_frames import EXTENDED, FrameBlock
from ingest.instruments.can_mapping import automatic_plan
from ingest.instruments.can_stream import CanDecoder
from ingest.station_clock import StationClock
from stream.batch import SampleBatch
from stream.errors import InstrumentError

GROUP = "239.74.163.91"
REOPEN_S = (0.01, 0.05)


class Keeper:
    """Decodes nothing: keeps all frames, and makes one sample of each."""

    def __init__(self) -> None:
        self.blocks: list[FrameBlock] = []
        self.epoch = uuid4()

    def take(self, block: FrameBlock) -> list[SampleBatch]:
        seq = sum(map(len, self.blocks))
        self.blocks.append(block)
        numbers = np.ascontiguousarray(block.data[:, :4]).view("<u4")[:, 0].astype(np.float64)
        return [SampleBatch("G1", "n", "r1", self.epoch, seq, int(block.t_ns[0]), 1000, "", values=numbers)]

    def finish(self) -> list[SampleBatch]:
        return []

    @property
    def frames(self) -> list[tuple[int, bytes]]:
        return [
            (int(block.arbitration_id[i]), block.data[i, : block.length[i]].tobytes())
            for block in self.blocks
            for i in range(len(block))
        ]


class Plug:
    """What a test does to a faulty bus."""

    is_there = True
    state = can.BusState.ACTIVE
    opened = 0
    last_words: list[can.Message] | None = None  # what the interface still gives before it is gone

    def pull(self) -> None:
        self.is_there = False

    def plug_in(self) -> None:
        self.is_there = True


class FaultyBus(VirtualBus):
    """A virtual bus that can be unplugged and go off the bus; python-can finds it by name."""

    plugs: ClassVar[dict[str, Plug]] = {}
    filters_asked: ClassVar[list[Any]] = []

    def __init__(self, channel: str, **options: Any) -> None:
        self.plug = self.plugs.setdefault(channel, Plug())
        if not self.plug.is_there:
            self._is_shutdown = True
            raise can.CanInitializationError("no such device")
        super().__init__(channel, **options)
        self.plug.opened += 1

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self.plug.last_words:
            return self.plug.last_words.pop(0), False
        if not self.plug.is_there or self.plug.last_words is not None:
            self.plug.last_words = None
            raise can.CanOperationError("device not configured")
        return super()._recv_internal(timeout)

    def _apply_filters(self, filters: Any) -> None:
        self.filters_asked.append(filters)

    @property
    def state(self) -> can.BusState:
        return self.plug.state

    @state.setter
    def state(self, new_state: can.BusState) -> None:
        raise NotImplementedError


class Bench:
    """One bus under test: what it delivered and said."""

    def __init__(self, channel: str, interface: str = "virtual", **more: Any) -> None:
        self.keeper = Keeper()
        self.delivered: list[SampleBatch] = []
        self.said: list[str] = []
        self.clock = StationClock()
        options = CanBusOptions(
            interface=interface,
            channel=channel,
            **{name: more.pop(name) for name in ("fd", "number", "options", "filter") if name in more},
        )
        arguments: dict[str, Any] = {
            "decoder": self.keeper,
            "deliver": self.delivered.append,
            "report": self.said.append,
            "block_s": 0.01,
            "reopen_s": REOPEN_S,
        }
        self.bus = CanBus(options, self.clock, **arguments | more)


@pytest.fixture
def channel() -> str:
    return uuid4().hex


@pytest.fixture
def sender(channel: str) -> Iterator[can.BusABC]:
    with can.Bus(channel, interface="virtual", ignore_config=True) as bus:
        yield bus


@pytest.fixture
def faulty(monkeypatch: pytest.MonkeyPatch, channel: str) -> Plug:
    monkeypatch.setitem(can.interfaces.BACKENDS, "faulty", (__name__, "FaultyBus"))
    FaultyBus.plugs[channel] = Plug()
    return FaultyBus.plugs[channel]


def frame(number: int, arbitration_id: int = 0x123, **more: Any) -> can.Message:
    return can.Message(
        arbitration_id=arbitration_id, is_extended_id=False, data=number.to_bytes(4, "little") + bytes(4), **more
    )


def numbers(bench: Bench) -> list[int]:
    return [int.from_bytes(data[:4], "little") for _, data in bench.keeper.frames]


def until(condition: Callable[[], object], within_s: float = 10.0) -> None:
    end_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < end_s, "waited in vain"
        time.sleep(0.002)


def test_frames_arrive_once_in_order_with_time_identifier_and_channel(channel: str) -> None:
    bench = Bench(channel, number=3)
    began_s = time.time()
    sent = [
        can.Message(began_s + i * 1e-3, 0x100 + i, is_extended_id=bool(i % 2), data=bytes(range(i % 9)))
        for i in range(500)
    ]
    options = {"interface": "virtual", "ignore_config": True, "preserve_timestamps": True}
    with can.Bus(channel, **options) as sender, bench.bus:  # type: ignore[arg-type]
        for message in sent:
            sender.send(message)
    assert bench.keeper.frames == [(m.arbitration_id | EXTENDED * m.is_extended_id, bytes(m.data)) for m in sent]
    got_ns = np.concatenate([block.t_ns for block in bench.keeper.blocks])
    assert got_ns.tolist() == [bench.clock.at_ns(message.timestamp) for message in sent]
    assert {int(c) for block in bench.keeper.blocks for c in block.channel} == {3}
    assert sum(map(len, bench.delivered)) == bench.bus.counts.decoded == bench.bus.counts.received == 500
    assert bench.bus.clock_source == "the interface, time of day"
    assert bench.said == []


def test_what_carries_no_samples_is_counted(channel: str, sender: can.BusABC) -> None:
    bench = Bench(channel, wanted=[0x123, 0x77 | EXTENDED])
    with bench.bus:
        sender.send(frame(1))
        sender.send(frame(2, 0x124))
        sender.send(can.Message(arbitration_id=0x77, is_extended_id=False, data=bytes(4)))
        sender.send(can.Message(arbitration_id=0x123, is_extended_id=False, is_remote_frame=True, dlc=4))
        sender.send(can.Message(is_error_frame=True))
        sender.send(can.Message(arbitration_id=0x123, is_extended_id=False, data=bytes(12), is_fd=True))
        sender.send(can.Message(arbitration_id=0x9999, is_extended_id=False, data=bytes(4)))
        for garbage in ({"arbitration_id": None}, {"timestamp": "noon"}):
            message = frame(3)
            for name, value in garbage.items():
                setattr(message, name, value)
            sender.channel[0].put(message)  # type: ignore[attr-defined]
            sender.channel[1].put(message)  # type: ignore[attr-defined]
        sender.send(frame(4))
    counts = bench.bus.counts
    assert (counts.received, counts.decoded, counts.unknown) == (10, 4, 2)
    assert (counts.remote_frames, counts.error_frames, counts.malformed) == (1, 1, 4)
    assert numbers(bench) == [1, 2, 0, 4]
    assert len(bench.said) == 1
    assert "4 frames are no frames of this bus" in bench.said[0]


def test_an_interface_that_goes_is_told_once_and_opened_again(channel: str, sender: can.BusABC, faulty: Plug) -> None:
    bench = Bench(channel, "faulty")
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
    assert numbers(bench) == [*range(100), *range(101, 200)]
    assert len(bench.said) == 3, bench.said  # it is gone, it cannot be opened, it is back
    assert "device not configured" in bench.said[0]
    assert "no such device" in bench.said[1]
    assert "back after" in bench.said[2]
    assert bench.bus.counts.outages == 1


def test_what_came_just_before_an_interface_went_is_kept(channel: str, faulty: Plug) -> None:
    bench = Bench(channel, "faulty")
    with bench.bus:
        faulty.last_words = [frame(i) for i in range(10)]
        until(lambda: bench.bus.counts.outages == 1)
    assert numbers(bench) == list(range(10))


def test_a_controller_that_is_off_the_bus_is_opened_again(channel: str, sender: can.BusABC, faulty: Plug) -> None:
    bench = Bench(channel, "faulty")
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


def test_stop_does_not_wait_for_an_interface_that_is_gone(channel: str, sender: can.BusABC, faulty: Plug) -> None:
    bench = Bench(channel, "faulty", reopen_s=(60.0, 60.0))
    bench.bus.start()
    sender.send(frame(1))
    until(lambda: bench.bus.counts.received)
    faulty.pull()
    until(lambda: bench.bus.counts.outages)
    began_s = time.monotonic()
    bench.bus.stop()
    assert time.monotonic() - began_s < 5.0
    assert numbers(bench) == [1]


def test_what_has_no_room_is_counted_and_told(channel: str, sender: can.BusABC) -> None:
    gate = threading.Event()
    delivered: list[SampleBatch] = []

    def deliver(batch: SampleBatch) -> None:
        gate.wait(20.0)
        delivered.append(batch)

    bench = Bench(channel, deliver=deliver, most_waiting=50)
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
    assert numbers(bench) == list(range(51))


def test_callbacks_that_raise_stop_nothing_and_are_told_once(channel: str, sender: can.BusABC) -> None:
    def deliver(_: SampleBatch) -> None:
        raise RuntimeError("the log is full")

    bench = Bench(channel, deliver=deliver)
    with bench.bus:
        for i in range(5):
            sender.send(frame(i))
            until(lambda i=i: bench.bus.counts.decoded > i)  # type: ignore[misc]
    assert bench.bus.counts.undelivered == 5
    assert len(bench.said) == 1
    assert "the log is full" in bench.said[0]


def test_a_decoder_that_raises_costs_its_block_only(channel: str, sender: can.BusABC) -> None:
    class Breaks(Keeper):
        def take(self, block: FrameBlock) -> list[SampleBatch]:
            if block.length[0] == 1:
                raise ValueError("not this one")
            return super().take(block)

    bench = Bench(channel, decoder=Breaks())
    with bench.bus:
        sender.send(can.Message(arbitration_id=1, data=[1]))
        until(lambda: bench.bus.counts.undecoded == 1)
        sender.send(frame(7))
    assert (bench.bus.counts.decoded, sum(map(len, bench.delivered))) == (1, 1)
    assert any("not this one" in said for said in bench.said)


def test_a_report_that_raises_stops_nothing(
    channel: str, sender: can.BusABC, faulty: Plug, monkeypatch: pytest.MonkeyPatch
) -> None:
    raised: list[Any] = []
    monkeypatch.setattr(threading, "excepthook", raised.append)

    def report(text: str) -> None:
        raise RuntimeError(text)

    bench = Bench(channel, "faulty", report=report)
    with bench.bus:
        faulty.pull()
        until(lambda: raised)
        faulty.plug_in()
        until(lambda: faulty.opened == 2)
        sender.send(frame(9))
    assert numbers(bench) == [9]


def test_stop_under_full_load_keeps_what_was_received(channel: str, sender: can.BusABC) -> None:
    bench = Bench(channel)
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
    got = numbers(bench)
    assert counts.overrun == 0
    assert counts.received == counts.decoded == len(got) == sum(map(len, bench.delivered))
    assert got == list(range(got[0], got[0] + len(got)))
    assert not any(thread.name.startswith(f"gyrofleet-can-{channel}") for thread in threading.enumerate())


def test_stop_from_a_callback_and_start_only_once(channel: str, sender: can.BusABC) -> None:
    def deliver(_: SampleBatch) -> None:
        bench.bus.stop()

    bench = Bench(channel, deliver=deliver)
    bench.bus.start()
    with pytest.raises(InstrumentError, match="started before"):
        bench.bus.start()
    sender.send(frame(1))
    until(lambda: not any(f"gyrofleet-can-{channel}" in thread.name for thread in threading.enumerate()))
    bench.bus.stop()
    assert bench.bus.counts.undelivered == 0
    with pytest.raises(InstrumentError, match="started before"):
        bench.bus.start()


def test_two_buses_at_once_do_not_mix() -> None:
    channels = [uuid4().hex, uuid4().hex]
    benches = [Bench(each, number=i) for i, each in enumerate(channels)]

    def send(channel: str, base: int) -> None:
        with can.Bus(channel, interface="virtual", ignore_config=True) as sender:
            for i in range(3000):
                sender.send(frame(base + i))

    with benches[0].bus, benches[1].bus:
        threads = [threading.Thread(target=send, args=(each, i * 10_000)) for i, each in enumerate(channels)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    for i, bench in enumerate(benches):
        assert numbers(bench) == list(range(i * 10_000, i * 10_000 + 3000))
        assert {int(c) for block in bench.keeper.blocks for c in block.channel} == {i}


@pytest.mark.parametrize(
    ("interface", "channel", "expected"),
    [
        ("kvasar", "0", "python-can knows no such interface; it knows .*kvaser"),
        ("kvaser", 0, "CANlib"),
        ("socketcan", "can-none-such", "ip link set can0 up"),
        ("slcan", "/dev/tty-none-such", "serial port"),
        ("udp_multicast", GROUP, "takes port and hop_limit, not rx_queue_size"),
    ],
)
def test_an_interface_that_cannot_be_opened_says_what_to_do(interface: str, channel: str | int, expected: str) -> None:
    options = CanBusOptions(interface=interface, channel=channel, options={"rx_queue_size": "many"})
    with pytest.raises(InstrumentError, match=rf"(?s)CAN bus {interface} {channel}.*{expected}"):
        CanBus(options, StationClock(), Keeper(), print, print).start()


def test_options_are_read_strictly() -> None:
    with pytest.raises(msgspec.ValidationError, match="bitrat"):
        msgspec.toml.decode(b'interface = "virtual"\nchannel = "a"\nbitrat = 5', type=CanBusOptions)


def test_hardware_is_asked_for_mapped_identifiers_only(channel: str, faulty: Plug, sender: can.BusABC) -> None:
    FaultyBus.filters_asked.clear()
    with Bench(channel, "faulty", wanted=[0x123, 0x77 | EXTENDED]).bus:
        pass
    assert FaultyBus.filters_asked[-1] == [
        {"can_id": 0x123, "can_mask": 0x7FF, "extended": False},
        {"can_id": 0x77, "can_mask": 0x1FFFFFFF, "extended": True},
    ]
    assert not filter_in_interface(sender, [0x123])  # the virtual bus would filter in Python
    FaultyBus.filters_asked.clear()
    with Bench(channel, "faulty", wanted=[0x123], filter=False).bus:
        pass
    assert all(asked is None for asked in FaultyBus.filters_asked)


# ---- multicast


def packed(message: can.Message) -> bytes:
    """As python-can's `pack_message` packs it."""
    names = ("timestamp", "arbitration_id", "is_extended_id", "is_remote_frame", "is_error_frame", "channel", "dlc")
    more = ("data", "is_fd", "bitrate_switch", "error_state_indicator")
    return msgspec.msgpack.encode({name: getattr(message, name) for name in names + more})


@pytest.fixture
def multicast() -> Iterator[Callable[[bytes], None]]:
    """Send a datagram to the group; skips where no datagram comes back."""
    try:
        bus = GeneralPurposeUdpMulticastBus(GROUP, 43117, 1)
    except (OSError, can.CanError) as error:
        pytest.skip(f"no multicast on this computer: {error}")
    try:
        bus.send(b"x", 1.0)
        if bus.recv(1.0) is None:
            pytest.skip("multicast datagrams do not come back on this computer")
        yield lambda datagram: bus.send(datagram, 1.0)
    except (OSError, can.CanError) as error:
        pytest.skip(f"no multicast on this computer: {error}")
    finally:
        bus.shutdown()


def test_multicast_frames_arrive_and_garbage_is_counted(multicast: Callable[[bytes], None]) -> None:
    bench = Bench(GROUP, "udp_multicast", fd=True, options={"port": 43117})
    with bench.bus:
        began_ns = bench.clock.now_ns()
        for i in range(300):
            multicast(packed(frame(i)))
        for garbage in (b"", b"\xc1", b"\x80", b"\xa2\xff\xff", msgspec.msgpack.encode({"arbitration_id": "x"})):
            multicast(garbage)
        multicast(packed(can.Message(arbitration_id=5, data=bytes(range(64)), is_fd=True)))
        multicast(packed(can.Message(is_error_frame=True)))
        until(lambda: bench.bus.counts.received == 307)
    ended_ns = bench.clock.now_ns()
    counts = bench.bus.counts
    assert numbers(bench)[:300] == list(range(300))
    assert bench.keeper.frames[300] == (5 | EXTENDED, bytes(range(64)))
    assert (counts.decoded, counts.malformed, counts.error_frames, counts.interface_overrun) == (301, 5, 1, 0)
    t_ns = np.concatenate([block.t_ns for block in bench.keeper.blocks])
    assert began_ns - 10**6 <= t_ns[0] <= t_ns[-1] <= ended_ns + 10**6
    assert counts.outages == 0


@pytest.mark.skipif(importlib.util.find_spec("msgpack") is None, reason="python-can sends multicast with msgpack only")
def test_multicast_of_python_can_itself_is_understood(multicast: Callable[[bytes], None]) -> None:
    bench = Bench(GROUP, "udp_multicast", options={"port": 43117})
    with can.Bus(GROUP, interface="udp_multicast", port=43117, ignore_config=True) as sender, bench.bus:
        for i in range(50):
            sender.send(frame(i))
        until(lambda: bench.bus.counts.received == 50)
    assert numbers(bench) == list(range(50))


# ---- columns, kernel frames and clock


@st.composite
def messages(draw: st.DrawFn) -> can.Message:
    is_extended = draw(st.booleans())
    return can.Message(
        timestamp=draw(st.floats(0, 2e9)),
        arbitration_id=draw(st.integers(-1, 0x900) | st.integers(0x1FFFFFF0, 0x20000010)),
        is_extended_id=is_extended,
        is_remote_frame=draw(st.booleans()),
        is_error_frame=draw(st.booleans()),
        data=draw(st.binary(max_size=10) | st.binary(min_size=60, max_size=66)),
    )


@given(st.lists(messages(), max_size=12), st.sampled_from([8, 64]), st.lists(st.integers(0, 11), max_size=2))
@settings(max_examples=100, deadline=None)
def test_columns_hold_what_the_messages_hold(given_: list[can.Message], most_bytes: int, spoilt: list[int]) -> None:
    for i in {i for i in spoilt if i < len(given_)}:
        given_[i].data = None  # type: ignore[assignment]
    whole = [m for m in given_ if m.data is not None]
    data_frames = [m for m in whole if not m.is_error_frame and not m.is_remote_frame]
    good = [
        m
        for m in data_frames
        if len(m.data) <= most_bytes and 0 <= m.arbitration_id <= (0x1FFFFFFF if m.is_extended_id else 0x7FF)
    ]
    columns = message_columns(given_, most_bytes)
    assert columns.stamps_s.tolist() == [m.timestamp for m in good]
    assert columns.arbitration_id.tolist() == [m.arbitration_id | EXTENDED * m.is_extended_id for m in good]
    assert [columns.data[i, :n].tobytes() for i, n in enumerate(columns.length)] == [bytes(m.data) for m in good]
    assert all(not columns.data[i, n:].any() for i, n in enumerate(columns.length))
    assert columns.error_frames == sum(m.is_error_frame for m in whole)
    assert columns.remote_frames == sum(m.is_remote_frame and not m.is_error_frame for m in whole)
    assert columns.malformed == len(given_) - len(whole) + len(data_frames) - len(good)


def kernel_frame(identifier: int, data: bytes, *, fd: bool = False) -> bytes:
    """struct can_frame, or canfd_frame, of linux/can.h."""
    head = identifier.to_bytes(4, "little" if np.little_endian else "big") + bytes([len(data), 0, 0, 0])
    return head + data.ljust(64 if fd else 8, b"\xee")


def test_kernel_frames_are_read_like_python_can_reads_them() -> None:
    frames = [
        kernel_frame(0x123, b"\1\2"),
        kernel_frame(0x1ABCDEF | 0x80000000, bytes(8)),
        kernel_frame(0x123 | 0x40000000, b""),
        kernel_frame(0x321, bytes(range(48)), fd=True),
        b"short",
    ]
    columns = kernel_columns(frames, np.arange(1.0, 6.0), 64)
    assert columns.arbitration_id.tolist() == [0x123, 0x1ABCDEF | EXTENDED, 0x321]
    assert columns.stamps_s.tolist() == [1.0, 2.0, 4.0]
    assert [columns.data[i, :n].tobytes() for i, n in enumerate(columns.length)] == [
        b"\1\2",
        bytes(8),
        bytes(range(48)),
    ]
    assert not columns.data[0, 2:].any()  # what the kernel left there is not data
    assert (columns.remote_frames, columns.malformed, columns.is_off) == (1, 1, None)
    assert kernel_columns(frames, np.arange(1.0, 6.0), 8).malformed == 2


@pytest.mark.parametrize(
    ("kind", "state", "expected"),
    [
        (0x40, 0, (True, None, 0)),
        (0x04, 0x10, (None, True, 0)),
        (0x04, 0x20, (None, True, 0)),
        (0x04, 0x40, (None, False, 0)),
        (0x04, 0x01, (None, None, 1)),
        (0x02, 0xFF, (None, None, 0)),
    ],
)
def test_error_frames_of_the_kernel_tell_of_the_controller(
    kind: int, state: int, expected: tuple[bool | None, bool | None, int]
) -> None:
    columns = kernel_columns([kernel_frame(kind | 0x20000000, bytes([0, state, 0, 0, 0, 0, 0, 0]))], np.zeros(1), 8)
    assert (columns.is_off, columns.is_passive, columns.overflows) == expected
    assert (columns.error_frames, len(columns)) == (1, 0)


def test_a_socket_gives_frames_with_the_kernels_time_and_its_losses() -> None:
    """A UDP socket stamps and counts like a CAN socket, which most computers that run tests lack."""

    class Owner:
        def shutdown(self) -> None: ...

    receiving = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiving.bind(("127.0.0.1", 0))
    receiving.setsockopt(socket.SOL_SOCKET, 35, 1)  # SO_TIMESTAMPNS
    clock = ReceiveClock(StationClock(), print)
    intake = SocketIntake(CanBusOptions(interface="socketcan", channel="can0"), clock, receiving, Owner())
    receiving.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    began_s = time.time()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for i in range(400):
            sender.sendto(kernel_frame(0x100, i.to_bytes(8, "little")), receiving.getsockname())
        taken: list[Any] = []
        intake.take(1.0, taken)
        sender.sendto(kernel_frame(0x100, (400).to_bytes(8, "little")), receiving.getsockname())
        intake.take(1.0, taken)
    columns = intake.columns(taken)
    intake.close()
    got = columns.data.copy().view("<u8")[:, 0].tolist()
    assert got[-1] == 400
    assert got[:-1] == list(range(len(got) - 1))  # the first ones fit, the rest was dropped
    if not columns.stamps_s.any():
        pytest.skip("this system stamps no datagrams")
    assert np.all((columns.stamps_s >= began_s - 0.01) & (columns.stamps_s <= time.time() + 0.01))
    lost = 401 - len(got)
    if not any(kind == 40 for _, kind, _ in taken[-1].ancillary) and lost:
        pytest.skip("this system does not tell what it dropped")
    assert intake.new_overruns() == lost
    assert intake.new_overruns() == 0


def test_a_bus_off_that_an_error_frame_tells_of_is_reported_and_the_socket_lives_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Owner:
        def shutdown(self) -> None: ...

    opened: list[Any] = []

    def open_socket(options: CanBusOptions, clock: ReceiveClock) -> tuple[SocketIntake, None]:
        receiving = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        receiving.bind(("127.0.0.1", 0))
        opened.append(receiving.getsockname())
        return SocketIntake(options, clock, receiving, Owner()), None

    monkeypatch.setattr("ingest.instruments.can_bus.open_intake", open_socket)
    bench = Bench("can0", "socketcan")
    with bench.bus, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(kernel_frame(0x20000004, bytes([0, 0x20, 0, 0, 0, 0, 0, 0])), opened[0])
        until(lambda: bench.bus.counts.error_passive == 1)
        sender.sendto(kernel_frame(0x123, bytes(4)), opened[0])
        sender.sendto(kernel_frame(0x20000040, bytes(8)), opened[0])
        until(lambda: bench.bus.counts.bus_off == 1)
        until(lambda: not bench.bus.is_open)
        sender.sendto(kernel_frame(0x124, bytes(4)), opened[0])
        until(lambda: bench.bus.is_open)
    counts = bench.bus.counts
    assert (counts.bus_off, counts.error_passive, counts.outages, counts.error_frames) == (1, 1, 0, 2)
    assert [arbitration_id for arbitration_id, _ in bench.keeper.frames] == [0x123, 0x124]
    assert len(opened) == 1
    expected = ("error passive", "off the bus.*ip link set can0 type can restart", "back after")
    assert len(bench.said) == 3
    assert all(re.search(text, said) for text, said in zip(expected, bench.said, strict=True)), bench.said


def test_receive_times_are_those_of_the_station() -> None:
    station, said = StationClock(speed=100.0, start_ns=10**18), list[str]()
    clock = ReceiveClock(station, said.append)
    stamps_s = clock.now_s() - np.array([0.3, 0.2, 0.1])
    times_ns = clock.times_ns(stamps_s, clock.now_s())
    assert times_ns.tolist() == [station.at_ns(each) for each in stamps_s.tolist()]
    assert said == []


def test_a_counter_of_the_interface_is_set_to_the_station_once_and_after_a_jump() -> None:
    station, said = StationClock(), list[str]()
    clock = ReceiveClock(station, said.append)
    read_s = clock.now_s()
    first = clock.times_ns(np.array([100.0, 100.5]), read_s)
    later = clock.times_ns(np.array([101.0]), read_s + 0.9)  # read late or early, its counter says when it came
    assert (first[1], later[0] - first[1]) == (station.at_ns(read_s), 500_000_000)
    assert said == []
    begun_anew = clock.times_ns(np.array([0.25]), read_s + 2.0)
    assert begun_anew[0] == station.at_ns(read_s + 2.0)
    assert len(said) == 1
    assert "jump" in said[0]
    assert clock.source == "the interface, counted from its own start"


def test_frames_without_a_time_have_that_of_reading() -> None:
    station = StationClock()
    clock = ReceiveClock(station, print)
    read_s = clock.now_s()
    assert clock.times_ns(np.array([0.0, np.nan]), read_s).tolist() == [station.at_ns(read_s)] * 2
    assert clock.source == "the computer, when a frame was read"


# ---- with the decoder


def test_values_of_a_database_arrive(tmp_path: Path, channel: str, sender: can.BusABC) -> None:
    path = tmp_path / "gyro.dbc"
    path.write_text(
        'VERSION ""\nNS_ :\nBS_:\nBU_: Gyro\nBO_ 291 GYRO: 8 Gyro\n'
        ' SG_ Rate : 7|24@0- (0.0001,0) [0|0] "deg/s" Vector__XXX\n'
        ' SG_ Temperature : 24|16@1- (0.01,0) [0|0] "degC" Vector__XXX\n'
    )
    message = cantools.database.load_file(path).get_message_by_name("GYRO")  # type: ignore[union-attr]
    plan = automatic_plan([path], "FOG-1")
    decoder = CanDecoder(plan, run="r1", epoch_of=lambda unit: UUID(int=1))
    bench = Bench(channel, decoder=decoder, wanted={route.arbitration_id for route in plan.routes})
    rates = [round(-5 + i * 0.0301, 4) for i in range(400)]
    with bench.bus:
        for i, rate in enumerate(rates):
            sender.send(
                can.Message(
                    time.time(),
                    291,
                    is_extended_id=False,
                    data=message.encode({"Rate": rate, "Temperature": 20 + i / 100}),
                )
            )
    found = {
        signal: np.concatenate([batch.value_array for batch in bench.delivered if batch.signal == signal])
        for signal in {batch.signal for batch in bench.delivered}
    }
    assert found.keys() == {signal for _, signal, _ in plan.signals}
    by_name = {plan.layout.name: plan.signal for plan in plan.routes[0].message.signals}
    assert np.allclose(found[by_name["Rate"]], rates, rtol=0, atol=1e-9)
    assert np.allclose(found[by_name["Temperature"]], 20 + np.arange(400) / 100, rtol=0, atol=1e-9)
