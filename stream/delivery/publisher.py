"""Delivery of numbered messages: kept by the source until a recorder has them on disk.

Zenoh has no durable acknowledgement, and a publisher's put returns normally for a message that is then lost.
So a source numbers its messages per stream (a key expression and an epoch) and keeps each of them until a recorder
acknowledges that it is on disk. At least once on the wire, exactly once in the log.
"""

import datetime as dt
import threading
import time
from collections.abc import Callable
from typing import Protocol, Self
from uuid import uuid4

from stream.batch import SampleBatch
from stream.bounds import MAX_KEY_CHARS, MAX_MESSAGE_BYTES
from stream.delivery.outbox import CHUNK_BYTES, Due, Outbox
from stream.delivery.outgoing import HeldMessage, OutgoingStream
from stream.delivery.spool import Spool, SpoolError, SpoolFull
from stream.errors import DeliveryError, GyrofleetError, WireError
from stream.events import AnyDocument, encode_event
from stream.identity import ACKNOWLEDGEMENT_KEY
from stream.security.proof import PROOF_BYTES, Forged, SourceProver, check_acknowledgement, credentials_of
from stream.transport.bus import Admitted, Bus
from stream.wire.acknowledgement import StreamId, decode_acknowledgement
from stream.wire.event_validation import decode_received

_TICK_S = 0.25
_SILENT_S, _ASK_AGAIN_S = 15.0, 30.0


class Sender(Protocol):
    """Destination of a source's samples and documents."""

    def send_batch(self, key: str, batch: SampleBatch) -> None:
        """Send samples under `key`; waits while too much is unacknowledged."""

    def send_event(self, key: str, document: AnyDocument) -> None:
        """Send a run document under `key`."""


