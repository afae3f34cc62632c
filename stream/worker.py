"""The worker: bus -> estimators -> estimates on the bus."""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, Self
from uuid import UUID

from stream.batch import SampleBatch
from stream.bus import Bus
from stream.checkpoint import Checkpoint, read_checkpoint, write_checkpoint
from stream.delivery import DurablePublisher, StreamId
from stream.errors import EstimatorError, GyrofleetError
from stream.estimators.base import Estimator, default_estimators
from stream.events import AnyDocument, EstimatePublished, LimitsApplied, RunEnded, decode_event
from stream.identity import EVERYTHING, EventKey, Place, SampleKey, estimate_key, parse_key, sample_key
from stream.signal_analysis import SignalAnalysis, fresh_followers
from stream.wire import decode_batch

# A worker that falls behind must hold up neither the recorder, which shares its subscription, nor the bus that it
# publishes on itself: sources in the same process wait for room, from others it leaves out what it cannot hold.
_ROOM_BYTES = 32 << 20
_MOST_BYTES = 256 << 20
# a recorder has on disk what it was given within a second; what is not there after this is lost
_PATIENCE_S = 5.0
_RETRY_S = 0.2


@dataclass
class WorkerCounts:
    """What a worker has done since it started."""

    samples: int = 0
    duplicates: int = 0
    recalled: int = 0
    lost: int = 0
    rejected: int = 0
    estimates: int = 0
    checkpoints: int = 0


class LoggedMessage(Protocol):
    """A message of a numbered stream that was recorded."""

    @property
    def stream(self) -> StreamId:
        """Which stream."""

    @property
    def payload(self) -> bytes:
        """What was sent."""


class RecordedLog(Protocol):
    """Where a worker reads again what it has missed."""

    @property
    def identity(self) -> str:
        """Identity of the store."""

    def positions(self) -> dict[StreamId, int]:
        """How far every stream has come in it."""

    def since(self, positions: Mapping[StreamId, int]) -> Iterator[LoggedMessage]:
        """Messages beyond those positions, in their order."""


