"""Sampling of a signal: its nominal interval, and whether every interval lies on the grid."""

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ingest.tables.checks import GoodRows, Owner
from stream.batch import IntArray
from stream.bounds import MAX_INTERVAL_NS
from stream.defects.rate_changes import RateChange, RateChanges
from stream.defects.rounded_times import (
    LEAST_ROUNDED,
    MOST_ROUNDING,
    about_a_line,
    coarsely_rounded,
    evenly_lost,
    longest_stretch,
    median_ns,
)

MEDIAN_INTERVALS = 10_000
_GRID_TOLERANCE = 0.1
_MULTIPLE = 0.01  # of an interval: within it, a grid of rounded times is that of the samples
_GEOMETRIC = 5.0  # standard deviations that the shortest intervals may be away from their number by chance
_MOSTLY = 0.9  # of the intervals, of times on a grid
_GAP_OF_JITTERED = 2.2  # of an interval: longer than two times moved apart by half of one
_LONE_SAMPLE_DT_NS = 10**9
_GAP = 1.5
# After a gap longer than this many intervals the source may have restarted with another grid.
_RESTART = 10.5


@dataclass(frozen=True)
class Sampling:
    """Times of one signal in short.

    `dt_ns`: nominal interval, nanoseconds: the mean of the first 10,000 intervals, a gap divided by the intervals it
    lasts. (The median is wrong by up to a rounding step if times are rounded: 102.4 Hz in whole milliseconds has a
    median of 10 ms.) Where times are rounded to more than a quarter of the interval, as those in 32-bit floats after a
    day, or are about an even grid without being on it, it is that of a line through the longest stretch without losses.
    `even_dt_ns`: that of even samples without a loss whose times, rounded to `dt_ns`, would be the same, as those of 98
    Hz in hundredths of a second; else 0. The times do not show which of the two is true.
    `off_grid`: intervals further than a tenth of the nominal one (or than the step to which the times are rounded, up
    to a quarter) from every multiple of it. Gaps of more than ten intervals are excepted: after such a gap the source
    may have restarted with another grid.
    """

    samples: int
    t_first_ns: int
    t_last_ns: int
    dt_ns: int
    off_grid: int
    worst_ns: int  # largest distance of such an interval from a multiple of the nominal one, nanoseconds
    gaps: int  # intervals longer than 1.5 nominal ones
    even_dt_ns: int = 0
    step_ns: int = 0  # to which the times of even samples are rounded, if it is over a quarter of the interval; else 0
    rate_changes: tuple[RateChange, ...] = ()

    @property
    def missing_share(self) -> float:
        """Share of the samples of an even record of this length that are not there."""
        expected = 1 + (self.t_last_ns - self.t_first_ns) / self.dt_ns if self.dt_ns else 1.0
        return max(0.0, 1.0 - self.samples / expected)

    @property
    def irregular(self) -> bool:
        """Whether an interval is off the grid."""
        return self.off_grid > 0