class DurablePublisher:
    """Sends samples and documents, and keeps them until they are acknowledged.

    Messages of a stream are sent in order. If the recorder asks for one again, the stream returns to it and continues
    from there, in an amount that grows with what is acknowledged. Without an answer, the first and the last message of
    the stream are sent again: the recorder then reports what it has, or what it lacks.

    `window_bytes` may be unacknowledged in memory. Beyond it `send_batch` waits, or, with a spool, leaves it on disk.
    It bounds the memory of the source and of the recorder's queue alike. After a silence of `resend_after_s` in a
    stream the recorder is polled, doubled each time, up to 10 s; after `timeout_s` waiting ends with an error. A
    recorder that reports a pause is not silent. All goes to the store of the identity `only_store`, by default that of
    the first recorder that has taken something; answers of recorders of other stores are ignored. A `spool` keeps
    messages on disk, and earlier ones are sent first; the caller closes it after the publisher. With `waits_when_full`
    senders wait for room in it without end: a gyro goes on sending, and is to be read again when a recorder is there.
    """

    def __init__(
        self, bus: Bus, *, window_bytes: int = 32 << 20, resend_after_s: float = 2.0, timeout_s: float = 60.0,
        only_store: str | None = None, spool: Spool | None = None,
    ) -> None:  # fmt: skip
        self._bus, self._window_bytes, self._resend_after_s = bus, window_bytes, resend_after_s
        self._timeout_s, self._spool = timeout_s, spool
        self.waits_when_full = False
        self._credentials = credentials_of(bus)
        self._prover = None if self._credentials is None else SourceProver(self._credentials)
        self._most_bytes = MAX_MESSAGE_BYTES - (0 if self._prover is None else PROOF_BYTES)
        self._forged = 0
        self._out = Outbox(window_bytes, resend_after_s, spool, only_store)
        self._epoch = uuid4().hex
        self._event_seq: dict[str, int] = {}
        self._by_key: dict[str, OutgoingStream] = {}
        self._is_reported = self._is_loading = self._closed = False
        self._silence: str | None = None  # of the recorder, and why
        self._asks_at = 0.0
        self._numbering = threading.Lock()
        self._lock = threading.Lock()
        self._state = threading.Condition(self._lock)
        bus.subscribe(ACKNOWLEDGEMENT_KEY, self._on_acknowledgement)
        self._pump = threading.Thread(target=self._pump_loop, name="gyrofleet-resend", daemon=True)
        self._pump.start()

    @property
    def outstanding(self) -> int:
        """Messages that no recorder has acknowledged yet; of those from before a restart, an upper bound."""
        with self._lock:
            return self._out.count()

    @property
    def not_kept(self) -> int:
        """Messages that are lost if this process ends now: neither acknowledged nor in the spool."""
        with self._lock:
            return self._out.not_kept()

    @property
    def paused(self) -> str | None:
        """Why the recorder pauses; None while it records, or reports nothing."""
        with self._lock:
            return self._out.paused if self._out.is_paused() else None

    @property
    def resent(self) -> int:
        """How many messages were sent again."""
        return self._out.resent

    @property
    def numbers(self) -> dict[str, float]:
        """Messages that no recorder has acknowledged, those sent again, the end of the certificate, for a status."""
        found = {"outstanding_messages": float(self.outstanding), "resent_total": float(self.resent)}
        return found if self._credentials is None else found | self._credentials.numbers

    @property
    def warning(self) -> str | None:
        """Current warning, for people; None if there is none."""
        failure = None if self._spool is None else self._spool.failure or self._spool.room.warning
        ending = None if self._credentials is None else self._credentials.trouble
        return failure or self._out.warning or self._silence or ending

    def send_batch(self, key: str, batch: SampleBatch) -> None:
        """Send samples under `key`; waits while the window, or the spool, is full.

        The batches of one key come from one thread. Raises a DeliveryError if nothing is acknowledged for `timeout_s`,
        a WireError if the batch or the key is larger than a recorder takes.
        """
        stream = self._by_key.get(key)
        if stream is None or (stream.epoch is not batch.epoch and stream.epoch != batch.epoch):
            stream = self._stream(key, batch.epoch.hex)
            stream.epoch = batch.epoch
            self._by_key[key] = stream
        seq = batch.seq
        payload = stream.encoder.encode(batch)
        if len(payload) > self._most_bytes:
            raise WireError(f"{key}: {len(payload):,} bytes in a batch, a message may have {self._most_bytes:,}")
        if self._accept(stream, seq, seq + len(batch), payload, is_document=False):
            self._publish(stream, payload)

    def send_event(self, key: str, document: AnyDocument) -> None:
        """Number and send a document, waiting and raising like `send_batch`; WireError if it makes no sense."""
        try:
            decode_received(encode_event(document, self._epoch, 0))
        except (WireError, OverflowError) as error:
            reason = str(error).removeprefix("not a run document: ")
            raise WireError(f"run {document.run[:80]}: {type(document).__name__} cannot be sent: {reason}") from error
        stream = self._stream(key, self._epoch)
        with self._numbering:  # a number is sent before the next is assigned
            seq = self._event_seq.get(key, 0)
            payload = encode_event(document, self._epoch, seq)
            is_due = self._accept(stream, seq, seq + 1, payload, is_document=True)
            self._event_seq[key] = seq + 1
            if is_due:
                self._publish(stream, payload)

    def drain(self, given_up: Callable[[], bool] = lambda: False) -> None:
        """Wait until all is acknowledged, or `given_up()`; DeliveryError if nothing is acknowledged for `timeout_s`."""
        began = time.monotonic()
        while not given_up():
            with self._state:
                if not self._out.bytes and not self._is_spooled():
                    self._check()
                    return
                self._wait(began)

    def fail(self, reason: str) -> None:
        """Make every sender and `drain` raise a DeliveryError with this reason at once."""
        with self._state:
            self._out.broken = self._out.broken or reason
            self._state.notify_all()

    def close(self) -> None:
        """Stop at once; DeliveryError if messages are outstanding and no error has said so. `drain` waits for them."""
        self._stop()
        if (self._out.bytes or self._is_spooled()) and not self._is_reported:
            self._is_reported = True
            raise DeliveryError(f"closed before everything was acknowledged: {self._out.format_outstanding()}")

    def abandon(self) -> None:
        """Stop sending, whatever is outstanding; the next publisher of the spool sends what is spooled."""
        self._is_reported = True
        self._stop()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is None and not self._is_reported:
                self.drain()
        finally:
            self._stop()

    def _stop(self) -> None:
        with self._state:
            self._closed = True
            self._state.notify_all()
        self._pump.join()

    def _stream(self, key: str, epoch: str) -> OutgoingStream:
        if len(key) > MAX_KEY_CHARS:
            raise WireError(
                f"key expression {key[:80]!r}... has {len(key)} characters, at most {MAX_KEY_CHARS} are allowed"
            )
        with self._lock:
            return self._out.stream(StreamId(key, epoch))

    def _publish(self, stream: OutgoingStream, payload: bytes) -> None:
        key, message = stream.id.key, stream.on_wire(payload)
        self._bus.publish(key, message if self._prover is None else self._prover.prove(key, message))

    def _accept(self, stream: OutgoingStream, seq: int, next_seq: int, payload: bytes, *, is_document: bool) -> bool:
        """Keep a message until it is acknowledged; returns whether it is published now."""
        is_kept = False
        with self._lock:
            if self._spool is not None:
                is_held, is_kept = self._keep(self._spool, stream, seq, next_seq, payload, is_document=is_document)
                if not is_held:
                    return False  # on disk; it is sent when its turn comes
            elif not self._out.fits(len(payload)):
                self._wait_for_room(len(payload))
            if self._out.broken:
                self._check()
            return self._out.hold(stream, HeldMessage(seq, next_seq, payload, is_kept))

    def _keep(
        self, spool: Spool, stream: OutgoingStream, seq: int, next_seq: int, payload: bytes, *, is_document: bool
    ) -> tuple[bool, bool]:
        """Put a message into the spool; returns whether it is held in memory, and whether the spool has it."""
        began = time.monotonic()
        while True:
            self._check()
            fits = not self._is_spooled() and self._out.fits(len(payload))
            try:
                spool.append(stream.id, seq, next_seq, payload, taken=fits, is_document=is_document)
            except SpoolFull as error:
                self._wait(time.monotonic() if self.waits_when_full else began, f"{error}: ")
            except SpoolError:
                while self._is_spooled():  # messages on disk are sent before
                    self._wait(began)
                self._wait_for_room(len(payload))
                return True, False
            else:
                return fits, True

    def _wait_for_room(self, size: int) -> None:
        began = time.monotonic()
        while not self._out.fits(size):
            self._wait(began)

    def _is_spooled(self) -> bool:
        return self._spool is not None and (self._is_loading or self._spool.waiting > 0)

    def _wait(self, began: float, why: str = "") -> None:
        self._check()
        silence_s = time.monotonic() - max(self._out.progress_at, began)
        if silence_s > self._timeout_s:
            self._is_reported = True
            raise DeliveryError(
                f"{why}no recorder has acknowledged anything for {silence_s:.0f} s and "
                f"{self._out.format_outstanding()}; is `gyrofleet record` running where this source is connected to?"
                f"{self._out.format_other_store()}{self._why_refused()}"
            )
        self._state.wait(0.1)

    def _why_refused(self) -> str:
        ending = None if self._credentials is None else self._credentials.trouble
        if ending is not None:
            return f"; {ending}"
        return self._bus.why_refused() if isinstance(self._bus, Admitted) else ""

    def _check(self) -> None:
        if self._out.broken:
            self._is_reported = True
            raise DeliveryError(self._out.broken)

    def _on_acknowledgement(self, _key: str, payload: bytes) -> None:
        try:
            acknowledgement = decode_acknowledgement(payload)
            if self._credentials is not None:
                by, signature = acknowledgement.by, acknowledgement.signature
                check_acknowledgement(self._credentials, by, signature, acknowledgement.content)
        except Forged as error:
            self._forged += 1
            self._out.warning = f"a forged acknowledgement is refused, {self._forged} so far: {error}"
            return
        except WireError:
            return  # not from a recorder; without an acknowledgement everything is kept and sent again
        now = time.monotonic()
        with self._state:
            if self._out.store in {None, acknowledgement.store}:
                self._out.update_pause(acknowledgement.paused, now)
            for position in acknowledgement.positions:
                self._out.answer(acknowledgement.store, position, now)
            self._state.notify_all()

    def _pump_loop(self) -> None:
        """Publish messages that are due again, and those that wait on disk, as acknowledgements allow."""
        tick_s = min(_TICK_S, self._resend_after_s / 2)
        tick_at = 0.0
        try:
            while True:
                with self._state:
                    has_work = self._out.credit > 0 and (self._out.behind or self._can_load())
                    if not self._closed and not has_work:
                        self._state.wait(min(0.05, tick_s))
                    if self._closed:
                        return
                    now = time.monotonic()
                    chunk: list[Due] = []
                    if now >= tick_at:
                        tick_at = now + tick_s
                        chunk += self._out.overdue(now)
                    chunk += self._out.next_chunk()
                    self._look_at_silence(now)
                chunk += self._load()
                for stream, held in chunk:
                    self._publish(stream, held.payload)
                with self._lock:
                    for stream, _ in chunk:
                        stream.pumping = False
                        if stream.sent < len(stream.held):
                            self._out.behind[stream] = None
        except GyrofleetError as error:
            self.fail(str(error))

    def _look_at_silence(self, now: float) -> None:
        """Find out why nobody acknowledges anything, in a thread of its own: the answer takes seconds."""
        silent_s = now - self._out.progress_at
        if silent_s < _SILENT_S or not self._out.count() or self._out.is_paused():
            self._silence, self._asks_at = None, 0.0
        elif now >= self._asks_at:
            self._asks_at = now + _ASK_AGAIN_S
            since = dt.datetime.now(dt.UTC) - dt.timedelta(seconds=silent_s)

            def ask() -> None:
                why = self._why_refused() or "; is `gyrofleet record` running where this source is connected to?"
                if self._asks_at:
                    self._silence = f"no recorder has acknowledged anything since {since:%H:%M:%S} UTC{why}"

            threading.Thread(target=ask, name="gyrofleet-silence", daemon=True).start()

    def _can_load(self) -> bool:
        is_waiting = self._spool is not None and self._spool.waiting > 0
        return is_waiting and self._out.bytes < self._window_bytes and self._out.broken is None

    def _load(self) -> list[Due]:
        """Bring messages from the disk into memory; returns those to publish now, in their order."""
        with self._lock:
            if self._out.credit <= 0 or not self._can_load():
                return []
            assert self._spool is not None
            self._is_loading = True
            most_bytes = min(self._window_bytes - self._out.bytes, self._out.credit, CHUNK_BYTES)
        messages = self._spool.read(most_bytes)
        now_due: list[Due] = []
        with self._state:
            self._is_loading = False
            for message in messages:
                stream = self._out.stream(message.stream)
                if message.next_seq > stream.acknowledged:
                    held = HeldMessage(message.seq, message.next_seq, message.payload, is_kept=True)
                    self._out.credit -= len(held.payload)
                    if self._out.hold(stream, held):
                        now_due.append((stream, held))
            for stream, _ in now_due:
                stream.pumping = True
            self._state.notify_all()
        return now_due
