"""The log as a file format and as a promise: other tools read it, no byte of it changes unseen."""

import os
import random
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader, make_reader

from storage.log.event_log import EventLog
from storage.log.recovery import salvage_segment
from storage.log.sequence import SequenceCheck, place_of
from storage.segments.reader import SegmentScan, read_marks, read_segment
from storage.segments.records import CHUNK, CHUNK_BYTES, EVENTS, FRAME, SAMPLES
from storage.store import Store
from stream.errors import StoreError
from stream.wire.batches import decode_batch
from tests.storage.log_records import append, samples, written


def test_other_tools_read_a_segment_with_all_their_checks(tmp_path: Path) -> None:
    store, records = written(tmp_path)
    (segment,) = store.log.glob("*.mcap")
    with segment.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == len(records)
        assert len(summary.chunk_indexes) == 20
        found = list(reader.iter_messages(log_time_order=False))
        assert [(c.topic, m.data) for _, c, m in found] == [(r.topic, r.data) for r in records]
        assert {s.name for s, _, _ in found if s is not None} == {SAMPLES, EVENTS}
        only = list(reader.iter_messages(topics=[records[0].topic]))
        assert [m.data for _, _, m in only] == [r.data for r in records if r.topic == records[0].topic]
    with segment.open("rb") as file:
        assert sum(1 for _ in NonSeekingReader(file, validate_crcs=True).iter_messages()) == len(records)
    assert list(read_segment(segment)) == records


def test_large_chunks_are_cut_and_all_is_there(tmp_path: Path) -> None:
    store = Store.create(tmp_path)
    log = EventLog(store)
    records = [samples("U1", 10_000 * i, 10_000) for i in range(400)]
    for record in records:
        append(log, record)
    log.seal()
    (segment,) = store.log.glob("*.mcap")
    scan = SegmentScan(segment)
    assert list(scan) == records
    assert len(scan.summary.chunks) >= sum(len(record.data) for record in records) // CHUNK_BYTES > 2


@pytest.mark.long
@pytest.mark.parametrize("how", ["flip", "cut", "zero"])
def test_no_byte_of_a_segment_changes_unseen_and_the_rest_is_saved(tmp_path: Path, how: str) -> None:
    store, records = written(tmp_path, syncs=12)
    (segment,) = store.log.glob("*.mcap")
    content = segment.read_bytes()
    rng = random.Random(7)
    list(read_segment(segment))
    by_chunk = 6
    edges = [0, 5, 9, 20, len(content) - 1, len(content) - 9, len(content) - 30, len(content) - 400]
    for at in edges + [rng.randrange(len(content)) for _ in range(120)]:
        damaged = bytearray(content)
        if how == "flip":
            damaged[at] ^= 1 << rng.randrange(8)
        elif how == "cut":
            del damaged[at:]
        else:
            damaged[at : at + 512] = bytes(len(damaged[at : at + 512]))
            if damaged == content:
                continue
        segment.write_bytes(damaged)
        with pytest.raises(StoreError, match="is damaged"):
            list(read_segment(segment))
        found = list(SegmentScan(segment, sealed=True))
        assert [record for record in records if record in found] == found, "something else was read"
        if how == "flip":
            assert len(found) >= len(records) - by_chunk
        elif how == "cut":
            whole = sum(chunk.chunk_start_offset + chunk.chunk_length <= at for chunk in _chunks(content, tmp_path))
            assert len(found) >= by_chunk * whole
        else:
            assert len(found) >= len(records) - 2 * by_chunk


