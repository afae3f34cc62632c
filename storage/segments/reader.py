"""Reading a segment, strictly or skipping damage; all CRCs are checked, which the library does not do by default."""

import mmap
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Metadata

from storage.segments.records import (
    CHECKSUM,
    CHUNK,
    CHUNK_BYTES,
    COMPRESSION,
    FRAME,
    MAGIC,
    MARKS,
    MESSAGE,
    SCHEMA_IDS,
    ChannelIndex,
    ChunkHead,
    LogRecord,
    SegmentSummary,
    checksum,
    encode_index,
    origin_of,
)
from stream.bounds import MAX_MESSAGE_BYTES
from stream.errors import OutOfMemory, StoreError

Buffer = bytes | mmap.mmap

_SCHEMAS = {number: name for name, number in SCHEMA_IDS.items()}
_HEAD_BYTES = 4096
MAX_CONTENT_BYTES = CHUNK_BYTES + 2 * MAX_MESSAGE_BYTES  # of a chunk; older versions wrote longer messages
_FOOTER_BYTES = FRAME.size + 8 + 8 + 4
_ZSTD_HEAD_BYTES = 18  # at most, RFC 8878 section 3.1.1
# bytes at a fixed offset in every chunk
_NEEDLE = struct.pack("<I", len(COMPRESSION)) + COMPRESSION
_NEEDLE_AT = CHUNK.size - 8 - len(_NEEDLE)
_DAMAGE = (McapError, ValueError, LookupError, EOFError, struct.error, zstandard.ZstdError, UnicodeDecodeError)


class ByteSpan(NamedTuple):
    """Bytes `begin` to `end` of a file."""

    begin: int
    end: int


class _Chunk(NamedTuple):
    begin: int
    head: ChunkHead
    content: bytes


def read_origin(path: Path) -> tuple[str, str] | None:
    """Identity of the store that wrote a segment, and the segment's number; None if its head lacks them."""
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
        opcode, length = FRAME.unpack_from(head, len(MAGIC))
        begin = len(MAGIC) + FRAME.size
        if head[: len(MAGIC)] != MAGIC or opcode != Opcode.HEADER or begin + length > len(head):
            return None
        library = Header.read(ReadDataStream(BytesIO(head[begin : begin + length]))).library
    except (*_DAMAGE, OSError):
        return None
    return origin_of(library)


def read_marks(path: Path) -> dict[str, str]:
    """Positions that streams reached in a sealed segment, from its end; StoreError if it is damaged there."""
    try:
        with _mapped(path) as content:
            found = _marks_in(content)
    except (*_DAMAGE, OSError) as error:
        raise StoreError(f"segment {path} is damaged ({type(error).__name__}: {error})") from error
    if found is None:
        raise StoreError(f"segment {path} carries no stream positions; was it written by gyrofleet?")
    if found.pop(CHECKSUM, None) != checksum(found):
        raise StoreError(f"segment {path} is damaged: the checksum of its stream positions does not match")
    return found


def _marks_in(content: Buffer) -> dict[str, str] | None:
    position = _end_of_data(content) + FRAME.size + 4
    while content[position] != Opcode.FOOTER:
        opcode, length = FRAME.unpack_from(content, position)
        if opcode == Opcode.METADATA_INDEX:
            (at,) = struct.unpack_from("<Q", content, position + FRAME.size)
            end = at + FRAME.size + FRAME.unpack_from(content, at)[1]
            metadata = Metadata.read(ReadDataStream(BytesIO(content[at + FRAME.size : end])))
            return dict(metadata.metadata) if metadata.name == MARKS else None
        position += FRAME.size + length
    return None


def read_segment(path: Path) -> Iterator[LogRecord]:
    """Messages of a sealed segment in their order, every CRC checked; StoreError if it is damaged."""
    channels: dict[int, tuple[str, str]] = {}
    try:
        with _mapped(path) as content:
            end = _end_of_data(content)
            position, crc = len(MAGIC), zlib.crc32(MAGIC)
            while position < end:
                opcode, length = FRAME.unpack_from(content, position)
                after = position + FRAME.size + length
                if opcode == Opcode.CHUNK:
                    chunk = _chunk_at(content, position, end)
                    if chunk is None:
                        raise ValueError(f"the chunk at byte {position} is damaged")
                    yield from _messages(chunk.content, channels)
                crc = zlib.crc32(content[position:after], crc)
                position = after
            if position != end or crc != struct.unpack_from("<I", content, end + FRAME.size)[0]:
                raise ValueError("the CRC of its data does not match")
    except (*_DAMAGE, OSError) as error:
        raise StoreError(
            f"segment {path} is damaged ({type(error).__name__}: {error}); `gyrofleet recover` saves its "
            "readable part, or restore it from a copy"
        ) from error


