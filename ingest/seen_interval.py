"""The interval at which a unit really samples, from its counter and the arrivals of its frames."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from stream.batch import IntArray

APART_NS = 200_000_000
_FEWEST, _MOST = 8, 512  # points of arrival; looked at when there are 8, 16, 32 and so on
_LINE = 8.0  # a slope is certain if it moves the arrivals by so many times their distance from a line
_SILENT_NS, _SILENT = 1_000_000_000, 4.0  # longer, and so many times longer than the pause before: whole turns may lack
_RECENT = 64  # points that are looked at by themselves, for a unit that changes its rate
_LEAST_STEP = 0.1  # of an interval: more than times on a grid may be off by where they are stored as even
FOLLOWED = 1e-3  # relative difference beyond which a grid of the stated interval cannot follow
WRONG = 5e-3  # and beyond which the stated interval is wrong


def after(times_ns: IntArray, steps: IntArray, last_ns: int, interval_ns: float) -> IntArray:
    """Times of samples on a grid that was moved earlier: those that lie before the last one placed are put behind it.

    `steps` are their intervals from that one.

    >>> after(np.array([95_000_000, 105_000_000]), np.array([1, 2]), 100_000_000, 1e7).tolist()
    [101000000, 105000000]
    """
    least_ns = last_ns + np.ceil(steps * (_LEAST_STEP * interval_ns)).astype(np.int64)
    return np.asarray(np.maximum(times_ns, least_ns))


class SeenInterval(NamedTuple):
    """An interval that is certainly not the stated one, nanoseconds, and its uncertainty."""

    stated_ns: float
    interval_ns: float
    uncertainty_ns: float

    @property
    def is_wrong(self) -> bool:
        """Whether the two certainly differ by more than half a per cent, as no clock of a unit does."""
        return abs(self.interval_ns - self.stated_ns) - self.uncertainty_ns > WRONG * self.stated_ns

    @property
    def to_write_s(self) -> float:
        """The shortest number within the uncertainty, or 2e-4, of what is seen.

        >>> SeenInterval(2e7, 10_003_100.0, 5000.0).to_write_s
        0.01
        """
        within_ns = max(self.uncertainty_ns, 2e-4 * self.interval_ns)
        candidates = (float(f"{self.interval_ns / 1e9:.{digits}g}") for digits in range(1, 7))
        return next((s for s in candidates if abs(s * 1e9 - self.interval_ns) <= within_ns), self.interval_ns / 1e9)

    def warning(self, what: str, where: str) -> str:
        """The sentence, and what becomes of the samples that come meanwhile."""
        return (
            f"{self.sentence(what, where)} and measure again; from now on its samples have the times of their arrival, "
            "and are marked as irregular: no metric that needs a grid is given of them"
        )

    def sentence(self, what: str, where: str) -> str:
        """Both intervals, and what to write; `where` states the wrong one.

        >>> SeenInterval(2e7, 10_003_100.0, 5000.0).sentence("G1", "i2.toml").split(", and ")[1]
        'interval_s in i2.toml is 0.02 s: write interval_s = 0.01 there'
        """
        seen = f"{self.interval_ns / 1e9:.5g} s +- {self.uncertainty_ns / 1e9:.1g} s"
        write = f"{self.to_write_s:.6g}"
        return (
            f"{what}: its samples come every {write} s ({seen}), and interval_s in {where} is "
            f"{self.stated_ns / 1e9:.6g} s: write interval_s = {write} there"
        )


class IntervalWatch:
    """Sees whether the frames of a unit come at another interval than the stated one.

    Frames arrive late by any delay, so that one pause shows nothing, nor do frames that are lost at once. It is certain
    where the distances of the arrivals from the stated grid lie on a line over time that rises or falls by eight times
    their distance from it: of all arrivals, or of the last 13 s.

    >>> watch = IntervalWatch(0.02e9)
    >>> [watch.see(25 * k, 250_000_000 * k) for k in range(8)][-1]
    SeenInterval(stated_ns=20000000.0, interval_ns=10000000.0, uncertainty_ns=0.0)
    """

    def __init__(self, stated_ns: float) -> None:
        self._stated_ns = stated_ns
        self.restart()

    def restart(self) -> None:
        """Forget the arrivals so far, as where the counter begins again."""
        self.points: list[tuple[int, int]] = []
        self._arrived_ns: int | None = None
        self._paused_ns = 0

    @property
    def is_settled(self) -> bool:
        """Whether enough has come to see a gross difference."""
        return len(self.points) >= _FEWEST

    def see(self, number: int, t_ns: int) -> SeenInterval | None:
        """What is certain with the arrival of a frame: an interval off by more than a tenth of a per cent."""
        paused_ns = 0 if self._arrived_ns is None else t_ns - self._arrived_ns
        if (self._paused_ns and paused_ns > max(_SILENT_NS, _SILENT * self._paused_ns)) or len(self.points) == _MOST:
            self.restart()
            paused_ns = 0
        self._arrived_ns, self._paused_ns = t_ns, paused_ns
        if self.points and (t_ns - self.points[-1][1] < APART_NS or number <= self.points[-1][0]):
            return None
        self.points.append((number, t_ns))
        n = len(self.points)
        found = self._certain(self.points) if n >= _FEWEST and n & (n - 1) == 0 else None
        if found is None and n > _RECENT and n % (_RECENT // 2) == 0:
            found = self._certain(self.points[-_RECENT:])
        return found

    def _certain(self, points: Sequence[tuple[int, int]]) -> SeenInterval | None:
        numbers, t_ns = (np.array(each, np.float64) - each[0] for each in zip(*points, strict=True))
        x, y = t_ns - t_ns.mean(), t_ns - self._stated_ns * numbers
        y -= y.mean()
        slope = float((x * y).sum() / (x * x).sum())
        distance = float(np.quantile(np.abs(y - slope * x), 0.9)) / float(t_ns[-1])
        if slope >= 1.0 or abs(slope) <= _LINE * distance:
            return None
        interval_ns = self._stated_ns / (1.0 - slope)
        if abs(interval_ns - self._stated_ns) <= FOLLOWED * self._stated_ns:
            return None
        return SeenInterval(self._stated_ns, interval_ns, 2.0 * distance * interval_ns**2 / self._stated_ns)
