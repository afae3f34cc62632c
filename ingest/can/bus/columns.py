"""What a CAN interface gives, in columns: data frames, and counts of all that is none."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from numbers import Real
from operator import attrgetter, index
from typing import Any

import numpy as np
import numpy.typing as npt

from ingest.can.frames import EXTENDED, MOST_BYTES
from stream.batch import BoolArray, FloatArray

_CLASSIC_BYTES = 8
_FIELDS = ("arbitration_id", "is_extended_id", "is_error_frame", "is_remote_frame")

# linux/can.h: struct can_frame (16 bytes) and canfd_frame (72 bytes)
_CAN_MTU, _CANFD_MTU = 16, 72
_KERNEL_FRAME = np.dtype([("id", "=u4"), ("length", "u1"), ("_", "u1", 3), ("data", "u1", 64)])
_REMOTE, _ERROR, _29_BITS, _11_BITS = 0x40000000, 0x20000000, 0x1FFFFFFF, 0x7FF

# linux/can/error.h: class of an error in the identifier, state of the controller in data[1]
_CONTROLLER, _BUS_OFF = 0x004, 0x040
_RX_OVERFLOW, _PASSIVE, _ACTIVE = 0x01, 0x30, 0x40


@dataclass(frozen=True)
class Columns:
    """Data frames as an interface gave them, and how many others it gave beside them.

    Attributes
    ----------
    stamps_s: shape (n,); as the interface stamps, seconds.
    arbitration_id, length, data: As in `FrameBlock`.
    error_frames, remote_frames, malformed: What came beside data frames.
    overflows: Error frames that tell of a controller which lost frames.
    is_off, is_passive: What error frames told last about the controller; None if they told nothing.
    """

    stamps_s: FloatArray
    arbitration_id: npt.NDArray[np.uint32]
    length: npt.NDArray[np.uint8]
    data: npt.NDArray[np.uint8]
    error_frames: int = 0
    remote_frames: int = 0
    malformed: int = 0
    overflows: int = 0
    is_off: bool | None = None
    is_passive: bool | None = None

    def __len__(self) -> int:
        return len(self.stamps_s)


def message_columns(messages: Sequence[Any], most_bytes: int, stamps_s: FloatArray | None = None) -> Columns:
    """Put messages of python-can, or what has their attributes, into columns.

    Parameters
    ----------
    messages: As received.
    most_bytes: Most data of a frame on this bus, bytes: 8, or 64 with CAN FD. Frames with more are malformed.
    stamps_s: shape (n,); where given, instead of the messages' own stamps.

    Examples
    --------
    >>> from can import Message
    >>> columns = message_columns([Message(timestamp=2.5, arbitration_id=0x11, data=[1]), Message(data=bytes(9))], 8)
    >>> hex(columns.arbitration_id[0]), columns.data.tolist(), columns.malformed
    ('0x80000011', [[1, 0, 0, 0, 0, 0, 0, 0]], 1)
    """
    try:
        return _columns(messages, most_bytes, _stamps(messages) if stamps_s is None else stamps_s)
    except (TypeError, ValueError, OverflowError, AttributeError):
        is_sound = np.array([_can_be_read(message) for message in messages], np.bool_)
        sound = [message for message, good in zip(messages, is_sound, strict=True) if good]
        kept_s = _stamps(sound) if stamps_s is None else stamps_s[is_sound]
        columns = _columns(sound, most_bytes, kept_s)
        return replace(columns, malformed=columns.malformed + len(messages) - len(sound))


def kernel_columns(frames: Sequence[bytes], stamps_s: FloatArray, most_bytes: int) -> Columns:
    """Put frames as Linux gives them (`struct can_frame` or `canfd_frame`) into columns, error frames read as well."""
    is_whole = np.fromiter((len(frame) in {_CAN_MTU, _CANFD_MTU} for frame in frames), np.bool_, len(frames))
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
    found[np.arange(MOST_BYTES) >= lengths[kept][:, None]] = 0  # the kernel leaves there what it had
    columns = Columns(
        stamps_s[is_whole][kept],
        ids[kept],
        lengths[kept],
        found[:, :_CLASSIC_BYTES] if not len(found) or lengths[kept].max() <= _CLASSIC_BYTES else found,
        error_frames=int(is_error.sum()),
        remote_frames=int((is_remote & ~is_error).sum()),
        malformed=len(frames) - len(table) + int((~is_sound).sum()),
    )
    return _told_by_errors(columns, [(int(ids[i]), bytes(data[i, :8])) for i in np.flatnonzero(is_error)])


def socket_stamps(ancillary: Sequence[Sequence[tuple[int, int, bytes]]], timestamp: int) -> FloatArray:
    """Stamps that Linux sends along with datagrams (SO_TIMESTAMPNS), seconds; 0 where it sent none."""
    stamps_s = np.zeros(len(ancillary))
    for i, parts in enumerate(ancillary):
        for _, kind, payload in parts:
            if kind == timestamp:
                seconds, nanoseconds = struct.unpack("@ll", payload)
                stamps_s[i] = seconds + nanoseconds * 1e-9
    return stamps_s


def _stamps(messages: Sequence[Any]) -> FloatArray:
    return np.fromiter(map(attrgetter("timestamp"), messages), np.float64, len(messages))


def _columns(messages: Sequence[Any], most_bytes: int, stamps_s: FloatArray) -> Columns:
    n = len(messages)
    ids = np.fromiter(map(attrgetter("arbitration_id"), messages), np.int64, n)
    is_extended, is_error, is_remote = (
        np.fromiter(map(attrgetter(name), messages), np.bool_, n) for name in _FIELDS[1:]
    )
    payloads = list(map(attrgetter("data"), messages))
    lengths = np.fromiter(map(len, payloads), np.int64, n)
    is_data = ~(is_error | is_remote)
    is_sound = (lengths <= most_bytes) & (ids >= 0) & (ids <= np.where(is_extended, _29_BITS, _11_BITS))
    kept = is_data & is_sound
    if not kept.all():
        payloads = [payloads[i] for i in np.flatnonzero(kept)]
    return Columns(
        stamps_s[kept],
        (ids[kept] | np.where(is_extended[kept], EXTENDED, 0)).astype(np.uint32),
        lengths[kept].astype(np.uint8),
        _bytes(payloads, lengths[kept]),
        error_frames=int(is_error.sum()),
        remote_frames=int((is_remote & ~is_error).sum()),
        malformed=int((is_data & ~is_sound).sum()),
    )


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


def _told_by_errors(columns: Columns, errors: Sequence[tuple[int, bytes]]) -> Columns:
    """Add what error frames of Linux say about the controller."""
    is_off: bool | None = None
    is_passive: bool | None = None
    overflows = 0
    for kind, data in errors:
        if kind & _BUS_OFF:
            is_off = True
        if kind & _CONTROLLER:
            overflows += bool(data[1] & _RX_OVERFLOW)
            if data[1] & (_PASSIVE | _ACTIVE):
                is_passive = bool(data[1] & _PASSIVE)
    return replace(columns, overflows=overflows, is_off=is_off, is_passive=is_passive)
