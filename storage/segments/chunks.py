"""Records of a segment in memory: where the next one ends, whether a chunk is intact, and its messages."""

import mmap
import struct
import zlib
from functools import lru_cache
from io import BytesIO
from typing import NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel

from storage.segments.records import (
    CHUNK,
    CHUNK_BYTES,
    COMPRESSION,
    FRAME,
    MESSAGE,
    SCHEMA_IDS,
    ChannelIndex,
    ChunkHead,
    LogRecord,
    SegmentSummary,
)
from stream.bounds import MAX_MESSAGE_BYTES
from stream.errors import OutOfMemory

Buffer = bytes | mmap.mmap

MAX_CONTENT_BYTES = CHUNK_BYTES + 2 * MAX_MESSAGE_BYTES  # of a chunk; older versions wrote longer messages
_SCHEMAS = {number: name for name, number in SCHEMA_IDS.items()}
_NUMBER = struct.Struct("<H")  # of its channel, at the begin of a message
_ZSTD_HEAD_BYTES = 18  # at most, RFC 8878 section 3.1.1
# bytes at a fixed offset in every chunk
_NEEDLE = struct.pack("<I", len(COMPRESSION)) + COMPRESSION
_NEEDLE_AT = CHUNK.size - 8 - len(_NEEDLE)


class Chunk(NamedTuple):
    """An intact chunk at byte `begin`, and its decompressed content."""

    begin: int
    head: ChunkHead
    content: bytes


def frame_at(content: Buffer, position: int, end: int) -> tuple[int, int] | None:
    """Opcode and end of the record at `position`, if there may be a whole one."""
    if position + FRAME.size > end:
        return None
    opcode, length = FRAME.unpack_from(content, position)
    after = position + FRAME.size + length
    return (opcode, after) if Opcode.HEADER <= opcode <= Opcode.DATA_END and after <= end else None


def is_plain(content: Buffer, position: int, opcode: int, after: int) -> bool:
    """Whether a frame other than a chunk is plausible: a flipped bit can make a chunk another, longer record."""
    if opcode == Opcode.MESSAGE_INDEX:
        size = after - position - FRAME.size - 6
        return bool(size >= 0 and struct.unpack_from("<I", content, position + FRAME.size + 2)[0] == size)
    if opcode == Opcode.DATA_END:
        return after - position == FRAME.size + 4
    return opcode in {Opcode.HEADER, Opcode.SCHEMA, Opcode.METADATA} and next_chunk(content, position, after) is None


def chunk_at(content: Buffer, position: int, end: int) -> Chunk | None:
    """The chunk at `position`, if there is an intact one."""
    if position < 0 or position + CHUNK.size > end:
        return None
    opcode, length, first_ns, last_ns, size, crc, named, compression, packed = CHUNK.unpack_from(content, position)
    begin = position + CHUNK.size
    is_chunk = (opcode, named, compression) == (Opcode.CHUNK, len(COMPRESSION), COMPRESSION)
    if not is_chunk or length != CHUNK.size - FRAME.size + packed or packed > end - begin:
        return None
    if size > MAX_CONTENT_BYTES:
        return None  # no version writes so much
    try:
        if zstandard.frame_content_size(content[begin : begin + min(packed, _ZSTD_HEAD_BYTES)]) != size:
            return None  # before allocating
        data = zstandard.decompress(content[begin : begin + packed])
    except (zstandard.ZstdError, OverflowError):
        return None
    except MemoryError as error:
        raise OutOfMemory(
            f"not enough memory for {size:,} bytes of a log segment, which may be intact; free some and try again"
        ) from error
    if len(data) != size or zlib.crc32(data) != crc:
        return None
    return Chunk(position, ChunkHead(first_ns, last_ns, size, crc, packed), data)


def next_chunk(content: Buffer, position: int, end: int) -> int | None:
    """Begin of the next intact chunk from `position` on."""
    found = position - 1
    while (found := content.find(_NEEDLE, found + 1, end)) >= 0:
        if found - _NEEDLE_AT >= position and chunk_at(content, found - _NEEDLE_AT, end) is not None:
            return found - _NEEDLE_AT
    return None


MessageSpan = tuple[str, str, int, int, int, int, int]
"""Topic, schema and both times of a message, where its data begin and end in a chunk, the number of its channel."""


def spans_of(
    content: bytes, channels: dict[int, tuple[str, str]], own: dict[int, Channel] | None = None
) -> list[MessageSpan]:
    """Places of the messages in a chunk's content; adds its channels to `channels` and `own`.

    Raises a ValueError, and adds nothing, if the content is none, although its checksum holds.
    """
    found: list[MessageSpan] = []
    add = found.append
    names, fresh = dict(channels), {}
    position, end = 0, len(content)
    unpack, frame, head = MESSAGE.unpack_from, FRAME.unpack_from, MESSAGE.size
    opcode_of_messages = int(Opcode.MESSAGE)
    try:
        while position < end:
            if content[position] == opcode_of_messages:
                _, length, number, _, log_time, publish_time = unpack(content, position)
                after = position + FRAME.size + length
                if after < position + head:
                    raise ValueError("it is shorter than its head")
                topic, schema = names[number]
                add((topic, schema, log_time, publish_time, position + head, after, number))
                position = after
                continue
            opcode, length = frame(content, position)
            after = position + FRAME.size + length
            if opcode == Opcode.CHANNEL:
                channel = _channel(content[position + FRAME.size : after])
                names[channel.id] = _topic(channel)
                fresh[channel.id] = channel
            position = after
    except (McapError, struct.error, KeyError, ValueError, MemoryError, OverflowError) as error:
        raise ValueError(f"the record at byte {position} of a chunk cannot be read: {error}") from error
    if position != end:
        raise ValueError(f"the last record of a chunk ends {position - end:,} bytes beyond it")
    channels.update((number, names[number]) for number in fresh)
    if own is not None:
        own.update(fresh)
    return found


def messages_of(
    content: bytes, channels: dict[int, tuple[str, str]], index: ChannelIndex | None = None,
    summary: SegmentSummary | None = None,
) -> list[LogRecord]:  # fmt: skip
    """Messages of a chunk's content; adds its channels to `channels` and the places of messages to `index`.

    Raises a ValueError, and adds nothing, if the content is none, although its checksum holds.
    """
    own: dict[int, Channel] = {}
    spans = spans_of(content, channels, own)
    if index is not None:
        for number in own:
            index.setdefault(number, [])
        for _, _, arrival_ns, _, begin, _, number in spans:
            index.setdefault(number, []).extend((arrival_ns, begin - MESSAGE.size))
        if summary is not None:
            summary.channels.update(own)
    return [
        LogRecord(topic, schema, arrival_ns, publish_ns, content[begin:end])
        for topic, schema, arrival_ns, publish_ns, begin, end, _ in spans
    ]


def _topic(channel: Channel) -> tuple[str, str]:
    """Topic and schema of a channel; KeyError if there is no such schema."""
    return channel.topic, _SCHEMAS[channel.schema_id]


@lru_cache(maxsize=100_000)
def _channel(record: bytes) -> Channel:
    """A channel; every chunk has those of its messages again."""
    channel: Channel = Channel.read(ReadDataStream(BytesIO(record)))
    return channel
