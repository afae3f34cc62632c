"""Compensated samples in one process, and by a worker beside a recorder."""

from collections.abc import Iterator

import pytest

from analytics.loop.live.compensation_worker import CompensatingSender, CompensationWorker
from analytics.loop.model.model_registry import ModelRegistry
from analytics.loop.model.model_use import Stage, activate
from storage.log.event_log import EventLog
from storage.log.tail import LogTail
from storage.recording.recorder import Recorder
from storage.store import Store, WriterLock
from stream.batch import SampleBatch
from stream.delivery.publisher import DurablePublisher
from stream.events import AnyDocument, RunEnded
from stream.identity import event_key, sample_key
from stream.security.actor import Actor
from stream.transport.bus import LocalBus
from stream.wire.batches import decode_batch
from tests.live_runs import (
    COEFFICIENTS,
    PLACE,
    RUN_S,
    T0_NS,
    TEXT,
    batches,
    compensated,
    ended,
    in_time,
    live,
    samples,
    version,
)


@pytest.fixture
def recording(store: Store) -> Iterator[tuple[LocalBus, DurablePublisher]]:
    """A recorder of a store in which a model is live, and a source that sends to it."""
    written = ModelRegistry(store).add(version(TEXT, COEFFICIENTS))
    activate(store, written, Stage.LIVE, reason="", by=Actor("Li"))
    with (
        LocalBus() as bus,
        WriterLock(store, "a test"),
        Recorder(store, bus, EventLog(store), sync_interval_s=0.01),
        DurablePublisher(bus) as source,
    ):
        yield bus, source


class _Kept:
    """A sender that keeps what it is given."""

    def __init__(self) -> None:
        self.events: list[AnyDocument] = []
        self.batches: list[tuple[str, SampleBatch]] = []

    def send_batch(self, key: str, batch: SampleBatch) -> None:
        self.batches.append((key, batch))

    def send_event(self, key: str, document: AnyDocument) -> None:
        assert key == event_key(PLACE)
        self.events.append(document)


def test_in_one_process_the_end_of_a_run_counts_what_was_compensated(store: Store) -> None:
    compensator, _ = live(store, TEXT, COEFFICIENTS)
    kept = _Kept()
    sender = CompensatingSender(kept, compensator)
    for batch in in_time(batches("rate", 100), batches("temperature", 10)):
        sender.send_batch(sample_key(PLACE, batch.unit, batch.signal), batch)
    sender.send_event(event_key(PLACE), ended())
    last = kept.events[-1]
    assert isinstance(last, RunEnded)
    totals = {each.signal: each.samples for each in last.totals}
    assert totals == {"rate": RUN_S * 10, "temperature": RUN_S, "rate_compensated": RUN_S * 10}
    assert samples([(PLACE, batch) for key, batch in kept.batches if key.endswith("_compensated")]).size == RUN_S * 10


@pytest.mark.long
def test_a_worker_that_is_killed_goes_on_and_nothing_is_lost_or_twice(
    store: Store, recording: tuple[LocalBus, DurablePublisher]
) -> None:
    bus, source = recording
    everything = list(in_time(batches("rate", 100), batches("temperature", 10)))
    expected, _ = live(Store.create(store.folder.parent / "E"), TEXT, COEFFICIENTS)
    out = compensated(expected, iter(everything), ended())
    for part in range(4):
        size = len(everything) // 4 + 1
        for batch in everything[part * size : (part + 1) * size]:
            source.send_batch(sample_key(PLACE, batch.unit, batch.signal), batch)
        if part == 3:
            source.send_event(event_key(PLACE), ended())
        source.drain()
        own = DurablePublisher(bus)
        worker = CompensationWorker(store, own)
        worker.look()
        if part == 3:
            own.drain()
        own.abandon()  # killed with what was not acknowledged
    again = DurablePublisher(bus)
    last = CompensationWorker(store, again)
    last.look()
    assert last.samples == 0  # the log has it all
    again.abandon()
    found = [
        decode_batch(message.payload)
        for message in LogTail(store).since({})
        if message.stream.key.endswith("_compensated")
    ]
    assert samples([(PLACE, batch) for batch in found]).tobytes() == samples(out).tobytes()


@pytest.mark.long
def test_what_cannot_be_compensated_is_told_once_however_often_the_worker_starts(
    store: Store, recording: tuple[LocalBus, DurablePublisher]
) -> None:
    bus, source = recording
    said: list[list[str]] = []
    for batch in batches("rate", 1000):
        source.send_batch(sample_key(PLACE, batch.unit, batch.signal), batch)
    for part in range(3):
        if part == 1:
            source.send_event(event_key(PLACE), RunEnded(run="r1", t_ns=T0_NS))
        source.drain()
        heard: list[AnyDocument] = []
        with DurablePublisher(bus) as own:
            worker = CompensationWorker(store, own, on_document=heard.append)
            worker.look()
        said.append([type(each).__name__ for each in heard])
    assert said == [["CompensationStarted"], ["NoteAdded"], []]
