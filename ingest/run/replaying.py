"""A stored run replayed: to estimators in this process, into another store, or to a running recorder."""

import functools
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from ingest.run.pipeline import EmbeddedPipeline
from storage.log.replay import Comparing, Comparison, StoredMessage, StoredRun
from storage.store import Store
from stream.delivery.publisher import DurablePublisher, Sender
from stream.errors import BadInput, NotFound, StoreError
from stream.estimators.base import PointEstimator, default_estimators
from stream.estimators.bias_stability import BiasStability
from stream.events import decode_event
from stream.transport.bus import LocalBus
from stream.transport.zenoh_bus import ZenohBus
from stream.wire.batches import decode_batch
from stream.worker.estimated_signals import EstimatedSignals
from stream.worker.worker import EstimationWorker

Progress = Callable[[float], None]
_DEFAULT_EVERY_S = 60.0


@dataclass
class Replayed:
    """How much was sent."""

    messages: int = 0
    samples: int = 0


@dataclass
class Pace:
    """Delays messages to `speed` times the source's clock; 0 does not wait."""

    speed: float
    _begin: tuple[int, float] | None = field(default=None, init=False)

    def wait_for(self, message: StoredMessage) -> None:
        """Wait until the last sample of a message would have been measured."""
        if not self.speed or message.last_ns is None:
            return
        if self._begin is None:
            self._begin = message.last_ns, time.monotonic()
        first_ns, began = self._begin
        time.sleep(max(0.0, began + (message.last_ns - first_ns) / 1e9 / self.speed - time.monotonic()))


def interval_s(run: StoredRun) -> float:
    """Interval in which the run was estimated, seconds; raises BadInput if it is not known."""
    if len(run.every_ns) > 1:
        intervals = " and ".join(f"{each / 1e9:g} s" for each in sorted(run.every_ns))
        raise BadInput(f"run {run.run} was estimated every {intervals}; say with --every which is to be replayed")
    if run.estimates and not run.every_ns:
        raise BadInput(f"the estimates of run {run.run} do not say how often they came; give --every SECONDS")
    return next(iter(run.every_ns)) / 1e9 if run.every_ns else _DEFAULT_EVERY_S


def estimated_every_s(folder: Path, run: str) -> float:
    """Interval of a run's estimates so far, seconds; where there are none, that of `gyrofleet estimate`."""
    try:
        found = StoredRun(Store.open(folder), run).every_ns
    except (NotFound, StoreError):
        found = set()
    return min(found) / 1e9 if found else _DEFAULT_EVERY_S


def compared(run: StoredRun, every_s: float, speed: float, progress: Progress) -> tuple[Replayed, Comparison]:
    """Estimate a run again, over a bus in this process, and compare with what is stored."""
    factories: dict[str, Callable[[], PointEstimator]] = {
        BiasStability(each).key: functools.partial(BiasStability, each) for each in run.averages_s
    }
    factories |= default_estimators()
    pace, found, comparing = Pace(speed), Replayed(), Comparing(run.estimates)
    with (
        LocalBus() as bus,
        EstimationWorker(bus, comparing, every_s=every_s, estimators=factories, estimated=_estimated(run)) as worker,
    ):
        for message in run.messages(progress):
            pace.wait_for(message)
            worker.wait_for_room()
            bus.publish(message.key, message.payload)
            _count(found, message)
    return found, comparing.result()


def sent_into(run: StoredRun, folder: Path, every_s: float, speed: float, progress: Progress) -> Replayed:
    """Record and estimate a run in another store."""
    with EmbeddedPipeline(folder, "gyrofleet replay", estimate_every_s=every_s, estimated=_estimated(run)) as pipeline:
        found = _send(run, pipeline, speed, progress)
        pipeline.finish()
    return found


def sent_to(run: StoredRun, endpoint: str, speed: float, progress: Progress) -> Replayed:
    """Send a run to a recorder, and wait until it has it."""
    with ZenohBus(connect=[endpoint]) as bus, DurablePublisher(bus) as publisher:
        found = _send(run, publisher, speed, progress)
        publisher.drain()
    return found


def _estimated(run: StoredRun) -> EstimatedSignals:
    """The signals that were estimated when the run was recorded, else the default."""
    return EstimatedSignals(frozenset(run.signals), rates=False) if run.signals else EstimatedSignals()


def _send(run: StoredRun, sender: Sender, speed: float, progress: Progress) -> Replayed:
    pace, found = Pace(speed), Replayed()
    begins: dict[tuple[str, str], int] = {}
    for message in run.messages(progress):
        pace.wait_for(message)
        if message.last_ns is None:
            sender.send_event(message.key, decode_event(message.payload).document)
        else:
            batch = decode_batch(message.payload)
            # where a run began in the middle of an epoch, its numbers begin again
            begin = begins.setdefault((message.key, batch.epoch.hex), batch.seq)
            sender.send_batch(message.key, batch if begin == 0 else replace(batch, seq=batch.seq - begin))
        _count(found, message)
    return found


def _count(found: Replayed, message: StoredMessage) -> None:
    found.messages += 1
    found.samples += message.samples
