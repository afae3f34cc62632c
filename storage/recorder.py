"""The recorder: bus -> event log -> acknowledgement, and sealed segments -> lake."""

import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Self

from storage.event_log import EventLog
from storage.lake import build_missing
from storage.mcap_segments import EVENTS, PREVIEW, REJECTED, SAMPLES, LogRecord
from storage.store import Store
from stream.batch import SampleBatch
from stream.bus import Bus
from stream.delivery import StreamId, StreamPosition, encode_acknowledgement
from stream.errors import GyrofleetError, StoreError, WireError
from stream.events import RunEnded, decode_event
from stream.identity import ACKNOWLEDGEMENT_KEY, EVERYTHING, SampleKey, parse_key
from stream.wire import decode_batch, encode_preview

_QUEUE_BYTES = 256 << 20
_PREVIEW_INTERVAL_NS = 1_000_000_000
_REWIND_INTERVAL_S = 0.2
_SEAL_GRACE_S = 1.0  # the last estimates of a run come just after its end


@dataclass
class RecorderCounts:
    """What a recorder has done since it started."""

    messages: int = 0
    samples: int = 0
    duplicates: int = 0
    out_of_order: int = 0
    rejected: int = 0
    segments: int = 0
    rejections: deque[str] = field(default_factory=lambda: deque(maxlen=20))


