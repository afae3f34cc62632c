"""Times of frames that increase strictly."""

from dataclasses import dataclass

import numpy as np

from stream.batch import BoolArray, IntArray

# Frames with equal or slightly decreasing time stamps follow each other; a larger step back is a clock set back.
JITTER_NS = 1_000_000


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
        keep = t_ns >= before - JITTER_NS
        kept = t_ns[keep]
        index = np.arange(len(kept))
        times_ns = np.maximum(np.maximum.accumulate(kept - index), last_ns + 1) + index
        self.retimed += int((times_ns != kept).sum())
        self.late += int(len(keep) - len(kept))
        if len(kept):
            self.last_ns = int(times_ns[-1])
        return times_ns, keep
