"""Frames of a spool file: numbered messages one after the other, each with a checksum.

A frame is a head (mark, CRC-32, length, stream number, first and next number) and its payload. The CRC covers all
that follows it. What follows a damaged frame is found again by the next mark whose frame is whole.
"""

import struct
import zlib
from typing import NamedTuple

TABLE = 0
ACKNOWLEDGED = 1
FIRST_STREAM = 2

_MARK = b"GFsp"
_REST = struct.Struct("<IIqq")
_HEAD = struct.Struct("<4sIIIqq")


class Frame(NamedTuple):
    """One frame: a message of a stream, or, under the numbers below FIRST_STREAM, what is known of the streams."""

    number: int
    seq: int
    next_seq: int
    payload: bytes


class Parsed(NamedTuple):
    """What a piece of a spool file holds: whole frames, how far they reach, damaged spans, bytes of a torn end."""

    frames: list[Frame]
    used: int
    damaged: list[tuple[int, int]]
    torn: int


def encode_frame(number: int, seq: int, next_seq: int, payload: bytes) -> bytes:
    """Put a frame into bytes.

    Examples
    --------
    >>> data = encode_frame(2, 0, 100, b"hello")
    >>> parse_frames(data, is_end=True).frames
    [Frame(number=2, seq=0, next_seq=100, payload=b'hello')]
    """
    rest = _REST.pack(len(payload), number, seq, next_seq)
    return b"".join((_MARK, zlib.crc32(payload, zlib.crc32(rest)).to_bytes(4, "little"), rest, payload))


def parse_frames(data: bytes, *, is_end: bool) -> Parsed:
    """Take a piece of a spool file apart.

    Parameters
    ----------
    data: The piece; it begins with a frame.
    is_end: Whether it reaches to the end of the file. If not, it is left at the first frame that is not whole, be it
        cut off or damaged: `used` says where.

    Examples
    --------
    >>> data = bytearray(encode_frame(2, 0, 1, b"one") + encode_frame(2, 1, 2, b"two"))
    >>> data[33] ^= 1
    >>> found = parse_frames(bytes(data), is_end=True)
    >>> found.frames, found.damaged, found.torn
    ([Frame(number=2, seq=1, next_seq=2, payload=b'two')], [(0, 35)], 0)
    """
    frames: list[Frame] = []
    damaged: list[tuple[int, int]] = []
    at, torn = 0, 0
    while at < len(data):
        frame = _frame_at(data, at)
        if frame is None:
            if not is_end:
                break
            following = _next_frame(data, at + 1)
            if following == len(data) and _is_cut_off(data, at):
                torn = len(data) - at
            else:
                damaged.append((at, following))
            at = following
            continue
        frames.append(frame)
        at += _HEAD.size + len(frame.payload)
    return Parsed(frames, at, damaged, torn)


def _frame_at(data: bytes, at: int) -> Frame | None:
    if at + _HEAD.size > len(data):
        return None
    mark, checksum, length, number, seq, next_seq = _HEAD.unpack_from(data, at)
    end = at + _HEAD.size + length
    if mark != _MARK or end > len(data):
        return None
    payload = data[at + _HEAD.size : end]
    if zlib.crc32(payload, zlib.crc32(data[at + 8 : at + _HEAD.size])) != checksum:
        return None
    return Frame(number, seq, next_seq, payload)


def _next_frame(data: bytes, at: int) -> int:
    while (at := data.find(_MARK, at)) >= 0:
        if _frame_at(data, at) is not None:
            return at
        at += 1
    return len(data)


def _is_cut_off(data: bytes, at: int) -> bool:
    """Whether what is left is the beginning of a frame, as a write leaves it that did not come to its end."""
    left = data[at : at + _HEAD.size]
    if len(left) < _HEAD.size:
        return left[:4] == _MARK[: len(left)]
    mark, _, length, *_ = _HEAD.unpack(left)
    return bool(mark == _MARK and at + _HEAD.size + length > len(data))
