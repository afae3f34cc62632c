"""How frames are drained from an opened CAN interface, each kind of interface as cheaply as it allows."""

import contextlib
import os
import select
import socket
import struct
import time
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec

from ingest.can.bus.clock import ReceiveClock
from ingest.can.bus.columns import Columns, kernel_columns, message_columns, socket_stamps
from ingest.can.bus.open import CanBusOptions, cannot_be_opened, open_bus
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


class Intake(ABC):
    """Drains one opened interface; it is given up when the interface is lost.

    Attributes
    ----------
    clock: Of the frames of this interface.
    is_off, is_passive: State of the controller, as far as the frames or the interface tell.
    is_told_passive: Whether people know that it is passive.
    gives_data: Whether data frames have come, since it was last off the bus.
    reopens: Whether a controller that is off the bus gets back by being opened again.
    """

    reopens = True

    def __init__(self, options: CanBusOptions, clock: ReceiveClock) -> None:
        self.options = options
        self.clock = clock
        self.is_off = False
        self.is_passive = False
        self.is_told_passive = False
        self.gives_data = False

    @abstractmethod
    def take(self, wait_s: float, into: list[Any]) -> None:
        """Append what has been received, after waiting at most `wait_s` seconds for a first frame.

        Raises whatever the driver raises; what was received before that is in `into`.
        """

    @abstractmethod
    def columns(self, taken: list[Any]) -> Columns:
        """Put what `take` has appended into columns; called in another thread."""

    def new_overruns(self) -> int:
        """Frames that the operating system has dropped before they were read, since this was last asked."""
        return 0

    def check(self) -> None:  # noqa: B027  not every interface can be asked
        """Ask the interface for the state of its controller."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the interface; never raises."""


class MessageIntake(Intake):
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

    def columns(self, taken: list[Any]) -> Columns:
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
    """The virtual bus of python-can: its queue is emptied at once, instead of once per message."""

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


class _Datagram(NamedTuple):
    payload: bytes
    ancillary: list[tuple[int, int, bytes]]


class SocketIntake(Intake):
    """A socket of Linux that gives one frame per datagram, stamped by the kernel, which also says what it dropped.

    Parameters
    ----------
    receiving: A socket of its own, which `close` closes.
    owner: What has opened it, with a method `shutdown`.
    """

    reopens = False  # the kernel restarts a controller, or a person does; the socket lives on meanwhile

    def __init__(self, options: CanBusOptions, clock: ReceiveClock, receiving: socket.socket, owner: Any) -> None:
        super().__init__(options, clock)
        self._socket = receiving
        self._owner = owner
        self._dropped = self._told_dropped = 0
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
                into.append(_Datagram(payload, ancillary))

    def columns(self, taken: list[Any]) -> Columns:
        """Put datagrams into columns."""
        for _, kind, payload in taken[-1].ancillary:
            if kind == _SO_RXQ_OVFL:  # counts on from the socket's beginning
                (self._dropped,) = struct.unpack("@I", payload)
        stamps_s = socket_stamps([each.ancillary for each in taken], _SO_TIMESTAMPNS)
        return self._frames([each.payload for each in taken], stamps_s)

    def new_overruns(self) -> int:
        """What the kernel says that it has dropped."""
        new = (self._dropped - self._told_dropped) % (1 << 32)
        self._told_dropped = self._dropped
        return new

    def _frames(self, payloads: list[bytes], stamps_s: Any) -> Columns:
        return kernel_columns(payloads, stamps_s, self.options.most_bytes)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
        with contextlib.suppress(Exception):  # of a bus that is gone anything may be raised
            self._owner.shutdown()


class _Packed(msgspec.Struct):
    """A frame as python-can sends it by multicast."""

    arbitration_id: int
    data: bytes
    is_extended_id: bool = True
    is_error_frame: bool = False
    is_remote_frame: bool = False


class MulticastIntake(SocketIntake):
    """Frames that python-can's udp_multicast sends: MessagePack in UDP, read without the package msgpack."""

    def __init__(self, options: CanBusOptions, clock: ReceiveClock, receiving: socket.socket, owner: Any) -> None:
        super().__init__(options, clock, receiving, owner)
        self._decode = msgspec.msgpack.Decoder(_Packed).decode

    def _frames(self, payloads: list[bytes], stamps_s: Any) -> Columns:
        decode = self._decode
        packed: list[_Packed | None] = []
        for payload in payloads:
            try:
                packed.append(decode(payload))
            except (msgspec.DecodeError, UnicodeDecodeError):
                packed.append(None)  # counted as malformed, which None is
        return message_columns(packed, self.options.most_bytes, stamps_s)


def open_intake(options: CanBusOptions, clock: ReceiveClock) -> tuple[Intake, "BusABC | None"]:
    """Open an interface and what drains it best; the bus of python-can beside it, unless it is received without one.

    Raises
    ------
    InstrumentError: If it cannot be opened.
    """
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


def _open_multicast(options: CanBusOptions, clock: ReceiveClock) -> Intake:
    from can.interfaces.udp_multicast.bus import GeneralPurposeUdpMulticastBus

    port, hop_limit = options.options.get("port", 43113), options.options.get("hop_limit", 1)
    if unknown := options.options.keys() - {"port", "hop_limit"}:
        raise InstrumentError(f"{options.name}: udp_multicast takes port and hop_limit, not {', '.join(unknown)}")
    try:
        bus = GeneralPurposeUdpMulticastBus(str(options.channel), port, hop_limit)
    except Exception as error:  # a driver raises whatever it likes
        raise cannot_be_opened(options, error) from error
    return MulticastIntake(options, clock, socket.socket(fileno=os.dup(bus.fileno())), bus)
