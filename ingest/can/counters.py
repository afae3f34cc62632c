"""Frame counters, which tell lost and repeated frames, and times that increase strictly."""

from dataclasses import dataclass

import numpy as np

from stream.batch import BoolArray, IntArray

# Frames with equal or slightly decreasing time stamps follow each other; a larger step back is a clock set back.
_JITTER_NS = 1_000_000
# A counter off by more than this share of its modulus after a long silence has restarted.
_OUT_OF_STEP = 0.25
# how many intervals show the usual one, and how far they may spread of it (10 to 90 %)
_LEAST_INTERVALS, _STEADY = 20, 0.2


class FrameCounter:
    """Numbers frames by a counter that runs from 0 to `modulus` - 1 and around.

    If the interval of the frames is known, whole turns of the counter come from the times; where it is not, from a
    steady one that the first frames show. `lost` frames are missing, `repeated` ones came again or too late; `restarts`
    are silences after which the counter had restarted.

    >>> counter = FrameCounter(16, interval_ns=10)
    >>> numbers, keep = counter.follow(np.array([0, 10, 12, 40]), np.array([14, 15, 15, 2]))
    >>> numbers[keep].tolist(), counter.lost, counter.repeated
    ([0, 1, 4], 2, 1)
    """

    def __init__(self, modulus: int, interval_ns: int | None = None) -> None:
        self._modulus, self._interval_ns = modulus, interval_ns
        self._last: tuple[int, int, int] | None = None  # time, counter, number of the last frame
        self._highest = -1
        self._usual_ns: float | None = None
        self.lost = self.repeated = self.restarts = 0

    def follow(self, t_ns: IntArray, counter: IntArray) -> tuple[IntArray, BoolArray]:
        """Number of every frame, the first of all being 0, and which are new; times and counters in arrival order."""
        if not len(counter):
            return np.zeros(0, np.int64), np.zeros(0, np.bool_)
        counter = counter % self._modulus
        t_last, c_last, n_last = self._last if self._last is not None else (int(t_ns[0]), int(counter[0]), 0)
        steps = np.diff(counter, prepend=np.int64(c_last)) % self._modulus
        if self._interval_ns is not None:
            elapsed = np.diff(t_ns, prepend=np.int64(t_last)) / self._interval_ns
            turns = np.rint((elapsed - steps) / self._modulus).astype(np.int64)
            turns[turns < -1] = 0  # no frame comes a turn late: the clock was set back, and the counter goes on
            out_of_step = np.abs(elapsed - steps - turns * self._modulus) > _OUT_OF_STEP * self._modulus
            is_restart = (elapsed > self._modulus) & out_of_step
            steps = np.where(is_restart, np.rint(elapsed).astype(np.int64), steps + turns * self._modulus)
            self.restarts += int(is_restart.sum())
        elif (usual_ns := self._steady_ns(t_ns, steps)) is not None:
            elapsed = np.diff(t_ns, prepend=np.int64(t_last)) / usual_ns
            turns = np.maximum(np.rint((elapsed - steps) / self._modulus), 0).astype(np.int64)
            is_in_step = np.abs(elapsed - steps - turns * self._modulus) <= _OUT_OF_STEP * self._modulus
            steps += np.where(is_in_step, turns * self._modulus, 0)
        if self._last is None:
            steps[0] = 0
        numbers = n_last + np.cumsum(steps)
        before = np.maximum.accumulate(np.concatenate([[self._highest], numbers]))[:-1]
        keep = numbers > before
        self.lost += int((numbers - before - 1)[keep].sum())
        self.repeated += int(len(keep) - keep.sum())
        self._last = int(t_ns[-1]), int(counter[-1]), int(numbers[-1])
        self._highest = max(self._highest, int(numbers.max()))
        return numbers, keep

    def _steady_ns(self, t_ns: IntArray, steps: IntArray) -> float | None:
        """The interval of frames that follow each other, if it hardly varies."""
        if self._usual_ns is None:
            intervals = np.diff(t_ns)[steps[1:] == 1]
            if len(intervals) < _LEAST_INTERVALS:
                return None
            low, middle, high = np.quantile(intervals, (0.1, 0.5, 0.9)).tolist()
            self._usual_ns = middle if middle > 0 and high - low <= _STEADY * middle else 0.0
        return self._usual_ns or None


@dataclass
class ForwardTimes:
    """Makes times increase strictly.

    Frames with the time of the one before, or less by up to a millisecond, are put a nanosecond after it (`retimed`);
    those further back are left out (`late`).

    >>> forward = ForwardTimes()
    >>> times_ns, keep = forward.follow(np.array([5_000_000, 5_000_000, 1, 6_000_000]))
    >>> times_ns.tolist(), keep.tolist(), forward.retimed, forward.late
    ([5000000, 5000001, 6000000], [True, True, False, True], 1, 1)
    """

    last_ns: int | None = None
    retimed: int = 0
    late: int = 0

    def follow(self, t_ns: IntArray) -> tuple[IntArray, BoolArray]:
        """Times of the frames that are kept, and which those are."""
        if not len(t_ns):
            return t_ns, np.zeros(0, np.bool_)
        last_ns = int(t_ns[0]) - 1 if self.last_ns is None else self.last_ns
        before = np.maximum.accumulate(np.concatenate([[last_ns], t_ns]))[:-1]
        keep = t_ns >= before - _JITTER_NS
        kept = t_ns[keep]
        index = np.arange(len(kept))
        times_ns = np.maximum(np.maximum.accumulate(kept - index), last_ns + 1) + index
        self.retimed += int((times_ns != kept).sum())
        self.late += int(len(keep) - len(kept))
        if len(kept):
            self.last_ns = int(times_ns[-1])
        return times_ns, keep
