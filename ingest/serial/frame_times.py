"""Sampling times of numbered frames, from counter and nominal interval, steered by the times of arrival."""

import math
from typing import NamedTuple

import numpy as np

from ingest.seen_interval import IntervalWatch, SeenInterval, after
from stream.batch import BoolArray, IntArray

_WINDOW_S = 10.0
_MOST_STEERING = 1e-3
_NS = 1e9
_RESYNC_NS = 0.25 * _NS  # largest delay of the line
_EARLY_NS = 5_000_000  # a frame that came so long before its time shows that the grid is late


class Placed(NamedTuple):
    """Which frames are new, shape (n,), and when those were sampled, shape (number of new ones,)."""

    is_new: BoolArray
    times_ns: IntArray


class FrameTimes:
    """Places frames on a grid of their nominal interval.

    The first frame is anchored at its arrival. From then on counters give the number of intervals passed, so that the
    jitter of the line does not matter. The device's clock is not the station's: every 10 s the grid is steered towards
    the earliest arrival of those 10 s, by half its error and at most 0.1 % of the interval. No frame is sampled after
    it arrived: one that came 5 ms or more before its time, as after a first one that was read late, moves the grid at
    once. If neither counter nor interval explain an arrival within 0.25 s (the device has restarted), the grid is
    anchored again. Where the arrivals show another interval for certain, the grid goes on with that.

    `is_live`: the arrivals are those of a real line; a simulated one that runs faster may fall behind its pace.

    `modulus`: where the counter wraps; None without a counter, so that only time tells lost frames.

    `seen`: the interval that the arrivals show, if it is not the stated one; from then on `is_wrong` may be true.

    `steering`: relative stretch of the interval now; it converges to the device's own error.

    >>> times = FrameTimes(0.01, modulus=256)
    >>> times.place(np.array([254, 255, 0]), 3, 1_020_000_000).times_ns.tolist()
    [1000000000, 1010000000, 1020000000]
    >>> times.place(np.array([3, 3]), 2, 1_050_000_000), times.lost, times.repeated
    (Placed(is_new=array([ True, False]), times_ns=array([1050000000])), 2, 1)
    """

    def __init__(self, interval_s: float, modulus: int | None, *, is_live: bool = True) -> None:
        self._is_live = is_live
        self._interval_ns = interval_s * _NS
        self._modulus = modulus
        self._counter: int | None = None
        self._number = self._last_ns = 0  # of the last frame
        self._base = (0, 0, self._interval_ns)  # number, its time, interval from there on
        self._earliest_ns = math.inf
        self.watch = IntervalWatch(self._interval_ns)
        self._counted = self._turned = 0  # by the counter alone; whole turns that the time has added since
        self.seen: SeenInterval | None = None
        self.steering = 0.0
        self.lost = self.repeated = self.restarts = 0

    @property
    def is_wrong(self) -> bool:
        """Whether the stated interval is wrong."""
        return self.seen is not None and self.seen.is_wrong

    def place(self, counters: IntArray | None, n: int, t_ns: int) -> Placed:
        """Place `n` frames, the last of which arrived at `t_ns`; `counters` has shape (n,), or is None."""
        is_first = self._counter is None
        steps, is_new = self._steps(counters, n)
        if not len(steps):
            return Placed(is_new, np.empty(0, np.int64))
        counted = int(steps.sum())
        if is_first:
            self._base = (0, t_ns - round(float(steps.sum()) * self._interval_ns), self._interval_ns)
        elif (restart := self._explain(steps, t_ns)) is not None:
            return Placed(is_new, self._restart(steps, restart, t_ns))
        self.lost += int(steps.sum()) - len(steps) + is_first
        numbers = self._number + np.cumsum(steps)
        if self._is_live and self._late_ns(steps, t_ns) < -_EARLY_NS:
            self._base = (int(numbers[-1]), t_ns, self._base[2])
            self._earliest_ns = math.inf
        times_ns = self._at(numbers)
        if not is_first:
            times_ns = after(times_ns, numbers - self._number, self._last_ns, self._interval_ns)
        self._number, self._last_ns = int(numbers[-1]), int(times_ns[-1])
        self._steer(t_ns)
        if self._is_live:
            self._see(counted, t_ns)
        return Placed(is_new, times_ns)

    def _see(self, counted: int, t_ns: int) -> None:
        """Go on with the interval that is seen, where that is another one for certain.

        Without a counter frames may be lost between those that come, but none can come that was not sampled.
        """
        self._counted += counted
        seen = self.watch.see(self._counted, t_ns)
        if len(self.watch.points) <= 1:
            self._turned = 0
        if seen is None or (self._modulus is None and seen.interval_ns > seen.stated_ns):
            return
        if self.seen is not None and self.seen.uncertainty_ns <= seen.uncertainty_ns:
            return
        self.seen, self._interval_ns = seen, seen.interval_ns
        self.lost -= self._turned  # the time required them only by the stated interval
        self._turned = 0
        [last_ns] = self._at(np.array([self._number])).tolist()
        self._base = (self._number, max(last_ns, t_ns) if seen.is_wrong else last_ns, seen.interval_ns)
        self._earliest_ns = math.inf

    def _steps(self, counters: IntArray | None, n: int) -> tuple[IntArray, BoolArray]:
        """Intervals from each new frame to the one before, and which are new."""
        if counters is None or self._modulus is None:
            steps = np.ones(n, np.int64)
            if self._counter is None and n:
                steps[0], self._counter = 0, 0
            return steps, np.ones(n, np.bool_)
        previous = counters[0] if self._counter is None and n else self._counter
        steps = np.diff(counters, prepend=np.int64(previous or 0)) % self._modulus
        is_new = steps != 0
        if self._counter is None and n:
            is_new[0] = True
        if n:
            self._counter = int(counters[-1])
        self.repeated += int(n - is_new.sum())
        return steps[is_new], is_new

    def _explain(self, steps: IntArray, t_ns: int) -> int | None:
        """Add whole turns of the counter that the time requires; index of its restart, None without one."""
        turn = self._modulus or 1
        jumps = np.flatnonzero(steps != 1)
        late_ns = self._late_ns(steps, t_ns)
        if late_ns > max(_RESYNC_NS, turn * self._interval_ns / 2):
            turns = turn * round(late_ns / (turn * self._interval_ns))
            steps[jumps[0] if len(jumps) else 0] += turns
            self._turned += turns
            late_ns = self._late_ns(steps, t_ns)
        if abs(late_ns) <= _RESYNC_NS or not len(jumps):
            return None
        return int(np.argmax(steps))

    def _restart(self, steps: IntArray, restart: int, t_ns: int) -> IntArray:
        """Times of frames, counted from a new start from index `restart` on."""
        self.restarts += 1
        self.lost += int(steps[:restart].sum()) - restart + int(steps[restart + 1 :].sum()) - (len(steps) - restart - 1)
        before = self._at(self._number + np.cumsum(steps[:restart]))
        last_ns = int(self._at(np.array([self._number + int(steps[:restart].sum())]))[0])
        counted = np.concatenate(([0], np.cumsum(steps[restart + 1 :])))
        start_ns = max(t_ns - round(float(counted[-1]) * self._interval_ns), last_ns + round(self._interval_ns))
        self._number = int(counted[-1])
        self._base = (0, start_ns, self._interval_ns)
        self._earliest_ns = math.inf
        self.watch.restart()
        times_ns = np.concatenate((before, self._at(counted)))
        self._last_ns = int(times_ns[-1])
        return times_ns

    def _late_ns(self, steps: IntArray, t_ns: int) -> float:
        return float(t_ns - self._at(np.array([self._number + int(steps.sum())]))[0])

    def _at(self, numbers: IntArray) -> IntArray:
        base, base_ns, interval_ns = self._base
        return np.asarray(base_ns + np.rint((numbers - base) * interval_ns).astype(np.int64))

    def _steer(self, t_ns: int) -> None:
        base, base_ns, interval_ns = self._base
        passed_ns = round((self._number - base) * interval_ns)
        self._earliest_ns = min(self._earliest_ns, t_ns - (base_ns + passed_ns))
        if passed_ns < _WINDOW_S * _NS:
            return
        steering = 0.5 * self._earliest_ns / passed_ns
        self.steering = float(np.clip(steering, -_MOST_STEERING, _MOST_STEERING))
        self._base = (self._number, base_ns + passed_ns, self._interval_ns * (1.0 + self.steering))
        self._earliest_ns = math.inf
