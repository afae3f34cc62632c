"""Delivery of numbered messages: kept by the source until a recorder has them on disk.

Zenoh has no durable acknowledgement, and a publisher's put returns normally for a message that is then lost.
So a source numbers what it sends per stream (a key expression and an epoch), keeps it, and lets go of it only
when a recorder acknowledges it after its data are on disk. At least once on the wire, exactly once in the log.
"""

import threading
import time
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol, Self
from uuid import uuid4

import msgspec

from stream.batch import SampleBatch
from stream.bus import Bus
from stream.errors import DeliveryError, WireError
from stream.events import AnyDocument, encode_event
from stream.identity import ACKNOWLEDGEMENT_KEY
from stream.wire import encode_batch


class StreamId(NamedTuple):
    """What is numbered without a gap: one key expression within one epoch of its source."""

    key: str
    epoch: str


class StreamPosition(msgspec.Struct, frozen=True, array_like=True):
    """How far a recorder has a stream on disk; with `rewind` it asks for what comes next once more."""

    key: str
    epoch: str
    next_seq: int
    rewind: bool = False


class Acknowledgement(msgspec.Struct, frozen=True, array_like=True):
    """Positions of the streams that moved since the last acknowledgement, and the store that holds them.

    `paused` says why the recorder takes nothing at the moment; it is empty while it records.
    """

    schema: int
    store: str
    positions: tuple[StreamPosition, ...]
    paused: str = ""


ACKNOWLEDGEMENT_SCHEMA = 1
_decoder = msgspec.msgpack.Decoder(Acknowledgement)


def encode_acknowledgement(store: str, positions: tuple[StreamPosition, ...], paused: str = "") -> bytes:
    """Put positions into their wire form."""
    return msgspec.msgpack.encode(Acknowledgement(ACKNOWLEDGEMENT_SCHEMA, store, positions, paused))


def decode_acknowledgement(payload: bytes) -> Acknowledgement:
    """Read positions from their wire form.

    Raises
    ------
    WireError
        If it is none.
    """
    try:
        return _decoder.decode(payload)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise WireError(f"not an acknowledgement: {error}") from error


class Sender(Protocol):
    """Where a source hands its samples and documents to."""

    def send_batch(self, key: str, batch: SampleBatch) -> None:
        """Send samples under `key`; waits while too much is on its way."""

    def send_event(self, key: str, document: AnyDocument) -> None:
        """Send a run document under `key`."""


class _Held(NamedTuple):
    next_seq: int
    payload: bytes


@dataclass
class _Outstanding:
    held: deque[_Held] = field(default_factory=deque)
    store: str | None = None
    resend: bool = False


