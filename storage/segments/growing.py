"""Reading a segment that may still be written, each time from where the last reading ended."""

import os
from collections.abc import Iterator
from pathlib import Path

from mcap.opcode import Opcode

from storage.segments.chunks import chunk_at, frame_at, is_plain, messages_of, next_chunk
from storage.segments.reader import ByteSpan
from storage.segments.records import MAGIC, LogRecord
from stream.closing import Closing

_BLOCK_BYTES = 16 << 20


class GrowingSegment(Closing):
    """A segment, open for reading; it may be written, renamed or cut meanwhile.

    `inode` identifies the file whatever its name, `offset` is the end of the last chunk that has been read. The owner
    sets `is_finished` once nothing is written to it any more, and `limit` if it is not valid from that byte on. Then
    `is_read` tells that everything has been read. `damaged` are bytes that cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        status = os.fstat(self._file)
        self.inode = (status.st_dev, status.st_ino)
        self.offset = 0
        self.limit: int | None = None
        self.is_finished = self.is_read = False
        self.damaged: list[ByteSpan] = []
        self._channels: dict[int, tuple[str, str]] = {}
        self._looked: tuple[int, bool] | None = None

    def records(self) -> Iterator[LogRecord]:
        """Messages of the chunks that are new and intact; a chunk that is not taken to its end comes again."""
        size = os.fstat(self._file).st_size
        end = size if self.limit is None else min(size, self.limit)
        if self.is_read or self._looked == (end, self.is_finished):
            return
        block_bytes = _BLOCK_BYTES
        while self.offset < end and not self.is_read:
            before = self.offset
            # not mapped: reading beyond the end of a file that recovery cuts would kill the process
            content = os.pread(self._file, min(end - before, block_bytes), before)
            is_last = before + len(content) >= end
            yield from self._records_in(content, before, is_end=is_last and self.is_finished)
            if is_last:
                break
            block_bytes = _BLOCK_BYTES if self.offset > before else 2 * block_bytes
        self.is_read |= self.is_finished
        self._looked = (end, self.is_finished)

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)

    def _records_in(self, content: bytes, base: int, *, is_end: bool) -> Iterator[LogRecord]:
        """Messages of the chunks in the bytes from `base` on; `is_end` if nothing comes after them."""
        position, end = 0, len(content)
        if base == 0 and content[: len(MAGIC)] == MAGIC:
            position = len(MAGIC)
        while position < end:
            frame = frame_at(content, position, end)
            if frame is not None and is_plain(content, position, *frame):
                if frame[0] == Opcode.DATA_END:
                    self.is_read = True  # what follows in a sealed segment only repeats
                    return
                position = frame[1]
                continue
            chunk = chunk_at(content, position, end)
            if chunk is not None:
                begin = base + position
                position += chunk.head.frame_bytes
                try:
                    yield from messages_of(chunk.content, self._channels)
                except ValueError:
                    self.damaged.append(ByteSpan(begin, base + position))
                # not after its indexes: recovery cuts them off if they are incomplete
                self.offset = base + position
                continue
            found = next_chunk(content, position + 1, end)
            if found is None and not is_end:
                return  # incomplete so far
            begin, position = position, end if found is None else found
            self.damaged.append(ByteSpan(base + begin, base + position))
            self.offset = base + position
