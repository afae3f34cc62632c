"""Ends of runs that wait for samples: the end of a run may be recorded before the last of its samples."""

import time
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from stream.events import EventMessage, RunEnded
from stream.identity import Place, sample_key
from stream.wire.acknowledgement import StreamId

# a source polls at least every 10 s about samples that it has; nothing arrives of those that nobody has
_LOST_AFTER_S = 60.0


@dataclass
class _Waiting:
    """The end of a run and the messages after it; `since`: its samples stand still, though its end is recorded."""

    messages: deque[tuple[Place, EventMessage]] = field(default_factory=deque)
    is_recorded: bool = False
    reached: int = -1
    since: float = 0.0


class PendingEnds:
    """Documents that are not processed yet, by stream.

    >>> pending, stream = PendingEnds(), StreamId("gyrofleet/plant/bench/event", "e")
    >>> ended = EventMessage(schema=1, epoch="e", seq=4, document=RunEnded(run="r1", t_ns=0))
    >>> pending.hold(stream, Place("plant", "bench"), ended, is_recorded=True)
    >>> pending.next_seq(stream), pending.is_lost(stream, {})
    (5, False)
    """

    def __init__(self) -> None:
        self._waiting: dict[StreamId, _Waiting] = {}

    @property
    def streams(self) -> list[StreamId]:
        """Streams in which something waits."""
        return list(self._waiting)

    def next_seq(self, stream: StreamId) -> int | None:
        """Number after the last waiting message of a stream; None if none waits."""
        waiting = self._waiting.get(stream)
        return None if waiting is None else waiting.messages[-1][1].seq + 1

    def hold(self, stream: StreamId, place: Place, message: EventMessage, *, is_recorded: bool) -> None:
        """Let a message wait; `is_recorded`: it came from the log."""
        self._waiting.setdefault(stream, _Waiting()).messages.append((place, message))
        self.mark_seen(stream, message.seq, is_recorded=is_recorded)

    def mark_seen(self, stream: StreamId, seq: int, *, is_recorded: bool) -> None:
        """A message of that number came again."""
        waiting = self._waiting.get(stream)
        if waiting is not None and waiting.messages[0][1].seq == seq:
            waiting.is_recorded |= is_recorded

    def first(self, stream: StreamId) -> tuple[Place, EventMessage] | None:
        """The first waiting message of a stream."""
        waiting = self._waiting.get(stream)
        return None if waiting is None else waiting.messages[0]

    def pop(self, stream: StreamId) -> None:
        """Remove the first waiting message of a stream."""
        waiting = self._waiting[stream]
        waiting.messages.popleft()
        waiting.is_recorded, waiting.reached = False, -1
        if not waiting.messages:
            del self._waiting[stream]

    def is_lost(self, stream: StreamId, positions: Mapping[StreamId, int]) -> bool:
        """Whether the samples that the first end in a stream waits for have not come for so long that they are lost."""
        waiting = self._waiting[stream]
        place, message = waiting.messages[0]
        assert isinstance(message.document, RunEnded)
        reached = sum(positions.get(each, 0) for each, _ in streams_of(place, message.document))
        if not waiting.is_recorded or reached != waiting.reached:
            waiting.reached, waiting.since = reached, time.monotonic()
        return time.monotonic() - waiting.since > _LOST_AFTER_S


def streams_of(place: Place, ended: RunEnded) -> Iterator[tuple[StreamId, int]]:
    """The sample streams of a run that has ended, and how many samples each has."""
    for total in ended.totals:
        yield StreamId(sample_key(place, total.unit, total.signal), total.epoch.replace("-", "")), total.samples
