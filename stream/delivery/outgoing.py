"""One numbered stream of a publisher: what is not acknowledged, how much of it was sent, where to rewind."""

from collections import deque
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import NamedTuple
from uuid import UUID, uuid5

from stream.events import decode_event, encode_event
from stream.identity import SampleKey, parse_key
from stream.wire.acknowledgement import StreamId
from stream.wire.batches import decode_batch, encode_batch
from stream.wire.encoder import BatchEncoder

_FIRST_REWIND_PATIENCE_S = 0.5


class HeldMessage(NamedTuple):
    """An unacknowledged message: numbers `seq` to `next_seq - 1`; `is_kept` if it is on disk as well."""

    seq: int
    next_seq: int
    payload: bytes
    is_kept: bool = False


@dataclass(slots=True, eq=False)
class OutgoingStream:
    """State of one stream of a publisher.

    The first `sent` of the messages that are `held` have been published; `sent_to` is the number after the last one
    that ever was. `pumping`: a thread is about to publish some, so that no other may overtake it. From number `base` on
    the stream is sent under an epoch of its own, because the messages before it are lost.

    >>> stream = OutgoingStream(StreamId("k", "00000000000000000000000000000001"), 2.0)
    >>> stream.held.extend([HeldMessage(0, 10, b"a"), HeldMessage(10, 20, b"b"), HeldMessage(20, 30, b"c")])
    >>> stream.sent = 3
    >>> stream.release(10)
    1
    >>> stream.rewind(10, now=0.0), stream.sent
    (2, 0)
    """

    id: StreamId
    patience_s: float
    epoch: UUID | None = None
    encoder: BatchEncoder = field(default_factory=BatchEncoder)
    held: deque[HeldMessage] = field(default_factory=deque)
    sent: int = 0
    sent_to: int = 0
    pumping: bool = False
    base: int = 0
    acknowledged: int = 0
    lost_since: float | None = None
    quiet_since: float = 0.0
    _first_patience_s: float = field(init=False)
    _rewound_to: int = -1
    _rewound_at: float = 0.0
    _rewind_patience_s: float = 0.0

    def __post_init__(self) -> None:
        """Remember the patience to return to."""
        self._first_patience_s = self.patience_s

    @property
    def wire_id(self) -> StreamId:
        """Identity of the stream at the recorder."""
        return self._id_from(self.base)

    def on_wire(self, payload: bytes) -> bytes:
        """A message as it is published."""
        base = self.base  # read once: an answer may change it meanwhile, and name and number belong together
        if not base:
            return payload
        epoch = self._id_from(base).epoch
        if isinstance(parse_key(self.id.key), SampleKey):
            batch = decode_batch(payload)
            return encode_batch(replace(batch, epoch=UUID(epoch), seq=batch.seq - base))
        event = decode_event(payload)
        return encode_event(event.document, epoch, event.seq - base)

    def release(self, next_seq: int) -> int:
        """Drop the messages before `next_seq`, which a recorder has; returns their bytes."""
        self.acknowledged = max(self.acknowledged, next_seq)
        held, size, count = self.held, 0, 0
        while held and held[0].next_seq <= next_seq:
            size += len(held.popleft().payload)
            count += 1
        self.sent = max(0, self.sent - count)
        return size

    def on_ack(self) -> None:
        """Reset the patience: the recorder is there."""
        self.patience_s = self._first_patience_s

    def mark_progress(self, now: float) -> None:
        """The recorder has taken something."""
        self.on_ack()
        self.quiet_since = now
        self.lost_since = None

    def is_overdue(self, now: float) -> bool:
        """Whether it is time to ask about the last message that was sent."""
        return self.sent > 0 and not self.pumping and now - self.quiet_since > self.patience_s

    def poll(self, now: float, longest_s: float) -> list[HeldMessage]:
        """The first message sent, which the recorder may lack, and the last, which makes it ask for the rest."""
        self.quiet_since = now
        self.patience_s = min(2 * self.patience_s, longest_s)
        return [self.held[i] for i in sorted({0, self.sent - 1})]

    def rewind(self, asked: int, now: float) -> int:
        """Return to number `asked`; returns how many messages will be sent again.

        Messages in transit make the recorder repeat its request: repeated requests are ignored for a while, longer
        each time.
        """
        self.on_ack()
        if asked == self._rewound_to:
            if now - self._rewound_at < self._rewind_patience_s:
                return 0
            self._rewind_patience_s = min(2 * self._rewind_patience_s, 4 * self._first_patience_s)
        else:
            self._rewind_patience_s = min(_FIRST_REWIND_PATIENCE_S, self._first_patience_s / 4)
        self._rewound_to, self._rewound_at = asked, now
        first = next((i for i, message in enumerate(self.held) if message.next_seq > asked), len(self.held))
        again = max(0, self.sent - first)
        self.sent -= again
        return again

    def begin_new_epoch(self) -> None:
        """Send what is held under an epoch of its own: the messages before it are lost."""
        self.base = self.held[0].seq
        self.sent = 0
        self.lost_since = None

    def unsent(self, most_bytes: int) -> list[HeldMessage]:
        """The next messages to publish, at least one if there is any; they count as sent."""
        found: list[HeldMessage] = []
        size = 0
        for message in islice(self.held, self.sent, None):
            if size >= most_bytes:
                break
            found.append(message)
            size += len(message.payload)
        self.sent += len(found)
        if found:
            self.sent_to = max(self.sent_to, found[-1].next_seq)
        return found

    def _id_from(self, base: int) -> StreamId:
        if not base:
            return self.id
        return StreamId(self.id.key, uuid5(UUID(self.id.epoch), f"from {base}").hex)
