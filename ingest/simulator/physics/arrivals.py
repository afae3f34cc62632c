"""Events at random times: jumps of the bias, and stretches of samples in which something is wrong."""

import heapq
import math
from collections.abc import Iterator, Sequence
from itertools import takewhile
from typing import NamedTuple

import numpy as np

from stream.batch import BoolArray, FloatArray

_NEVER = 2**62
SECONDS_PER_HOUR = 3600.0


class Jump(NamedTuple):
    """A bias that changes for good: when, in seconds from power-on, and by how much."""

    at_s: float
    size_deg_per_h: float


class Stretch(NamedTuple):
    """Samples from `first` on, up to but not including `stop`; the first after power-on is number 0."""

    first: int
    stop: int


def random_jumps(rate_per_h: float, sd_deg_per_h: float, generator: np.random.Generator) -> Iterator[Jump]:
    """Jumps of a Poisson process, sizes normal about 0, for as long as they are asked for.

    Examples
    --------
    >>> jumps = random_jumps(60.0, 1.0, np.random.default_rng(1))
    >>> next(jumps).at_s < next(jumps).at_s
    True
    """
    at_s = 0.0
    while rate_per_h > 0.0:
        at_s += generator.exponential(SECONDS_PER_HOUR / rate_per_h)
        yield Jump(at_s, sd_deg_per_h * generator.standard_normal())


def merged_jumps(planned: Sequence[Jump], drawn: Iterator[Jump], until_s: float = math.inf) -> Iterator[Jump]:
    """All jumps in the order of time, up to but not including `until_s`."""
    return takewhile(lambda jump: jump.at_s < until_s, heapq.merge(sorted(planned), drawn))


class Staircase:
    """The sum of all jumps so far, block by block.

    Parameters
    ----------
    jumps: In the order of time.
    interval_s: Sample interval; a jump acts from the first sample at or after it.
    """

    def __init__(self, jumps: Iterator[Jump], interval_s: float) -> None:
        self._jumps = jumps
        self._interval_s = interval_s
        self._level = 0.0
        self._take()

    def _take(self) -> None:
        at_s, self._size = next(self._jumps, (math.inf, 0.0))
        self._next = _NEVER if math.isinf(at_s) else math.ceil(at_s / self._interval_s)

    def add(self, first: int, out: FloatArray) -> None:
        """Add the level, deg/h, to samples `first`, `first` + 1, ..."""
        done = 0
        while done < len(out):
            while self._next <= first + done:
                self._level += self._size
                self._take()
            stop = min(len(out), self._next - first)
            out[done:stop] += self._level
            done = stop


def random_stretches(probability: float, mean_samples: float, generator: np.random.Generator) -> Iterator[Stretch]:
    """Stretches that begin with a probability at every good sample, of geometrically distributed lengths.

    Examples
    --------
    >>> next(random_stretches(0.5, 1.0, np.random.default_rng(2)))
    Stretch(first=0, stop=1)
    """
    stop = 0
    while probability > 0.0:
        first = stop + int(generator.geometric(probability)) - 1
        if first >= _NEVER:
            return
        stop = first + int(generator.geometric(1.0 / mean_samples))
        yield Stretch(first, stop)


class StretchMask:
    """Which samples lie in a stretch, block by block.

    Parameters
    ----------
    stretches: In the order of time, without overlap.
    """

    def __init__(self, stretches: Iterator[Stretch]) -> None:
        self._stretches = stretches
        self._next = next(stretches, Stretch(_NEVER, _NEVER))

    def take(self, first: int, n: int) -> BoolArray:
        """Whether samples `first` to `first + n - 1` lie in a stretch, shape (n,)."""
        mask = np.zeros(n, np.bool_)
        while self._next.first < first + n:
            mask[max(self._next.first - first, 0) : min(self._next.stop - first, n)] = True
            if self._next.stop > first + n:
                break
            self._next = next(self._stretches, Stretch(_NEVER, _NEVER))
        return mask
