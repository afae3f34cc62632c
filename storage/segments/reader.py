"""Reading a segment, strictly or skipping damage; all CRCs are checked, which the library does not do by default."""

import mmap
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Header, Metadata

from storage.segments.chunks import (
    Buffer,
    Chunk,
    MessageSpan,
    chunk_at,
    frame_at,
    is_plain,
    messages_of,
    next_chunk,
    spans_of,
)
from storage.segments.records import (
    CHECKSUM,
    FRAME,
    MAGIC,
    MARKS,
    ChannelIndex,
    LogRecord,
    SegmentSummary,
    checksum,
    encode_index,
    origin_of,
)
from stream.errors import StoreError

_HEAD_BYTES = 4096
_FOOTER_BYTES = FRAME.size + 8 + 8 + 4
_CHANNEL = struct.Struct("<HHI")  # number, schema, length of the topic that follows
_CHUNK_INDEX = struct.Struct("<QQQQI")  # first and last log time, begin, length, size of what follows
_INDEXED = struct.Struct("<H")  # number of the channel, at the begin of an index
_PLACE = struct.Struct("<HQ")  # of a channel in the chunk
_DAMAGE = (McapError, ValueError, LookupError, EOFError, struct.error, zstandard.ZstdError, UnicodeDecodeError)


class ByteSpan(NamedTuple):
    """Bytes `begin` to `end` of a file."""

    begin: int
    end: int


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
    for content in read_chunks(path):
        with _damage_of(path):
            found = messages_of(content, channels)
        yield from found


def read_chunks(path: Path) -> Iterator[bytes]:
    """Contents of the chunks of a sealed segment in their order, every CRC checked; StoreError if it is damaged."""
    with _damage_of(path), _mapped(path) as content:
        end = _end_of_data(content)
        position, summed, crc = len(MAGIC), 0, 0
        while position < end:
            opcode, length = FRAME.unpack_from(content, position)
            after = position + FRAME.size + length
            if opcode == Opcode.CHUNK:
                chunk = chunk_at(content, position, end)
                if chunk is None:
                    raise ValueError(f"the chunk at byte {position} is damaged")
                crc, summed = zlib.crc32(content[summed:after], crc), after  # once for a chunk: thousands of indexes
                yield chunk.content
            position = after
        if position != end or zlib.crc32(content[summed:end], crc) != _crc_at(content, end):
            raise ValueError("the CRC of its data does not match")


def read_chunks_of(path: Path, is_wanted: Callable[[str], bool]) -> Iterator[bytes]:
    """Contents of the chunks that hold messages of wanted topics, in their order; StoreError if one is damaged.

    The summary names them, whose CRC is checked; other chunks are not read. A chunk without indexes is read as well.
    """
    with _damage_of(path), _mapped(path) as content:
        end = _end_of_data(content)
        for begin in _chunks_of(content, end, is_wanted):
            if (chunk := chunk_at(content, begin, end)) is None:
                raise ValueError(f"the chunk at byte {begin} is damaged")
            yield chunk.content


def _chunks_of(content: Buffer, end: int, is_wanted: Callable[[str], bool]) -> Iterator[int]:
    """Where the chunks begin, from the summary behind the data."""
    wanted: set[int] = set()
    position = end + FRAME.size + 4
    while content[position] != Opcode.FOOTER:  # all channels come before the chunks
        opcode, length = FRAME.unpack_from(content, position)
        at = position + FRAME.size
        if opcode == Opcode.CHANNEL:
            number, _, size = _CHANNEL.unpack_from(content, at)
            begin = at + _CHANNEL.size
            if is_wanted(content[begin : begin + size].decode()):
                wanted.add(number)
        elif opcode == Opcode.CHUNK_INDEX:
            _, _, chunk, _, size = _CHUNK_INDEX.unpack_from(content, at)
            begin = at + _CHUNK_INDEX.size
            if not size or any(number in wanted for number, _ in _PLACE.iter_unpack(content[begin : begin + size])):
                yield chunk
        position = at + length


def _crc_at(content: Buffer, end: int) -> int:
    """CRC of the data section, which ends there."""
    return int(struct.unpack_from("<I", content, end + FRAME.size)[0])


def spans_in(path: Path, content: bytes, channels: dict[int, tuple[str, str]]) -> list[MessageSpan]:
    """Places of the messages in the content of a segment's chunk; StoreError if it has none."""
    with _damage_of(path):
        return spans_of(content, channels)


@contextmanager
def _damage_of(path: Path) -> Iterator[None]:
    """Report damage of a segment."""
    try:
        yield
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
    beginning, up to the end of a chunk and its indexes, and `summary` its summary. With `is_wanted`, chunks are left
    out that hold no message of a wanted topic by the indexes after them; then the last two are not complete.
    """

    def __init__(
        self, path: Path, limit: int | None = None, *, sealed: bool = False,
        is_wanted: Callable[[str], bool] | None = None,
    ) -> None:  # fmt: skip
        self.path, self.limit, self._sealed, self._is_wanted = path, limit, sealed, is_wanted
        self._unwanted: set[int] = set()
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
                try:
                    yield from messages_of(chunk.content, channels, index, self.summary)
                except ValueError:
                    self.damaged.append(ByteSpan(chunk.begin, chunk.begin + chunk.head.frame_bytes))
                    continue
                if self._is_wanted is None:
                    self._extend(content, chunk, index, end)
                else:
                    self._unwanted |= {each for each in index if not self._is_wanted(channels[each][0])}

    def _chunks(self, content: Buffer, end: int) -> Iterator[Chunk]:
        """Intact chunks; what is between them and not a record is damaged."""
        position = len(MAGIC)
        if content[: len(MAGIC)] == MAGIC:
            self.whole_bytes = position
        else:
            self.damaged.append(ByteSpan(0, len(MAGIC)))
        while position < end:
            frame = frame_at(content, position, end)
            if frame is not None and frame[0] == Opcode.CHUNK and self._is_unwanted(content, frame[1], end):
                position = frame[1]
                continue
            chunk = chunk_at(content, position, end) if frame is not None and frame[0] == Opcode.CHUNK else None
            if chunk is not None:
                yield chunk
            if frame is None or (chunk is None and not is_plain(content, position, *frame)):
                found = next_chunk(content, position + 1, end)
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

    def _is_unwanted(self, content: Buffer, position: int, end: int) -> bool:
        """Whether the indexes from a chunk's end on show that it has unwanted messages only."""
        begin = position
        while self._unwanted and (frame := frame_at(content, position, end)) is not None:
            if frame[0] == Opcode.CHUNK:
                return position > begin
            if frame[0] != Opcode.MESSAGE_INDEX or not is_plain(content, position, *frame):
                return False
            if _INDEXED.unpack_from(content, position + FRAME.size)[0] not in self._unwanted:
                return False
            position = frame[1]
        return False  # of the last chunk, some indexes may not be written yet

    def _extend(self, content: Buffer, chunk: Chunk, index: ChannelIndex, end: int) -> None:
        """Extend the undamaged beginning by this chunk, if it reaches up to it."""
        if chunk.begin != self.whole_bytes:
            if not self.damaged:  # the index before it, which readers of this segment skip: others would be misled
                self.damaged.append(ByteSpan(self.whole_bytes, chunk.begin))
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
