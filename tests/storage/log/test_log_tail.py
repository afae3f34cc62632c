"""Catching up with a log: beginning with the runs that go on, and reading on from there."""

from collections.abc import Callable, Iterator
from pathlib import Path
from uuid import UUID

import numpy as np
import pytest

from storage.log.event_log import EventLog
from storage.log.sequence import place_of
from storage.log.tail import LogTail, first_to_read, records_of
from storage.manifests.log import manifest_path
from storage.segments.records import EVENTS, SAMPLES, LogRecord
from storage.store import Store, WriterLock
from stream.batch import SampleBatch
from stream.events import AnyDocument, EstimatePublished, RunEnded, RunStarted, SpectralLinesFound, encode_event
from stream.identity import Place, estimate_key, event_key, sample_key
from stream.wire.acknowledgement import StreamId
from stream.wire.batches import decode_batch, encode_batch

PLACE = Place("plant", "bench")
KEY = sample_key(PLACE, "U1", "rate")
ESTIMATE = estimate_key(PLACE, "U1", "rate", "allan_deviation")


class Writer:
    """A log that is written message by message; each stream is numbered by itself."""

    def __init__(self, folder: Path) -> None:
        self.store = Store.create(folder)
        self.lock = WriterLock(self.store, "test")
        self.log = EventLog(self.store)
        self.tail = LogTail(self.store)
        self._next: dict[str, int] = {}

    def samples(self, run: str, epoch: int, n: int = 10) -> None:
        stream = f"{epoch}"
        seq = self._next.get(stream, 0)
        self._next[stream] = seq + n
        batch = SampleBatch("U1", "rate", run, UUID(int=epoch), seq, 0, 10, "deg/s", values=np.zeros(n))
        self._append(LogRecord(KEY, SAMPLES, 1, 1, encode_batch(batch)))

    def event(self, document: AnyDocument, key: str = "") -> None:
        key = key or event_key(PLACE)
        seq = self._next.get(key, 0)
        self._next[key] = seq + 1
        self._append(LogRecord(key, EVENTS, 1, 1, encode_event(document, "e", seq)))

    def estimate(self, run: str, uid: str) -> None:
        self.event(
            EstimatePublished(
                run=run, t_ns=0, uid=uid, unit="U1", signal="rate", estimator="allan", unit_of_measure="deg/h",
                confidence=0.95, samples=1, missing=0, sample_interval_s=1.0,
            ),
            ESTIMATE,
        )  # fmt: skip

    def end(self, run: str) -> None:
        self.event(RunEnded(run=run, t_ns=0))

    def seal(self) -> None:
        self.log.sync()
        self.log.seal()

    def _append(self, record: LogRecord) -> None:
        place = place_of(record)
        assert place is not None
        self.log.append(place, record)

    def from_the_beginning(self, *, thorough: bool = False) -> list[str]:
        """What is read: the runs of batches in their order, and the identities of documents."""
        found = self.tail.beginning(thorough=thorough)
        runs = [
            decode_batch(message.payload).run
            for message in self.tail.since(found.positions)
            if message.stream.key == KEY
        ]
        return [run for run in runs if run not in found.ended]


@pytest.fixture
def writer(tmp_path: Path) -> Iterator[Writer]:
    writer = Writer(tmp_path / "store")
    yield writer
    writer.log.abandon()
    writer.lock.close()


def two_runs(writer: Writer, between: Callable[[], None]) -> None:
    writer.event(RunStarted(run="r1", t_ns=0))
    writer.samples("r1", 1)
    between()
    writer.event(RunStarted(run="r2", t_ns=0))
    writer.samples("r2", 2)
    writer.samples("r1", 1)
    writer.estimate("r1", "a")
    between()
    writer.end("r1")
    writer.estimate("r1", "b")
    between()
    writer.samples("r2", 2)
    writer.estimate("r2", "c")
    writer.log.sync()


