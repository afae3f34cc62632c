"""Frame counters, which tell lost and repeated frames, and restarts of the device."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stream.batch import BoolArray, FloatArray, IntArray

# A counter off by more than this share of its modulus after a long silence has restarted.
_OUT_OF_STEP = 0.25
# how many intervals show the usual one, and how far they may spread of it (10 to 90 %)
_LEAST_INTERVALS, _STEADY = 20, 0.2
# frames by which a counter differs from the time at a restart, or where it is corrupted: at first, and at least four
# times the spread of the delays once so many frames have shown it
_FAR, _LEAST_FAR, _SPREADS, _SHOWN = 100, 20, 4.0, 200
# frames that a device sends within the silence before it begins to count again, beyond those of the silence's length
_SOON = 8
# frames in a row, sent at their pace, that show a restart whose first frames were lost
_LEAST_PACED = 20
# frames that show how late the first one was
_FIRST = 1000
# a baseline of delays may rise by this share of the time, as where the clock of the device is slow
_DRIFT = 1e-3


class _Frame(NamedTuple):
    t_ns: int
    counter: int
    number: int


@dataclass
class _Doubtful:
    """Frames in a row whose counter does not follow from the frame before them: a restart, a gap, or corrupted."""

    first: _Frame
    last: _Frame
    step: int  # from the frame before them
    is_soon: bool  # the counter is as low as after a restart
    is_ahead: bool  # of the time
    rows: list[int]  # those of the present block
    count: int = 1


def _is_far(steps: IntArray, elapsed: FloatArray, counter: IntArray, far: float) -> BoolArray:
    """Whether a counter stepped far back, far ahead of the time, or far less than the time if it is as low as again.

    The frame that follows the last one is not among them, however late it comes: the receiver has stalled.
    """
    is_behind = (elapsed >= 0) & (elapsed - steps > far) & ((steps <= 0) | ((steps > 1) & (counter <= elapsed + _SOON)))
    return np.asarray(is_behind | (steps - np.maximum(elapsed, 0) > far), np.bool_)


class FrameCounter:
    """Numbers frames by a counter that runs from 0 to `modulus` - 1 and around.

    If the interval of the frames is known, whole turns of the counter come from the times; where it is not, from a
    steady one that the first frames show. `lost` frames are missing, `repeated` ones came again or too late, `strays`
    have a counter that fits neither the frames before nor those after; `restarts` are places where the counter began
    again: the frames from there on are numbered by their times.

    >>> counter = FrameCounter(16, interval_ns=10)
    >>> numbers, keep = counter.follow(np.array([0, 10, 12, 40]), np.array([14, 15, 15, 2]))
    >>> numbers[keep].tolist(), counter.lost, counter.repeated
    ([0, 1, 4], 2, 1)
    >>> counter = FrameCounter(65536, interval_ns=10)
    >>> numbers, keep = counter.follow(np.array([0, 10, 20, 90, 100]), np.array([5000, 5001, 5002, 0, 1]))
    >>> numbers[keep].tolist(), counter.restarts
    ([0, 1, 2, 9, 10], 1)
    """

    def __init__(self, modulus: int, interval_ns: int | None = None) -> None:
        self._modulus, self._interval_ns = modulus, interval_ns
        self._first_ns = 0
        self._last: _Frame | None = None
        self._highest = -1
        self._usual_ns: float | None = None
        self._doubtful: _Doubtful | None = None
        self._least_delay_ns: float | None = None  # of late, in which the device's clock may have drifted
        self._first_delay_ns = 0.0  # the least one of the first frames, before it has
        self.lost = self.repeated = self.restarts = 0
        self._strays = 0
        self._spread, self._shown = 0.0, 0  # of the delays, intervals; frames that have shown it

    @property
    def _far(self) -> float:
        """Frames by which a counter and the time do not differ by their delays alone."""
        shown = max(_LEAST_FAR, _SPREADS * self._spread) if self._shown >= _SHOWN else _FAR
        return min(_FAR, shown)

    @property
    def strays(self) -> int:
        """Frames whose counter fits neither those before nor those after."""
        return self._strays + (self._doubtful.count if self._doubtful else 0)

    def follow(self, t_ns: IntArray, counter: IntArray) -> tuple[IntArray, BoolArray]:
        """Number of every frame, the first of all being 0, and which are new; times and counters in arrival order."""
        if not len(counter):
            return np.zeros(0, np.int64), np.zeros(0, np.bool_)
        counter = counter % self._modulus
        if self._last is None:
            self._first_ns = int(t_ns[0])
        elif self._doubtful is None and self._follows(t_ns, counter):
            return self._next(t_ns, counter), np.ones(len(counter), np.bool_)
        far = np.flatnonzero(self._far_off(t_ns, counter)) if self._interval_ns is not None else np.empty(0, np.int64)
        if not len(far) and self._doubtful is None:
            return self._number(t_ns, counter)
        numbers, keep = np.zeros(len(counter), np.int64), np.zeros(len(counter), np.bool_)
        begin = 0
        for stop in [*far.tolist(), len(counter)]:
            while begin < stop and self._doubtful is not None:
                self._decide(begin, t_ns, counter, numbers, keep)
                begin += 1
            if begin < stop:
                part = slice(begin, stop)
                numbers[part], keep[part] = self._number(t_ns[part], counter[part])
            if stop < len(counter):
                self._decide(stop, t_ns, counter, numbers, keep)
            begin = stop + 1
        if self._doubtful is not None:
            self._doubtful.rows.clear()
        return numbers, keep

    def _follows(self, t_ns: IntArray, counter: IntArray) -> bool:
        """Whether each frame is the next one, as nearly all are."""
        t_last, c_last, n_last = self._last or (0, 0, -1)
        if self._interval_ns is None or n_last != self._highest:
            return False
        steps = np.diff(counter, prepend=np.int64(c_last))
        is_next = (steps == 1) | (steps == 1 - self._modulus)
        return bool(
            is_next.all() and 2 * np.diff(t_ns, prepend=np.int64(t_last)).max() < self._modulus * self._interval_ns
        )

    def _next(self, t_ns: IntArray, counter: IntArray) -> IntArray:
        numbers = np.arange(self._highest + 1, self._highest + 1 + len(counter))
        self._remember(t_ns, counter, numbers, t_ns - self._first_ns - numbers * (self._interval_ns or 0))
        return numbers

    def _remember(self, t_ns: IntArray, counter: IntArray, numbers: IntArray, delays_ns: IntArray) -> None:
        t_last, _, n_last = self._last or (int(t_ns[0]), 0, 0)
        if len(delays_ns):
            least = float(delays_ns.min())
            if n_last < _FIRST and not self.restarts:
                self._first_delay_ns = min(self._first_delay_ns, least)
            if self._least_delay_ns is not None:
                least = min(least, self._least_delay_ns + _DRIFT * max(0, int(t_ns[-1]) - t_last))
            self._shown += len(delays_ns)
            self._spread = max(self._spread, (float(delays_ns.max()) - least) / (self._interval_ns or 1))
            self._least_delay_ns = least
        self._last = _Frame(int(t_ns[-1]), int(counter[-1]), int(numbers[-1]))
        self._highest = max(self._highest, int(numbers.max()))

    def _number(self, t_ns: IntArray, counter: IntArray) -> tuple[IntArray, BoolArray]:
        """The same for frames that follow those before as their times say, but for lost, repeated and late ones."""
        t_last, c_last, n_last = self._last if self._last is not None else (int(t_ns[0]), int(counter[0]), 0)
        steps = np.diff(counter, prepend=np.int64(c_last)) % self._modulus
        if self._interval_ns is not None:
            elapsed = np.diff(t_ns, prepend=np.int64(t_last)) / self._interval_ns
            steps, is_restart = self._steps(steps, elapsed)
            self.restarts += int(is_restart.sum())
        elif (usual_ns := self._steady_ns(t_ns, steps)) is not None:
            elapsed = np.diff(t_ns, prepend=np.int64(t_last)) / usual_ns
            turns = np.maximum(np.rint((elapsed - steps) / self._modulus), 0).astype(np.int64)
            is_in_step = np.abs(elapsed - steps - turns * self._modulus) <= _OUT_OF_STEP * self._modulus
            steps += np.where(is_in_step, turns * self._modulus, 0)
            is_restart = (steps - elapsed > _FAR) & (counter <= elapsed + _SOON) & ~is_in_step
            steps[is_restart] = np.maximum(1, np.rint(elapsed[is_restart])).astype(np.int64)  # by the time
            self.restarts += int(is_restart.sum())
        if self._last is None:
            steps[0] = 0
        numbers = n_last + np.cumsum(steps)
        before = np.maximum.accumulate(np.concatenate([[self._highest], numbers]))[:-1]
        keep = numbers > before
        self.lost += int((numbers - before - 1)[keep].sum())
        self.repeated += int(len(keep) - keep.sum())
        delays_ns = (t_ns - self._first_ns - numbers * (self._interval_ns or 0))[keep]
        self._remember(t_ns, counter, numbers, delays_ns)
        return numbers, keep

    def _steps(self, steps: IntArray, elapsed: FloatArray) -> tuple[IntArray, BoolArray]:
        """Steps of the counter with the whole turns that the time says, and where it restarted in a long silence."""
        turns = np.rint((elapsed - steps) / self._modulus).astype(np.int64)
        turns[turns < -1] = 0  # no frame comes a turn late: the clock was set back, and the counter goes on
        out_of_step = np.abs(elapsed - steps - turns * self._modulus) > _OUT_OF_STEP * self._modulus
        is_restart = (elapsed > self._modulus) & out_of_step
        return np.where(is_restart, np.rint(elapsed).astype(np.int64), steps + turns * self._modulus), is_restart

    def _far_off(self, t_ns: IntArray, counter: IntArray) -> BoolArray:
        """Frames whose counter stepped far back from what the time says, or far ahead of it."""
        t_last, c_last, _ = self._last if self._last is not None else (int(t_ns[0]), int(counter[0]), 0)
        elapsed = np.diff(t_ns, prepend=np.int64(t_last)) / (self._interval_ns or 1)
        steps, is_restart = self._steps(np.diff(counter, prepend=np.int64(c_last)) % self._modulus, elapsed)
        far = _is_far(steps, elapsed, counter, self._far) & ~is_restart
        if self._last is None:
            far[0] = False
        return np.asarray(far, np.bool_)

    def _step(self, before: _Frame, t_ns: int, counter: int) -> tuple[int, float, bool]:
        """Step from one frame to another, intervals between their times, and whether the step is far off them."""
        elapsed = np.array([t_ns - before.t_ns]) / (self._interval_ns or 1)
        steps, is_restart = self._steps(np.array([(counter - before.counter) % self._modulus]), elapsed)
        is_far = _is_far(steps, elapsed, np.array([counter]), self._far) & ~is_restart
        return int(steps[0]), float(elapsed[0]), bool(is_far[0])

    def _decide(self, row: int, t_ns: IntArray, counter: IntArray, numbers: IntArray, keep: BoolArray) -> None:
        """Take one frame where counter and time disagree: those that follow it show what it was."""
        assert self._last is not None
        here = _Frame(int(t_ns[row]), int(counter[row]), 0)
        step, elapsed, is_far = self._step(self._last, here.t_ns, here.counter)
        doubtful = self._doubtful
        if not is_far:
            self._strays += doubtful.count if doubtful else 0
            self._doubtful = None
            numbers[row : row + 1], keep[row : row + 1] = self._number(t_ns[row : row + 1], counter[row : row + 1])
            return
        if doubtful is not None:
            further, _, is_far = self._step(doubtful.last, here.t_ns, here.counter)
            if not is_far and further > 0:
                doubtful.rows.append(row)
                doubtful.count += 1
                doubtful.last = here._replace(number=doubtful.last.number + further)
                if self._is_certain(doubtful):
                    self._accept(doubtful, t_ns, counter, numbers, keep)
                return
            self._strays += doubtful.count
        is_soon = here.counter <= elapsed + _SOON
        self._doubtful = _Doubtful(here, here, step, is_soon, step > elapsed, [row])

    def _is_certain(self, doubtful: _Doubtful) -> bool:
        if doubtful.is_ahead or (doubtful.is_soon and doubtful.step <= 0):
            return True
        return doubtful.count >= _LEAST_PACED and (doubtful.step > 0 or self._is_paced(doubtful))

    def _is_paced(self, doubtful: _Doubtful) -> bool:
        """Whether the frames came as they were sent; late ones come in a burst."""
        paced_ns = doubtful.last.t_ns - doubtful.first.t_ns
        return 2 * paced_ns >= doubtful.last.number * (self._interval_ns or 1)

    def _accept(
        self, doubtful: _Doubtful, t_ns: IntArray, counter: IntArray, numbers: IntArray, keep: BoolArray
    ) -> None:
        """Go on with a counter that began again, or that has left out frames."""
        assert self._last is not None
        assert self._interval_ns is not None
        passed_ns, interval_ns = doubtful.first.t_ns - self._first_ns, self._interval_ns
        latest = (passed_ns - (self._least_delay_ns or 0.0)) / interval_ns  # no frame is sampled after it came
        number = self._last.number + doubtful.step
        goes_on = (
            number - latest <= self._far if doubtful.is_ahead else doubtful.step > 0 and not self._is_paced(doubtful)
        )
        if not goes_on:
            number = max(self._highest + 1, round((passed_ns - self._first_delay_ns) / interval_ns))
            self._least_delay_ns = None
            self.restarts += 1
        before = self._highest
        for row in doubtful.rows:
            along, _, _ = self._step(doubtful.first, int(t_ns[row]), int(counter[row]))
            numbers[row] = number + along
            keep[row] = numbers[row] > self._highest
            self._highest = max(self._highest, int(numbers[row]))
        kept = int(keep[doubtful.rows].sum())
        self.lost += self._highest - before - kept
        self._last = doubtful.last._replace(number=number + doubtful.last.number)
        self._doubtful = None

    def _steady_ns(self, t_ns: IntArray, steps: IntArray) -> float | None:
        """The interval of frames that follow each other, if it hardly varies."""
        if self._usual_ns is None:
            intervals = np.diff(t_ns)[steps[1:] == 1]
            if len(intervals) < _LEAST_INTERVALS:
                return None
            low, middle, high = np.quantile(intervals, (0.1, 0.5, 0.9)).tolist()
            self._usual_ns = middle if middle > 0 and high - low <= _STEADY * middle else 0.0
        return self._usual_ns or None
