"""One segment of the event log: a self-contained MCAP file. No other file imports mcap.

Chunks and the data section carry CRCs, and every read validates them: the library's default reader reports
nothing for a flipped byte.
"""

import os
import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import msgspec
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

from storage.store import sync_folder
from stream.errors import StoreError
from stream.events import document_schema
from stream.wire import sample_descriptors

PROFILE = "gyrofleet"
SAMPLES = "gyrofleet.SampleBatch"
PREVIEW = "gyrofleet.Preview"
EVENTS = "gyrofleet.EventMessage"
REJECTED = "gyrofleet.Rejected"

_MARKS = "gyrofleet.marks"
_RECORD_LIMIT_BYTES = 1 << 30
_MAGIC_BYTES = 8
_FRAME = struct.Struct("<BQ")
_OPCODES = {int(opcode) for opcode in Opcode}
_CHUNK_OPCODE = bytes([Opcode.CHUNK])
# What the library raises on bytes that are not what they should be.
_DAMAGE = (McapError, ValueError, KeyError, EOFError, struct.error, zstandard.ZstdError)


class LogRecord(NamedTuple):
    """One message as it stands in the log."""

    topic: str
    schema: str
    arrival_ns: int
    publish_ns: int
    data: bytes


class SegmentWriter:
    """Writes one segment, under another name until it is sealed.

    Parameters
    ----------
    path : Path
        Name of the sealed segment.
    suffix : str
        What is added to the name until then.
    """

    def __init__(self, path: Path, suffix: str = ".open") -> None:
        self.path = path
        self.open_path = path.with_name(path.name + suffix)
        self.payload_bytes = 0
        self.records = 0
        self._file = self.open_path.open("xb")
        self._writer = Writer(self._file, compression=CompressionType.ZSTD, enable_data_crcs=True)
        self._writer.start(PROFILE, "gyrofleet")
        descriptors = sample_descriptors()
        self._schemas = {
            SAMPLES: self._writer.register_schema(SAMPLES, "protobuf", descriptors),
            PREVIEW: self._writer.register_schema(PREVIEW, "protobuf", descriptors),
            EVENTS: self._writer.register_schema(EVENTS, "jsonschema", msgspec.json.encode(document_schema())),
            REJECTED: 0,
        }
        self._encodings = {SAMPLES: "protobuf", PREVIEW: "protobuf", EVENTS: "json", REJECTED: ""}
        self._channels: dict[tuple[str, str], int] = {}

    def append(self, record: LogRecord) -> None:
        """Add a message; it is on disk after the next `sync`."""
        channel = self._channels.get((record.topic, record.schema))
        if channel is None:
            channel = self._channels[record.topic, record.schema] = self._writer.register_channel(
                record.topic, self._encodings[record.schema], self._schemas[record.schema]
            )
        # MCAP's own times are unsigned; a time before 1970 stays in the message itself
        self._writer.add_message(channel, record.arrival_ns, record.data, max(record.publish_ns, 0), self.records)
        self.records += 1
        self.payload_bytes += len(record.data)

    def sync(self) -> None:
        """Bring everything appended so far to the disk."""
        self._writer.flush()
        os.fdatasync(self._file.fileno())

    def seal(self, marks: dict[str, str]) -> Path:
        """Finish the segment with the positions its streams have reached, and give it its name."""
        self._writer.add_metadata(_MARKS, marks)
        self._writer.finish()
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()
        self.open_path.rename(self.path)
        sync_folder(self.path.parent)
        return self.path

    def abandon(self) -> None:
        """Leave the file as it is, for recovery."""
        self._file.close()


def read_segment(path: Path) -> Iterator[LogRecord]:
    """Messages of a sealed segment in the order they were written, every CRC checked.

    Raises
    ------
    StoreError
        If the segment is damaged.
    """
    schemas: dict[int, str] = {0: REJECTED}
    channels: dict[int, tuple[str, str]] = {}
    try:
        with path.open("rb") as file:
            for record in StreamReader(file, validate_crcs=True, record_size_limit=_RECORD_LIMIT_BYTES).records:
                if isinstance(record, Message):
                    topic, schema = channels[record.channel_id]
                    yield LogRecord(topic, schema, record.log_time, record.publish_time, record.data)
                elif isinstance(record, Schema):
                    schemas[record.id] = record.name
                elif isinstance(record, Channel):
                    channels[record.id] = (record.topic, schemas[record.schema_id])
    except _DAMAGE as error:
        raise StoreError(
            f"segment {path} is damaged ({type(error).__name__}: {error}); restore it from a copy, or move it out of "
            f"{path.parent} to go on without what it holds"
        ) from error


def read_marks(path: Path) -> dict[str, str]:
    """Positions that a sealed segment's streams have reached, from its summary.

    Raises
    ------
    StoreError
        If the segment is damaged.
    """
    try:
        with path.open("rb") as file:
            for metadata in make_reader(file, validate_crcs=True).iter_metadata():
                if isinstance(metadata, Metadata) and metadata.name == _MARKS:
                    return metadata.metadata
    except _DAMAGE as error:
        raise StoreError(f"segment {path} is damaged ({type(error).__name__}: {error})") from error
    raise StoreError(f"segment {path} carries no stream positions; was it written by gyrofleet?")


class Salvage(NamedTuple):
    """What could be read of a segment that was never sealed."""

    records: list[LogRecord]
    damaged_chunks: int


def salvage_segment(path: Path) -> Salvage:
    """Read an unsealed segment chunk by chunk, leaving out what is damaged, up to where the file breaks off."""
    schemas: dict[int, str] = {0: REJECTED}
    channels: dict[int, tuple[str, str]] = {}
    records: list[LogRecord] = []
    damaged = 0
    for inner in _whole_chunks(path.read_bytes()):
        if inner is None:
            damaged += 1
            continue
        for record in inner:
            if isinstance(record, Schema):
                schemas[record.id] = record.name
            elif isinstance(record, Channel):
                channels[record.id] = (record.topic, schemas[record.schema_id])
            elif isinstance(record, Message) and record.channel_id in channels:
                topic, schema = channels[record.channel_id]
                records.append(LogRecord(topic, schema, record.log_time, record.publish_time, record.data))
    return Salvage(records, damaged)


def _whole_chunks(content: bytes) -> Iterator[list[McapRecord] | None]:
    """Records of each chunk whose CRC holds; None for a damaged stretch between them."""
    position = _MAGIC_BYTES
    while position + _FRAME.size <= len(content):
        opcode, length = _FRAME.unpack_from(content, position)
        end = position + _FRAME.size + length
        if opcode in _OPCODES and end <= len(content):
            if opcode == Opcode.CHUNK:
                yield _chunk_at(content, position)
            position = end
            continue
        # the frame itself is damaged, or the file breaks off here: look for the next chunk that holds
        found = content.find(_CHUNK_OPCODE, position + 1)
        while found >= 0 and _chunk_at(content, found) is None:
            found = content.find(_CHUNK_OPCODE, found + 1)
        if found < 0:
            return
        yield None
        position = found


def _chunk_at(content: bytes, position: int) -> list[McapRecord] | None:
    if position + _FRAME.size > len(content):
        return None
    _, length = _FRAME.unpack_from(content, position)
    begin = position + _FRAME.size
    if length > len(content) - begin:
        return None
    try:
        chunk = Chunk.read(ReadDataStream(BytesIO(content[begin : begin + length])))
        return breakup_chunk(chunk, validate_crc=True)
    except _DAMAGE:
        return None
