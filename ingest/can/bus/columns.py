"""Frames of a CAN interface as columns with times at the station, and counts of everything that is no data frame."""

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from operator import attrgetter, index
from typing import Any

import numpy as np
import numpy.typing as npt

from ingest.can.frames import EXTENDED, MOST_BYTES
from ingest.station_clock import StationClock
from stream.batch import BoolArray, FloatArray, IntArray

_SAME_CLOCK_S = 60.0  # an older stamp is of another clock than the computer's
_AHEAD_S = 1.0  # no frame is received before it was sent
_CLASSIC_BYTES = 8

# linux/can.h: struct can_frame (16 bytes) and canfd_frame (72 bytes)
_CAN_MTU, _CANFD_MTU = 16, 72
_KERNEL_FRAME = np.dtype([("id", "=u4"), ("length", "u1"), ("_", "u1", 3), ("data", "u1", 64)])
_REMOTE, _ERROR, _29_BITS, _11_BITS = 0x40000000, 0x20000000, 0x1FFFFFFF, 0x7FF

# linux/can/error.h: class of an error in the identifier, state of the controller in data[1]
_CONTROLLER, _BUS_OFF = 0x004, 0x040
_RX_OVERFLOW, _PASSIVE, _ACTIVE = 0x01, 0x30, 0x40


@dataclass(frozen=True)
class FrameColumns:
    """Data frames as an interface gave them, and counts of the others."""

    stamps_s: FloatArray  # shape (n,); time stamps of the interface, seconds
    arbitration_id: npt.NDArray[np.uint32]
    length: npt.NDArray[np.uint8]
    data: npt.NDArray[np.uint8]
    error_frames: int = 0
    remote_frames: int = 0
    malformed: int = 0
    overflows: int = 0  # error frames that report lost frames of the controller
    overruns: int = 0  # frames that the operating system dropped before they were read
    is_off: bool | None = None  # last state of the controller in error frames; None if they report none
    is_passive: bool | None = None

    def __len__(self) -> int:
        return len(self.stamps_s)


def message_columns(messages: Sequence[Any], most_bytes: int, stamps_s: FloatArray | None = None) -> FrameColumns:
    """Put messages of python-can, or objects with their attributes, into columns.

    Frames with more than `most_bytes`, 8, or 64 with CAN FD, are malformed. `stamps_s` take the place of their own.
    """
    try:
        return _columns(messages, most_bytes, _stamps(messages) if stamps_s is None else stamps_s)
    except (TypeError, ValueError, OverflowError, AttributeError):
        is_sound = np.array([_can_be_read(message) for message in messages], np.bool_)
        sound = [message for message, good in zip(messages, is_sound, strict=True) if good]
        kept_s = _stamps(sound) if stamps_s is None else stamps_s[is_sound]
        columns = _columns(sound, most_bytes, kept_s)
        return replace(columns, malformed=columns.malformed + len(messages) - len(sound))


def kernel_columns(frames: Sequence[bytes], stamps_s: FloatArray, most_bytes: int) -> FrameColumns:
    """Put frames of Linux (`struct can_frame` or `canfd_frame`) into columns, error frames read as well."""
    is_whole = np.array([len(frame) in {_CAN_MTU, _CANFD_MTU} for frame in frames], np.bool_)
    padded = b"".join(frame.ljust(_CANFD_MTU, b"\0") for frame in frames if len(frame) in {_CAN_MTU, _CANFD_MTU})
    table = np.frombuffer(padded, _KERNEL_FRAME)
    identifier, lengths, data = table["id"], table["length"], table["data"]
    is_error, is_remote = (identifier & _ERROR) != 0, (identifier & _REMOTE) != 0
    is_extended = (identifier & EXTENDED) != 0
    ids = np.where(is_extended, identifier & (EXTENDED | _29_BITS), identifier & _11_BITS).astype(np.uint32)
    kept = ~is_error & ~is_remote
    is_sound = lengths[kept] <= most_bytes
    kept[kept] = is_sound
    found = data[kept]
    found[np.arange(MOST_BYTES) >= lengths[kept][:, None]] = 0  # the kernel leaves old bytes there
    is_classic = not len(found) or lengths[kept].max() <= _CLASSIC_BYTES
    columns = FrameColumns(
        stamps_s[is_whole][kept], ids[kept], lengths[kept], found[:, :_CLASSIC_BYTES] if is_classic else found,
        error_frames=int(is_error.sum()), remote_frames=int((is_remote & ~is_error).sum()),
        malformed=len(frames) - len(table) + int((~is_sound).sum()),
    )  # fmt: skip
    return _with_errors(columns, [(int(ids[i]), bytes(data[i, :8])) for i in np.flatnonzero(is_error)])


def socket_stamps(ancillary: Sequence[Sequence[tuple[int, int, bytes]]], timestamp: int) -> FloatArray:
    """Time stamps that Linux sends with datagrams (SO_TIMESTAMPNS), seconds; 0 for none."""
    stamps_s = np.zeros(len(ancillary))
    for i, parts in enumerate(ancillary):
        for _, kind, payload in parts:
            if kind == timestamp:
                seconds, nanoseconds = struct.unpack("@ll", payload)
                stamps_s[i] = seconds + nanoseconds * 1e-9
    return stamps_s


def _stamps(messages: Sequence[Any]) -> FloatArray:
    return np.fromiter(map(attrgetter("timestamp"), messages), np.float64, len(messages))


