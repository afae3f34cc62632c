"""Live CAN buses: what is received arrives once, in order and with its time, and is decoded and delivered."""

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from uuid import UUID, uuid4

import can
import can.interfaces
import cantools
import msgspec
import numpy as np
import pytest

from ingest.can.bus.bus import CanBus, CanBusOptions
from ingest.can.bus.interface import filter_in_interface
from ingest.can.frames import EXTENDED
from ingest.can.mapping import CanMapping
from ingest.can.stream import CanDecoder
from ingest.station_clock import StationClock
from stream.errors import InstrumentError

MakeBench = Callable[..., Any]
MakeFrame = Callable[..., can.Message]
Plug = Any

GROUP = "239.74.163.91"


def test_frames_arrive_once_in_order_with_time_identifier_and_channel(channel: str, bus_bench: MakeBench) -> None:
    bench = bus_bench(channel, number=3)
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


def test_what_carries_no_samples_is_counted(
    channel: str, sender: can.BusABC, bus_bench: MakeBench, frame: MakeFrame
) -> None:
    bench = bus_bench(channel, wanted=[0x123, 0x77 | EXTENDED])
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
    assert bench.numbers == [1, 2, 0, 4]
    assert len(bench.said) == 1
    assert "4 frames are no frames of this bus" in bench.said[0]


def test_two_buses_at_once_do_not_mix(bus_bench: MakeBench, frame: MakeFrame) -> None:
    channels = [uuid4().hex, uuid4().hex]
    benches = [bus_bench(each, number=i) for i, each in enumerate(channels)]

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
        assert bench.numbers == list(range(i * 10_000, i * 10_000 + 3000))
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
def test_an_interface_that_cannot_be_opened_says_what_to_do(
    interface: str, channel: str | int, expected: str, keeper: Any
) -> None:
    options = CanBusOptions(interface=interface, channel=channel, options={"rx_queue_size": "many"})
    with pytest.raises(InstrumentError, match=rf"(?s)CAN bus {interface} {channel}.*{expected}"):
        CanBus(options, StationClock(), keeper, print, print).start()


def test_options_are_read_strictly() -> None:
    with pytest.raises(msgspec.ValidationError, match="bitrat"):
        msgspec.toml.decode(b'interface = "virtual"\nchannel = "a"\nbitrat = 5', type=CanBusOptions)


def test_hardware_is_asked_for_mapped_identifiers_only(
    channel: str, faulty: Plug, sender: can.BusABC, bus_bench: MakeBench
) -> None:
    faulty.filters_asked.clear()
    with bus_bench(channel, "faulty", wanted=[0x123, 0x77 | EXTENDED]).bus:
        pass
    assert faulty.filters_asked[-1] == [
        {"can_id": 0x123, "can_mask": 0x7FF, "extended": False},
        {"can_id": 0x77, "can_mask": 0x1FFFFFFF, "extended": True},
    ]
    assert not filter_in_interface(sender, [0x123])  # the virtual bus would filter in Python
    faulty.filters_asked.clear()
    with bus_bench(channel, "faulty", wanted=[0x123], filter=False).bus:
        pass
    assert all(asked is None for asked in faulty.filters_asked)


def test_values_of_a_database_arrive(tmp_path: Path, channel: str, sender: can.BusABC, bus_bench: MakeBench) -> None:
    path = tmp_path / "gyro.dbc"
    path.write_text(
        'VERSION ""\nNS_ :\nBS_:\nBU_: Gyro\nBO_ 291 GYRO: 8 Gyro\n'
        ' SG_ Rate : 7|24@0- (0.0001,0) [0|0] "deg/s" Vector__XXX\n'
        ' SG_ Temperature : 24|16@1- (0.01,0) [0|0] "degC" Vector__XXX\n'
    )
    message = cantools.database.load_file(path).get_message_by_name("GYRO")  # type: ignore[union-attr]
    plan = CanMapping([path], unit="FOG-1").plan()
    decoder = CanDecoder(plan, run="r1", epoch_of=lambda unit: UUID(int=1))
    bench = bus_bench(channel, decoder=decoder, wanted={route.arbitration_id for route in plan.routes})
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
