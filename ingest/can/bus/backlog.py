"""What has been received from a CAN bus and is not decoded yet: bounded, so that a slow log costs no memory."""

import threading
from collections import deque
from typing import Any, NamedTuple

from ingest.can.bus.intake import Intake


class Taken(NamedTuple):
    """Frames of one intake as it gave them; `read_s` is when the last of them was read."""

    intake: Intake
    frames: list[Any]
    read_s: float


class Backlog:
    """Hands frames from the thread that reads to the one that decodes.

    Parameters
    ----------
    most_waiting: Frames that may wait; those beyond are not kept.
    block: Frames that are worth decoding without waiting for more.
    """

    def __init__(self, most_waiting: int, block: int) -> None:
        self._most_waiting = most_waiting
        self._block = block
        self._taken: deque[Taken] = deque()
        self._waiting = 0
        self._is_closed = False
        self._state = threading.Condition()

    def put(self, intake: Intake, frames: list[Any], read_s: float) -> int:
        """Append frames; how many of them, the last ones, had no room."""
        with self._state:
            room = max(0, self._most_waiting - self._waiting)
            kept = frames[:room]
            if kept:
                was_empty = not self._waiting
                self._waiting += len(kept)
                self._taken.append(Taken(intake, kept, read_s))
                if was_empty or self._waiting >= self._block:
                    self._state.notify()
            return len(frames) - len(kept)

    def take(self, gather_s: float) -> list[Taken] | None:
        """Everything that waits, frames of one intake joined, after at most `gather_s` from the first frame on.

        None when the backlog is closed and empty.
        """
        with self._state:
            self._state.wait_for(lambda: self._taken or self._is_closed)
            self._state.wait_for(lambda: self._waiting >= self._block or self._is_closed, gather_s)
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
        """Nothing comes any more."""
        with self._state:
            self._is_closed = True
            self._state.notify_all()