def _columns(messages: Sequence[Any], most_bytes: int, stamps_s: FloatArray) -> FrameColumns:
    n = len(messages)
    ids = np.fromiter(map(attrgetter("arbitration_id"), messages), np.int64, n)
    flags = ("is_extended_id", "is_error_frame", "is_remote_frame")
    is_extended, is_error, is_remote = (np.fromiter(map(attrgetter(name), messages), np.bool_, n) for name in flags)
    payloads = list(map(attrgetter("data"), messages))
    lengths = np.fromiter(map(len, payloads), np.int64, n)
    is_data = ~(is_error | is_remote)
    is_sound = (lengths <= most_bytes) & (ids >= 0) & (ids <= np.where(is_extended, _29_BITS, _11_BITS))
    kept = is_data & is_sound
    if not kept.all():
        payloads = [payloads[i] for i in np.flatnonzero(kept)]
    return FrameColumns(
        stamps_s[kept], (ids[kept] | np.where(is_extended[kept], EXTENDED, 0)).astype(np.uint32),
        lengths[kept].astype(np.uint8), _bytes(payloads, lengths[kept]), error_frames=int(is_error.sum()),
        remote_frames=int((is_remote & ~is_error).sum()), malformed=int((is_data & ~is_sound).sum()),
    )  # fmt: skip


def _bytes(payloads: Sequence[bytes], lengths: npt.NDArray[np.int64]) -> npt.NDArray[np.uint8]:
    """Data of frames side by side, shape (n, 8) or (n, 64)."""
    width = _CLASSIC_BYTES if not len(lengths) or lengths.max() <= _CLASSIC_BYTES else MOST_BYTES
    flat = np.frombuffer(b"".join(payloads), np.uint8)
    if len(flat) == width * len(payloads):
        return flat.reshape(-1, width)
    data = np.zeros((len(payloads), width), np.uint8)
    inside: BoolArray = np.arange(width) < lengths[:, None]
    data[inside] = flat
    return data


def _can_be_read(message: Any) -> bool:
    try:
        return (
            abs(index(message.arbitration_id)) <= EXTENDED
            and memoryview(message.data).nbytes == len(message.data)
            and {message.is_extended_id, message.is_error_frame, message.is_remote_frame} <= {True, False}
            and isinstance(getattr(message, "timestamp", 0.0), Real)
        )
    except (TypeError, ValueError, AttributeError):
        return False


def _with_errors(columns: FrameColumns, errors: Sequence[tuple[int, bytes]]) -> FrameColumns:
    """Add what error frames of Linux report about the controller."""
    states = [data[1] for kind, data in errors if kind & _CONTROLLER]
    passive = [bool(state & _PASSIVE) for state in states if state & (_PASSIVE | _ACTIVE)]
    return replace(
        columns, overflows=sum(bool(state & _RX_OVERFLOW) for state in states),
        is_off=any(kind & _BUS_OFF for kind, _ in errors) or None, is_passive=passive[-1] if passive else None,
    )  # fmt: skip


class ReceiveClock:
    """Receive times of one opened interface.

    Interfaces stamp in seconds since 1970, in seconds since they were switched on, or not at all; the first frames
    show which. A counter of the interface's own is set to the station's clock once, so that intervals between frames
    stay those of the hardware; without a stamp a frame has the time at which it was read. If the stamps leave the
    station's clock later, because either was set, this is reported and they are set to it again.

    >>> clock = ReceiveClock(StationClock(start_ns=0, origin_s=1000.0), print)
    >>> clock.times_ns(np.array([7.0, 7.25]), read_s=1000.5).tolist(), clock.source
    ([250000000, 500000000], 'the interface, counted from its own start')
    """

    def __init__(self, clock: StationClock, report: Callable[[str], None]) -> None:
        self._clock, self._report = clock, report
        self._offset_s: float | None = None
        self.source = "no frame yet"

    def now_s(self) -> float:
        """The station's time on the computer's clock, seconds since 1970, without steps of that clock."""
        return self._clock.origin_s + (self._clock.now_ns() - self._clock.start_ns) / (1e9 * self._clock.speed)

    def times_ns(self, stamps_s: FloatArray, read_s: float) -> IntArray:
        """Times of reception, nanoseconds at the station, from an interface's stamps (0 or NaN for none), seconds."""
        is_stamped = np.isfinite(stamps_s) & (stamps_s > 0.0)
        moments_s = np.full(len(stamps_s), read_s)
        if is_stamped.any():
            stamped = stamps_s[is_stamped]
            moments_s[is_stamped] = stamped + self._offset_to(float(stamped[-1]), read_s)
        elif self._offset_s is None:
            self.source = "the computer, when a frame was read"
        elapsed_ns = (moments_s - self._clock.origin_s) * self._clock.speed * 1e9
        return self._clock.start_ns + np.rint(elapsed_ns).astype(np.int64)

    def _offset_to(self, stamp_s: float, read_s: float) -> float:
        """From stamps to the computer's clock, seconds."""
        if self._offset_s is None:
            is_of_day = -_AHEAD_S <= read_s - stamp_s <= _SAME_CLOCK_S
            self._offset_s = 0.0 if is_of_day else read_s - stamp_s
            self.source = "the interface, " + ("time of day" if is_of_day else "counted from its own start")
        behind_s = read_s - stamp_s - self._offset_s
        if not -_AHEAD_S <= behind_s <= _SAME_CLOCK_S:
            self._offset_s = read_s - stamp_s
            self._report(
                f"its time stamps are {abs(behind_s):.3f} s {'behind' if behind_s > 0 else 'ahead of'} the station's "
                f"clock all at once; they are set to it again, and times jump here"
            )
        return self._offset_s