def _end_of_data(content: Buffer) -> int:
    """End of the data section, from the footer; ValueError if a CRC of summary or footer fails."""
    at = len(content) - len(MAGIC) - _FOOTER_BYTES
    if at < len(MAGIC) or content[: len(MAGIC)] != MAGIC or content[-len(MAGIC) :] != MAGIC:
        raise ValueError("it does not begin and end as an MCAP file")
    opcode, length, start, _, crc = struct.unpack_from("<BQQQI", content, at)
    begin = start - FRAME.size - 4
    if (opcode, length) != (Opcode.FOOTER, _FOOTER_BYTES - FRAME.size) or not len(MAGIC) <= begin < at:
        raise ValueError("its footer is damaged")
    if zlib.crc32(content[start : at + _FOOTER_BYTES - 4]) != crc or content[begin] != Opcode.DATA_END:
        raise ValueError("the CRC of its summary does not match")
    return int(begin)


class SegmentScan:
    """Reads a segment chunk by chunk and skips damage. Iterate once; then the attributes are complete.

    From byte `limit` on the file is not valid; a `sealed` one was finished, so that it cannot be torn. `damaged` are
    unreadable bytes, `torn` those of an incomplete record at the end. `whole_bytes` is the length of the undamaged
    beginning, up to the end of a chunk and its indexes, and `summary` its summary.
    """

    def __init__(self, path: Path, limit: int | None = None, *, sealed: bool = False) -> None:
        self.path, self.limit, self._sealed = path, limit, sealed
        self.damaged: list[ByteSpan] = []
        self.torn: ByteSpan | None = None
        self.whole_bytes = 0
        self.summary = SegmentSummary()

    def __iter__(self) -> Iterator[LogRecord]:
        """Messages of the intact chunks, in their order."""
        channels: dict[int, tuple[str, str]] = {}
        with _mapped(self.path) as content:
            end = len(content) if self.limit is None else min(self.limit, len(content))
            for chunk in self._chunks(content, end):
                index: ChannelIndex = {}
                yield from _messages(chunk.content, channels, index, self.summary)
                self._extend(content, chunk, index, end)

    def _chunks(self, content: Buffer, end: int) -> Iterator[_Chunk]:
        """Intact chunks; what is between them and not a record is damaged."""
        position = len(MAGIC)
        if content[: len(MAGIC)] == MAGIC:
            self.whole_bytes = position
        else:
            self.damaged.append(ByteSpan(0, len(MAGIC)))
        while position < end:
            frame = _frame_at(content, position, end)
            chunk = _chunk_at(content, position, end) if frame is not None and frame[0] == Opcode.CHUNK else None
            if chunk is not None:
                yield chunk
            if frame is None or (chunk is None and not _is_plain(content, position, *frame)):
                found = _next_chunk(content, position + 1, end)
                if found is None:
                    cut = {Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.METADATA}
                    if frame is None and content[position] in cut and not self._sealed:
                        self.torn = ByteSpan(position, end)
                    else:
                        self.damaged.append(ByteSpan(position, end))
                    return
                self.damaged.append(ByteSpan(position, found))
                position = found
                continue
            if frame[0] in {Opcode.HEADER, Opcode.SCHEMA} and self.whole_bytes == position:
                self.whole_bytes = frame[1]
            elif frame[0] == Opcode.DATA_END:
                return  # what follows in a sealed segment only repeats
            position = frame[1]

    def _extend(self, content: Buffer, chunk: _Chunk, index: ChannelIndex, end: int) -> None:
        """Extend the undamaged beginning by this chunk, if it reaches up to it."""
        if chunk.begin != self.whole_bytes:
            return
        after = chunk.begin + chunk.head.frame_bytes
        indexes = encode_index(index)
        is_indexed = content[after : after + len(indexes)] == indexes and after + len(indexes) <= end
        self.summary.add_chunk(chunk.begin, chunk.head, index, len(indexes) if is_indexed else 0)
        self.whole_bytes = after + (len(indexes) if is_indexed else 0)


