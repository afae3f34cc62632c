"""The worker: what it makes of duplicates, losses, refusals and the end of a run."""

from collections.abc import Iterator
from contextlib import suppress
from uuid import UUID

import numpy as np
import pytest

from stream.batch import SampleBatch
from stream.delivery.publisher import DurablePublisher
from stream.errors import WireError
from stream.estimators.base import default_estimators
from stream.events import AnyDocument, EstimatePublished, RunEnded, decode_event
from stream.identity import ACKNOWLEDGEMENT_KEY, EVERYTHING, Place, event_key, sample_key
from stream.transport.bus import LocalBus
from stream.wire.acknowledgement import StreamPosition, encode_acknowledgement
from stream.wire.batches import encode_batch
from stream.worker.worker import EstimationWorker

PLACE = Place("plant", "bench")
KEY = sample_key(PLACE, "U1", "rate")
RNG = np.random.default_rng(11)
VALUES = RNG.standard_normal(100_000)


def batch(first: int, n: int = 1000, dt_ns: int = 10**7, run: str = "r1") -> SampleBatch:
    values = VALUES[first : first + n]
    return SampleBatch("U1", "rate", run, UUID(int=1), first, first * 10**7, dt_ns, "deg/s", values=values)


class Bench:
    """A worker on a bus, and what it published."""

    def __init__(self) -> None:
        self.bus = LocalBus()
        self.bus.subscribe(EVERYTHING, self._acknowledge)
        self.publisher = DurablePublisher(self.bus)
        self.published: list[EstimatePublished] = []
        self.worker = EstimationWorker(self.bus, self.publisher, every_s=60.0, on_document=self._see)

    def _see(self, document: AnyDocument) -> None:
        if isinstance(document, EstimatePublished):
            self.published.append(document)

    def _acknowledge(self, key: str, payload: bytes) -> None:
        with suppress(WireError):
            event = decode_event(payload)
            position = StreamPosition(key, event.epoch, event.seq + 1)
            self.bus.publish(ACKNOWLEDGEMENT_KEY, encode_acknowledgement("store", (position,)))

    def send(self, *batches: SampleBatch) -> None:
        for each in batches:
            self.bus.publish(KEY, encode_batch(each))

    def end(self, run: str = "r1") -> None:
        with DurablePublisher(self.bus) as source:
            source.send_event(event_key(PLACE), RunEnded(run=run, t_ns=10**12))
        self.worker.close()


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.publisher.close()


def final(bench: Bench, estimator: str) -> EstimatePublished:
    (document,) = [d for d in bench.published if d.final and d.estimator == estimator]
    return document


def test_estimates_come_by_the_signals_own_time_and_once_more_at_the_end(bench: Bench) -> None:
    bench.send(*(batch(i * 1000) for i in range(25)))  # 250 s
    bench.end()
    times = [d.t_ns for d in bench.published if d.estimator == "allan_deviation" and not d.final]
    assert [t // 60_000_000_000 for t in times] == [1, 2, 3, 4]
    assert {d.estimator for d in bench.published if d.final} == set(default_estimators())
    last = final(bench, "bias_stability_10s")
    assert (last.samples, last.missing, last.unit_of_measure) == (25_000, 0, "deg/h")
    expected = VALUES[:25_000].reshape(25, 1000).mean(axis=1).std(ddof=1) * 3600
    assert last.points[0].value == pytest.approx(expected, rel=1e-9)


def test_duplicates_change_nothing_and_losses_are_counted_as_missing(bench: Bench) -> None:
    bench.send(batch(0), batch(1000), batch(0), batch(1000), batch(3000))
    bench.end()
    assert (bench.worker.counts.duplicates, bench.worker.counts.lost) == (2, 1000)
    last = final(bench, "allan_deviation")
    assert (last.samples, last.missing) == (3000, 1000)


@pytest.mark.long
def test_a_signal_that_cannot_be_estimated_says_why_and_harms_no_other(bench: Bench) -> None:
    bench.send(batch(0), batch(1000, dt_ns=2 * 10**7), batch(2000))
    other = sample_key(PLACE, "U2", "rate")
    values = VALUES[:5000]
    bench.bus.publish(
        other, encode_batch(SampleBatch("U2", "rate", "r1", UUID(int=2), 0, 0, 10**7, "deg/s", values=values))
    )
    bench.bus.publish(KEY, b"garbage")
    bench.end()
    mine = [d for d in bench.published if d.final and d.unit == "U1"]
    assert all("sample interval changes from 0.01 s to 0.02 s" in str(d.reason) and not d.points for d in mine)
    theirs = [d for d in bench.published if d.final and d.unit == "U2" and d.estimator == "allan_deviation"]
    assert theirs[0].points
    assert bench.worker.counts.rejected == 1


def test_runs_are_estimated_apart(bench: Bench) -> None:
    bench.send(batch(0))
    bench.send(SampleBatch("U1", "rate", "r2", UUID(int=9), 0, 0, 10**7, "deg/s", values=VALUES[:500]))
    bench.end("r2")
    assert {d.run for d in bench.published if d.final} == {"r2"}
    assert not [d for d in bench.published if d.run == "r1"]  # nothing was due, and stopping adds nothing