class EstimationWorker:
    """Keeps the estimators of every signal on the bus up to date and publishes what they say.

    Estimates are published whenever a signal's own time passes a multiple of `every_s`, and once more, marked
    final, when its run ends: a function of the data, not of the moment they are looked at. With them go the early
    decisions on the limits of a run whose duration is planned, and at its end its noise coefficients and spectral
    lines.

    Given the log of the recorder, nothing is missed: what did not come over the bus is read there. With a checkpoint, a
    worker that was killed goes on where it stood, and gives the documents that it would have given.

    Parameters
    ----------
    bus : Bus
        Where samples come from.
    publisher : DurablePublisher
        What the estimates are sent with.
    every_s : float
        Interval between estimates in the signal's time, seconds.
    estimators : mapping of callables, optional
        Each makes one estimator of a signal; by default those of `default_estimators`.
    on_document : callable, optional
        Called with every document that is published, in the worker's thread.
    log : RecordedLog, optional
        The log of the store that is recorded to.
    checkpoint : Path, optional
        File of the checkpoint; it needs the log.
    checkpoint_every_s : float
        Interval between checkpoints, seconds.

    Raises
    ------
    EstimatorError
        If the checkpoint cannot be gone on from; the message says what to do.
    """

    def __init__(
        self,
        bus: Bus,
        publisher: DurablePublisher,
        *,
        every_s: float = 60.0,
        estimators: Mapping[str, Callable[[], Estimator]] | None = None,
        on_document: Callable[[AnyDocument], None] | None = None,
        log: RecordedLog | None = None,
        checkpoint: Path | None = None,
        checkpoint_every_s: float = 30.0,
    ) -> None:
        self._publisher = publisher
        self._every_ns = round(every_s * 1e9)
        self._factories = default_estimators() if estimators is None else estimators
        self._on_document = on_document
        self._log = log
        self._checkpoint = checkpoint
        self._checkpoint_every_s = checkpoint_every_s
        self._checked_at = time.monotonic()
        self.counts = WorkerCounts()
        self.failure: GyrofleetError | None = None
        self.warning: str | None = None
        self._signals: dict[tuple[str, str, str], SignalAnalysis] = {}
        self._limits: dict[str, LimitsApplied] = {}
        self._positions: dict[StreamId, int] = {}
        # while the log is read: documents that wait until it is known which of them it holds already, and those
        self._held: list[tuple[str, AnyDocument]] | None = None
        self._known: set[str] = set()
        self.resumed = self._resume()
        self._incoming: deque[tuple[str, bytes]] = deque()
        self._incoming_bytes = 0
        self._state = threading.Condition()
        self._closing = self._killed = False
        self._thread = threading.Thread(target=self._loop, name="gyrofleet-estimators", daemon=True)
        # what comes between the reading of the log and the bus is missed by neither: the bus is first
        bus.subscribe(EVERYTHING, self._on_message)
        self._thread.start()

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

    def kill(self) -> None:
        """Stop at once, and leave undone what has not been done: as a process that is killed."""
        with self._state:
            self._killed = self._closing = True
            self._incoming.clear()
            self._state.notify_all()
        self._thread.join()

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
        with self._state:
            if self._killed:
                return
            if self._incoming_bytes > _MOST_BYTES:
                return  # the gap in the numbers is counted as lost when the next batch of the signal is taken
            self._incoming.append((key, payload))
            self._incoming_bytes += len(payload)
            if len(self._incoming) == 1:
                self._state.notify_all()

    def _resume(self) -> bool:
        if self._log is None:
            return False
        found = None if self._checkpoint is None else read_checkpoint(self._checkpoint)
        if found is None or found.store != self._log.identity:
            self._positions = self._log.positions()
            self._write()  # so that one who is killed before the first regular one begins here again
            return False
        self._positions = {StreamId(key, epoch): next_seq for key, epoch, next_seq in found.positions}
        self._limits = {limits.run: limits for limits in found.limits}
        for state in found.signals:
            self._signals[state.run, state.unit, state.signal] = SignalAnalysis.from_state(state, self._every_ns)
        return True

    def _loop(self) -> None:
        try:
            if self.resumed:
                self._recall()
            while True:
                with self._state:
                    while not self._incoming and not self._closing:
                        self._state.wait(0.5)
                        if time.monotonic() - self._checked_at >= self._checkpoint_every_s:
                            break
                    taken, self._incoming = self._incoming, deque()
                for key, payload in taken:
                    if self._killed:
                        return
                    self._take(key, payload)
                    self._save_if_due()
                with self._state:
                    self._incoming_bytes -= sum(len(payload) for _, payload in taken)
                    self._state.notify_all()
                    is_last = self._closing and not self._incoming
                if self._killed:
                    return
                if is_last:
                    break
                self._save_if_due()
            for analysis in self._signals.values():
                self._publish(analysis, final=False)
            self._save(is_last=True)
        except Exception as error:  # noqa: BLE001  whatever it is, a worker that stopped must say so
            with self._state:
                self.failure = (
                    error
                    if isinstance(error, GyrofleetError)
                    else EstimatorError(f"the estimators stopped ({type(error).__name__}: {error}); recording goes on")
                )
                self._state.notify_all()

    def _save_if_due(self) -> None:
        if time.monotonic() - self._checked_at >= self._checkpoint_every_s:
            try:
                self._save()
            except EstimatorError as error:
                self.warning = str(error)  # the one before still stands, and the next is tried in its turn

    def _save(self, *, is_last: bool = False) -> None:
        """Write a checkpoint, once what was published before it is in the log."""
        self._checked_at = time.monotonic()
        if self._checkpoint is None:
            return
        if is_last:
            self._publisher.drain()
        elif self._publisher.outstanding:
            self._checked_at += _RETRY_S - self._checkpoint_every_s
            return
        self._write()
        self.counts.checkpoints += 1

    def _write(self) -> None:
        if self._checkpoint is None or self._log is None:
            return
        checkpoint = Checkpoint(
            store=self._log.identity,
            every_ns=self._every_ns,
            positions=[(stream.key, stream.epoch, next_seq) for stream, next_seq in self._positions.items()],
            limits=list(self._limits.values()),
            signals=[analysis.export_state() for analysis in self._signals.values()],
        )
        write_checkpoint(self._checkpoint, checkpoint)

    def _recall(self) -> None:
        """Take in what the log holds beyond what was seen; documents that it holds as well are not sent again."""
        assert self._log is not None
        self._held, self._known = [], set()
        before = self.counts.samples
        for message in self._log.since(dict(self._positions)):
            self._take(message.stream.key, message.payload)
        held, self._held = self._held, None
        self.counts.recalled += self.counts.samples - before
        for key, document in held:
            if document.uid not in self._known:
                self._send(key, document)

    def _take(self, key: str, payload: bytes) -> None:
        try:
            parsed = parse_key(key)
            if isinstance(parsed, SampleKey):
                batch = decode_batch(payload)
                stream, first, after = StreamId(key, batch.epoch.hex), batch.seq, batch.next_seq
            else:
                message = decode_event(payload)
                stream, first, after = StreamId(key, message.epoch), message.seq, message.seq + 1
        except GyrofleetError:
            self.counts.rejected += 1  # the recorder keeps it aside and reports it
            return
        # with a log it is known which streams were there before; without, one may be joined in its middle
        unknown = first if self._log is None else 0
        if first > self._positions.get(stream, unknown) and self._held is None:
            self._fill(stream, first)
        expected = self._positions.get(stream, unknown)
        if first < expected:
            if isinstance(parsed, SampleKey):
                self.counts.duplicates += 1
            return
        self._positions[stream] = after
        if isinstance(parsed, SampleKey):
            self.counts.lost += first - expected
            self._update(parsed.place, batch)
        elif isinstance(parsed, EventKey):
            self._follow(parsed.place, message.document)
        elif self._held is not None:
            self._known.add(message.document.uid)

    def _fill(self, stream: StreamId, first: int) -> None:
        """Read from the log what is missing before number `first` of a stream."""
        deadline = time.monotonic() + _PATIENCE_S
        while self._log is not None and self._positions.get(stream, 0) < first and time.monotonic() < deadline:
            self._recall()
            if self._positions.get(stream, 0) < first:
                time.sleep(_RETRY_S)

    def _follow(self, place: Place, document: AnyDocument) -> None:
        if isinstance(document, LimitsApplied):
            self._limits[document.run] = document
            for analysis in self._signals.values():
                if analysis.run == document.run:
                    analysis.apply_limits(document)
        elif isinstance(document, RunEnded):
            if self._held is None:
                for total in document.totals:
                    key = sample_key(place, total.unit, total.signal)
                    self._fill(StreamId(key, UUID(total.epoch).hex), total.samples)
            for name in [each for each in self._signals if each[0] == document.run]:
                self._publish(self._signals.pop(name), final=True)
            self._limits.pop(document.run, None)

    def _update(self, place: Place, batch: SampleBatch) -> None:
        name = (batch.run, batch.unit, batch.signal)
        analysis = self._signals.get(name)
        if analysis is None:
            analysis = SignalAnalysis.begin(place, batch, self._every_ns, fresh_followers(self._factories))
            self._signals[name] = analysis
            if batch.run in self._limits:
                analysis.apply_limits(self._limits[batch.run])
        self.counts.samples += len(batch)
        if analysis.update(batch):
            self._publish(analysis, final=False)

    def _publish(self, analysis: SignalAnalysis, *, final: bool) -> None:
        for what, document in analysis.documents(final=final):
            key = estimate_key(analysis.place, analysis.unit, analysis.signal, what)
            if self._held is not None:
                self._held.append((key, document))
            else:
                self._send(key, document)

    def _send(self, key: str, document: AnyDocument) -> None:
        self._publisher.send_event(key, document)
        self.counts.estimates += isinstance(document, EstimatePublished)
        if self._on_document is not None:
            self._on_document(document)
