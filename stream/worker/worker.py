"""The worker: samples from the bus -> estimators -> estimates on the bus."""

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from stream.closing import Closing
from stream.delivery.recorded_log import DocumentSender, Identities, RecordedLog
from stream.errors import CheckpointDamaged, EstimatorError, GyrofleetError
from stream.events import AnyDocument, EstimatePublished
from stream.identity import EVERYTHING
from stream.security.proof import credentials_of
from stream.status.proven_status import on_bus
from stream.status.reporter import StatusReporter
from stream.status.role_status import Role, RoleState, RoleStatus, new_status
from stream.transport.bus import Bus, queued_bytes
from stream.transport.scheduling import wait_for_turn
from stream.wire.acknowledgement import StreamId
from stream.worker.estimated_signals import EstimatedSignals
from stream.worker.estimation import Estimation

if TYPE_CHECKING:
    from stream.estimators.base import PointEstimator

# A worker that falls behind must block neither the recorder, which shares its subscription, nor the bus that it
# publishes on: sources in the same process wait for room; messages of others that it cannot hold are left out.
_ROOM_BYTES = 16 << 20
_MOST_BYTES = 48 << 20
# a recorder has messages on disk within a second; for those not there after this time nothing waits: the log is read
# again later
_PATIENCE_S = 2.0
_RETRY_S = 0.2
_MESSAGES_AT_ONCE = 512
_READ_AGAIN_S = 2.0
_LONGEST_READ_AGAIN_S = 60.0
# how long samples wait so that the documents before a checkpoint reach the log, and when it is tried again
_SETTLE_S = 1.0
_SETTLE_AGAIN_S = 5.0


