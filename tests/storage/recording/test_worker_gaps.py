"""A worker that misses messages of the bus, while the recorder has them sooner or later: it takes all, in order."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from uuid import UUID

import numpy as np
import pytest

import stream.worker.worker
from storage.log.event_log import EventLog
from storage.log.tail import LogTail
from storage.recording.recorder import Recorder
from storage.store import Store, WriterLock, recorder_endpoint, writer_endpoint
from stream.batch import SampleBatch
from stream.delivery.publisher import DurablePublisher
from stream.events import AnyDocument, EstimatePublished, RunEnded, StreamTotal, encode_event
from stream.identity import Place, event_key, sample_key
from stream.transport.bus import LocalBus
from stream.wire.batches import encode_batch
from stream.worker.worker import EstimationWorker

PLACE = Place("plant", "bench")
KEY = sample_key(PLACE, "U1", "rate")
EPOCH = UUID(int=1)
N = 1000


def batch(number: int) -> bytes:
    values = np.random.default_rng(number).standard_normal(N)
    return encode_batch(
        SampleBatch("U1", "rate", "r1", EPOCH, number * N, number * N * 10**7, 10**7, "deg/s", values=values)
    )


def end(samples: int) -> bytes:
    total = StreamTotal(unit="U1", signal="rate", epoch=str(EPOCH), samples=samples)
    return encode_event(RunEnded(run="r1", t_ns=samples * 10**7, totals=(total,)), "e", 0)


class Bench:
    """A recorder and a worker on buses of their own: each hears what it is given."""

    def __init__(self, folder: Path) -> None:
        self.store = Store.create(folder)
        self._lock = WriterLock(self.store, "test")
        self.recorded, self.heard = LocalBus(), LocalBus()
        self.recorder = Recorder(
            self.store, self.recorded, EventLog(self.store), sync_interval_s=0.01, builds_lake=False
        )
        self._publisher = DurablePublisher(self.recorded)
        self.finals: list[EstimatePublished] = []
        self.worker = EstimationWorker(
            self.heard, self._publisher, every_s=60.0, log=LogTail(self.store), on_document=self._see
        )

    def _see(self, document: AnyDocument) -> None:
        if isinstance(document, EstimatePublished) and document.final:
            self.finals.append(document)

    def until(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + 20.0
        while not condition():
            assert time.monotonic() < deadline, "it does not come"
            time.sleep(0.01)

    def close(self) -> None:
        self.worker.kill()
        self._publisher.drain()
        self._publisher.close()
        self.recorder.close()
        self._lock.close()


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setattr(stream.worker.worker, "_PATIENCE_S", 0.1)
    monkeypatch.setattr(stream.worker.worker, "_READ_AGAIN_S", 0.2)
    bench = Bench(tmp_path / "store")
    yield bench
    bench.close()


def test_samples_that_are_recorded_long_after_their_successors_were_heard_are_not_missed(bench: Bench) -> None:
    for bus in (bench.heard, bench.recorded):
        bus.publish(KEY, batch(0))
    bench.heard.publish(KEY, batch(2))  # and not 1, which no recorder has for now
    bench.heard.publish(event_key(PLACE), end(4 * N))
    time.sleep(1.0)
    assert (bench.worker.counts.samples, bench.finals) == (N, [])
    bench.recorded.publish(event_key(PLACE), end(4 * N))  # the end may be recorded before the last samples
    time.sleep(1.0)
    assert bench.finals == []
    for number in (1, 2, 3):
        bench.recorded.publish(KEY, batch(number))
    bench.until(lambda: bool(bench.finals))
    assert {(each.samples, each.missing) for each in bench.finals} == {(4 * N, 0)}
    assert bench.worker.counts.lost == 0


def test_an_end_that_was_not_heard_is_found_in_the_log(bench: Bench) -> None:
    bench.heard.publish(KEY, batch(0))
    for number in range(2):
        bench.recorded.publish(KEY, batch(number))
    bench.recorded.publish(event_key(PLACE), end(2 * N))
    bench.until(lambda: bool(bench.finals))
    assert {each.samples for each in bench.finals} == {2 * N}


def test_the_end_of_a_run_whose_samples_are_lost_does_not_wait_for_ever(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stream.worker.pending_ends._LOST_AFTER_S", 0.5)
    for bus in (bench.heard, bench.recorded):
        bus.publish(KEY, batch(0))
        bus.publish(event_key(PLACE), end(2 * N))
    bench.until(lambda: bool(bench.finals))
    assert {each.samples for each in bench.finals} == {N}


def test_who_recorded_a_store_last_is_known_while_nobody_does(tmp_path: Path) -> None:
    store = Store.create(tmp_path / "store")
    assert recorder_endpoint(store.folder) is None
    with WriterLock(store, "gyrofleet record", "tcp/127.0.0.1:7447"):
        assert recorder_endpoint(store.folder) == writer_endpoint(store.folder) == "tcp/127.0.0.1:7447"
    assert (recorder_endpoint(store.folder), writer_endpoint(store.folder)) == ("tcp/127.0.0.1:7447", None)
    with WriterLock(store, "gyrofleet import"):
        assert recorder_endpoint(store.folder) is None
    assert recorder_endpoint(store.folder) == "tcp/127.0.0.1:7447"
