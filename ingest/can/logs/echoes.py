"""Frames that a log has twice: a logger records what it sends, and what it or another node receives of it."""

from collections import deque

from ingest.can.frames import CanFrame

WITHIN_NS = 5_000_000
_MOST_WAITING = 64  # frames of one id and channel within that time


class Echoes:
    """Finds frames that repeat one of the other direction: id, channel and data are the same, within 5 ms.

    Each frame is repeated once at most. Frames of one direction alone are never echoes, whatever their data.

    >>> echoes, frame = Echoes(), CanFrame(0, 0, 0x101, b"1")
    >>> echoes.is_echo(frame, is_rx=True), echoes.is_echo(frame._replace(t_ns=100_000), is_rx=False)
    (False, True)
    >>> echoes.is_echo(frame._replace(t_ns=200_000), is_rx=False)
    False
    """

    def __init__(self) -> None:
        self._waiting: dict[tuple[int, int], deque[tuple[CanFrame, bool]]] = {}
        self._directions: set[bool] = set()

    def is_echo(self, frame: CanFrame, *, is_rx: bool) -> bool:
        """Whether the next frame of the log repeats one before it."""
        key = frame.channel, frame.arbitration_id
        if (waiting := self._waiting.get(key)) is None:
            waiting = self._waiting[key] = deque(maxlen=_MOST_WAITING)
        while waiting and frame.t_ns - waiting[0][0].t_ns > WITHIN_NS:
            waiting.popleft()
        self._directions.add(is_rx)
        if len(self._directions) > 1:
            for place, (other, other_is_rx) in enumerate(waiting):
                is_near = abs(frame.t_ns - other.t_ns) <= WITHIN_NS
                if is_near and other_is_rx != is_rx and other.data == frame.data:
                    del waiting[place]
                    return True
        waiting.append((frame, is_rx))
        return False
