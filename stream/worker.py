"""The worker: bus -> estimators -> estimates on the bus."""

import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

from stream.batch import SampleBatch
from stream.bus import Bus
from stream.delivery import DurablePublisher, StreamId
from stream.errors import EstimatorError, GyrofleetError
from stream.estimators.base import Estimator, NoEstimate, default_estimators
from stream.events import EstimatePublished, RunEnded, decode_event
from stream.identity import EVERYTHING, EventKey, Place, SampleKey, estimate_key, parse_key
from stream.wire import decode_batch

# A worker that falls behind must hold up neither the recorder, which shares its subscription, nor the bus that it
# publishes on itself: sources in the same process wait for room, from others it leaves out what it cannot hold.
_ROOM_BYTES = 32 << 20
_MOST_BYTES = 256 << 20


@dataclass
class WorkerCounts:
    """What a worker has done since it started."""

    samples: int = 0
    duplicates: int = 0
    lost: int = 0
    rejected: int = 0
    estimates: int = 0


@dataclass
class _Signal:
    place: Place
    estimators: Sequence[Estimator]
    next_due_ns: int
    last_ns: int
    refusal: str | None = None


class EstimationWorker:
    """Keeps the estimators of every signal on the bus up to date and publishes what they say.

    Estimates are published whenever a signal's own time passes a multiple of `every_s`, and once more, marked
    final, when its run ends: a function of the data, not of the moment they are looked at.

    Parameters
    ----------
    bus : Bus
        Where samples come from.
    publisher : DurablePublisher
        What the estimates are sent with.
    every_s : float
        Interval between estimates in the signal's time, seconds.
    estimators : sequence of callables, optional
        Each makes one estimator of a signal; by default those of `default_estimators`.
    on_estimate : callable, optional
        Called with every document that is published, in the worker's thread.
    """

    def __init__(
        self,
        bus: Bus,
        publisher: DurablePublisher,
        *,
        every_s: float = 60.0,
        estimators: Sequence[Callable[[], Estimator]] | None = None,
        on_estimate: Callable[[EstimatePublished], None] | None = None,
    ) -> None:
        self._publisher = publisher
        self._every_ns = round(every_s * 1e9)
        self._factories = list(default_estimators().values()) if estimators is None else list(estimators)
        self._on_estimate = on_estimate
        self.counts = WorkerCounts()
        self.failure: GyrofleetError | None = None
        self._signals: dict[tuple[str, str, str], _Signal] = {}
        self._next_seq: dict[StreamId, int] = {}
        self._incoming: deque[tuple[str, bytes]] = deque()
        self._incoming_bytes = 0
        self._state = threading.Condition()
        self._closing = False
        self._thread = threading.Thread(target=self._loop, name="gyrofleet-estimators", daemon=True)
        self._thread.start()
        bus.subscribe(EVERYTHING, self._on_message)

    def close(self) -> None:
        """Work off what has arrived, publish what is known of runs that have not ended, and stop.

        Raises
        ------
        GyrofleetError
            If the worker had stopped before.
        """
        with self._state:
            self._closing = True
            self._state.notify_all()
        self._thread.join()
        if self.failure is not None:
            raise self.failure

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def wait_for_room(self) -> None:
        """Wait until the worker is not far behind; for a source in the same process, before it sends more."""
        with self._state:
            while self._incoming_bytes > _ROOM_BYTES and self.failure is None and self._thread.is_alive():
                self._state.wait(0.1)

    def _on_message(self, key: str, payload: bytes) -> None:
        if "/estimate/" in key:
            return
        with self._state:
            if self._incoming_bytes > _MOST_BYTES:
                return  # the gap in the numbers is counted as lost when the next batch of the signal is taken
            self._incoming.append((key, payload))
            self._incoming_bytes += len(payload)
            if len(self._incoming) == 1:
                self._state.notify_all()

    def _loop(self) -> None:
        try:
            while True:
                with self._state:
                    while not self._incoming and not self._closing:
                        self._state.wait(0.5)
                    taken, self._incoming = self._incoming, deque()
                for key, payload in taken:
                    self._take(key, payload)
                with self._state:
                    self._incoming_bytes -= sum(len(payload) for _, payload in taken)
                    self._state.notify_all()
                if not taken and self._closing:
                    break
            for run, unit, name in list(self._signals):
                self._publish(run, unit, name, final=False)
        except Exception as error:  # noqa: BLE001  whatever it is, a worker that stopped must say so
            with self._state:
                self.failure = (
                    error
                    if isinstance(error, GyrofleetError)
                    else EstimatorError(f"the estimators stopped ({type(error).__name__}: {error}); recording goes on")
                )
                self._state.notify_all()

    def _take(self, key: str, payload: bytes) -> None:
        try:
            parsed = parse_key(key)
            if isinstance(parsed, SampleKey):
                batch = decode_batch(payload)
            else:
                document = decode_event(payload).document
        except GyrofleetError:
            self.counts.rejected += 1  # the recorder keeps it aside and reports it
            return
        if isinstance(parsed, SampleKey):
            self._update(key, parsed, batch)
        elif isinstance(parsed, EventKey) and isinstance(document, RunEnded):
            for run, unit, name in [each for each in self._signals if each[0] == document.run]:
                self._publish(run, unit, name, final=True)
                del self._signals[run, unit, name]

    def _update(self, key: str, parsed: SampleKey, batch: SampleBatch) -> None:
        stream = StreamId(key, batch.epoch.hex)
        expected = self._next_seq.get(stream, batch.seq)
        if batch.seq < expected:
            self.counts.duplicates += 1
            return
        self.counts.lost += batch.seq - expected
        self._next_seq[stream] = batch.next_seq
        signal = self._signals.get((batch.run, batch.unit, batch.signal))
        if signal is None:
            due_ns = batch.t0_ns + self._every_ns
            signal = _Signal(parsed.place, [make() for make in self._factories], due_ns, batch.last_ns)
            self._signals[batch.run, batch.unit, batch.signal] = signal
        if signal.refusal is None:
            try:
                for estimator in signal.estimators:
                    estimator.update(batch)
            except GyrofleetError as error:
                signal.refusal = str(error)
        self.counts.samples += len(batch)
        signal.last_ns = batch.last_ns
        if batch.last_ns >= signal.next_due_ns:
            passed = (batch.last_ns - signal.next_due_ns) // self._every_ns + 1
            signal.next_due_ns += passed * self._every_ns
            self._publish(batch.run, batch.unit, batch.signal, final=False)

    def _publish(self, run: str, unit: str, name: str, *, final: bool) -> None:
        signal = self._signals[run, unit, name]
        for estimator in signal.estimators:
            estimate = NoEstimate(signal.refusal) if signal.refusal else estimator.estimate()
            document = EstimatePublished(
                run=run,
                t_ns=signal.last_ns,
                unit=unit,
                signal=name,
                estimator=estimator.key,
                unit_of_measure=estimator.unit_of_measure,
                confidence=estimator.confidence,
                samples=estimator.samples,
                missing=estimator.missing,
                sample_interval_s=estimator.sample_interval_s,
                final=final,
                points=() if isinstance(estimate, NoEstimate) else estimate,
                reason=estimate.reason if isinstance(estimate, NoEstimate) else None,
            )
            self._publisher.send_event(estimate_key(signal.place, unit, name, estimator.key), document)
            self.counts.estimates += 1
            if self._on_estimate is not None:
                self._on_estimate(document)
