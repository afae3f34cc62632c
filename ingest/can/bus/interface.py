"""CAN interfaces: their options, how they are opened, and how each kind is drained of frames most cheaply."""

import contextlib
import os
import select
import socket
import struct
import time
from abc import ABC, abstractmethod
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import msgspec

from ingest.can.bus.columns import FrameColumns, ReceiveClock, kernel_columns, message_columns, socket_stamps
from ingest.can.frames import EXTENDED
from stream.decoding import msgpack_decoder
from stream.errors import InstrumentError

if TYPE_CHECKING:
    from can import BusABC
    from can.interfaces.virtual import VirtualBus

_MOST_AT_ONCE = 4096
_GATHER_S = 0.001  # frames that are stamped already are worth waiting for: one turn of the reader takes them all
_SO_TIMESTAMPNS, _SO_RXQ_OVFL, _SO_RCVBUFFORCE = 35, 40, 33  # asm-generic/socket.h; Python has no names for them
_BUFFER_BYTES = 8 << 20
_MOST_DATAGRAM_BYTES = 4096
_ANCILLARY_BYTES = 128


_ADVICE = {
    "socketcan": "it is Linux's own; bring it up, `ip link set can0 up type can bitrate 500000`, and see `ip -d link`",
    "kvaser": "install Kvaser's CANlib (linuxcan, or the drivers for Windows) and plug the interface in",
    "pcan": "install PEAK's PCAN-Basic and plug the interface in",
    "vector": "install Vector's XL Driver Library and assign the channel in Vector Hardware Manager",
    "slcan": "the channel is a serial port, such as /dev/ttyACM0 or COM3, that no other program has open",
    "udp_multicast": "the channel is a multicast address, such as 239.74.163.2, and the computer needs a route to it",
}
_MOST_FILTERS = 512  # CAN_RAW_FILTER_MAX of Linux


class CanBusOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One CAN bus of a station file."""

    interface: str  # its name in python-can: socketcan, kvaser, pcan, vector, slcan, virtual, udp_multicast, ...
    channel: str | int  # can0, PCAN_USBBUS1, 0, /dev/ttyACM0, 239.74.163.2, ...
    number: int = 0  # channel number of the bus' frames in mappings
    bitrate: int | None = None  # bits per second. That of socketcan is set with `ip link` instead
    fd: bool = False  # whether frames of CAN FD, with up to 64 bytes, are expected
    data_bitrate: int | None = None  # bits per second in the data phase of CAN FD
    filter: bool = True  # whether the interface, if it can, gives mapped identifiers only; others are not counted then
    options: dict[str, Any] = {}  # further options of the interface in python-can

    @property
    def name(self) -> str:
        """Its name in messages."""
        return f"CAN bus {self.interface} {self.channel}"

    @property
    def most_bytes(self) -> int:
        """Most data of a frame, bytes."""
        return 64 if self.fd else 8


class CanIntake(ABC):
    """Drains one opened interface, until the interface is lost."""

    reopens = True  # whether a controller that is off the bus comes back by being opened again

    def __init__(self, options: CanBusOptions, clock: ReceiveClock) -> None:
        self.options, self.clock = options, clock
        # state of the controller, as far as the frames or the interface report it, and what of it was reported
        self.is_off = self.is_passive = self.is_reported_passive = False
        self.gives_data = False  # since it was last off the bus

    @abstractmethod
    def take(self, wait_s: float, into: list[Any]) -> None:
        """Append frames, after waiting at most `wait_s` seconds for a first one; raises what the driver raises."""

    @abstractmethod
    def columns(self, taken: list[Any]) -> FrameColumns:
        """Put frames of `take` into columns; called in another thread."""

    def check(self) -> None:  # noqa: B027  not every interface can be asked
        """Ask the interface for the state of its controller."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the interface; never raises."""