@pytest.mark.parametrize(("each", "bits"), [(9, 1), pytest.param(1, 8, marks=pytest.mark.long)])
def test_no_bit_beside_the_contents_of_chunks_costs_another_chunk(tmp_path: Path, each: int, bits: int) -> None:
    """Of every ninth byte one bit; in the long form every bit of every byte."""
    store, records = written(tmp_path, syncs=3)
    (segment,) = store.log.glob("*.mcap")
    content = segment.read_bytes()
    by_chunk = 6
    chunks = _chunks(content, tmp_path)
    packed = [(c.chunk_start_offset + CHUNK.size, c.chunk_start_offset + c.chunk_length) for c in chunks]
    lost = 0
    frames = [*range(40), *range(chunks[0].chunk_start_offset - 20, content.rindex(b"gyrofleet.marks"))]
    with segment.open("r+b", buffering=0) as file:  # in place: writing the whole file takes longer than reading it
        for at in frames[::each]:
            if any(begin <= at < end for begin, end in packed):
                continue  # a CRC's business
            for bit in (at // each % 8,) if bits == 1 else range(8):
                os.pwrite(file.fileno(), bytes([content[at] ^ 1 << bit]), at)
                scan = SegmentScan(segment, sealed=True)
                found = list(scan)
                kept = set(found)
                assert [record for record in records if record in kept] == found, f"bit {bit} of byte {at}"
                assert len(found) >= len(records) - by_chunk, f"bit {bit} of byte {at} costs more than its chunk"
                assert len(found) == len(records) or scan.damaged, f"bit {bit} of byte {at} loses a chunk unseen"
                lost += len(records) - len(found)
            os.pwrite(file.fileno(), content[at : at + 1], at)
    assert segment.read_bytes() == content
    assert lost >= 3 * bits * by_chunk, "the heads of the chunks were never hit"


def _chunks(content: bytes, folder: Path) -> list:  # type: ignore[type-arg]
    copy = folder / "copy.mcap"
    if not copy.exists():
        copy.write_bytes(content)
    scan = SegmentScan(copy)
    list(scan)
    return scan.summary.chunks


def test_marks_carry_a_checksum_of_their_own(tmp_path: Path) -> None:
    store, _ = written(tmp_path)
    (segment,) = store.log.glob("*.mcap")
    content = segment.read_bytes()
    at = content.rfind(b"2000")  # a position, which no CRC of the format covers for a reader that begins at the end
    segment.write_bytes(content[:at] + b"3" + content[at + 1 :])
    with pytest.raises(StoreError, match="is damaged"):
        read_marks(segment)
    log = EventLog(store)
    assert any("is damaged" in warning for warning in log.warnings)
    assert {mark for stream, mark in log.marks.items() if "event" not in stream.key} == {2000}


def test_a_segment_without_its_beginning_is_read(tmp_path: Path) -> None:
    store, records = written(tmp_path, seal=False)
    (left_open,) = store.log.glob("*.open")
    content = left_open.read_bytes()
    first = _chunks(content, tmp_path)[0]
    end = first.chunk_start_offset + first.chunk_length
    left_open.write_bytes(bytes(end) + content[end:])
    log = EventLog(store)
    (recovery,) = log.recovered
    assert recovery.records == len(records) - 6
    assert {(lost.unit, lost.signal, lost.count) for lost in recovery.lost} == {
        *((f"U{i}", "rate", 100) for i in range(5)),
        ("plant/bench", "documents", 1),
    }
    (lost,) = [each for each in recovery.lost if each.unit == "U0"]
    assert (lost.first_ns, lost.last_ns) == (None, 100 * 10**6)
    assert "100 samples of unit U0, signal rate (numbers 0 to 99" in str(lost)
    assert recovery.kept_aside is not None
    assert recovery.kept_aside.read_bytes()[end:] == content[end:]


def test_an_undamaged_segment_is_finished_where_it_lies(tmp_path: Path) -> None:
    store, records = written(tmp_path, seal=False)
    (left_open,) = store.log.glob("*.open")
    inode = left_open.stat().st_ino
    with left_open.open("ab") as file:
        file.write(b"\x06torn")
    log = EventLog(store)
    (recovery,) = log.recovered
    assert (recovery.records, recovery.damaged_chunks, recovery.lost) == (len(records), 0, ())
    (segment,) = store.log.glob("*.mcap")
    assert segment.stat().st_ino == inode
    assert list(read_segment(segment)) == records
    with segment.open("rb") as file:
        assert len(list(make_reader(file, validate_crcs=True).iter_messages())) == len(records)
    assert recovery.kept_aside is not None
    assert recovery.kept_aside.read_bytes() == b"\x06torn"
    assert EventLog(store).recovered == []
    assert EventLog(store).warnings == []


def test_an_abandoned_segment_has_what_its_name_says_is_durable(tmp_path: Path) -> None:
    store, records = written(tmp_path, seal=False)
    (left_open,) = store.log.glob("*.open")
    chunks = _chunks(left_open.read_bytes(), tmp_path)
    durable = chunks[7].chunk_start_offset
    left_open.rename(left_open.with_name(f"00000001.mcap.abandoned-{durable}"))
    log = EventLog(store)
    assert list(read_segment(store.log / "00000001.mcap")) == records[: 7 * 6]
    assert {mark for stream, mark in log.marks.items() if "event" not in stream.key} == {700}


def test_salvaging_a_damaged_segment_says_what_is_lost_and_keeps_the_evidence(tmp_path: Path) -> None:
    store, records = written(tmp_path)
    (segment,) = store.log.glob("*.mcap")
    content = bytearray(segment.read_bytes())
    chunk = _chunks(bytes(content), tmp_path)[-1]
    content[chunk.chunk_start_offset + 100] ^= 1  # the last chunk: only the marks say that there was more
    segment.write_bytes(content)
    recovery = salvage_segment(store, segment, {})
    assert recovery.kept_aside is not None
    assert recovery.kept_aside.read_bytes() == content
    assert list(read_segment(segment)) == records[:-6]
    assert sorted(lost.count for lost in recovery.lost) == [1, 100, 100, 100, 100, 100]
    assert {lost.last_ns for lost in recovery.lost} == {None}
    assert recovery.entry is not None
    assert recovery.entry.origin == "salvaged"


def test_a_gap_in_the_numbers_is_a_lost_stretch() -> None:
    check = SequenceCheck()
    for first in (0, 100, 300):
        place = place_of(samples("U1", first))
        assert place is not None
        assert check.follow(place)
    (lost,) = check.lost
    assert (lost.first_seq, lost.last_seq, lost.first_ns, lost.last_ns) == (200, 299, 199 * 10**6, 300 * 10**6)
    place = place_of(samples("U1", 100))
    assert place is not None
    assert not check.follow(place)
    assert len(check.repeated) == 1


def test_batches_come_back_as_they_were(tmp_path: Path) -> None:
    store, records = written(tmp_path)
    (segment,) = store.log.glob("*.mcap")
    read = [decode_batch(record.data) for record in read_segment(segment) if record.schema == SAMPLES]
    assert read == [decode_batch(record.data) for record in records if record.schema == SAMPLES]


@pytest.mark.parametrize("length", range(6))
def test_an_index_too_short_to_be_one_ends_a_file_without_an_error(tmp_path: Path, length: int) -> None:
    store, records = written(tmp_path, syncs=2)
    (segment,) = store.log.glob("*.mcap")
    whole = SegmentScan(segment)
    assert list(whole) == records
    content = segment.read_bytes()[: whole.whole_bytes] + FRAME.pack(Opcode.MESSAGE_INDEX, length) + bytes(length)
    segment.write_bytes(content)
    scan = SegmentScan(segment)
    assert list(scan) == records
    assert scan.torn is not None or scan.damaged
