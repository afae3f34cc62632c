"""Files of the log: sealed and growing segments, the manifest and its snapshot, messages on the wire, the spool."""

import hashlib
import random
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from uuid import UUID

import msgspec
import numpy as np
import zstandard

from storage.check.recover import recover
from storage.check.verify import verify
from storage.log.event_log import EventLog
from storage.log.recovery import examine_segment
from storage.log.sequence import place_of
from storage.manifests.entries import SegmentEntries
from storage.manifests.log import FIRST, SNAPSHOT, ManifestWriter, read_log_manifest
from storage.segments.growing import GrowingSegment
from storage.segments.reader import SegmentScan, read_marks, read_origin, read_segment
from storage.segments.records import EVENTS, SAMPLES, LogRecord
from storage.store import Store
from stream.batch import SampleBatch
from stream.delivery.spool import Spool
from stream.delivery.spool_frames import encode_frame, parse_frames
from stream.delivery.spool_streams import held_messages, scan
from stream.errors import GyrofleetError
from stream.events import NoteAdded, encode_event
from stream.identity import Place, event_key, sample_key
from stream.wire.acknowledgement import StreamId
from stream.wire.batches import decode_batch, encode_batch
from stream.wire.event_validation import decode_received
from tests.fuzz.format import Format
from tests.fuzz.mutations import Mutation, mutated_blocks, mutated_bytes, mutated_json, mutated_msgpack, within
from tests.fuzz.trees import made_by

_PLACE = Place("plant", "bench")
_SEGMENT = "00000001.mcap"
_IDENTITY = "5e" * 16


def _batch(seq: int) -> bytes:
    counts = np.arange(20, dtype=np.int32)
    return encode_batch(SampleBatch("G-1", "rate", "r1", UUID(int=1), seq, seq * 10**7, 10**7, "deg/s", counts=counts))


def _note(seq: int) -> bytes:
    return encode_event(NoteAdded(run="r1", t_ns=5, text="looked at"), "e", seq)


def filled_store(folder: Path, segments: int = 2, *, is_open: bool = False) -> Store:
    """A store with so many segments."""
    store = Store.create(folder)
    log = EventLog(store)
    for number in range(segments):
        for seq in range(0, 60, 20):
            at = 60 * number + seq
            _append(log, LogRecord(sample_key(_PLACE, "G-1", "rate"), SAMPLES, 10**18 + at, at * 10**7, _batch(at)))
        _append(log, LogRecord(event_key(_PLACE), EVENTS, 10**18, 5, _note(number)))
        log.sync()
        if not is_open:
            log.seal()
    return store


def _append(log: EventLog, record: LogRecord) -> None:
    place = place_of(record)
    assert place is not None
    log.append(place, record)


def _sealed(folder: Path) -> list[bytes]:
    store = filled_store(folder / "s", 1)
    return [(store.log / _SEGMENT).read_bytes()]


def _growing(folder: Path) -> list[bytes]:
    store = filled_store(folder / "s", 1, is_open=True)
    return [(store.log / f"{_SEGMENT}.open").read_bytes()]


def _read_segment(path: Path) -> None:
    read_origin(path)
    for _ in SegmentScan(path, sealed=True):
        pass
    with GrowingSegment(path) as growing:
        growing.is_finished = True
        for _ in growing.records():
            pass
    examine_segment(path, {})
    read_marks(path)
    for _ in read_segment(path):
        pass


def _recover(path: Path) -> None:
    """What a recorder does at its start with what a kill has left, and what `gyrofleet verify` says of it then."""
    store = Store.open(path.parents[1])
    list(recover(store))
    verify(store)


def _mutated_segment(content: bytes, rng: random.Random) -> bytes:
    """Messages in a chunk changed, and its compression, lengths and checksum made right again; or any bytes."""
    at = _chunk(content)
    if rng.random() < 0.4 or at is None:
        return rng.choice((mutated_bytes, mutated_blocks))(content, rng)
    length = int.from_bytes(content[at + 1 : at + 9], "little")
    body = at + 9
    if body + 32 > len(content):
        return mutated_bytes(content, rng)
    first, last, size, _, words = struct.unpack_from("<QQQII", content, body)
    start = body + 32 + words
    if start + 8 > len(content):
        return mutated_bytes(content, rng)
    (packed,) = struct.unpack_from("<Q", content, start)
    try:
        inner = zstandard.ZstdDecompressor().decompress(
            content[start + 8 : start + 8 + packed], max_output_size=1 << 24
        )
    except zstandard.ZstdError:
        return mutated_bytes(content, rng)
    inner = rng.choice((mutated_blocks, mutated_bytes, _mutated_message))(inner, rng)
    fresh = zstandard.ZstdCompressor().compress(inner)
    size = rng.choice((len(inner), len(inner), len(inner), size, 2**40, 2**63))
    head = struct.pack("<QQQII", first, last, size, zlib.crc32(inner), words) + content[body + 32 : start]
    chunk = head + struct.pack("<Q", len(fresh)) + fresh
    return content[:at] + b"\x06" + struct.pack("<Q", len(chunk)) + chunk + content[body + length :]


def _chunk(content: bytes) -> int | None:
    """Where the first chunk begins."""
    at = 8
    while at + 9 <= len(content):
        if content[at] == 6:
            return at
        at += 9 + int.from_bytes(content[at + 1 : at + 9], "little")
    return None