class SamplingGrid:
    """Finds the sampling of one signal from its times, in pieces of any size.

    `nominal` makes the nominal interval of the first intervals and the measured one, all nanoseconds.

    >>> grid = SamplingGrid()
    >>> grid.add(np.array([0, 10, 20, 50, 61]))
    >>> found = grid.finish()
    >>> found.dt_ns, found.worst_ns, found.gaps
    (10, 1, 1)
    """

    def __init__(self, nominal: Callable[[IntArray, int], int] | None = None) -> None:
        self._from_measured = nominal
        self._early: list[IntArray] = []
        self._samples = self._first_ns = self._last_ns = 0
        self._dt_ns: int | None = None
        self._off_grid = self._worst_ns = self._gaps = self._step_ns = self._even_dt_ns = 0
        self._rates = RateChanges()

    def add(self, times_ns: IntArray) -> None:
        """Add the times that follow, strictly increasing, nanoseconds."""
        if not len(times_ns):
            return
        if not self._samples:
            self._first_ns = int(times_ns[0])
        self._samples += len(times_ns)
        self._rates.follow(times_ns)
        if self._dt_ns is not None:
            self._judge(np.diff(times_ns, prepend=np.int64(self._last_ns)), self._dt_ns)
        else:
            self._early.append(times_ns)
            if self._samples > MEDIAN_INTERVALS:
                self._settle()
        self._last_ns = int(times_ns[-1])

    def finish(self) -> Sampling:
        """The sampling of all times added, at least one."""
        dt_ns = self._settle() if self._dt_ns is None else self._dt_ns
        return Sampling(
            self._samples, self._first_ns, self._last_ns, dt_ns, self._off_grid, self._worst_ns, self._gaps,
            self._even_dt_ns, self._step_ns, tuple(self._rates.found),
        )  # fmt: skip

    def _settle(self) -> int:
        times_ns = np.concatenate(self._early)
        intervals_ns = times_ns[1:] - times_ns[:-1]
        self._early.clear()
        dt_ns = _nominal(intervals_ns[:MEDIAN_INTERVALS]) if len(intervals_ns) else _LONE_SAMPLE_DT_NS
        if (rounded := coarsely_rounded(intervals_ns[:MEDIAN_INTERVALS])) is not None:
            dt_ns, self._step_ns = rounded
        elif (finer := _grid_with_losses(intervals_ns[:MEDIAN_INTERVALS])) is not None:
            dt_ns = finer
        elif (mean_ns := _grid_of_jittered(intervals_ns[:MEDIAN_INTERVALS], dt_ns)) is not None:
            dt_ns = mean_ns
        if self._from_measured is not None:
            dt_ns = self._from_measured(intervals_ns, dt_ns)
        self._dt_ns = dt_ns = min(dt_ns, MAX_INTERVAL_NS)  # two samples decades apart have a gap between them
        self._even_dt_ns = evenly_lost(intervals_ns[:MEDIAN_INTERVALS], dt_ns)
        self._judge(intervals_ns, dt_ns)
        return dt_ns

    def _judge(self, intervals_ns: IntArray, dt_ns: int) -> None:
        others = intervals_ns[intervals_ns != dt_ns]
        if len(others):
            off_grid, worst_ns = off_grid_intervals(others, dt_ns)
            self._off_grid += off_grid
            self._worst_ns = max(self._worst_ns, worst_ns)
            self._gaps += int(np.count_nonzero(is_gap(others, dt_ns)))
            if off_grid and not self._step_ns:  # floats of 32 bits become coarse as the record goes on
                rounded = coarsely_rounded(intervals_ns[-MEDIAN_INTERVALS:])
                self._step_ns = rounded[1] if rounded is not None else 0


def off_grid_intervals(intervals_ns: IntArray, dt_ns: int) -> tuple[int, int]:
    """Intervals off the grid of `dt_ns` (see `Sampling`), and the largest distance from it, nanoseconds."""
    within = intervals_ns[intervals_ns <= _RESTART * dt_ns]
    multiples = np.maximum(np.rint(within / dt_ns).astype(np.int64), 1)
    distances_ns = np.abs(within - multiples * dt_ns)
    tolerance_ns = _GRID_TOLERANCE * dt_ns
    if distances_ns.max(initial=0) > tolerance_ns:
        tolerance_ns = max(tolerance_ns, _rounding_ns(within, dt_ns))
    return int(np.count_nonzero(distances_ns > tolerance_ns)), int(distances_ns.max(initial=0))


def _rounding_ns(intervals_ns: IntArray, dt_ns: int) -> int:
    """What the rounding of times may add to an interval, as of 128 Hz in whole milliseconds; 0 where none is needed.

    >>> _rounding_ns(np.array([8_000_000, 7_000_000]), 7_812_500)
    1000000
    >>> _rounding_ns(np.array([5_000_000, 6_000_000]), 5_000_000)
    0
    """
    step_ns = int(np.gcd.reduce(intervals_ns))
    beside_ns = abs(dt_ns - round(dt_ns / step_ns) * step_ns)
    return step_ns if beside_ns > _MULTIPLE * dt_ns and step_ns <= MOST_ROUNDING * dt_ns else 0


