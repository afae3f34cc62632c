"""The frames that wait between the thread that reads a CAN interface and the one that decodes them."""

import threading
from collections import deque
from typing import Any, NamedTuple

from ingest.can.bus.interface import CanIntake


class Taken(NamedTuple):
    """Frames of one intake as it gave them; `read_s` is when the last of them was read."""

    intake: CanIntake
    frames: list[Any]
    read_s: float


class Backlog:
    """Hands frames from the thread that reads to the one that decodes; bounded, so that a slow log costs no memory."""

    def __init__(self, capacity: int, block: int) -> None:
        self._capacity, self._block = capacity, block
        self._taken: deque[Taken] = deque()
        self._waiting = 0
        self._is_closed = False
        self._state = threading.Condition()

    def put(self, intake: CanIntake, frames: list[Any], read_s: float) -> int:
        """Append frames; returns how many of them, the last ones, were dropped."""
        with self._state:
            kept = frames[: max(0, self._capacity - self._waiting)]
            if kept:
                was_empty = not self._waiting
                self._waiting += len(kept)
                self._taken.append(Taken(intake, kept, read_s))
                if was_empty or self._waiting >= self._block:
                    self._state.notify()
            return len(frames) - len(kept)

    def take(self, collect_s: float) -> list[Taken] | None:
        """Everything that waits, joined by intake, at most `collect_s` after the first frame; None once closed."""
        with self._state:
            self._state.wait_for(lambda: self._taken or self._is_closed)
            self._state.wait_for(lambda: self._waiting >= self._block or self._is_closed, collect_s)
            taken, self._taken = self._taken, deque()
            self._waiting = 0
        if not taken:
            return None
        joined = [taken.popleft()]
        for each in taken:
            if each.intake is joined[-1].intake:
                joined[-1].frames.extend(each.frames)
                joined[-1] = joined[-1]._replace(read_s=each.read_s)
            else:
                joined.append(each)
        return joined

    def close(self) -> None:
        """No more frames come."""
        with self._state:
            self._is_closed = True
            self._state.notify_all()
