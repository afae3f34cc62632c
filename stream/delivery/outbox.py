"""The unacknowledged messages of a publisher, in order, and the handling of the recorder's answers."""

import time

from stream.delivery.outgoing import HeldMessage, OutgoingStream
from stream.delivery.spool import Spool
from stream.wire.acknowledgement import StreamId, StreamPosition

CHUNK_BYTES = 256 << 10
_FIRST_CREDIT_BYTES = 1 << 20
_LONGEST_PATIENCE_S = 10.0
_PAUSE_HOLDS_S = 3.0
_POLLED_IN_A_PAUSE = 10
_LOST_AFTER = 5  # patiences, after which a request for acknowledged messages is taken as a loss

Due = tuple[OutgoingStream, HeldMessage]


class Outbox:
    """The streams of one publisher and their messages in memory; callers hold the publisher's lock.

    `bytes` are held; messages sent again or read from disk cost `credit`, which acknowledgements return twofold.
    `behind` are the streams with messages that wait to be published. `progress_at` is the time of the recorder's last
    activity, `paused` the reason of its pause; `broken` is why nothing can be delivered any more.

    Everything goes to one store: `store` is its identity, if not given that of the first recorder that has taken
    something. Answers of recorders of other stores are ignored; `other_store` is the last one that asked for something.
    Answers about numbers that were never sent are counted in `ignored`.
    """

    def __init__(self, window_bytes: int, resend_after_s: float, spool: Spool | None, store: str | None = None) -> None:
        self._window_bytes, self._resend_after_s = window_bytes, resend_after_s
        self._longest_wait_s = max(_LONGEST_PATIENCE_S, resend_after_s)
        self._spool = spool
        self.store = store or (None if spool is None else spool.store or None)
        self.other_store: str | None = None
        self.ignored = 0
        self.streams: dict[tuple[str, str], OutgoingStream] = {}
        self._renamed: dict[tuple[str, str], tuple[OutgoingStream, int]] = {}
        self.behind: dict[OutgoingStream, None] = {}
        self._holding: dict[OutgoingStream, None] = {}  # of thousands of streams those that hold something
        self.bytes = 0
        self.credit = _FIRST_CREDIT_BYTES
        self.progress_at = time.monotonic()
        self.paused = ""
        self._paused_at = float("-inf")
        self.broken: str | None = None
        self.resent = 0
        self.warning: str | None = None

    def stream(self, stream_id: StreamId) -> OutgoingStream:
        """The stream of that name, begun at its position in the spool."""
        stream = self.streams.get(stream_id)
        if stream is not None:
            return stream
        stream = OutgoingStream(stream_id, self._resend_after_s)
        state = None if self._spool is None else self._spool.streams.get(stream_id)
        if state is not None and self._spool is not None:
            stream.acknowledged = state.acknowledged
            stream.sent_to = state.appended  # by this process or the one before it
            stream.base = state.base
            if stream.base:
                self._renamed[stream.wire_id] = stream, stream.base
        self.streams[stream_id] = stream
        return stream

    def hold(self, stream: OutgoingStream, held: HeldMessage) -> bool:
        """Keep a message in memory; returns whether it is published now, because all before it in its stream were."""
        if not stream.held:
            stream.quiet_since = time.monotonic()
            if not self.bytes:
                self.progress_at = stream.quiet_since
            self._holding[stream] = None
        stream.held.append(held)
        self.bytes += len(held.payload)
        if stream.sent == len(stream.held) - 1 and not stream.pumping:
            stream.sent += 1
            stream.sent_to = max(stream.sent_to, held.next_seq)
            return True
        self.behind[stream] = None
        return False

    def fits(self, size: int) -> bool:
        """Whether there is room for a message of so many bytes."""
        return not self.bytes or self.bytes + size <= self._window_bytes

    def is_paused(self) -> bool:
        """Whether the recorder has just reported a pause."""
        return bool(self.paused) and time.monotonic() - self._paused_at < _PAUSE_HOLDS_S

    def count(self) -> int:
        """Messages that are not acknowledged; of those on disk from before, an upper bound."""
        spooled = 0 if self._spool is None else self._spool.waiting
        return spooled + sum(len(stream.held) for stream in self._holding)

    def not_kept(self) -> int:
        """Messages that are neither acknowledged nor on disk."""
        return sum(not each.is_kept for stream in self._holding for each in stream.held)

    def format_outstanding(self) -> str:
        """What is outstanding, for people."""
        waiting = {stream.id.key: len(stream.held) for stream in self.streams.values() if stream.held}
        text = f"{self.count()} messages are outstanding"
        if waiting:
            first, count = min(waiting.items())
            more = f" and {len(waiting) - 1} more streams" if len(waiting) > 1 else ""
            text = f"{count} messages of {first}{more} are outstanding"
        if self._spool is None:
            return text
        lost = f" but {not_kept} of them" if (not_kept := self.not_kept()) else ""
        return f"{text}; they are kept in {self._spool.folder}{lost} and sent when the same source starts again"

    def answer(self, store: str, position: StreamPosition, now: float) -> None:
        """Process the answer of a recorder about a stream."""
        name = (position.key, position.epoch)
        stream, base = self._renamed.get(name) or (self.streams.get(name), 0)
        if stream is None or base != stream.base:
            return  # of an epoch before: those messages are acknowledged or lost
        if self.store not in {None, store}:
            self.other_store = store
            return
        next_seq = base + position.next_seq
        if not base <= next_seq <= stream.sent_to:
            self.ignored += 1
            self.warning = (
                f"an answer is ignored, {self.ignored} so far: it names number {next_seq} of {stream.id.key}, of which "
                f"{stream.sent_to} were sent; another program answers on this bus as store {store[:40]}"
            )
        elif position.rewind:
            self._rewind(stream, next_seq, now)
        else:
            self._acknowledge(stream, store, next_seq, now)

    def format_other_store(self) -> str:
        """That a recorder of another store answers, as the end of a sentence; empty where none does."""
        if self.other_store is None:
            return ""
        return (
            f"; a recorder of another store ({self.other_store[:40]}) requests them, but they go to the store "
            f"{self.store}: send to one store until the run has ended"
        )

    def update_pause(self, reason: str, now: float) -> None:
        """Process the reason why the recorder pauses; empty while it records."""
        if reason:
            self.progress_at = self._paused_at = now
            for stream in self.streams.values():
                stream.on_ack()
        elif self.paused:
            for stream in self.streams.values():
                stream.quiet_since = float("-inf")  # it records again: poll at once
        self.paused = reason

    def _acknowledge(self, stream: OutgoingStream, store: str, next_seq: int, now: float) -> None:
        if next_seq:
            self.store = store
        if self._spool is not None:
            self._spool.acknowledge(store, stream.id, next_seq)
        freed = stream.release(next_seq)
        if not stream.held:
            self._holding.pop(stream, None)
        if freed:
            stream.mark_progress(now)
            self.bytes -= freed
            self.credit = min(self.credit + 2 * freed, self._window_bytes)
            self.progress_at = now

    def _rewind(self, stream: OutgoingStream, asked: int, now: float) -> None:
        """Return to number `asked`, which the recorder lacks; messages before it are not durable there yet."""
        if stream.held and stream.held[0].seq > asked:
            self._miss(stream, asked, now)
        elif again := stream.rewind(asked, now):
            self.resent += again
            self.credit = max(self.credit, _FIRST_CREDIT_BYTES)
            self.behind[stream] = None

    def _miss(self, stream: OutgoingStream, asked: int, now: float) -> None:
        """Handle a request for messages that are not here any more."""
        text = f"the recorder asks for {stream.id.key} from number {asked}, and this source has it from"
        is_lost_there = asked < stream.acknowledged
        if is_lost_there:
            stream.lost_since = now if stream.lost_since is None else stream.lost_since
            if now - stream.lost_since <= _LOST_AFTER * self._resend_after_s:
                return  # it may be a late request
        if self._spool is not None:
            stream.begin_new_epoch()
            self._spool.rebase(stream.id, stream.base)
            self._renamed[stream.wire_id] = stream, stream.base
            self.behind[stream] = None
            why = "its spool is damaged"
            if is_lost_there:
                why = "the recorder has lost what it had acknowledged (see `gyrofleet verify`)"
            self.warning = f"{text} {stream.base}, as {why}: it continues under a new epoch"
        elif is_lost_there:
            self.broken = (
                f"{text} {stream.acknowledged}: it has lost what it had acknowledged; look at its store with "
                f"`gyrofleet verify`"
            )
        else:
            self.broken = f"{text} {stream.held[0].seq}; send the messages before it, or begin a new epoch"

    def overdue(self, now: float) -> list[Due]:
        """The messages to send again because nothing was answered."""
        if self.credit <= 0:
            self.credit = CHUNK_BYTES  # without any answer, a little is still sent
        overdue = [stream for stream in self._holding if stream.is_overdue(now)]
        if self.is_paused():
            overdue = overdue[:_POLLED_IN_A_PAUSE]  # enough to notice its end
        polled = [(stream, held) for stream in overdue for held in stream.poll(now, self._longest_wait_s)]
        self.resent += len(polled)
        return polled

    def next_chunk(self) -> list[Due]:
        """The next messages of the streams that are behind, up to the credit."""
        chunk: list[Due] = []
        room = min(CHUNK_BYTES, self.credit)
        while self.behind and room > 0:
            stream = next(iter(self.behind))
            messages = stream.unsent(room)
            if stream.sent == len(stream.held):
                del self.behind[stream]
            stream.pumping = bool(messages)
            chunk += [(stream, held) for held in messages]
            size = sum(len(held.payload) for held in messages)
            room -= size
            self.credit -= size
        return chunk
