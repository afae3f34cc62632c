"""The recorder: bus -> event log -> acknowledgement, and sealed segments -> lake.

A disk error does not end it: the segment is abandoned, sources resend what was not durable, and a new segment is
begun. While the disk cannot be written, or is full, recording is paused, and sources are notified.
"""

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from storage.log.event_log import EventLog
from storage.log.files import sealed_segments
from storage.log.run_owners import RunOwners
from storage.manifests.lake import read_manifest
from storage.recording.acts.signed_rules import keep_signed_rules
from storage.recording.disk_watch import DiskWatch
from storage.recording.intake import Intake
from storage.recording.reports import Reports
from storage.recording.service import RecorderService
from storage.recording.status_board import StatusBoard
from storage.segments.disk import DISK, Disk
from storage.store import Store
from stream.closing import Closing
from stream.errors import GyrofleetError, StoreError
from stream.identity import ACKNOWLEDGEMENT_KEY, EVERYTHING
from stream.security.proof import SourceVerifier, credentials_of
from stream.status.proven_status import received_status
from stream.status.reporter import StatusReporter
from stream.status.role_status import SILENT_AFTER_S, STATUS_KEY, Role, RoleState, RoleStatus, new_status
from stream.transport.bus import Bus, queued_bytes
from stream.transport.scheduling import wait_for_turn
from stream.wire.acknowledgement import StreamId, StreamPosition, encode_acknowledgement

if TYPE_CHECKING:
    from storage.recording.lake_builder import LakeBuilder

_QUEUE_BYTES = 64 << 20
_ROOM_PATIENCE_S = 2.0  # of a bus callback: a source closes a transport that stalls for 8 s
_SEAL_GRACE_S = 1.0  # the last estimates of a run arrive just after its end
_SETTLE_S = 120.0
_RECOVER_AFTER_S = 5.0  # an abandoned segment is sealed with the next one, before that is full
_RETRY_S = 1.0


