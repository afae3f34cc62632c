"""Documents beyond the lake: a sealed segment is read for them once, and what is read is always what the log has."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from mcap.reader import make_reader

from storage.log import sealed_documents
from storage.log.sealed_documents import is_of_documents
from storage.log.tail import documents_beyond
from storage.log.writer import SegmentWriter
from storage.segments import reader
from storage.segments.chunks import messages_of
from storage.segments.reader import SegmentScan, read_chunks_of
from stream.errors import StoreError
from stream.events import RunStarted
from tests.storage.log.test_log_tail import KEY, Writer


@pytest.fixture
def writer(tmp_path: Path) -> Iterator[Writer]:
    """Two sealed segments and an open one, each with a document between samples."""
    writer = Writer(tmp_path / "store")
    for run in ("r1", "r2", "r3"):
        writer.samples(run, 1)
        writer.event(RunStarted(run=run, t_ns=0))
        writer.samples(run, 1)
        if run != "r3":
            writer.seal()
    writer.log.sync()
    yield writer
    writer.log.abandon()
    writer.lock.close()


@pytest.fixture
def reads(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the sealed segments that were read, each time."""
    names: list[str] = []
    read_chunks_of = reader.read_chunks_of

    def counted(path: Path, is_wanted: Callable[[str], bool]) -> Iterator[bytes]:
        names.append(path.name)
        return read_chunks_of(path, is_wanted)

    monkeypatch.setattr(sealed_documents, "read_chunks_of", counted)
    return names


def runs(writer: Writer, in_lake: frozenset[str] = frozenset()) -> list[str]:
    return [document.run for document, _ in documents_beyond(writer.store, in_lake)]


def test_a_sealed_segment_is_read_once(writer: Writer, reads: list[str]) -> None:
    assert [runs(writer) for _ in range(3)] == [["r1", "r2", "r3"]] * 3
    assert reads == ["00000001.mcap", "00000002.mcap"]


def test_a_segment_of_the_lake_is_not_read(writer: Writer, reads: list[str]) -> None:
    assert runs(writer, frozenset({"00000001"})) == ["r2", "r3"]
    assert reads == ["00000002.mcap"]


def test_what_is_written_and_sealed_later_is_found_once(writer: Writer, reads: list[str]) -> None:
    assert runs(writer) == ["r1", "r2", "r3"]
    writer.event(RunStarted(run="r4", t_ns=0))
    writer.seal()
    writer.event(RunStarted(run="r5", t_ns=0))
    writer.log.sync()
    assert runs(writer) == ["r1", "r2", "r3", "r4", "r5"]
    assert reads == ["00000001.mcap", "00000002.mcap", "00000003.mcap"]


@pytest.mark.parametrize("read_first", range(5))
def test_a_segment_that_is_sealed_while_it_is_read_is_read_once(writer: Writer, read_first: int) -> None:
    writer.event(RunStarted(run="r4", t_ns=0))
    writer.log.sync()
    documents = documents_beyond(writer.store, frozenset())
    found = [next(documents)[0].run for _ in range(read_first)]
    writer.log.seal()
    found += [document.run for document, _ in documents]
    assert found == ["r1", "r2", "r3", "r4"]


def damage(path: Path, chunk: int) -> None:
    """Change a byte of a chunk, which the library for MCAP finds."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    content = bytearray(path.read_bytes())
    at = summary.chunk_indexes[chunk]
    content[at.chunk_start_offset + at.chunk_length - 1] ^= 1
    path.write_bytes(content)


def test_damage_that_comes_later_is_found(writer: Writer) -> None:
    assert runs(writer) == ["r1", "r2", "r3"]
    damage(writer.store.log / "00000002.mcap", 0)
    with pytest.raises(StoreError, match="00000002"):
        runs(writer)


def test_chunks_of_samples_are_not_read(writer: Writer) -> None:
    for count in (1, 2, 3):
        writer.samples("r4", count)
        writer.log.sync()  # ends a chunk
        writer.event(RunStarted(run=f"r4.{count}", t_ns=0))
        writer.log.sync()
    writer.seal()
    path = writer.store.log / "00000003.mcap"
    for chunk in (1, 3, 5):
        damage(path, chunk)
    assert runs(writer) == ["r1", "r2", "r3", "r4.1", "r4.2", "r4.3"]
    damage(path, 4)
    with pytest.raises(StoreError, match="00000003"):
        list(read_chunks_of(path, is_of_documents))


def test_a_chunk_without_indexes_is_read(writer: Writer, tmp_path: Path) -> None:
    """Recovery keeps a chunk whose indexes are damaged."""
    content = bytearray((writer.store.log / "00000003.mcap.open").read_bytes())
    content[-1] ^= 1  # of the last index
    path = tmp_path / "copy" / "00000001.mcap"
    path.parent.mkdir()
    path.with_suffix(".mcap.open").write_bytes(content)
    scan = SegmentScan(path.with_suffix(".mcap.open"))
    records = list(scan)
    assert scan.summary.chunks[-1].message_index_offsets == {}
    copy = SegmentWriter(path, found=(memoryview(bytes(content[: scan.whole_bytes])), scan.summary))
    copy.sync()
    copy.seal({})
    found = {record for content in read_chunks_of(path, is_of_documents) for record in messages_of(content, {})}
    assert found == set(records)


def test_segments_of_many_documents_are_not_kept(
    writer: Writer, reads: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sealed_documents, "_MOST_BYTES", 0)
    assert runs(writer) == runs(writer) == ["r1", "r2", "r3"]
    assert reads == ["00000001.mcap", "00000002.mcap"] * 2


def test_the_oldest_are_forgotten(writer: Writer, reads: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sealed_documents, "_MOST_SEGMENTS", 1)
    assert runs(writer) == runs(writer) == ["r1", "r2", "r3"]
    assert reads == ["00000001.mcap", "00000002.mcap"] * 2


@pytest.mark.parametrize("each", [7, pytest.param(1, marks=pytest.mark.long)])
def test_chunks_of_samples_of_an_open_segment_are_not_read(writer: Writer, each: int) -> None:
    """All but the last one, whose indexes may not be whole; those with documents are, wherever the file ends.

    At every seventh byte; in the long form at every byte.
    """
    for count in (1, 2, 3):
        writer.samples("r4", count)
        writer.log.sync()
        writer.event(RunStarted(run=f"r4.{count}", t_ns=0))
        writer.log.sync()
    writer.samples("r4", 4)
    writer.log.sync()
    path = writer.store.log / "00000003.mcap.open"
    assert runs(writer) == ["r1", "r2", "r3", "r4.1", "r4.2", "r4.3"]
    scan = SegmentScan(path, is_wanted=is_of_documents)
    assert [record.topic for record in scan].count(KEY) == 2 + 1  # of 6: beside a document, and the last
    assert not scan.damaged
    for limit in range(0, path.stat().st_size, each):
        whole = [each for each in SegmentScan(path, limit) if is_of_documents(each.topic)]
        some = SegmentScan(path, limit, is_wanted=is_of_documents)
        assert [each for each in some if is_of_documents(each.topic)] == whole