class MessageIntake(CanIntake):
    """Any interface of python-can: one message after the other."""

    def __init__(self, options: CanBusOptions, clock: ReceiveClock, bus: "BusABC") -> None:
        super().__init__(options, clock)
        self.bus = bus

    def take(self, wait_s: float, into: list[Any]) -> None:
        """Append messages."""
        message = self.bus.recv(wait_s)
        while message is not None:
            into.append(message)
            message = self.bus.recv(0.0) if len(into) < _MOST_AT_ONCE else None

    def columns(self, taken: list[Any]) -> FrameColumns:
        """Put messages into columns."""
        return message_columns(taken, self.options.most_bytes)

    def check(self) -> None:
        """Ask the driver."""
        from can import BusState

        try:
            state = self.bus.state
        except NotImplementedError:
            return
        self.is_off = self.is_off or state is BusState.ERROR
        self.is_passive = state is BusState.PASSIVE

    def close(self) -> None:
        """Shut the interface down."""
        with contextlib.suppress(Exception):  # of a bus that is gone anything may be raised
            self.bus.shutdown()


class VirtualIntake(MessageIntake):
    """The virtual bus of python-can: its queue is emptied at once instead of message by message."""

    bus: "VirtualBus"

    def take(self, wait_s: float, into: list[Any]) -> None:
        """Append all messages in the queue."""
        message = self.bus.recv(wait_s)
        if message is None:
            return
        into.append(message)
        time.sleep(_GATHER_S)
        waiting = self.bus.queue
        with waiting.mutex:
            into.extend(waiting.queue)
            waiting.queue.clear()
            waiting.not_full.notify_all()


class SocketIntake(CanIntake):
    """A socket of Linux that gives one frame per datagram, stamped by the kernel, which also counts what it drops."""

    reopens = False  # the kernel restarts a controller, or a person does; the socket lives on meanwhile

    def __init__(self, options: CanBusOptions, clock: ReceiveClock, receiving: socket.socket, owner: Any) -> None:
        super().__init__(options, clock)
        self._socket, self._owner = receiving, owner
        self._dropped = 0
        for level_option in ((_SO_RXQ_OVFL, 1), (socket.SO_RCVBUF, _BUFFER_BYTES), (_SO_RCVBUFFORCE, _BUFFER_BYTES)):
            with contextlib.suppress(OSError):  # without the right to, the buffer stays as large as the system allows
                receiving.setsockopt(socket.SOL_SOCKET, *level_option)
        self._poll = select.poll()
        self._poll.register(receiving, select.POLLIN)

    def take(self, wait_s: float, into: list[Any]) -> None:
        """Append datagrams."""
        if not self._poll.poll(wait_s * 1e3):
            return
        time.sleep(_GATHER_S)
        receive = self._socket.recvmsg
        with contextlib.suppress(BlockingIOError):
            while len(into) < _MOST_AT_ONCE:
                payload, ancillary, _, _ = receive(_MOST_DATAGRAM_BYTES, _ANCILLARY_BYTES, socket.MSG_DONTWAIT)
                into.append((payload, ancillary))

    def columns(self, taken: list[Any]) -> FrameColumns:
        """Put datagrams into columns."""
        before = self._dropped
        payloads, ancillary = zip(*taken, strict=True)
        for _, kind, payload in ancillary[-1]:
            if kind == _SO_RXQ_OVFL:  # counts from the socket's beginning
                (self._dropped,) = struct.unpack("@I", payload)
        found = self._frames(payloads, socket_stamps(ancillary, _SO_TIMESTAMPNS))
        return replace(found, overruns=(self._dropped - before) % (1 << 32))

    def _frames(self, payloads: Sequence[bytes], stamps_s: Any) -> FrameColumns:
        return kernel_columns(payloads, stamps_s, self.options.most_bytes)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
        with contextlib.suppress(Exception):  # of a bus that is gone anything may be raised
            self._owner.shutdown()


class _Packed(msgspec.Struct):
    arbitration_id: int
    data: bytes
    is_extended_id: bool = True
    is_error_frame: bool = False
    is_remote_frame: bool = False


class MulticastIntake(SocketIntake):
    """Frames that python-can's udp_multicast sends: MessagePack in UDP, read without the package msgpack."""

    _decoder = msgpack_decoder(_Packed)

    def _frames(self, payloads: Sequence[bytes], stamps_s: Any) -> FrameColumns:
        decode = self._decoder.decode
        packed: list[_Packed | None] = []
        for payload in payloads:
            try:
                packed.append(decode(payload))
            except (msgspec.DecodeError, UnicodeDecodeError):
                packed.append(None)  # counted as malformed, which None is
        return message_columns(packed, self.options.most_bytes, stamps_s)


