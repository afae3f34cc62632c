"""CAN buses over multicast: what python-can sends is understood, and garbage is counted."""

import importlib.util
from collections.abc import Callable, Iterator
from typing import Any

import can
import can.interfaces
import msgspec
import numpy as np
import pytest
from can.interfaces.udp_multicast.bus import GeneralPurposeUdpMulticastBus

from ingest.can.frames import EXTENDED

MakeBench = Callable[..., Any]
MakeFrame = Callable[..., can.Message]
Until = Callable[..., None]

GROUP = "239.74.163.91"


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


def test_multicast_frames_arrive_and_garbage_is_counted(
    multicast: Callable[[bytes], None], bus_bench: MakeBench, frame: MakeFrame, until: Until
) -> None:
    bench = bus_bench(GROUP, "udp_multicast", fd=True, options={"port": 43117})
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
    assert bench.numbers[:300] == list(range(300))
    assert bench.keeper.frames[300] == (5 | EXTENDED, bytes(range(64)))
    assert (counts.decoded, counts.malformed, counts.error_frames, counts.interface_overrun) == (301, 5, 1, 0)
    t_ns = np.concatenate([block.t_ns for block in bench.keeper.blocks])
    assert began_ns - 10**6 <= t_ns[0] <= t_ns[-1] <= ended_ns + 10**6
    assert counts.outages == 0


@pytest.mark.skipif(importlib.util.find_spec("msgpack") is None, reason="python-can sends multicast with msgpack only")
def test_multicast_of_python_can_itself_is_understood(
    multicast: Callable[[bytes], None], bus_bench: MakeBench, frame: MakeFrame, until: Until
) -> None:
    bench = bus_bench(GROUP, "udp_multicast", options={"port": 43117})
    with can.Bus(GROUP, interface="udp_multicast", port=43117, ignore_config=True) as sender, bench.bus:
        for i in range(50):
            sender.send(frame(i))
        until(lambda: bench.bus.counts.received == 50)
    assert bench.numbers == list(range(50))
