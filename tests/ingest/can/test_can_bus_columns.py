"""Messages and kernel frames of a CAN bus as columns: what they hold, and what error frames and sockets tell."""

import re
import socket
import time
from collections.abc import Callable
from typing import Any

import can
import can.interfaces
import numpy as np
import pytest
from hypothesis import strategies as st

from ingest.can.bus.bus import CanBusOptions
from ingest.can.bus.columns import ReceiveClock, kernel_columns, message_columns
from ingest.can.bus.interface import SocketIntake
from ingest.can.frames import EXTENDED
from ingest.station_clock import StationClock
from tests.stream.examples import examples

MakeBench = Callable[..., Any]
Until = Callable[..., None]


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


@examples(
    25, 100, st.lists(messages(), max_size=12), st.sampled_from([8, 64]), st.lists(st.integers(0, 11), max_size=2)
)
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
    if not any(kind == 40 for _, kind, _ in taken[-1][1]) and lost:
        pytest.skip("this system does not tell what it dropped")
    assert columns.overruns == lost
    assert intake.columns(taken).overruns == 0


def test_a_bus_off_that_an_error_frame_tells_of_is_reported_and_the_socket_lives_on(
    monkeypatch: pytest.MonkeyPatch, bus_bench: MakeBench, until: Until
) -> None:
    class Owner:
        def shutdown(self) -> None: ...

    opened: list[Any] = []

    def open_socket(options: CanBusOptions, clock: ReceiveClock) -> tuple[SocketIntake, None]:
        receiving = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        receiving.bind(("127.0.0.1", 0))
        opened.append(receiving.getsockname())
        return SocketIntake(options, clock, receiving, Owner()), None

    monkeypatch.setattr("ingest.can.bus.bus.open_intake", open_socket)
    bench = bus_bench("can0", "socketcan")
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