class Recorder(Closing):
    """Writes everything on the bus to a store, whose writer lock the caller holds.

    The bus callback only appends to a bounded queue. A writer thread appends a message if it is the next of its stream,
    drops duplicates, requests a rewind if one is missing, and acknowledges after an fdatasync every `sync_interval_s`.
    Another thread builds the lake from sealed segments. A segment is sealed by size, by age, and when a run ends.

    `builds_lake` says whether this process builds the lake, `reports_status` whether it is a role of its own;
    `on_warning` gets messages for people: pauses, disk errors, low disk space. `on_failure` is called once, when
    recording has ended by a failure.
    """

    def __init__(
        self, store: Store, bus: Bus, log: EventLog, *, sync_interval_s: float = 0.1, builds_lake: bool = True,
        on_warning: Callable[[str], None] = lambda _text: None,
        on_failure: Callable[[GyrofleetError], None] = lambda _error: None, disk: Disk = DISK,
        reports_status: bool = True,
    ) -> None:  # fmt: skip
        self._store, self._bus, self._log, self._sync_interval_s = store, bus, log, sync_interval_s
        self._warn, self._on_failure = on_warning, on_failure
        self._credentials = credentials_of(bus)
        if self._credentials is not None:
            keep_signed_rules(store, self._credentials, on_warning)
        sources = owners = None
        if self._credentials is not None:
            sources, owners = SourceVerifier(self._credentials), RunOwners(log.entries)
        self._intake = Intake(log, store, sources, owners)
        self.counts = self._intake.counts
        self._reports = Reports(store, log, self._intake, self._warn)
        self._watch = DiskWatch(store.folder, disk)
        self.failure: GyrofleetError | None = None
        self.paused: str | None = None
        self._incoming: deque[tuple[str, bytes, int]] = deque()
        self._incoming_bytes = 0
        self._state = threading.Condition()
        self._closing = False
        self._settle_wanted = self._settle_done = self._settle_from = self._received = self._processed = 0
        self._arrived_ns = 0
        self._seal_at: float | None = None
        self._quiet_at: float | None = None
        self._ending: str | None = None  # of the certificate
        self._synced_at = self._troubled_at = time.monotonic()
        self._builder = _new_builder(store, on_warning) if builds_lake else None
        self._turned_at = time.monotonic()
        self._writer = threading.Thread(target=self._write_loop, name="gyrofleet-recorder", daemon=True)
        self._writer.start()
        bus.subscribe(EVERYTHING, self._on_message)
        self._service = RecorderService(store, bus, self.settle, owners)
        self._board, self._sources, self._began_ns = StatusBoard(store), sources, time.time_ns()
        bus.subscribe(STATUS_KEY, self._on_status)
        self._status = StatusReporter(self.status, self._board.put) if reports_status else None

    def status(self) -> RoleStatus:
        """What is recorded since its start, and what keeps it from recording."""
        counts, failure = self.counts, self.failure
        still_s = time.monotonic() - self._turned_at
        halted = f"nothing was written for {still_s:,.0f} s: the disk does not answer"
        paused = self.paused or (halted if still_s > SILENT_AFTER_S else "")
        state = RoleState.FAILED if failure else RoleState.PAUSED if paused else RoleState.WORKING
        names = ("messages", "samples", "duplicates", "conflicts", "rejected", "left_to_sources", "interruptions")
        numbers = {f"{name}_total": float(getattr(counts, name)) for name in (*names, "segments")}
        numbers |= {"clock_steps_back_total": float(counts.backwards), "queue_bytes": float(self._incoming_bytes)}
        numbers |= {"free_bytes": float(self._watch.free_bytes), "last_message_seconds": self._arrived_ns / 1e9}
        numbers |= {"last_sample_seconds": counts.last_sample_ns / 1e9}
        if self._credentials is not None:
            numbers |= self._credentials.numbers
        lake = "" if self._builder is None else self._builder.trouble
        lesser = "; ".join(each for each in (self._certificate_trouble(), lake) if each)
        trouble = str(failure) if failure else paused or lesser
        return new_status(Role.RECORD, self._began_ns, state=state, trouble=trouble[:4000], numbers=numbers)

    def _certificate_trouble(self) -> str | None:
        return None if self._credentials is None else self._credentials.trouble

    def end(self) -> None:
        """Write what has arrived and seal the log; `close` then completes the lake."""
        self._service.close()
        with self._state:
            self._closing = True
            self._state.notify_all()
        self._writer.join()

    def close(self) -> None:
        """Write what has arrived, seal, complete the lake, and stop; StoreError if not all could be written."""
        self.end()
        if self._builder is not None:
            self._builder.close()
        if self._status is not None:
            self._status.close()
        if self.failure is not None:
            raise self.failure

    def wait_for_lake(self) -> None:
        """Wait until everything sealed before the start is in the lake."""
        if self._builder is not None:
            self._builder.wait_until_caught_up()

    def settle(self) -> None:
        """Seal what has arrived, and wait until it is in the lake, whichever process builds that."""
        until = time.monotonic() + _SETTLE_S
        with self._state:
            number = self._settle_wanted = self._settle_wanted + 1
            self._settle_from = self._received  # later messages are not waited for
            self._state.notify_all()
            while self._settle_done < number:
                if self._closing or self.failure is not None or time.monotonic() >= until:
                    why = self.paused or self.failure or "closing"
                    raise StoreError(f"{self._store.folder} cannot seal now: {why}")
                self._state.wait(0.1)
        while missing := {path.stem for path in sealed_segments(self._store)} - read_manifest(self._store).segments:
            if self._builder is not None:
                self._builder.wake()
            if self._closing or time.monotonic() >= until:
                raise StoreError(
                    f"{len(missing)} segments of {self._store.folder} are not in its lake, the first "
                    f"{min(missing)}; is a `gyrofleet lake` at work there?"
                )
            time.sleep(0.05)

    def _on_message(self, key: str, payload: bytes) -> None:
        size = queued_bytes(key, payload)
        with self._state:
            until = time.monotonic() + _ROOM_PATIENCE_S
            while self._incoming_bytes > _QUEUE_BYTES and not self._closing and self.paused is None:
                left_s = until - time.monotonic()
                if left_s <= 0.0:
                    break
                self._state.wait(left_s)
            if self._closing or self.paused is not None or self._incoming_bytes > _QUEUE_BYTES or self.failure:
                self.counts.left_to_sources += 1
                return  # not acknowledged: its source keeps it
            self._arrived_ns = time.time_ns()
            self._incoming.append((key, payload, self._arrived_ns))
            self._incoming_bytes += size
            self._received += 1
            if len(self._incoming) == 1:
                self._state.notify_all()

    def _on_status(self, _key: str, payload: bytes) -> None:
        try:
            self._board.put(*received_status(payload, self._sources))
        except GyrofleetError as error:
            self.counts.rejected += 1
            self.counts.rejections.append(f"a status: {str(error)[:500]}")

    def _write_loop(self) -> None:
        wait_for_turn()
        trouble: OSError | None = None
        try:
            while True:
                try:
                    if trouble is not None:
                        error, trouble = trouble, None
                        self._interrupt(error)
                    elif self._write_chunk():
                        return
                except OSError as error:
                    trouble = error
        except Exception as error:  # noqa: BLE001  a recorder that stops must report any failure
            self._log.abandon()
            if not isinstance(error, GyrofleetError):
                error = StoreError(
                    f"recording to {self._store.folder} stopped ({type(error).__name__}: {error}); what is "
                    f"acknowledged is safe, sources keep the rest; start it again"
                )
            with self._state:
                self.failure = error
                self._state.notify_all()
            self._on_failure(error)

    def _write_chunk(self) -> bool:
        """Write a chunk of messages; whether it was the last."""
        self._turned_at = time.monotonic()
        self._reports.log_changes()
        settling = self._settle_wanted
        taken, is_last = self._next_messages()
        # also if the disk fails: then they are not acknowledged, and are sent again
        self._processed += len(taken)
        for key, payload, arrival_ns in taken:
            self._intake.add(key, payload, arrival_ns)
        now = time.monotonic()
        if self._intake.ended_runs:
            self._intake.ended_runs = 0
            self._seal_at = now + _SEAL_GRACE_S
        if self._intake.exclusions:  # evaluations read the lake, and are to follow it
            self._intake.exclusions = 0
            self._seal_at = now
        if self._intake.late or self._intake.checks:
            # once no more of it comes: a run that is extended for hours must not be cut into seconds
            self._intake.late = self._intake.checks = 0
            self._quiet_at = now + _SEAL_GRACE_S
        missing, self._intake.rewinds = self._intake.rewinds, []
        if missing:
            self._request_rewind(missing)
        if is_last or now - self._synced_at >= self._sync_interval_s:
            self._sync()
            self._synced_at = now
            self._monitor(now)
        due = min((at for at in (self._seal_at, self._quiet_at) if at is not None), default=math.inf)
        if is_last:
            self._reports.conflicts(math.inf)
        is_settled = settling > self._settle_done and self._processed >= self._settle_from
        if is_last or is_settled or self._log.due or now >= due:
            self._seal()
        if is_settled:
            with self._state:
                self._settle_done = settling
                self._state.notify_all()
        return is_last

    def _next_messages(self) -> tuple[list[tuple[str, bytes, int]], bool]:
        with self._state:
            if not self._incoming and not self._closing and self._settle_wanted == self._settle_done:
                self._state.wait(self._sync_interval_s)
            # bounded, so that data are made durable and acknowledged while more are waiting
            taken = [self._incoming.popleft() for _ in range(min(len(self._incoming), 1000))]
            self._incoming_bytes -= sum(queued_bytes(key, payload) for key, payload, _ in taken)
            self._state.notify_all()
            return taken, self._closing and not self._incoming

    def _request_rewind(self, streams: Iterable[StreamId]) -> None:
        marks = self._log.marks
        self._acknowledge(tuple(StreamPosition(*stream, marks.get(stream, 0), rewind=True) for stream in streams))

    def _acknowledge(self, positions: tuple[StreamPosition, ...]) -> None:
        payload = encode_acknowledgement(self._store.identity, positions, self.paused or "", self._credentials)
        self._bus.publish(ACKNOWLEDGEMENT_KEY, payload)

    def _sync(self) -> None:
        self._log.sync()
        moved, self._intake.moved = self._intake.moved, set()
        if moved:
            marks, received = self._log.marks, self._intake.received
            reached = {stream: min(marks.get(stream, 0), received.get(stream, 0)) for stream in moved}
            self._acknowledge(tuple(StreamPosition(*stream, next_seq) for stream, next_seq in reached.items()))

    def _seal(self) -> None:
        self._seal_at = self._quiet_at = None
        recovered = self._log.recover()  # segments that were abandoned since
        self._reports.log_changes()
        self._sync()
        sealed = self._log.seal()
        self.counts.segments += sealed is not None
        if self._builder is not None and (recovered or sealed is not None):
            self._builder.wake()

    def _monitor(self, now: float) -> None:
        """Check disk space and clocks, and report clock steps and conflicts."""
        full, warning = self._watch.look(now)
        if warning is not None:
            self._warn(warning)
            self._reports.append("disk_low", warning, {})
        ending, self._ending = self._ending, self._certificate_trouble()
        if self._ending not in {None, ending}:
            self._warn(str(self._ending))
        if full is not None:
            self._seal()
            self._pause(full, self._watch.has_room_again)
        self._reports.clock_steps()
        self._reports.conflicts(now)

    def _interrupt(self, error: OSError) -> None:
        """After a disk error, fall back to what is durable and continue in a new segment."""
        self.counts.interruptions += 1
        undone = self._log.abandon()
        self._intake.undo(undone)
        is_again = time.monotonic() - self._troubled_at < _RETRY_S
        self._troubled_at = time.monotonic()
        self._seal_at = self._troubled_at + _RECOVER_AFTER_S
        text = f"writing to {self._store.folder} failed: {error}; the segment is abandoned, sources resend the rest"
        self._warn(text)
        if self._closing:
            raise StoreError(f"{text}; start again to continue")
        try:
            full, _ = self._watch.look(time.monotonic(), again=True)
        except OSError:
            full = None  # the folder itself is missing
        if full is not None:
            self._pause(full, self._watch.has_room_again)
        elif is_again:
            until = time.monotonic() + _RETRY_S
            self._pause(text, lambda: time.monotonic() >= until)
        else:
            self._reports.append("disk_error", text, {"error": str(error)})
        # request what was undone at once, not only after the source's timeout
        self._request_rewind(undone)

    def _pause(self, reason: str, is_over: Callable[[], bool]) -> None:
        """Take no messages until `is_over`; sources get the reason every second, and keep theirs."""
        self._warn(f"recording is paused: {reason}")
        began = time.monotonic()
        with self._state:
            self.paused = reason
            self.counts.left_to_sources += len(self._incoming)
            self._processed += len(self._incoming)
            self._incoming.clear()
            self._incoming_bytes = 0
            self._state.notify_all()
        while not self._closing and not is_over():
            self._acknowledge(())
            with self._state:
                self._state.wait(_RETRY_S)
        if self._closing:
            raise StoreError(f"recording ended while paused: {reason}; sources keep what is not acknowledged")
        self.paused = None
        paused_s = time.monotonic() - began
        text = f"recording resumes after a pause of {paused_s:.1f} s: {reason}"
        self._warn(text)
        self._reports.append("recording_paused", text, {"paused_s": paused_s, "reason": reason})


def _new_builder(store: Store, on_warning: Callable[[str], None]) -> "LakeBuilder":
    from storage.recording.lake_builder import LakeBuilder  # and pyarrow, 25 MB

    return LakeBuilder(store, on_warning)