def _mutated_message(content: bytes, rng: random.Random) -> bytes:
    """The JSON of an event in a chunk changed, in its length."""
    begin, end = content.find(b'{"'), content.rfind(b"}") + 1
    if begin < 0 or end <= begin:
        return mutated_bytes(content, rng)
    text = mutated_json(content[begin:end], rng)
    return content[:begin] + text[: end - begin].ljust(end - begin) + content[end:]


def _empty_store(folder: Path) -> None:
    filled_store(folder, 0)


def _three_segments(folder: Path) -> None:
    filled_store(folder, 3)


def _store_around(folder: Path) -> None:
    made_by(_three_segments).write(folder)


def _manifest(_folder: Path) -> list[bytes]:
    return made_by(_three_segments).contents("log/manifest.jsonl")


def chained(inner: Mutation) -> Mutation:
    """One line of a manifest changed, and all chained again."""

    def mutate(content: bytes, rng: random.Random) -> bytes:
        lines = [line.rpartition(b"\t")[0] for line in content.splitlines()]
        if not lines or rng.random() < 0.2:
            return mutated_bytes(content, rng)
        at = rng.randrange(len(lines))
        lines[at] = inner(lines[at], rng).replace(b"\n", b" ")
        last, chained = FIRST, b""
        for text in lines:
            last = hashlib.sha256(last.encode() + text).hexdigest()
            chained += text + b"\t" + last.encode() + b"\n"
        return chained

    return mutate


def _read_manifest(path: Path) -> None:
    store = Store(path.parents[1] if path.parent.name == "log" else path.parent, _IDENTITY)
    for whole in (True, False):
        read_log_manifest(store, whole=whole)
    ManifestWriter(store)
    verify(store)


def _snapshot(folder: Path) -> list[bytes]:
    from storage.manifests import log

    _store_around(folder)
    store = Store.open(folder)
    found = read_log_manifest(store, whole=True)
    state = SegmentEntries()
    for name, entry in found.entries.items():
        state[name] = entry
    written = log._Snapshot(found.whole_bytes, found.lines, found.last, state.state(), [])
    return [_hashed(msgspec.msgpack.encode(written))]


def _hashed(packed: bytes) -> bytes:
    return hashlib.sha256(packed).hexdigest().encode() + packed


def _spool(folder: Path) -> list[bytes]:
    with Spool(folder / "spool") as spool:
        for seq in range(0, 60, 20):
            spool.append(StreamId(sample_key(_PLACE, "G-1", "rate"), UUID(int=1).hex), seq, seq + 20, _batch(seq))
        spool.acknowledge("5e" * 16, StreamId(sample_key(_PLACE, "G-1", "rate"), UUID(int=1).hex), 20)
    return [path.read_bytes() for path in sorted((folder / "spool").glob("*.spool"))]


def _read_spool(path: Path) -> None:
    scan(path.parent)
    held_messages(path.parent)
    with Spool(path.parent) as spool:
        while spool.read(1000):
            pass


def _mutated_spool(content: bytes, rng: random.Random) -> bytes:
    """Frames with other numbers and payloads, soundly written; or any bytes."""
    frames = parse_frames(content, is_end=True).frames
    if rng.random() < 0.3 or not frames:
        return rng.choice((mutated_bytes, mutated_blocks))(content, rng)
    at = rng.randrange(len(frames))
    frame = frames[at]
    number, seq, following = frame.number, frame.seq, frame.next_seq
    match rng.randrange(4):
        case 0:
            number = rng.choice((0, 1, 2, 3, 2**32 - 1))
        case 1:
            seq, following = rng.choice((0, -1, 2**63 - 1, -(2**63), 7)), rng.choice((0, -1, 2**63 - 1, -(2**63), 9))
    payload = mutated_msgpack(frame.payload, rng) if number < 2 else mutated_bytes(frame.payload, rng)
    changed = (number, seq, following, payload)
    return b"".join(encode_frame(*each) for each in [*frames[:at], changed, *frames[at + 1 :]])


def _read_message(decode: Callable[[bytes], object]) -> Callable[[Path], None]:
    def read(path: Path) -> None:
        try:
            decode(path.read_bytes())
        except GyrofleetError as error:
            error.args = (f"{path.name}: {error}",)  # a message has no file
            raise

    return read


FORMATS = [
    Format("segment", _sealed, _read_segment, _mutated_segment, f"log/{_SEGMENT}", gate_inputs=200),
    Format(
        "open segment", _growing, _recover, _mutated_segment, f"log/{_SEGMENT}.open",
        _empty_store, changes=True, gate_inputs=15,
    ),
    Format(
        "log manifest", _manifest, _read_manifest, chained(mutated_json), "log/manifest.jsonl",
        _store_around, changes=True, gate_inputs=15,
    ),
    Format(
        "log snapshot", _snapshot, _read_manifest, within(lambda content: content[64:], _hashed, mutated_msgpack),
        SNAPSHOT, _store_around, changes=True, gate_inputs=15,
    ),
    Format("spool", _spool, _read_spool, _mutated_spool, "spool/00000001.spool", changes=True, gate_inputs=100),
    Format("samples message", lambda _: [_batch(0)], _read_message(decode_batch), mutated_blocks, "message"),
    Format("event message", lambda _: [_note(0)], _read_message(decode_received), mutated_json, "message"),
]  # fmt: skip
