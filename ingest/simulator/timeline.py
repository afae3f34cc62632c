"""A physical quantity as an exact function of time, whose course is changed by commands."""

import threading
from collections.abc import Callable, Sequence
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from ingest.station_clock import StationClock
from stream.batch import FloatArray, IntArray

State = TypeVar("State")


class Stretch(NamedTuple, Generic[State]):
    """How it goes on from a moment on, until the next stretch."""

    start_ns: int
    state: State


class Timeline(Generic[State]):
    """Stretches of a course, the last of which goes on for ever.

    A command takes its moment from the clock while nobody evaluates, so that what was once evaluated up to now is never
    changed by a command that came later: a gyro on the table may be computed for any interval of the past.

    Parameters
    ----------
    clock: The station's clock.
    state: Of the first stretch, which reaches back for ever.
    value: Values of a stretch from its state and the seconds since its start, shape (n,).

    Examples
    --------
    >>> line = Timeline(StationClock(start_ns=0), 0.0, lambda state, dt_s: state + 2.0 * dt_s)
    >>> line.change(lambda now_ns, state, dt_s: [Stretch(now_ns + 10**9, 7.0)])
    >>> bool(line.at(line.last_ns + 10**9) == 9.0)
    True
    """

    def __init__(self, clock: StationClock, state: State, value: Callable[[State, FloatArray], FloatArray]) -> None:
        self._clock = clock
        self._value = value
        self._stretches = [Stretch(clock.now_ns(), state)]
        self._lock = threading.Lock()

    @property
    def last_ns(self) -> int:
        """Where the last stretch begins."""
        return self._stretches[-1].start_ns

    @property
    def now(self) -> State:
        """State of the stretch that was last planned."""
        return self._stretches[-1].state

    def change(self, plan: Callable[[int, State, float], Sequence[Stretch[State]]]) -> None:
        """Replace what was to come.

        Parameters
        ----------
        plan: The stretches that come, from the moment now, the state of the present stretch and the seconds since its
            start. What of them begins before now begins now.
        """
        with self._lock:
            now_ns = self._clock.now_ns()
            while len(self._stretches) > 1 and self._stretches[-1].start_ns >= now_ns:
                self._stretches.pop()
            present = self._stretches[-1]
            dt_s = max(0, now_ns - present.start_ns) / 1e9
            self._stretches.extend(plan(max(now_ns, present.start_ns), present.state, dt_s))

    def since(self, t_ns: int) -> tuple[int, list[Stretch[State]]]:
        """Now, and the stretches from that in which `t_ns` lies on: what is before now will not change any more."""
        with self._lock:
            first = 0
            for i, stretch in enumerate(self._stretches):
                if stretch.start_ns <= t_ns:
                    first = i
            return self._clock.now_ns(), self._stretches[first:]

    def follow(self, stretches: Sequence[Stretch[State]]) -> None:
        """Take over stretches of another process; those before them are kept."""
        with self._lock:
            kept = [stretch for stretch in self._stretches if stretch.start_ns < stretches[0].start_ns]
            self._stretches = [*kept, *stretches]

    def at(self, t_ns: IntArray | int, value: Callable[[State, FloatArray], FloatArray] | None = None) -> FloatArray:
        """Values at these times, shape as theirs; before the first stretch, that of its start.

        Another quantity of the same course, an angle beside a rate, has a `value` of its own.
        """
        with self._lock:
            times = np.atleast_1d(np.asarray(t_ns, np.int64))
            starts = np.array([stretch.start_ns for stretch in self._stretches], np.int64)
            which = np.maximum(np.searchsorted(starts, times, side="right") - 1, 0)
            values = np.empty(times.shape)
            for k in np.unique(which):
                mine = which == k
                dt_s = np.maximum(times[mine] - starts[k], 0) / 1e9
                values[mine] = (value or self._value)(self._stretches[k].state, dt_s)
            return values if np.ndim(t_ns) else values.reshape(())
