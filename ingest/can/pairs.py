"""Frames that come in pairs of the same data, as in a log that has every frame twice."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ingest.can.decode import FrameBytes
from stream.batch import BoolArray, IntArray

_LEAST_PAIRS = 20
_LEAST_SHARE = 0.45  # of the frames that repeat the one before: of pairs throughout it is a half
_MOST_UNLIKE = 0.05  # of those that come as soon, and have other data


class Pairs(NamedTuple):
    """How many frames repeat the one before, and the mean intervals within and between the pairs, seconds."""

    number: int
    within_s: float
    between_s: float


@dataclass
class PairFinder:
    """Counts frames with the data of the one before that follow it in less than half of the interval before.

    >>> finder = PairFinder()
    >>> t_ns = np.arange(30).repeat(2) * 10_000_000 + np.tile([0, 100_000], 30)
    >>> data = np.arange(30, dtype=np.uint8).repeat(2)[:, None]
    >>> finder.follow(t_ns, FrameBytes(data, np.full(60, 1, np.uint8)), np.ones(60, np.bool_))
    >>> finder.found()
    Pairs(number=29, within_s=0.0001, between_s=0.0099)
    """

    _frames: int = 0
    _same: int = 0
    _unlike: int = 0
    _within_ns: int = 0
    _between_ns: int = 0
    _last: tuple[int, bytes] | None = None
    _interval_ns: int = 0  # before the last frame

    def follow(self, t_ns: IntArray, octets: FrameBytes, keep: BoolArray) -> None:
        """Take the next frames that are kept, in the order of the log."""
        rows = np.flatnonzero(keep)
        if not len(rows):
            return
        times_ns, data = t_ns[rows], octets.data[rows]
        is_same = np.zeros(len(rows), np.bool_)
        is_same[1:] = (data[1:] == data[:-1]).all(axis=1) & (octets.length[rows[1:]] == octets.length[rows[:-1]])
        last_ns, last_data = self._last or (int(times_ns[0]), b"")
        is_same[0] = data[0].tobytes() == last_data
        intervals_ns = np.diff(times_ns, prepend=np.int64(last_ns))
        before_ns = np.concatenate([[self._interval_ns], intervals_ns[:-1]])
        is_soon = 2 * np.abs(intervals_ns) < before_ns
        is_second = is_soon & is_same
        self._frames += len(rows)
        self._same += int(np.count_nonzero(is_second))
        self._unlike += int(np.count_nonzero(is_soon & ~is_same))
        self._within_ns += int(intervals_ns[is_second].sum())
        self._between_ns += int(before_ns[is_second].sum())
        self._last, self._interval_ns = (int(times_ns[-1]), data[-1].tobytes()), int(intervals_ns[-1])

    def found(self) -> Pairs | None:
        """The pairs, if nearly all frames come in such."""
        soon = self._same + self._unlike
        if self._same < max(_LEAST_PAIRS, _LEAST_SHARE * self._frames) or self._unlike > _MOST_UNLIKE * soon:
            return None
        number = self._same
        return Pairs(number, self._within_ns / number / 1e9, self._between_ns / number / 1e9)
