"""MCAP records of the segments of the event log, for writing and reading."""

import struct
import zlib
from functools import cache
from pathlib import Path
from typing import NamedTuple

import msgspec
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, McapRecord, MetadataIndex, Schema, Statistics

from stream.events import document_schema
from stream.wire.batches import sample_descriptors

PROFILE = "gyrofleet"
SAMPLES = "gyrofleet.SampleBatch"
PREVIEW = "gyrofleet.Preview"
EVENTS = "gyrofleet.EventMessage"
REJECTED = "gyrofleet.Rejected"
MARKS = "gyrofleet.marks"
CHECKSUM = "checksum"
# fixed, so that a chunk can be read without the head of its file
SCHEMA_IDS = {REJECTED: 0, SAMPLES: 1, PREVIEW: 2, EVENTS: 3}
MAGIC = b"\x89MCAP0\r\n"
COMPRESSION = b"zstd"

FRAME = struct.Struct("<BQ")  # opcode, length of what follows
MESSAGE = struct.Struct("<BQHIQQ")  # frame, channel, sequence, log time, publish time
MESSAGE_HEAD_BYTES = MESSAGE.size - FRAME.size
CHUNK = struct.Struct("<BQQQQII4sQ")  # frame, first and last log time, size, CRC, 4, b"zstd", length of the data
CHUNK_BYTES = 2 << 20

_INDEX_HEAD = struct.Struct("<BQHI")
ENCODINGS = {SAMPLES: "protobuf", PREVIEW: "protobuf", EVENTS: "json", REJECTED: ""}


def written_by(store: str, path: Path) -> str:
    """Origin in a segment's head: the identity of the store, and the segment's number."""
    if not store:
        return "gyrofleet"
    text = f"{store} {path.name.partition('.')[0]}"
    return f"gyrofleet {text} {zlib.crc32(text.encode()):08x}"


def origin_of(library: str) -> tuple[str, str] | None:
    """Identity and number from the text of `written_by`; None if it lacks them or is damaged.

    >>> origin_of(written_by("5e0f", Path("00000007.mcap.open")))
    ('5e0f', '00000007')
    """
    text, _, crc = library.removeprefix("gyrofleet ").rpartition(" ")
    if crc != f"{zlib.crc32(text.encode()):08x}":
        return None
    store, _, segment = text.partition(" ")
    return store, segment


class LogRecord(NamedTuple):
    """One message of the log."""

    topic: str
    schema: str
    arrival_ns: int
    publish_ns: int
    data: bytes


class SealedSegment(NamedTuple):
    """A finished segment: its file, length and SHA-256."""

    path: Path
    size: int
    sha256: str


ChannelIndex = dict[int, list[int]]  # by channel: log time and offset in the chunk of each message, alternating


class ChunkHead(NamedTuple):
    """Head of a chunk, before its compressed messages."""

    first_ns: int
    last_ns: int
    content_bytes: int
    crc: int
    packed_bytes: int

    @property
    def frame_bytes(self) -> int:
        """Length of the whole record."""
        return CHUNK.size + self.packed_bytes

    def encode(self) -> bytes:
        """Its encoding with the frame."""
        length = self.frame_bytes - FRAME.size
        return CHUNK.pack(
            Opcode.CHUNK, length, self.first_ns, self.last_ns, self.content_bytes, self.crc, len(COMPRESSION),
            COMPRESSION, self.packed_bytes,
        )  # fmt: skip


def encode_index(index: ChannelIndex) -> bytes:
    """The index records after a chunk: offsets of the messages of each channel."""
    parts = []
    for channel, places in index.items():
        size = 8 * len(places)
        parts.append(_INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + size, channel, size))
        parts.append(struct.pack(f"<{len(places)}Q", *places))
    return b"".join(parts)


class SegmentSummary:
    """Summary at the end of a segment, collected while it is written or read."""

    def __init__(self) -> None:
        self.channels: dict[int, Channel] = {}
        self.chunks: list[ChunkIndex] = []
        self.counts: dict[int, int] = {}

    def add_chunk(self, begin: int, head: ChunkHead, index: ChannelIndex, indexes: int) -> None:
        """Add a chunk at byte `begin`, its messages, and the size of the indexes after it."""
        at = begin + head.frame_bytes
        offsets = {}
        for channel, places in index.items():
            self.counts[channel] = self.counts.get(channel, 0) + len(places) // 2
            offsets[channel] = at
            at += _INDEX_HEAD.size + 8 * len(places)
        chunk = ChunkIndex(
            chunk_start_offset=begin, chunk_length=head.frame_bytes, message_start_time=head.first_ns,
            message_end_time=head.last_ns, compression=COMPRESSION.decode(), compressed_size=head.packed_bytes,
            uncompressed_size=head.content_bytes, message_index_length=indexes,
            message_index_offsets=offsets if indexes else {},
        )  # fmt: skip
        self.chunks.append(chunk)

    def records(self, metadata: MetadataIndex) -> list[list[McapRecord]]:
        """The records of the summary section, by kind."""
        used = [chunk for chunk in self.chunks if chunk.message_index_offsets]
        statistics = Statistics(
            attachment_count=0, channel_count=len(self.channels), channel_message_counts=self.counts,
            chunk_count=len(self.chunks), message_count=sum(self.counts.values()),
            message_start_time=min((chunk.message_start_time for chunk in used), default=0),
            message_end_time=max((chunk.message_end_time for chunk in used), default=0), metadata_count=1,
            schema_count=len(SCHEMA_IDS) - 1,
        )  # fmt: skip
        channels = [self.channels[number] for number in sorted(self.channels)]
        return [list(schemas()), list(channels), [statistics], list(self.chunks), [metadata]]


@cache
def schemas() -> tuple[Schema, ...]:
    """The schemas of every segment, for other tools; that of documents takes milliseconds, twice a segment."""
    descriptors = sample_descriptors()
    documents = msgspec.json.encode(document_schema())
    return (
        Schema(id=SCHEMA_IDS[SAMPLES], data=descriptors, encoding="protobuf", name=SAMPLES),
        Schema(id=SCHEMA_IDS[PREVIEW], data=descriptors, encoding="protobuf", name=PREVIEW),
        Schema(id=SCHEMA_IDS[EVENTS], data=documents, encoding="jsonschema", name=EVENTS),
    )


def encoded(*records: McapRecord) -> bytes:
    """Encoding of records."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())


def checksum(marks: dict[str, str]) -> str:
    """Checksum of the positions of streams; MCAP has none for metadata.

    >>> checksum({"gyrofleet/plant/bench/U1/rate 01": "500"})
    '9427e9cb'
    """
    text = "\n".join(f"{name}\t{marks[name]}" for name in sorted(marks))
    return f"{zlib.crc32(text.encode()):08x}"
