"""One numbered stream on its way: what is not acknowledged yet, how much of it was sent, where to go back to."""

from collections import deque
from dataclasses import replace
from itertools import islice
from typing import NamedTuple
from uuid import UUID, uuid5

from stream.events import decode_event, encode_event
from stream.identity import SampleKey, parse_key
from stream.wire.acknowledgement import StreamId
from stream.wire.batches import decode_batch, encode_batch
from stream.wire.encoder import BatchEncoder

_FIRST_REWIND_PATIENCE_S = 0.5


class Held(NamedTuple):
    """A message that is kept: numbers `seq` to `next_seq - 1`."""

    seq: int
    next_seq: int
    payload: bytes


class OutgoingStream:
    """What a publisher knows of one stream.

    The first `sent` of the messages that are `held` have been published, and not those after them; `sent_to` is the
    number behind the last one that ever was, beyond which nobody can have anything of it. `pumping` says that
    a thread is about to publish some, so that nobody overtakes it. From number `base` on the stream is sent under an
    epoch of its own, because what was before is lost.

    Examples
    --------
    >>> stream = OutgoingStream(StreamId("k", "00000000000000000000000000000001"), 2.0)
    >>> stream.held.extend([Held(0, 10, b"a"), Held(10, 20, b"b"), Held(20, 30, b"c")])
    >>> stream.sent = 3
    >>> stream.let_go(10)
    1
    >>> stream.go_back(10, now=0.0), stream.sent
    (2, 0)
    """

    __slots__ = (
        "_first_patience_s",
        "_rewind_patience_s",
        "_rewound_at",
        "_rewound_to",
        "acknowledged",
        "base",
        "encoder",
        "epoch",
        "held",
        "id",
        "lost_since",
        "patience_s",
        "pumping",
        "quiet_since",
        "sent",
        "sent_to",
    )

    def __init__(self, stream_id: StreamId, patience_s: float) -> None:
        self.id = stream_id
        self.epoch: UUID | None = None
        self.encoder = BatchEncoder()
        self.held: deque[Held] = deque()
        self.sent = 0
        self.sent_to = 0
        self.pumping = False
        self.base = 0
        self.acknowledged = 0
        self.lost_since: float | None = None
        self.quiet_since = 0.0
        self.patience_s = self._first_patience_s = patience_s
        self._rewound_to = -1
        self._rewound_at = 0.0
        self._rewind_patience_s = 0.0

    @property
    def wire_id(self) -> StreamId:
        """What the recorder knows it as."""
        return self._id_from(self.base)

    def on_wire(self, payload: bytes) -> bytes:
        """A message as it is published."""
        base = self.base  # once: an answer can move it meanwhile, and name and number belong together
        if not base:
            return payload
        epoch = self._id_from(base).epoch
        if isinstance(parse_key(self.id.key), SampleKey):
            batch = decode_batch(payload)
            return encode_batch(replace(batch, epoch=UUID(epoch), seq=batch.seq - base))
        event = decode_event(payload)
        return encode_event(event.document, epoch, event.seq - base)

    def let_go(self, next_seq: int) -> int:
        """Forget what comes before `next_seq`, as a recorder has it; returns its bytes."""
        self.acknowledged = max(self.acknowledged, next_seq)
        held, size, count = self.held, 0, 0
        while held and held[0].next_seq <= next_seq:
            size += len(held.popleft().payload)
            count += 1
        self.sent = max(0, self.sent - count)
        return size

    def on_ack(self) -> None:
        """The recorder is there: it need not be asked less and less often."""
        self.patience_s = self._first_patience_s

    def mark_progress(self, now: float) -> None:
        """The recorder has taken something."""
        self.on_ack()
        self.quiet_since = now
        self.lost_since = None

    def is_overdue(self, now: float) -> bool:
        """Whether it is time to ask what became of the last message that was sent."""
        return self.sent > 0 and not self.pumping and now - self.quiet_since > self.patience_s

    def ask(self, now: float, longest_s: float) -> list[Held]:
        """The first and the last message that were sent and not acknowledged, to be sent once more.

        The first may be what the recorder lacks; the last makes it ask, whatever else it lacks.
        """
        self.quiet_since = now
        self.patience_s = min(2 * self.patience_s, longest_s)
        return [self.held[i] for i in sorted({0, self.sent - 1})]

    def go_back(self, asked: int, now: float) -> int:
        """Begin again at number `asked`; returns how many messages will be sent once more.

        What was on its way when it was first asked for makes the recorder ask for the same again: such requests are
        left alone for a while, and longer each time.
        """
        self.on_ack()
        if asked == self._rewound_to:
            if now - self._rewound_at < self._rewind_patience_s:
                return 0
            self._rewind_patience_s = min(2 * self._rewind_patience_s, 4 * self._first_patience_s)
        else:
            self._rewind_patience_s = min(_FIRST_REWIND_PATIENCE_S, self._first_patience_s / 4)
        self._rewound_to, self._rewound_at = asked, now
        first = 0
        for message in self.held:
            if message.next_seq > asked:
                break
            first += 1
        again = max(0, self.sent - first)
        self.sent -= again
        return again

    def begin_anew(self) -> None:
        """What is held is sent under an epoch of its own: what was before it is lost."""
        self.base = self.held[0].seq
        self.sent = 0
        self.lost_since = None

    def unsent(self, most_bytes: int) -> list[Held]:
        """The next messages to publish, at least one if there is any; they count as sent."""
        found: list[Held] = []
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