class Recorder:
    """Writes everything on the bus to a store.

    The bus's callback only appends to a bounded queue. One thread writes: it takes a message if it is the next
    of its stream, drops it if it was seen, asks for a rewind if one is missing; it acknowledges after fdatasync.
    Another thread makes the lake from sealed segments. A segment is sealed by size, by age, and when a run ends.

    Parameters
    ----------
    store : Store
        Where to; the caller holds its writer lock.
    bus : Bus
        Where from.
    log : EventLog
        The store's log.
    sync_interval_s : float
        How often data are brought to the disk and acknowledged.
    on_lake : callable, optional
        Called with the name of each segment that has reached the lake.
    on_failure : callable, optional
        Called once, when nothing can be recorded any more.
    """

    def __init__(
        self,
        store: Store,
        bus: Bus,
        log: EventLog,
        *,
        sync_interval_s: float = 0.2,
        on_lake: Callable[[str], None] | None = None,
        on_failure: Callable[[GyrofleetError], None] | None = None,
    ) -> None:
        self._store = store
        self._bus = bus
        self._log = log
        self._sync_interval_s = sync_interval_s
        self._on_lake = on_lake
        self._on_failure = on_failure
        self.counts = RecorderCounts()
        self.failure: GyrofleetError | None = None
        self._incoming: deque[tuple[str, bytes, int]] = deque()
        self._incoming_bytes = 0
        self._state = threading.Condition()
        self._closing = False
        self._moved: set[StreamId] = set()
        self._rewinds: dict[StreamId, float] = {}
        self._previewed: dict[str, int] = {}
        self._seal_at: float | None = None
        self._sealed: queue.Queue[bool] = queue.Queue()
        self._caught_up = threading.Event()
        self._writer = threading.Thread(target=self._write_loop, name="gyrofleet-recorder", daemon=True)
        self._builder = threading.Thread(target=self._build_loop, name="gyrofleet-lake", daemon=True)
        self._sealed.put(True)  # whatever an earlier process sealed and did not bring to the lake
        self._builder.start()
        self._writer.start()
        bus.subscribe(EVERYTHING, self._on_message)

    def close(self) -> None:
        """Write what has arrived, seal, bring everything to the lake, and stop.

        Raises
        ------
        StoreError
            If writing failed.
        """
        with self._state:
            self._closing = True
            self._state.notify_all()
        self._writer.join()
        self._sealed.put(False)
        self._builder.join()
        if self.failure is not None:
            raise self.failure

    def wait_for_lake(self) -> None:
        """Wait until everything that was sealed before this recorder started is in the lake.

        Raises
        ------
        StoreError
            If it cannot be brought there.
        """
        self._caught_up.wait()
        if self.failure is not None:
            raise self.failure

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _on_message(self, key: str, payload: bytes) -> None:
        with self._state:
            while self._incoming_bytes > _QUEUE_BYTES and not self._closing and self.failure is None:
                self._state.wait(0.1)
            if self._closing:
                return  # not acknowledged: its source keeps it
            self._incoming.append((key, payload, time.time_ns()))
            self._incoming_bytes += len(payload)
            if len(self._incoming) == 1:
                self._state.notify_all()

    def _write_loop(self) -> None:
        try:
            synced_at = time.monotonic()
            while True:
                taken, is_last = self._next_messages()
                for key, payload, arrival_ns in taken:
                    self._take(key, payload, arrival_ns)
                now = time.monotonic()
                if is_last or now - synced_at >= self._sync_interval_s:
                    self._sync()
                    synced_at = now
                if is_last or self._log.due or (self._seal_at is not None and now >= self._seal_at):
                    self._seal()
                if is_last:
                    return
        except Exception as error:  # noqa: BLE001  whatever it is, a recorder that stopped must say so
            self._log.abandon()
            self._fail(
                StoreError(
                    f"recording to {self._store.folder} stopped: {error}; what is acknowledged is safe, sources "
                    f"keep the rest; free space or mend the disk and start again"
                )
            )

    def _next_messages(self) -> tuple[list[tuple[str, bytes, int]], bool]:
        with self._state:
            if not self._incoming and not self._closing:
                self._state.wait(self._sync_interval_s)
            # a bounded bite, so that data reach the disk and are acknowledged while more are waiting
            taken = [self._incoming.popleft() for _ in range(min(len(self._incoming), 1000))]
            self._incoming_bytes -= sum(len(payload) for _, payload, _ in taken)
            self._state.notify_all()
            return taken, self._closing and not self._incoming

    def _take(self, key: str, payload: bytes, arrival_ns: int) -> None:
        self.counts.messages += 1
        try:
            parsed = parse_key(key)
            if isinstance(parsed, SampleKey):
                batch = decode_batch(payload)
                if (batch.unit, batch.signal) != (parsed.unit, parsed.signal):
                    raise WireError(f"it holds samples of {batch.unit}/{batch.signal}")
                stream = StreamId(key, batch.epoch.hex)
                record = LogRecord(key, SAMPLES, arrival_ns, batch.t0_ns, payload)
                if self._append(stream, batch.seq, batch.next_seq, record):
                    self.counts.samples += len(batch)
                    self._preview(key, batch, arrival_ns)
            else:
                event = decode_event(payload)
                stream = StreamId(key, event.epoch)
                record = LogRecord(key, EVENTS, arrival_ns, event.document.t_ns, payload)
                is_new = self._append(stream, event.seq, event.seq + 1, record)
                if is_new and isinstance(event.document, RunEnded):
                    self._seal_at = time.monotonic() + _SEAL_GRACE_S
        except GyrofleetError as error:
            self.counts.rejected += 1
            self.counts.rejections.append(f"{key}: {error}")
            self._log.append_aside(LogRecord(key, REJECTED, arrival_ns, arrival_ns, payload))

    def _append(self, stream: StreamId, seq: int, next_seq: int, record: LogRecord) -> bool:
        expected = self._log.marks.get(stream, 0)
        if seq == expected:
            self._log.append(stream, next_seq, record)
            self._moved.add(stream)
            return True
        if next_seq <= expected:
            self.counts.duplicates += 1
            self._moved.add(stream)  # its source missed the acknowledgement
        elif seq < expected:
            raise WireError(f"numbers {seq} to {next_seq - 1} overlap what is recorded up to {expected - 1}")
        else:
            self.counts.out_of_order += 1
            self._ask_rewind(stream, expected)
        return False

    def _ask_rewind(self, stream: StreamId, expected: int) -> None:
        now = time.monotonic()
        if now - self._rewinds.get(stream, 0.0) >= _REWIND_INTERVAL_S:
            self._rewinds[stream] = now
            position = StreamPosition(stream.key, stream.epoch, expected, rewind=True)
            self._bus.publish(ACKNOWLEDGEMENT_KEY, encode_acknowledgement(self._store.identity, (position,)))

    def _preview(self, key: str, batch: SampleBatch, arrival_ns: int) -> None:
        last_ns = self._previewed.get(key)
        if last_ns is None or abs(batch.t0_ns - last_ns) >= _PREVIEW_INTERVAL_NS:
            self._previewed[key] = batch.t0_ns
            data = encode_preview(float(batch.value_array[0]), batch.unit_of_measure)
            self._log.append_aside(LogRecord(f"{key}/preview", PREVIEW, arrival_ns, batch.t0_ns, data))

    def _sync(self) -> None:
        if not self._moved:
            return
        self._log.sync()
        moved, self._moved = self._moved, set()
        positions = tuple(StreamPosition(s.key, s.epoch, self._log.marks[s]) for s in moved)
        self._bus.publish(ACKNOWLEDGEMENT_KEY, encode_acknowledgement(self._store.identity, positions))

    def _seal(self) -> None:
        self._seal_at = None
        if self._log.seal() is not None:
            self.counts.segments += 1
            self._sync()
            self._sealed.put(True)

    def _build_loop(self) -> None:
        try:
            while self._sealed.get():
                for name in build_missing(self._store):
                    if self._on_lake is not None:
                        self._on_lake(name)
                self._caught_up.set()
        except GyrofleetError as error:
            self._fail(StoreError(str(error)))
        except Exception as error:  # noqa: BLE001  as above
            self._fail(
                StoreError(
                    f"the lake of {self._store.folder} cannot be written: {error}; the log is complete, "
                    f"the lake is made from it at the next start"
                )
            )

    def _fail(self, failure: StoreError) -> None:
        with self._state:
            is_first, self.failure = self.failure is None, self.failure or failure
            self._state.notify_all()
        self._caught_up.set()
        if is_first and self._on_failure is not None:
            self._on_failure(failure)
