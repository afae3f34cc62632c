"""Frames of a spool file: numbered messages one after the other, each with a checksum.

A frame is a head (mark, CRC-32, length, stream number, first and next number) and its payload. The CRC covers all
that follows it. After a damaged frame, reading resumes at the next mark of a sound frame.
"""

import math
import struct
import zlib
from typing import NamedTuple

TABLE = 0
ACKNOWLEDGED = 1
FIRST_STREAM = 2

_MARK = b"GFsp"
_REST = struct.Struct("<IIqq")
_HEAD = struct.Struct("<4sIIIqq")


class SpoolFrame(NamedTuple):
    """One frame: a message of a stream, or, with a number below FIRST_STREAM, the state of the streams."""

    number: int
    seq: int
    next_seq: int
    payload: bytes


class Parsed(NamedTuple):
    """Contents of a piece of a spool file: sound frames, how far they reach, damaged spans, bytes of a torn end."""

    frames: list[SpoolFrame]
    used: int
    damaged: list[tuple[int, int]]
    torn: int


def encode_frame(number: int, seq: int, next_seq: int, payload: bytes) -> bytes:
    """A frame as bytes."""
    rest = _REST.pack(len(payload), number, seq, next_seq)
    return b"".join((_MARK, zlib.crc32(payload, zlib.crc32(rest)).to_bytes(4, "little"), rest, payload))


def parse_frames(data: bytes, *, is_end: bool, most_bytes: float = math.inf) -> Parsed:
    """Read a piece of a spool file that begins with a frame.

    If it does not reach the end of the file (`is_end`), reading stops, at `used`, at the first frame that is not sound.
    It also stops where payloads of `most_bytes` are read, at one frame at least.

    >>> data = bytearray(encode_frame(2, 0, 1, b"one") + encode_frame(2, 1, 2, b"two"))
    >>> data[33] ^= 1
    >>> found = parse_frames(bytes(data), is_end=True)
    >>> found.frames, found.damaged, found.torn
    ([SpoolFrame(number=2, seq=1, next_seq=2, payload=b'two')], [(0, 35)], 0)
    """
    frames: list[SpoolFrame] = []
    damaged: list[tuple[int, int]] = []
    at, torn, size = 0, 0, 0
    while at < len(data) and size < most_bytes:
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
        size += len(frame.payload)
        at += _HEAD.size + len(frame.payload)
    return Parsed(frames, at, damaged, torn)


def _frame_at(data: bytes, at: int) -> SpoolFrame | None:
    if at + _HEAD.size > len(data):
        return None
    mark, checksum, length, number, seq, next_seq = _HEAD.unpack_from(data, at)
    end = at + _HEAD.size + length
    if mark != _MARK or end > len(data):
        return None
    payload = data[at + _HEAD.size : end]
    if zlib.crc32(payload, zlib.crc32(data[at + 8 : at + _HEAD.size])) != checksum:
        return None
    return SpoolFrame(number, seq, next_seq, payload)


def _next_frame(data: bytes, at: int) -> int:
    while (at := data.find(_MARK, at)) >= 0:
        if _frame_at(data, at) is not None:
            return at
        at += 1
    return len(data)


def _is_cut_off(data: bytes, at: int) -> bool:
    """Whether the rest is the beginning of a frame, as an interrupted write leaves it."""
    left = data[at : at + _HEAD.size]
    if len(left) < _HEAD.size:
        return left[:4] == _MARK[: len(left)]
    mark, _, length, *_ = _HEAD.unpack(left)
    return bool(mark == _MARK and at + _HEAD.size + length > len(data))
