"""Writer of one segment of the event log, a self-contained MCAP file.

Chunks are assembled here and not by the library's writer: each chunk carries the channels of its messages, so that it
can be read alone; the durable length is known to the byte after each `sync`; and a message costs a microsecond.
Chunks, data section and summary carry CRCs.
"""

import hashlib
import struct
import zlib
from pathlib import Path

import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel, DataEnd, Footer, Header, Metadata, MetadataIndex, SummaryOffset

from storage.log.files import next_free
from storage.segments.disk import DISK, Disk
from storage.segments.records import (
    CHECKSUM,
    CHUNK_BYTES,
    ENCODINGS,
    MAGIC,
    MARKS,
    MESSAGE,
    MESSAGE_HEAD_BYTES,
    PROFILE,
    SCHEMA_IDS,
    ChannelIndex,
    ChunkHead,
    LogRecord,
    SealedSegment,
    SegmentSummary,
    checksum,
    encode_index,
    encoded,
    schemas,
    written_by,
)

_LEVEL = 3


class SegmentWriter:
    """Writes one segment under a temporary name until it is sealed; to be abandoned after any OSError.

    Until `path` is its name, the file has `suffix` behind it, or is `open_path`. `found` are whole records at the
    beginning of an existing file and their summary: the rest is cut off, and writing resumes there; without it the file
    is created. `durable_bytes` is the length of the file that is durable; it ends at the end of a chunk.
    """

    def __init__(
        self, path: Path, suffix: str = ".open", disk: Disk = DISK, *, store: str = "",
        found: tuple[memoryview, SegmentSummary] | None = None, open_path: Path | None = None,
    ) -> None:  # fmt: skip
        self.path = path
        self.open_path = open_path or path.with_name(path.name + suffix)
        self.payload_bytes = self.durable_bytes = 0
        self._disk = disk
        self._size = self._crc = 0
        self._hash = hashlib.sha256()
        self._compressor = zstandard.ZstdCompressor(level=_LEVEL)
        self._summary = SegmentSummary() if found is None else found[1]
        self._channels = {(each.topic, each.schema_id): each.id for each in self._summary.channels.values()}
        self.records = sum(self._summary.counts.values())
        self._described: dict[int, bytes] = {}
        self._begin_chunk()
        if found is None:
            self._file = disk.create(self.open_path)
            try:
                self._write(MAGIC + encoded(Header(profile=PROFILE, library=written_by(store, path)), *schemas()))
            except OSError:
                disk.close(self._file)
                disk.remove(self.open_path)
                raise
            return
        self._file = disk.reopen(self.open_path, len(found[0]))
        for begin in range(0, len(found[0]), CHUNK_BYTES):
            self._account(found[0][begin : begin + CHUNK_BYTES])

    def _begin_chunk(self) -> None:
        self._parts: list[bytes] = []
        self._chunk_size = 0
        self._index: ChannelIndex = {}
        self._first_ns = self._last_ns = 0

    def append(self, record: LogRecord) -> None:
        """Add a message; durable after the next `sync`."""
        topic, schema, arrival_ns, publish_ns, data = record
        channel = self._channels.get((topic, SCHEMA_IDS[schema]))
        if channel is None:
            channel = self._register(topic, schema)
        index = self._index.get(channel)
        if index is None:
            index = self._begin_channel(channel)
        if not self._last_ns:
            self._first_ns = arrival_ns
        self._first_ns = min(self._first_ns, arrival_ns)
        self._last_ns = max(self._last_ns, arrival_ns)
        index += (arrival_ns, self._chunk_size)
        # MCAP's own times are unsigned; a time before 1970 stays in the message itself
        head = MESSAGE.pack(
            Opcode.MESSAGE, MESSAGE_HEAD_BYTES + len(data), channel, self.records & 0xFFFFFFFF, arrival_ns,
            max(publish_ns, 0),
        )  # fmt: skip
        self._parts += (head, data)
        self._chunk_size += len(head) + len(data)
        self.records += 1
        self.payload_bytes += len(data)
        if self._chunk_size >= CHUNK_BYTES:
            self._end_chunk()

    def sync(self) -> None:
        """Make everything appended so far durable."""
        self._end_chunk()
        if self.durable_bytes < self._size:
            self._disk.sync_data(self._file)
            self.durable_bytes = self._size

    def seal(self, marks: dict[str, str], *, replaces: bool = False) -> SealedSegment:
        """Finish the segment with the positions its streams have reached, and give it its name.

        The name is durable after a `sync_folder`; until then the segment has either name. Another segment of that name
        is replaced if `replaces`; else this one gets the next free name.
        """
        self._end_chunk()
        metadata = encoded(Metadata(name=MARKS, metadata=marks | {CHECKSUM: checksum(marks)}))
        at = self._size
        self._write(metadata)
        # the CRC of the data section is that of everything before this record
        self._write(encoded(DataEnd(self._crc)))
        self._write(self._ending(MetadataIndex(offset=at, length=len(metadata), name=MARKS)))
        self._disk.sync(self._file)
        self._disk.close(self._file)
        move = self._disk.replace if replaces else self._disk.rename
        while True:
            try:
                move(self.open_path, self.path)
                break
            except FileExistsError:
                self.path = next_free(self.path)
        return SealedSegment(self.path, self._size, self._hash.hexdigest())

    @property
    def channels(self) -> int:
        """Number of channels; MCAP allows 65,535."""
        return len(self._summary.channels)

    def abandon(self) -> None:
        """Close the file as it is, for recovery."""
        self._disk.close(self._file)

    def _register(self, topic: str, schema: str) -> int:
        number = len(self._summary.channels) + 1
        schema_id = SCHEMA_IDS[schema]
        self._channels[topic, schema_id] = number
        self._summary.channels[number] = Channel(
            id=number, topic=topic, message_encoding=ENCODINGS[schema], metadata={}, schema_id=schema_id
        )
        return number

    def _begin_channel(self, number: int) -> list[int]:
        described = self._described.get(number)
        if described is None:
            described = self._described[number] = encoded(self._summary.channels[number])
        self._parts.append(described)
        self._chunk_size += len(described)
        index = self._index[number] = []
        return index

    def _end_chunk(self) -> None:
        if not self._parts:
            return
        content = b"".join(self._parts)
        packed = self._compressor.compress(content)
        head = ChunkHead(self._first_ns, self._last_ns, len(content), zlib.crc32(content), len(packed))
        indexes = encode_index(self._index)
        begin = self._size
        self._write(b"".join((head.encode(), packed, indexes)))
        self._summary.add_chunk(begin, head, self._index, len(indexes))
        self._begin_chunk()

    def _ending(self, metadata: MetadataIndex) -> bytes:
        start = self._size
        groups = [encoded(*records) for records in self._summary.records(metadata) if records]
        at, offsets = start, []
        for group in groups:
            offsets.append(SummaryOffset(group_opcode=group[0], group_start=at, group_length=len(group)))
            at += len(group)
        summary = b"".join(groups) + encoded(*offsets)
        crc = zlib.crc32(struct.pack("<BQQQ", Opcode.FOOTER, 8 + 8 + 4, start, at), zlib.crc32(summary))
        return summary + encoded(Footer(summary_start=start, summary_offset_start=at, summary_crc=crc)) + MAGIC

    def _write(self, content: bytes) -> None:
        self._disk.write(self._file, content)
        self._account(content)

    def _account(self, content: bytes | memoryview) -> None:
        self._size += len(content)
        self._crc = zlib.crc32(content, self._crc)
        self._hash.update(content)