def is_gap(intervals_ns: IntArray, dt_ns: int) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Which intervals, in nanoseconds, are gaps in a signal of nominal interval `dt_ns`."""
    return intervals_ns > _GAP * dt_ns


def _nominal(intervals_ns: IntArray) -> int:
    """Mean of the intervals near a multiple of the median, which is a rough guess where times are rounded."""
    dt_ns = median_ns(intervals_ns)
    for _ in range(2):
        multiples = np.maximum(np.rint(intervals_ns / dt_ns).astype(np.int64), 1)
        near = (np.abs(intervals_ns - multiples * dt_ns) <= 0.25 * dt_ns) & (multiples <= _RESTART)
        if near.any():
            dt_ns = max(1, round(int(intervals_ns[near].sum()) / int(multiples[near].sum())))
    return dt_ns


def _grid_with_losses(intervals_ns: IntArray) -> int | None:
    """Interval of samples of which more than half are lost at random; None where the times show none.

    Their intervals are multiples of it, and the shorter a multiple, the more often it occurs: as the number of trials
    until a success does. The median interval would be several of them, and nothing would seem lost.

    >>> kept = np.flatnonzero(np.random.default_rng(1).random(4000) < 0.3) * 500_000_000
    >>> _grid_with_losses(np.diff(kept)), _grid_with_losses(np.full(100, 10))
    (500000000, None)
    """
    if len(intervals_ns) < LEAST_ROUNDED:
        return None
    shortest_ns = int(intervals_ns.min())
    if 2 * shortest_ns > 1.5 * median_ns(intervals_ns):
        return None
    near = intervals_ns[intervals_ns < (1 + 2 * _GRID_TOLERANCE) * shortest_ns]
    grid_ns = round(float(near.mean()))
    multiples = np.maximum(np.rint(intervals_ns / grid_ns).astype(np.int64), 1)
    off = np.abs(intervals_ns - multiples * grid_ns) > _GRID_TOLERANCE * grid_ns
    counts = np.bincount(np.minimum(multiples, 4), minlength=5)
    is_falling = counts[1] >= counts[2] >= counts[3] > 0
    expected = len(intervals_ns) / float(multiples.mean())  # of the shortest, by the geometric distribution
    is_geometric = abs(counts[1] - expected) < _GEOMETRIC * math.sqrt(expected)
    return grid_ns if not off.any() and is_falling and is_geometric else None


def _grid_of_jittered(intervals_ns: IntArray, dt_ns: int) -> int | None:
    """Interval of samples without losses whose times are about an even grid; None where they are on one, or on none.

    The longest stretch without a gap is looked at. Each of its times has to lie within half an interval of its place on
    the line through all of them; a lost sample moves those after it by a whole one.

    >>> rng = np.random.default_rng(3)
    >>> times = np.arange(5000) * 10**8 + rng.integers(-4 * 10**7, 4 * 10**7, 5000)
    >>> abs(_grid_of_jittered(np.diff(times), 99_800_000) - 10**8) < 2e4
    True
    >>> _grid_of_jittered(np.diff(np.delete(times, 2500)), 99_800_000) is None
    True
    """
    if len(intervals_ns) < LEAST_ROUNDED:
        return None
    multiples = np.maximum(np.rint(intervals_ns / dt_ns), 1)
    on_grid = np.abs(intervals_ns - multiples * dt_ns) <= _GRID_TOLERANCE * dt_ns
    if on_grid.mean() > _MOSTLY:
        return None
    times_ns = np.cumsum(np.append(0, longest_stretch(intervals_ns, intervals_ns > _GAP_OF_JITTERED * dt_ns)))
    if len(times_ns) <= LEAST_ROUNDED:
        return None
    mean_ns, away_ns = about_a_line(times_ns)
    return round(mean_ns) if np.abs(away_ns).max() <= mean_ns / 2 else None


class SignalGrids:
    """Finds the sampling of each signal of each unit and run, from their rows block by block.

    The times of a signal are judged by some thirty operations on arrays. Most signals of a file have a cell in every
    row: they share a grid until the first empty cell.
    """

    def __init__(self) -> None:
        self._grids: dict[tuple[Owner, str], SamplingGrid] = {}
        self._shared: dict[Owner, SamplingGrid] = {}

    def add(self, rows: GoodRows) -> None:
        """Add the times of the next rows of a unit and run."""
        grids, owner = self._grids, rows.owner
        is_first = owner not in self._shared
        shared = self._shared.setdefault(owner, SamplingGrid())
        leaving = [
            name for name, cells in rows.signals.items()
            if cells.valid is not None and grids.get((owner, name)) is shared
        ]  # fmt: skip
        for name in leaving:
            grids[owner, name] = copy.deepcopy(shared)
        followed: set[int] = set()
        for name, cells in rows.signals.items():
            times_ns = rows.times_ns if cells.valid is None else rows.times_ns[cells.valid]
            if not len(times_ns):
                continue
            grid = grids.get((owner, name))
            if grid is None:
                grid = grids[owner, name] = shared if is_first and cells.valid is None else SamplingGrid()
            if id(grid) not in followed:
                followed.add(id(grid))
                grid.add(times_ns)

    def finish(self) -> dict[tuple[Owner, str], Sampling]:
        """The sampling of each signal that has samples, in the order in which they come."""
        return {name: grid.finish() for name, grid in self._grids.items()}