def open_intake(options: CanBusOptions, clock: ReceiveClock) -> tuple[CanIntake, "BusABC | None"]:
    """Open an interface; the bus of python-can beside it, if there is one. Raises InstrumentError if it fails."""
    if options.interface == "udp_multicast" and hasattr(socket, "CMSG_SPACE"):
        return _open_multicast(options, clock), None
    bus = open_bus(options)
    from can.interfaces.socketcan import SocketcanBus
    from can.interfaces.virtual import VirtualBus

    if type(bus) is VirtualBus:
        return VirtualIntake(options, clock, bus), bus
    if type(bus) is SocketcanBus:
        return SocketIntake(options, clock, socket.socket(fileno=os.dup(bus.fileno())), bus), bus
    return MessageIntake(options, clock, bus), bus


def _open_multicast(options: CanBusOptions, clock: ReceiveClock) -> CanIntake:
    from can.interfaces.udp_multicast.bus import GeneralPurposeUdpMulticastBus

    port, hop_limit = options.options.get("port", 43113), options.options.get("hop_limit", 1)
    if unknown := options.options.keys() - {"port", "hop_limit"}:
        raise InstrumentError(f"{options.name}: udp_multicast takes port and hop_limit, not {', '.join(unknown)}")
    try:
        bus = GeneralPurposeUdpMulticastBus(str(options.channel), port, hop_limit)
    except Exception as error:  # a driver raises whatever it likes
        raise cannot_be_opened(options, error) from error
    return MulticastIntake(options, clock, socket.socket(fileno=os.dup(bus.fileno())), bus)


def open_bus(options: CanBusOptions) -> "BusABC":
    """Open an interface through python-can, without its configuration files; raises InstrumentError if it fails."""
    try:
        import can
    except ImportError as error:
        raise InstrumentError(f"{options.name}: no python-can ({error}); pip install python-can") from error
    if options.interface not in can.interfaces.BACKENDS:
        known = ", ".join(sorted(can.interfaces.BACKENDS))
        raise InstrumentError(f"{options.name}: python-can knows no such interface; it knows {known}")
    named = {"bitrate": options.bitrate, "data_bitrate": options.data_bitrate, "fd": options.fd or None}
    given = {name: value for name, value in named.items() if value is not None} | options.options
    try:
        return can.Bus(channel=options.channel, interface=options.interface, ignore_config=True, **given)
    except Exception as error:  # a driver raises whatever it likes
        raise cannot_be_opened(options, error) from error


def cannot_be_opened(options: CanBusOptions, error: Exception) -> InstrumentError:
    """The error of an interface that could not be opened."""
    advice = _ADVICE.get(options.interface, "see python-can's page on this interface for its driver and channels")
    return InstrumentError(
        f"{options.name} cannot be opened: {type(error).__name__}: {error}; {advice}. "
        f"Is it plugged in, and are channel, bit rates and options right?"
    )


def filter_in_interface(bus: "BusABC", wanted: Collection[int]) -> bool:
    """Ask the interface for these identifiers (bit 31 set if of 29 bits) only; whether it accepts.

    The hook is called instead of `set_filters`, which filters in Python if the hardware cannot: one comparison per
    frame and identifier, error frames are dropped, and nothing is counted.
    """
    import can

    if type(bus)._apply_filters is can.BusABC._apply_filters or not 0 < len(wanted) <= _MOST_FILTERS:  # noqa: SLF001
        return False
    filters: list[Any] = []
    for each in sorted(wanted):
        mask = 0x1FFFFFFF if each & EXTENDED else 0x7FF
        filters.append({"can_id": each & ~EXTENDED, "can_mask": mask, "extended": bool(each & EXTENDED)})
    with contextlib.suppress(Exception):  # otherwise all frames are read, and filtered here
        bus._apply_filters(filters)  # noqa: SLF001
        return True
    return False
