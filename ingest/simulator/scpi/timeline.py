"""A physical quantity as an exact function of time, changed by commands."""

import threading
from collections.abc import Callable, Sequence
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from ingest.station_clock import StationClock
from stream.batch import FloatArray, IntArray

State = TypeVar("State")


class Segment(NamedTuple, Generic[State]):
    """The state from a time on, until the next segment."""

    start_ns: int
    state: State


class Timeline(Generic[State]):
    """Segments of a course; the last one has no end.

    A command takes its time from the clock under the lock of the evaluation, so that a later command never changes a
    value of the past: a gyro on the table may be computed for any past interval. `value` makes values of a segment from
    its state and the seconds since its start, shape (n,).

    >>> line = Timeline(StationClock(start_ns=0), 0.0, lambda state, dt_s: state + 2.0 * dt_s)
    >>> line.change(lambda now_ns, state, dt_s: [Segment(now_ns + 10**9, 7.0)])
    >>> _, segments = line.since(0)
    >>> float(line.at(segments[-1].start_ns + 10**9))
    9.0
    """

    def __init__(self, clock: StationClock, state: State, value: Callable[[State, FloatArray], FloatArray]) -> None:
        self._clock, self._value = clock, value
        self._segments = [Segment(clock.now_ns(), state)]
        self._lock = threading.Lock()

    @property
    def now(self) -> State:
        """State of the last segment."""
        return self._segments[-1].state

    def change(self, plan: Callable[[int, State, float], Sequence[Segment[State]]]) -> None:
        """Replace the future.

        `plan`: returns the next segments for the time now, the state of the present segment and the seconds since its
        start; segments that begin before now begin now.
        """
        with self._lock:
            now_ns = self._clock.now_ns()
            while len(self._segments) > 1 and self._segments[-1].start_ns >= now_ns:
                self._segments.pop()
            present = self._segments[-1]
            dt_s = max(0, now_ns - present.start_ns) / 1e9
            self._segments.extend(plan(max(now_ns, present.start_ns), present.state, dt_s))

    def since(self, t_ns: int) -> tuple[int, list[Segment[State]]]:
        """Now, and the segments from the one at `t_ns` on; the course before now will not change any more."""
        with self._lock:
            begun = [i for i, segment in enumerate(self._segments) if segment.start_ns <= t_ns]
            return self._clock.now_ns(), self._segments[begun[-1] if begun else 0 :]

    def follow(self, segments: Sequence[Segment[State]]) -> None:
        """Take over segments of another process; earlier ones are kept."""
        with self._lock:
            kept = [segment for segment in self._segments if segment.start_ns < segments[0].start_ns]
            self._segments = [*kept, *segments]

    def at(self, t_ns: IntArray | int, value: Callable[[State, FloatArray], FloatArray] | None = None) -> FloatArray:
        """Values at these times, of the same shape; before the first segment, the value at its start.

        Another quantity of the same course, such as an angle beside a rate, is given by its own `value`.
        """
        with self._lock:
            times = np.atleast_1d(np.asarray(t_ns, np.int64))
            starts = np.array([segment.start_ns for segment in self._segments], np.int64)
            which = np.maximum(np.searchsorted(starts, times, side="right") - 1, 0)
            values = np.empty(times.shape)
            for k in np.unique(which):
                mine = which == k
                dt_s = np.maximum(times[mine] - starts[k], 0) / 1e9
                values[mine] = (value or self._value)(self._segments[k].state, dt_s)
            return values if np.ndim(t_ns) else values.reshape(())