class EstimationWorker(Closing):
    """Updates the estimators of every signal on the bus and publishes their estimates.

    Estimates are published whenever a signal's own time passes a multiple of `every_s`, and once more, marked
    final, when its run ends: a function of the samples, not of the batches or times in which they come, or how often
    the worker was stopped. With them go the early decisions on the limits of a run whose duration is planned, and at
    its end its noise coefficients and spectral lines.

    With the log of the recorder nothing is missed: messages that did not come over the bus are read there, and a run
    in progress when the worker starts is read from its beginning. With a checkpoint, a worker that was stopped or
    killed resumes, and publishes the same documents, each once.

    Signals in a checkpoint keep their interval. `estimators` are the factories of those of a signal, by default
    `default_estimators`. `on_document` is called with every document that is published, in the worker's thread. `log`
    is that of the store that is recorded to. The checkpoint, which needs it, is written every `checkpoint_every_s`; the
    one before it is kept beside it. The spectral density of each signal is a third of the work. By default angular
    rates are `estimated`, and signals that a run has limits on.

    An EstimatorError is raised if the checkpoint cannot be read or is of a newer gyrofleet; its message says what to
    do. `warnings` are problems that did not stop the worker.
    """

    def __init__(
        self, bus: Bus, publisher: DocumentSender, *, every_s: float = 60.0,
        estimators: "Mapping[str, Callable[[], PointEstimator]] | None" = None,
        on_document: Callable[[AnyDocument], None] | None = None, log: RecordedLog | None = None,
        checkpoint: Path | None = None, checkpoint_every_s: float = 30.0, spectrum: bool = True,
        estimated: EstimatedSignals = EstimatedSignals(),
    ) -> None:  # fmt: skip
        self._publisher, self._on_document, self._log = publisher, on_document, log
        self._checkpoint, self._checkpoint_every_s = checkpoint, checkpoint_every_s
        self._next_save = time.monotonic() + checkpoint_every_s
        self._estimation = Estimation(
            round(every_s * 1e9), estimators, self._publish,
            None if log is None else self._fill, spectrum=spectrum, estimated=estimated,
        )  # fmt: skip
        self.counts = self._estimation.counts
        self._known = Identities(())
        self._fill_at = 0.0
        self._fill_wait_s = self._read_wait_s = _READ_AGAIN_S
        self._read_at = time.monotonic() + _READ_AGAIN_S
        self.failure: GyrofleetError | None = None
        self.warnings: list[str] = []
        self.resumed = False if log is None else self._resume(log)
        self._incoming: deque[tuple[str, bytes, float]] = deque()  # key, payload, time.monotonic()
        self._incoming_bytes = 0
        self._taken_at: float | None = None  # when the message in work arrived
        self._state = threading.Condition()
        self._closing = self._killed = False
        self._began_ns, self._credentials = time.time_ns(), credentials_of(bus)
        self._thread = threading.Thread(target=self._loop, name="gyrofleet-estimators", daemon=True)
        # subscribed before the log is read, so that no message between the two is missed
        bus.subscribe(EVERYTHING, self._on_message)
        self._thread.start()
        self._status = StatusReporter(self.status, on_bus(bus))

    def status(self) -> RoleStatus:
        """What is estimated since its start, and by how much it lags."""
        counts, failure = self.counts, self.failure
        numbers = {
            f"{name}_total": float(getattr(counts, name)) for name in ("samples", "estimates", "lost", "recalled")
        }
        with self._state:
            oldest = self._taken_at or (self._incoming[0][2] if self._incoming else None)
            numbers["queue_bytes"] = float(self._incoming_bytes)
        numbers["lag_seconds"] = 0.0 if oldest is None else time.monotonic() - oldest
        state = RoleState.WORKING if failure is None else RoleState.FAILED
        ending = None
        if self._credentials is not None:
            numbers |= self._credentials.numbers
            ending = self._credentials.trouble
        trouble = ending or "" if failure is None else str(failure)
        return new_status(Role.ESTIMATE, self._began_ns, state=state, trouble=trouble, numbers=numbers)

    def close(self) -> None:
        """Process what came, write a checkpoint, stop, and raise what had stopped it; unfinished runs resume."""
        with self._state:
            self._closing = True
            self._state.notify_all()
        self._thread.join()
        self._status.close()
        if self.failure is not None:
            raise self.failure

    def kill(self) -> None:
        """Stop at once, like a process that is killed."""
        with self._state:
            self._killed = self._closing = True
            self._incoming.clear()
            self._state.notify_all()
        self._thread.join()
        self._status.kill()

    def wait_for_room(self) -> None:
        """Wait until the worker is not far behind; called by a source in the same process before it sends more."""
        with self._state:
            while self._incoming_bytes > _ROOM_BYTES and self.failure is None and self._thread.is_alive():
                self._state.wait(0.1)

    def _on_message(self, key: str, payload: bytes) -> None:
        with self._state:
            if self._killed:
                return
            if self._incoming_bytes > _MOST_BYTES:
                return  # the gap in the numbers is counted as lost with the next batch of the signal
            self._incoming.append((key, payload, time.monotonic()))
            self._incoming_bytes += queued_bytes(key, payload)
            if len(self._incoming) == 1:
                self._state.notify_all()

    def _resume(self, log: RecordedLog) -> bool:
        """Resume from the newest sound checkpoint; without one, begin with the runs in progress in the log."""
        is_damaged = False
        if self._checkpoint is not None:
            from stream.worker.checkpoint import generations, quarantine, read_checkpoint  # loads all estimators

            for path in generations(self._checkpoint):
                try:
                    found = read_checkpoint(path)
                    if found is None or found.store != log.identity:
                        continue
                    self._estimation.resume(found)
                except CheckpointDamaged as error:
                    is_damaged = True
                    kept = quarantine(path)
                    self.warnings.append(f"{error}; it is kept as {kept}, and the log is read instead")
                else:
                    return True
        beginning = log.beginning(thorough=is_damaged)
        self._estimation.positions, self._estimation.ended = beginning.positions, beginning.ended
        self._write()  # a worker killed before the first regular one begins here again
        return False

    def _loop(self) -> None:
        wait_for_turn()
        try:
            if self._log is not None:
                self._known = Identities(self._log.published(self._estimation.positions))
                self._recall(saving=True)
                self._estimation.release()
                self._known = Identities(())
                self._estimation.ended = frozenset()
            while self._work():
                self._read_log_when_due()
            if not self._killed:
                self._finish()
        except Exception as error:  # noqa: BLE001  a worker that stopped must report any error
            with self._state:
                if not isinstance(error, GyrofleetError):
                    error = EstimatorError(f"estimation stopped ({type(error).__name__}: {error}); recording continues")
                self.failure = error
                self._state.notify_all()

    def _work(self) -> bool:
        """Process what has come; returns whether there may be more."""
        with self._state:
            while not self._incoming and not self._closing:
                self._state.wait(0.5)
                if time.monotonic() >= min(self._next_save, self._read_at):
                    break
            taken, self._incoming = self._incoming, deque()
        messages = list(taken)
        for begin in range(0, len(messages), _MESSAGES_AT_ONCE):
            if self._killed:
                return False
            part = messages[begin : begin + _MESSAGES_AT_ONCE]
            self._taken_at = part[0][2]
            self._estimation.take_all([(key, payload) for key, payload, _ in part])
            if time.monotonic() >= self._next_save:
                self._save_if_it_can_be()
        if taken and not self._estimation.left_out:  # once it is processed, which may take longer than the wait
            self._read_wait_s = _READ_AGAIN_S
            self._read_at = time.monotonic() + _READ_AGAIN_S
        with self._state:
            self._incoming_bytes -= sum(queued_bytes(key, payload) for key, payload, _ in taken)
            self._taken_at = None
            self._state.notify_all()
            is_last = self._closing and not self._incoming
        if not is_last and time.monotonic() >= self._next_save:
            self._save_if_it_can_be()
        return not is_last and not self._killed

    def _read_log_when_due(self) -> None:
        """Read messages from the log that were left out, or may have been missed where nothing comes any more."""
        if time.monotonic() >= self._read_at:
            self._estimation.left_out = False
            if self._log is not None:
                self._recall()
            self._read_wait_s = min(2 * self._read_wait_s, _LONGEST_READ_AGAIN_S)
            self._read_at = time.monotonic() + self._read_wait_s
        self._estimation.release()

    def _finish(self) -> None:
        """Read the rest of the log, and write a checkpoint."""
        if self._log is not None and (self._checkpoint is not None or self._estimation.left_out):
            self._recall()
        # a worker with a checkpoint waits for the rest when it is started again
        self._estimation.release(is_last=self._checkpoint is None)
        self._save(is_last=True)

    def _save_if_it_can_be(self) -> None:
        try:
            self._save()
        except EstimatorError as error:
            # earlier ones remain, and the next is tried in its turn
            if str(error) not in self.warnings:
                self.warnings.append(str(error))

    def _save(self, *, is_last: bool = False) -> None:
        """Write a checkpoint, once the documents published before it are in the log."""
        self._next_save = time.monotonic() + self._checkpoint_every_s
        if self._checkpoint is None:
            return
        if is_last:
            self._publisher.drain()
        deadline = time.monotonic() + _SETTLE_S
        while self._publisher.outstanding:
            if time.monotonic() > deadline or self._closing:
                self._next_save = time.monotonic() + min(_SETTLE_AGAIN_S, self._checkpoint_every_s)
                return
            time.sleep(_RETRY_S / 10)
        self._write()
        self.counts.checkpoints += 1

    def _write(self) -> None:
        if self._checkpoint is not None and self._log is not None:
            from stream.worker.checkpoint import write_checkpoint

            write_checkpoint(self._checkpoint, self._estimation.checkpoint(self._log.identity))

    def _recall(self, *, saving: bool = False) -> None:
        """Read the messages of the log beyond the positions."""
        assert self._log is not None
        estimation = self._estimation
        before = self.counts.samples
        estimation.catching_up = True
        messages = self._log.since(dict(estimation.positions))
        while part := [(each.stream.key, each.payload) for each in islice(messages, _MESSAGES_AT_ONCE)]:
            if self._killed:
                break
            estimation.take_all(part)
            if saving and time.monotonic() >= self._next_save:
                self._save_if_it_can_be()
        estimation.catching_up = False
        self.counts.recalled += self.counts.samples - before

    def _fill(self, stream: StreamId, first: int) -> None:
        """Read the missing messages of a stream before that number from the log, if they arrive there soon."""
        now = time.monotonic()
        if now < self._fill_at or self._closing:
            return
        positions = self._estimation.positions
        deadline = now + _PATIENCE_S
        while True:
            self._recall()
            if positions.get(stream, 0) >= first:
                self._fill_wait_s = _READ_AGAIN_S
                return
            if time.monotonic() > deadline or self._closing:
                break
            time.sleep(_RETRY_S)
        self._fill_at = time.monotonic() + self._fill_wait_s
        self._fill_wait_s = min(2 * self._fill_wait_s, _LONGEST_READ_AGAIN_S)

    def _publish(self, key: str, document: AnyDocument) -> None:
        if document.uid in self._known:
            return
        self._publisher.send_event(key, document)
        self.counts.estimates += isinstance(document, EstimatePublished)
        if self._on_document is not None:
            self._on_document(document)
