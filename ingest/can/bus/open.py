"""How a CAN interface is configured and opened, and what to do where it cannot be."""

import contextlib
from collections.abc import Collection
from typing import TYPE_CHECKING, Any

import msgspec

from ingest.can.frames import EXTENDED
from stream.errors import InstrumentError

if TYPE_CHECKING:
    from can import BusABC

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
    """One CAN bus, as a station file says it.

    Parameters
    ----------
    interface: As python-can calls it: socketcan, kvaser, pcan, vector, slcan, virtual, udp_multicast, ...
    channel: As the interface calls it: can0, PCAN_USBBUS1, 0, /dev/ttyACM0, 239.74.163.2, ...
    number: Channel number that the bus' frames have, for a mapping that tells buses apart.
    bitrate: Bits per second. That of socketcan is set with `ip link` instead.
    fd: Whether frames of CAN FD, with up to 64 bytes, are expected.
    data_bitrate: Bits per second in the data phase of CAN FD.
    filter: Whether the interface, if it can, is asked for mapped identifiers only. Frames of others are then not
        counted.
    options: Whatever else python-can takes for this interface.

    Examples
    --------
    >>> msgspec.convert({"interface": "socketcan", "channel": "can0"}, CanBusOptions).name
    'CAN bus socketcan can0'
    """

    interface: str
    channel: str | int
    number: int = 0
    bitrate: int | None = None
    fd: bool = False
    data_bitrate: int | None = None
    filter: bool = True
    options: dict[str, Any] = {}

    @property
    def name(self) -> str:
        """What messages call it."""
        return f"CAN bus {self.interface} {self.channel}"

    @property
    def most_bytes(self) -> int:
        """Most data of a frame, bytes."""
        return 64 if self.fd else 8


def open_bus(options: CanBusOptions) -> "BusABC":
    """Open an interface through python-can; no configuration file of python-can's is read.

    Raises
    ------
    InstrumentError: If python-can, the interface or its driver is missing, or the interface refuses.
    """
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
    """What to tell where opening failed."""
    advice = _ADVICE.get(options.interface, "see python-can's page on this interface for its driver and channels")
    return InstrumentError(
        f"{options.name} cannot be opened: {type(error).__name__}: {error}; {advice}. "
        f"Is it plugged in, and are channel, bit rates and options right?"
    )


def filter_in_interface(bus: "BusABC", wanted: Collection[int]) -> bool:
    """Ask the interface for these identifiers (bit 31 set where of 29 bits) only; whether it has taken it.

    The hook is called instead of `set_filters`, which filters in Python wherever the hardware cannot: one comparison
    per frame and identifier, error frames are dropped, and nothing is counted.
    """
    import can

    if type(bus)._apply_filters is can.BusABC._apply_filters or not 0 < len(wanted) <= _MOST_FILTERS:  # noqa: SLF001
        return False
    filters: list[Any] = [
        {
            "can_id": each & ~EXTENDED,
            "can_mask": 0x1FFFFFFF if each & EXTENDED else 0x7FF,
            "extended": bool(each & EXTENDED),
        }
        for each in sorted(wanted)
    ]
    with contextlib.suppress(Exception):  # all frames are read then, and filtered here
        bus._apply_filters(filters)  # noqa: SLF001
        return True
    return False