class DurablePublisher:
    """Sends samples and documents, and keeps them until they are acknowledged.

    Parameters
    ----------
    bus : Bus
        Where to send.
    window_bytes : int
        How much may be unacknowledged; beyond it, `send_batch` waits. It bounds the memory of the source and
        of the recorder's queue alike.
    resend_after_s : float
        Silence after which everything unacknowledged is sent again; doubled each time, up to 30 s.
    timeout_s : float
        Silence after which waiting is given up with an error.
    """

    def __init__(
        self, bus: Bus, *, window_bytes: int = 32 << 20, resend_after_s: float = 2.0, timeout_s: float = 60.0
    ) -> None:
        self._bus = bus
        self._window_bytes = window_bytes
        self._resend_after_s = resend_after_s
        self._timeout_s = timeout_s
        self._epoch = uuid4().hex
        self._event_seq: dict[str, int] = {}
        self._streams: dict[StreamId, _Outstanding] = {}
        self._bytes = 0
        self._progress_at = time.monotonic()
        self._broken: str | None = None
        self._closed = False
        self._state = threading.Condition()
        self.resent = 0
        bus.subscribe(ACKNOWLEDGEMENT_KEY, self._on_acknowledgement)
        self._resender = threading.Thread(target=self._resend_loop, name="gyrofleet-resend", daemon=True)
        self._resender.start()

    @property
    def outstanding(self) -> int:
        """Messages that no recorder has acknowledged yet."""
        with self._state:
            return sum(len(stream.held) for stream in self._streams.values())

    def send_batch(self, key: str, batch: SampleBatch) -> None:
        """Send samples under `key`; waits while the window is full.

        Raises
        ------
        DeliveryError
            If nothing is acknowledged for `timeout_s`.
        """
        self._send(StreamId(key, batch.epoch.hex), batch.next_seq, encode_batch(batch))

    def send_event(self, key: str, document: AnyDocument) -> None:
        """Send a run document under `key`, numbered within this publisher; waits and raises like `send_batch`."""
        with self._state:
            seq = self._event_seq.get(key, 0)
            self._event_seq[key] = seq + 1
        self._send(StreamId(key, self._epoch), seq + 1, encode_event(document, self._epoch, seq))

    def drain(self) -> None:
        """Wait until everything is acknowledged.

        Raises
        ------
        DeliveryError
            If nothing is acknowledged for `timeout_s`; the message says what is outstanding.
        """
        with self._state:
            while self._bytes:
                self._wait()
            self._check()

    def fail(self, reason: str) -> None:
        """Let whoever sends or drains have `reason` as a DeliveryError at once: there is nothing to wait for."""
        with self._state:
            self._broken = self._broken or reason
            self._state.notify_all()

    def close(self) -> None:
        """Stop sending again; whatever `drain` has not seen acknowledged is given up."""
        with self._state:
            self._closed = True
            self._state.notify_all()
        self._resender.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _send(self, stream_id: StreamId, next_seq: int, payload: bytes) -> None:
        with self._state:
            while self._bytes and self._bytes + len(payload) > self._window_bytes:
                self._wait()
            self._check()
            if not self._bytes:
                self._progress_at = time.monotonic()
            self._streams.setdefault(stream_id, _Outstanding()).held.append(_Held(next_seq, payload))
            self._bytes += len(payload)
        self._bus.publish(stream_id.key, payload)

    def _wait(self) -> None:
        self._check()
        silence_s = time.monotonic() - self._progress_at
        if silence_s > self._timeout_s:
            raise DeliveryError(
                f"no recorder has acknowledged anything for {silence_s:.0f} s and {self._told_outstanding()}; "
                f"is `gyrofleet record` running where this source is connected to?"
            )
        self._state.wait(0.1)

    def _check(self) -> None:
        if self._broken:
            raise DeliveryError(self._broken)

    def _told_outstanding(self) -> str:
        waiting = [(stream_id, len(stream.held)) for stream_id, stream in self._streams.items() if stream.held]
        first, count = waiting[0]
        more = f" and {len(waiting) - 1} more streams" if len(waiting) > 1 else ""
        return f"{count} messages of {first.key}{more} are outstanding"

    def _on_acknowledgement(self, _key: str, payload: bytes) -> None:
        try:
            acknowledgement = decode_acknowledgement(payload)
        except WireError:
            return  # not from a recorder of ours; without an acknowledgement everything is kept and sent again
        with self._state:
            for position in acknowledgement.positions:
                stream = self._streams.get(StreamId(position.key, position.epoch))
                if stream is not None:
                    self._take(stream, acknowledgement.store, position)
            self._state.notify_all()

    def _take(self, stream: _Outstanding, store: str, position: StreamPosition) -> None:
        if position.rewind and stream.store not in {None, store}:
            self._broken = (
                f"the recorder asks for {position.key} from number {position.next_seq}, but earlier numbers went to "
                f"another store; send to one store until the run has ended"
            )
            return
        if not position.rewind:
            stream.store = store
        while stream.held and stream.held[0].next_seq <= position.next_seq:
            self._bytes -= len(stream.held.popleft().payload)
            self._progress_at = time.monotonic()
        stream.resend |= position.rewind and bool(stream.held)

    def _resend_loop(self) -> None:
        patience_s = self._resend_after_s
        last_progress = quiet_since = self._progress_at
        while True:
            with self._state:
                self._state.wait(0.05)
                if self._closed:
                    return
                if self._progress_at != last_progress:
                    last_progress = quiet_since = self._progress_at
                    patience_s = self._resend_after_s
                overdue = self._bytes > 0 and time.monotonic() - quiet_since > patience_s
                again: list[tuple[str, bytes]] = []
                for stream_id, stream in self._streams.items():
                    if stream.resend or overdue:
                        stream.resend = False
                        again += [(stream_id.key, held.payload) for held in stream.held]
                if overdue:
                    patience_s = min(2 * patience_s, 30.0)
                    quiet_since = time.monotonic()
                self.resent += len(again)
            for key, payload in again:
                self._bus.publish(key, payload)
