"""CAN frames in blocks of columns, and their identifiers."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from stream.batch import IntArray

EXTENDED = 1 << 31
MOST_BYTES = 64
IdArray = npt.NDArray[np.uint32]

_SHORTEST_EXTENDED = 0x800
_IDS_NAMED = 8


class CanFrame(NamedTuple):
    """One data frame; `arbitration_id` has bit 31 set if it is of 29 bits."""

    t_ns: int
    channel: int
    arbitration_id: int
    data: bytes


@dataclass(frozen=True)
class FrameBlock:
    """Data frames in the order of reception."""

    t_ns: IntArray  # shape (n,); time of reception, nanoseconds
    channel: npt.NDArray[np.int16]  # shape (n,); channel of the interface or log
    arbitration_id: IdArray  # shape (n,); bit 31 is set if it is of 29 bits
    length: npt.NDArray[np.uint8]  # shape (n,); bytes of data
    data: npt.NDArray[np.uint8]  # shape (n, 8) or (n, 64); bytes beyond a frame's length are 0

    def __len__(self) -> int:
        return len(self.t_ns)


def frame_block(frames: Sequence[CanFrame]) -> FrameBlock:
    """Put frames into columns."""
    lengths = np.array([len(frame.data) for frame in frames], np.uint8)
    width = 8 if not len(lengths) or lengths.max() <= 8 else MOST_BYTES
    joined = b"".join(frame.data.ljust(width, b"\0") for frame in frames)
    return FrameBlock(
        np.array([frame.t_ns for frame in frames], np.int64),
        np.array([frame.channel for frame in frames], np.int16),
        np.array([frame.arbitration_id for frame in frames], np.uint32),
        lengths,
        np.frombuffer(joined, np.uint8).reshape(len(frames), width),
    )


def arbitration_id(identifier: int, *, is_extended: bool) -> int:
    """An identifier with bit 31 set if it is of 29 bits, as any beyond 0x7FF must be."""
    return identifier | EXTENDED if is_extended or identifier >= _SHORTEST_EXTENDED else identifier


def id_text(identifier: int) -> str:
    """An arbitration id for people: ``0x024``, or ``0x17F00010`` if it is of 29 bits."""
    return f"0x{identifier & ~EXTENDED:08X}" if identifier & EXTENDED else f"0x{identifier:03X}"


def ids_text(identifiers: Iterable[int]) -> str:
    """The first of some arbitration ids, for people."""
    named = [id_text(identifier) for identifier in islice(identifiers, _IDS_NAMED + 1)]
    return ", ".join([*named[:_IDS_NAMED], "..."] if len(named) > _IDS_NAMED else named)


def pgn_keys(identifiers: IdArray) -> IdArray:
    """J1939: 29-bit identifiers without priority, source address and, in PDU format 1, destination address.

    >>> [hex(key) for key in pgn_keys(np.array([0x98F00421, 0x8CF004FE, 0x98EA0021], np.uint32))]
    ['0x80f00400', '0x80f00400', '0x80ea0000']
    """
    is_pdu1 = (identifiers >> np.uint32(16)) & np.uint32(0xFF) < 240
    return identifiers & np.where(is_pdu1, np.uint32(0x83FF0000), np.uint32(0x83FFFF00))


def pgn_key(identifier: int) -> int:
    """`pgn_keys` of one identifier."""
    return identifier & (0x83FF0000 if identifier >> 16 & 0xFF < 240 else 0x83FFFF00)