@pytest.mark.parametrize("sealing", [True, False])
def test_a_run_that_goes_on_is_taken_from_its_beginning_and_one_that_has_ended_is_not(
    writer: Writer, sealing: bool
) -> None:
    two_runs(writer, writer.seal if sealing else writer.log.sync)
    assert writer.from_the_beginning() == ["r2", "r2"]
    found = writer.tail.beginning()
    assert found.positions[StreamId(KEY, UUID(int=1).hex)] == 20
    assert found.positions[StreamId(KEY, UUID(int=2).hex)] == 0
    assert list(writer.tail.published(found.positions)) == ["c"]
    assert list(writer.tail.published({})) == ["a", "b", "c"]


def test_runs_that_share_a_stream_are_distinguished(writer: Writer) -> None:
    for run, ends in (("r1", True), ("r2", False), ("r3", True), ("r2", False)):
        writer.samples(run, 1)
        if ends:
            writer.end(run)
        writer.seal()
    assert writer.from_the_beginning() == ["r2", "r2"]
    assert writer.tail.beginning().ended == {"r3"}  # r1 ended before any run that goes on began


def test_a_run_that_is_added_to_after_its_end_goes_on(writer: Writer) -> None:
    writer.samples("r1", 1)
    writer.end("r1")
    writer.seal()
    for run in ("r2", "r1"):
        writer.samples(run, 2 if run == "r2" else 3)
        writer.seal()
    assert sorted(writer.from_the_beginning()) == ["r1", "r1", "r2"]


def test_read_thoroughly_a_run_that_was_not_estimated_to_its_end_is_begun_too(writer: Writer) -> None:
    two_runs(writer, writer.seal)
    writer.samples("r3", 3)
    writer.end("r3")
    writer.seal()
    assert writer.from_the_beginning(thorough=True) == ["r1", "r2", "r1", "r2"]  # r3 was never estimated
    writer.event(SpectralLinesFound(run="r1", t_ns=0, unit="U1", signal="rate", lines=None), ESTIMATE)
    writer.log.sync()
    assert writer.from_the_beginning(thorough=True) == ["r2", "r2"]


def test_where_the_manifest_is_gone_the_segments_are_read(writer: Writer) -> None:
    two_runs(writer, writer.seal)
    sealed = sorted(path.name for path in writer.store.log.glob("*.mcap"))
    assert first_to_read(writer.store, sealed) == 1
    manifest_path(writer.store).unlink()
    assert first_to_read(writer.store, sealed) == 0
    assert writer.from_the_beginning() == ["r2", "r2"]


def test_with_nothing_going_on_no_segment_is_read_and_all_is_known(writer: Writer) -> None:
    writer.samples("r1", 1)
    writer.end("r1")
    writer.seal()
    assert first_to_read(writer.store, ["00000001.mcap"]) == 1
    assert writer.from_the_beginning() == []
    assert writer.tail.beginning().positions == {StreamId(KEY, UUID(int=1).hex): 10, StreamId(event_key(PLACE), "e"): 1}


@pytest.mark.parametrize("read_first", [0, 1, 7, 20])
def test_a_segment_that_is_sealed_while_it_is_read_is_read_once(writer: Writer, read_first: int) -> None:
    for _ in range(20):
        writer.samples("r1", 1)
    writer.log.sync()
    records = records_of(writer.store, lambda _name: True, lambda _key: True)
    found = [next(records) for _ in range(read_first)]
    writer.log.seal()
    for _ in range(20):
        writer.samples("r1", 1)
    writer.log.sync()
    found += records
    assert [decode_batch(record.data).seq for record in found] == list(range(0, 400, 10))


def test_an_open_segment_is_read_once_though_another_is_sealed_meanwhile(writer: Writer, tmp_path: Path) -> None:
    for _ in range(20):
        writer.samples("r1", 1)
    writer.seal()
    (sealed,) = writer.store.log.glob("*.mcap")
    aside = sealed.rename(tmp_path / sealed.name)
    for _ in range(20):
        writer.samples("r1", 2)
    writer.log.sync()
    records = records_of(writer.store, lambda _name: True, lambda _key: True)
    found = [next(records) for _ in range(7)]
    aside.rename(sealed)  # as one that had been given up, and is put right
    found += records
    read = sorted((decode_batch(record.data).epoch.int, decode_batch(record.data).seq) for record in found)
    assert read == [(epoch, seq) for epoch in (1, 2) for seq in range(0, 200, 10)]
