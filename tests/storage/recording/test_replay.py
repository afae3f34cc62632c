"""A stored run sent once more is estimated as it was, to the last bit; differences are reported."""

import functools
import time
from collections.abc import Callable
from pathlib import Path
from uuid import UUID

import numpy as np
import pytest

from ingest.run.pipeline import EmbeddedPipeline
from ingest.run.replaying import Pace, compared, interval_s, sent_into
from storage.log.event_log import EventLog
from storage.log.replay import StoredMessage, StoredRun
from storage.recording.recorder import Recorder
from storage.store import Store, WriterLock
from stream.batch import SampleBatch
from stream.delivery.publisher import DurablePublisher, Sender
from stream.errors import BadInput, NotFound
from stream.estimators.base import PointEstimator, default_estimators
from stream.estimators.bias_stability import BiasStability
from stream.events import Limit, LimitsApplied, RunEnded, RunStarted
from stream.identity import Place, event_key, sample_key
from stream.transport.bus import LocalBus
from stream.worker.worker import EstimationWorker

PLACE = Place("plant", "bench")
EVENTS = event_key(PLACE)
N = 30_000
COUNTS = np.random.default_rng(3).integers(-500, 500, N).astype(np.int32)
LIMITS = (
    Limit(characteristic="bias_stability", signal="rate", tau_s=1.0, upper=100.0, unit_of_measure="deg/h"),
    Limit(characteristic="allan_deviation", signal="rate", tau_s=3.0, upper=50.0, unit_of_measure="deg/h"),
)


def nothing(_done: float) -> None:
    """No progress is shown."""


def send_run(sender: Sender, run: str = "r1", seq: int = 0, n: int = N) -> None:
    """A regular signal in odd batches with a gap, and a slow irregular one, both of epoch 1 from number `seq` on."""
    sender.send_event(EVENTS, RunStarted(run=run, t_ns=0))
    sender.send_event(EVENTS, LimitsApplied(run=run, t_ns=0, revision="R", limits=LIMITS, planned_s=n / 100))
    times = np.cumsum(np.random.default_rng(4).integers(10**7, 3 * 10**7, n))
    at = 0
    for step in [1, 36, 700, 3, *[997] * (n // 997 + 1)]:
        stop = min(n, at + step)
        if at < stop:
            gap_ns = 5 * 10**9 if at > n // 2 else 0
            head = ("U1", "rate", run, UUID(int=1), seq + at, at * 10**7 + gap_ns, 10**7, "deg/h")
            sender.send_batch(sample_key(PLACE, "U1", "rate"), SampleBatch(*head, counts=COUNTS[at:stop], scale=0.5))
            head = ("U1", "temperature", run, UUID(int=1), seq + at, int(times[at]), 2 * 10**7, "degC")
            batch = SampleBatch(
                *head, values=COUNTS[at:stop] / np.float64(10.0), times_ns=times[at:stop], irregular=True
            )
            sender.send_batch(sample_key(PLACE, "U1", "temperature"), batch)
        at = stop
    sender.send_event(EVENTS, RunEnded(run=run, t_ns=int(times[-1])))


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """Two runs within one epoch, estimated every 50 s while they came."""
    folder = tmp_path_factory.mktemp("replay") / "store"
    with EmbeddedPipeline(folder, "test", estimate_every_s=50.0, rotate_bytes=64 << 10) as pipeline:
        send_run(pipeline)
        send_run(pipeline, "r2", seq=N, n=N // 2)
        pipeline.finish()
    return Store.open(folder)


@pytest.mark.long
@pytest.mark.parametrize("run", ["r1", "r2"])
def test_a_run_is_estimated_as_it_was_to_the_last_bit(store: Store, run: str) -> None:
    stored = StoredRun(store, run)
    assert stored.is_ended
    assert interval_s(stored) == 50.0
    found, comparison = compared(stored, 50.0, 0.0, nothing)
    assert comparison.is_equal, comparison
    assert comparison.equal > 30
    assert found.samples == (2 * N if run == "r1" else N)


def test_what_is_not_the_same_is_said(store: Store) -> None:
    stored = StoredRun(store, "r1")
    first, second = list(stored.estimates)[:2]
    stored.estimates[first] = stored.estimates[first]._replace(digest=b"")
    stored.estimates["f" * 32] = stored.estimates.pop(second)._replace(name="one that is not made")
    _, comparison = compared(stored, 50.0, 0.0, nothing)
    assert not comparison.is_equal
    assert comparison.different == [stored.estimates[first].name]
    assert comparison.missing == ["one that is not made"]
    assert len(comparison.extra) == 1
    _, comparison = compared(StoredRun(store, "r1"), 40.0, 0.0, nothing)
    assert not comparison.is_equal


def test_a_run_begun_in_the_middle_of_an_epoch_is_replayed_into_another_store(store: Store, tmp_path: Path) -> None:
    stored = StoredRun(store, "r2")
    for _ in range(2):  # given again it adds nothing
        assert sent_into(stored, tmp_path / "other", 50.0, 0.0, nothing).samples == N
    other = StoredRun(Store.open(tmp_path / "other"), "r2")
    assert other.estimates == stored.estimates
    assert sum(message.samples for message in other.messages()) == N
    assert compared(other, 50.0, 0.0, nothing)[1].is_equal


def test_estimators_beyond_the_usual_ones_are_found_in_what_is_stored(tmp_path: Path) -> None:
    averages = {BiasStability(each).key: functools.partial(BiasStability, each) for each in (5.0, 1.23456789)}
    factories: dict[str, Callable[[], PointEstimator]] = {**default_estimators(), **averages}
    store = Store.create(tmp_path / "store")
    with (
        WriterLock(store, "test"),
        LocalBus() as bus,
        Recorder(store, bus, EventLog(store)),
        DurablePublisher(bus) as source,
        DurablePublisher(bus) as estimates,
        EstimationWorker(bus, estimates, every_s=100.0, estimators=factories),
    ):
        send_run(source)
        source.drain()
    stored = StoredRun(store, "r1")
    assert {5.0, 1.23456789} <= stored.averages_s
    assert compared(stored, 100.0, 0.0, nothing)[1].is_equal


def test_a_run_that_is_not_there_and_an_unknown_interval_are_said(store: Store) -> None:
    with pytest.raises(NotFound, match="holds no run 'r9'"):
        StoredRun(store, "r9")
    stored = StoredRun(store, "r1")
    stored.every_ns = {10**9, 2 * 10**9}
    with pytest.raises(BadInput, match="every 1 s and 2 s"):
        interval_s(stored)
    stored.every_ns = set()
    with pytest.raises(BadInput, match="give --every"):
        interval_s(stored)


def test_a_replay_keeps_the_pace_of_the_source() -> None:
    pace = Pace(speed=100.0)
    began = time.monotonic()
    for last_ns in (10**9, None, 6 * 10**9, 21 * 10**9):
        pace.wait_for(StoredMessage("key", b"", 1, last_ns))
    assert 0.2 <= time.monotonic() - began < 2.0
