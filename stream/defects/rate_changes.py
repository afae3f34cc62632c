"""Places where the sample rate of a signal changes: a logger that writes 100 Hz for an hour and 10 Hz from then on.

Where the new interval is a multiple of the old one, every sample is on the grid, and samples only seem to be missing.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np

from stream.batch import IntArray, SampleBatch

_WINDOW = 32  # intervals that a rate lasts at least
_NEAR = 0.25  # of the median interval: rounded times differ from each other by up to this
_MOSTLY = 0.9  # of the intervals of a window are near its median
_CHANGED = 0.1  # of an interval: no clock is as wrong
_LISTED = 1000
_DATED_NS = 10**17  # times below count from the start of a run without a date


@dataclass(frozen=True)
class RateChange:
    """From the sample at `t_ns` on, a signal has another sample rate."""

    t_ns: int
    from_hz: float
    to_hz: float

    @property
    def at(self) -> str:
        """The moment in words: in UTC, or in seconds where the run has no date."""
        if abs(self.t_ns) < _DATED_NS:
            return f"{self.t_ns / 1e9:.9g} s"
        moment = datetime.fromtimestamp(round(self.t_ns / 1e6) / 1e3, UTC)
        return moment.isoformat(timespec="milliseconds").removesuffix("+00:00").removesuffix(".000") + "Z"


class RateChanges:
    """Finds where the sample rate of one signal changes, from its times in pieces of any size.

    A rate is that of a window of 32 intervals of which nine in ten are within a quarter of their median: one that lasts
    63 is always seen. It changes where a later one differs by more than a tenth. Gaps, single losses and times without
    an even interval are none. `found` has the first 1000.

    >>> changes = RateChanges()
    >>> changes.follow(np.concatenate([np.arange(500) * 10**7, 5 * 10**9 + np.arange(70) * 10**8]))
    >>> changes.found, changes.found[0].at
    ([RateChange(t_ns=5000000000, from_hz=100.0, to_hz=10.0)], '5 s')
    """

    def __init__(self) -> None:
        self.found: list[RateChange] = []
        self._level_ns = 0.0  # the interval since the last change; 0 before the first
        self._tail = np.zeros(0, np.int64)  # the last times judged
        self._pending = np.zeros(0, np.int64)  # those not judged yet

    def follow(self, times_ns: IntArray) -> None:
        """Take in the times that follow, strictly increasing, nanoseconds."""
        pending = np.concatenate([self._pending, times_ns])
        whole = len(pending) // _WINDOW * _WINDOW
        if whole:
            times_ns = np.concatenate([self._tail, pending[:whole]])
            self._judge(times_ns, np.diff(times_ns))
            self._tail = times_ns[-_WINDOW - 1 :].copy()
        self._pending = pending[whole:].copy()

    def follow_batch(self, batch: SampleBatch) -> None:
        """Take in the times of a batch that follows; of an even one, only those at its ends are looked at."""
        n, dt_ns = len(batch), batch.dt_ns
        if batch.times_ns is not None or n < 8 * _WINDOW:
            self.follow(batch.time_array)
            return
        first = 4 * _WINDOW
        self.follow(batch.t0_ns + dt_ns * np.arange(first))
        waiting = (len(self._pending) + n - first) % _WINDOW  # the windows are those without the short cut
        last = batch.t0_ns + dt_ns * np.arange(n - _WINDOW - 1 - waiting, n)
        self._tail, self._pending = last[: _WINDOW + 1], last[_WINDOW + 1 :]

    def _judge(self, times_ns: IntArray, intervals_ns: IntArray) -> None:
        level_ns = self._level_ns
        if level_ns and max(intervals_ns.max() - level_ns, level_ns - intervals_ns.min()) <= _CHANGED * level_ns:
            return  # as nearly always
        first = len(self._tail) - 1 if len(self._tail) else len(intervals_ns) % _WINDOW  # where they are new
        windows = intervals_ns[first:].reshape(-1, _WINDOW)
        medians_ns = np.median(windows, axis=1, keepdims=True)
        near = np.abs(windows - medians_ns) <= _NEAR * medians_ns
        steady = np.flatnonzero((near.mean(axis=1) >= _MOSTLY) & (medians_ns[:, 0] > 0))
        levels_ns = (windows * near)[steady].sum(axis=1) / near[steady].sum(axis=1)
        for window, found_ns in zip(steady.tolist(), levels_ns.tolist(), strict=True):
            if not level_ns:
                level_ns = found_ns
            elif abs(found_ns - level_ns) > _CHANGED * min(found_ns, level_ns):
                begin = first + window * _WINDOW
                place = _change_near(begin, intervals_ns, level_ns, found_ns)
                own_ns = intervals_ns[place : begin + _WINDOW]  # without those of the rate before
                found_ns = float(own_ns[np.abs(own_ns - found_ns) <= _NEAR * found_ns].mean())
                self._add(RateChange(int(times_ns[place]), 1e9 / level_ns, 1e9 / found_ns))
                level_ns = found_ns
        self._level_ns = level_ns

    def _add(self, change: RateChange) -> None:
        if self.found and self.found[-1].t_ns == change.t_ns:  # the window before had intervals of both rates
            self.found[-1] = replace(change, from_hz=self.found[-1].from_hz)
        elif len(self.found) < _LISTED:
            self.found.append(change)


def _change_near(place: int, intervals_ns: IntArray, from_ns: float, to_ns: float) -> int:
    """The first interval that is nearer to the new one, about the `place` where a window of such begins."""
    is_new = np.abs(intervals_ns - to_ns) < np.abs(intervals_ns - from_ns)
    while place and is_new[place - 1]:
        place -= 1
    while not is_new[place]:
        place += 1
    return place


def remark_on_rate_changes(found: Sequence[RateChange]) -> tuple[str, str] | None:
    """What a reader must know of changes of the sample rate, in English and Chinese; None if there is none.

    >>> remark_on_rate_changes([]) is None
    True
    >>> remark_on_rate_changes([RateChange(5 * 10**9, 100.0, 10.0)] * 3)[0]
    'the sample rate changes at 5 s from 100 Hz to 10 Hz, and 2 more times'
    """
    if not found:
        return None
    first, more = found[0], len(found) - 1
    times = "" if not more else ", and once more" if more == 1 else f", and {more:,} more times"
    return (
        f"the sample rate changes at {first.at} from {first.from_hz:.4g} Hz to {first.to_hz:.4g} Hz{times}",
        f"采样率于 {first.at} 由 {first.from_hz:.4g} Hz 变为 {first.to_hz:.4g} Hz"
        + (f"，此后又改变 {more:,} 次" if more else ""),
    )