@contextmanager
def _mapped(path: Path) -> Iterator[Buffer]:
    with path.open("rb") as file:
        if path.stat().st_size == 0:
            yield b""
            return
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            yield content


def _frame_at(content: Buffer, position: int, end: int) -> tuple[int, int] | None:
    """Opcode and end of the record at `position`, if there may be a whole one."""
    if position + FRAME.size > end:
        return None
    opcode, length = FRAME.unpack_from(content, position)
    after = position + FRAME.size + length
    return (opcode, after) if Opcode.HEADER <= opcode <= Opcode.DATA_END and after <= end else None


def _is_plain(content: Buffer, position: int, opcode: int, after: int) -> bool:
    """Whether a frame other than a chunk is plausible: a flipped bit can make a chunk another, longer record."""
    if opcode == Opcode.MESSAGE_INDEX:
        size = after - position - FRAME.size - 6
        return bool(size >= 0 and struct.unpack_from("<I", content, position + FRAME.size + 2)[0] == size)
    if opcode == Opcode.DATA_END:
        return after - position == FRAME.size + 4
    return opcode in {Opcode.HEADER, Opcode.SCHEMA, Opcode.METADATA} and _next_chunk(content, position, after) is None


def _chunk_at(content: Buffer, position: int, end: int) -> _Chunk | None:
    """The chunk at `position`, if there is an intact one."""
    if position < 0 or position + CHUNK.size > end:
        return None
    opcode, length, first_ns, last_ns, size, crc, named, compression, packed = CHUNK.unpack_from(content, position)
    begin = position + CHUNK.size
    is_chunk = (opcode, named, compression) == (Opcode.CHUNK, len(COMPRESSION), COMPRESSION)
    if not is_chunk or length != CHUNK.size - FRAME.size + packed or packed > end - begin:
        return None
    try:
        if zstandard.frame_content_size(content[begin : begin + min(packed, _ZSTD_HEAD_BYTES)]) != size:
            return None  # before allocating
        data = zstandard.decompress(content[begin : begin + packed])
    except (zstandard.ZstdError, OverflowError):
        return None
    except MemoryError as error:
        if size > MAX_CONTENT_BYTES:
            return None  # no version writes so much
        raise OutOfMemory(
            f"not enough memory for {size:,} bytes of a log segment, which may be intact; free some and try again"
        ) from error
    if len(data) != size or zlib.crc32(data) != crc:
        return None
    return _Chunk(position, ChunkHead(first_ns, last_ns, size, crc, packed), data)


def _next_chunk(content: Buffer, position: int, end: int) -> int | None:
    """Begin of the next intact chunk from `position` on."""
    found = position - 1
    while (found := content.find(_NEEDLE, found + 1, end)) >= 0:
        if found - _NEEDLE_AT >= position and _chunk_at(content, found - _NEEDLE_AT, end) is not None:
            return found - _NEEDLE_AT
    return None


def _messages(
    content: bytes, channels: dict[int, tuple[str, str]], index: ChannelIndex | None = None,
    summary: SegmentSummary | None = None,
) -> Iterator[LogRecord]:  # fmt: skip
    """Messages of a chunk's content; adds its channels to `channels` and the places of messages to `index`."""
    position, end = 0, len(content)
    unpack, head = MESSAGE.unpack_from, MESSAGE.size
    while position < end:
        opcode, length = FRAME.unpack_from(content, position)
        after = position + FRAME.size + length
        if opcode == Opcode.MESSAGE:
            _, _, number, _, log_time, publish_time = unpack(content, position)
            topic, schema = channels[number]
            if index is not None:
                index.setdefault(number, []).extend((log_time, position))
            yield LogRecord(topic, schema, log_time, publish_time, content[position + head : after])
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(BytesIO(content[position + FRAME.size : after])))
            channels[channel.id] = (channel.topic, _SCHEMAS[channel.schema_id])
            if index is not None and summary is not None:
                summary.channels[channel.id] = channel
                index.setdefault(channel.id, [])
        position = after
