"""CAN frames in blocks: columns instead of objects, so that a hundred thousand a second can be decoded."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from stream.batch import IntArray

EXTENDED = 1 << 31
MOST_BYTES = 64


class Frame(NamedTuple):
    """One data frame; `arbitration_id` has bit 31 set where it is of 29 bits."""

    t_ns: int
    channel: int
    arbitration_id: int
    data: bytes


@dataclass(frozen=True)
class FrameBlock:
    """Data frames in the order in which they were received.

    Attributes
    ----------
    t_ns: shape (n,); when each was received, nanoseconds.
    channel: shape (n,); on which channel of the interface or log.
    arbitration_id: shape (n,); bit 31 is set where it is of 29 bits.
    length: shape (n,); bytes of data.
    data: shape (n, 8) or (n, 64); bytes beyond a frame's length are 0.
    """

    t_ns: IntArray
    channel: npt.NDArray[np.int16]
    arbitration_id: npt.NDArray[np.uint32]
    length: npt.NDArray[np.uint8]
    data: npt.NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.t_ns)


def frame_block(frames: Sequence[Frame]) -> FrameBlock:
    """Put frames into columns.

    Examples
    --------
    >>> block = frame_block([Frame(10, 0, 0x123, bytes([1, 2])), Frame(20, 1, 0x1ABCDEF | EXTENDED, bytes(8))])
    >>> block.length.tolist(), block.data.shape, hex(block.arbitration_id[1])
    ([2, 8], (2, 8), '0x81abcdef')
    """
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
