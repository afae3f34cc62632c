"""Rolling window: any estimator over the last seconds of a signal.

The window consists of panes, an estimator each; the estimator of the window is that of its panes merged. Two stacks
need two merges a step (Tangwongsan, Hirzel, Schneider, Wu, DOI 10.14778/2752939.2752940), and nothing is subtracted:
an outlier has no effect once it has left the window.
"""

import itertools
import math
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from stream.batch import SampleBatch
from stream.clock import MAX_SPAN_NS
from stream.errors import EstimatorError
from stream.estimators.base import NoEstimate, PointEstimator, Points

MOST_PANES = 100_000


class WindowEstimate(NamedTuple):
    """Estimate over one window from `start_ns` up to, not including, `stop_ns`."""

    start_ns: int
    stop_ns: int
    samples: int
    missing: int
    estimate: Points | NoEstimate


class RollingWindow:
    """An estimator over the last `window_s` seconds, once every `step_s`.

    `make` is its factory, as in `default_estimators`. Times are the signal's own since its first sample; the window is
    1 to 100,000 whole steps.

    Notes
    -----
    For the Allan deviation this is the dynamic Allan deviation (Galleani and Tavella, DOI 10.1109/TUFFC.2009.1064).
    Memory: twice the estimator for each step of the window.

    Examples
    --------
    >>> from uuid import UUID
    >>> from stream.estimators.bias_stability import BiasStability
    >>> window = RollingWindow(lambda: BiasStability(1.0), window_s=4.0, step_s=2.0)
    >>> batch = SampleBatch("FOG-1", "rate", "r1", UUID(int=1), 0, 0, 10**9, "deg/h",
    ...                     values=np.array([1.0, 1.0, 3.0, 3.0, 9.0, 9.0, 3.0]))
    >>> [(each.start_ns // 10**9, round(each.estimate[0].value, 3)) for each in window.update(batch)]
    [(0, 1.155), (2, 3.464)]
    """

    def __init__(self, make: Callable[[], PointEstimator], window_s: float, step_s: float) -> None:
        panes = round(window_s / step_s) if step_s > 0 and math.isfinite(window_s / step_s) else 0
        if not 1 <= panes <= MOST_PANES or not math.isclose(panes * step_s, window_s, rel_tol=1e-9):
            raise EstimatorError(
                f"a window of {window_s:g} s in steps of {step_s:g} s: it takes a whole number of steps, "
                f"1 to {MOST_PANES:,}"
            )
        if not 1 <= round(step_s * 1e9) <= window_s * 1e9 <= MAX_SPAN_NS:
            raise EstimatorError(f"a window of {window_s:g} s in steps of {step_s:g} s: steps take 1 ns to 146 years")
        self._panes = panes
        self._step_ns = round(step_s * 1e9)
        self._first_ns: int | None = None
        self._pane = 0
        self._now = make()
        # merged from each pane to the last of those in front; the one of most panes is last
        self._front: list[PointEstimator] = []
        self._back: deque[PointEstimator] = deque()
        self._back_merged: PointEstimator | None = None

    @property
    def unit_of_measure(self) -> str:
        """Unit of the estimates; empty before the first batch."""
        return self._now.unit_of_measure

    def update(self, batch: SampleBatch) -> list[WindowEstimate]:
        """Take in the next batch of the signal; returns the windows that it completes.

        A window is complete once a later sample has come. The first one ends `window_s` after the first sample.
        Windows within a gap are left out. Raises what the estimator raises.
        """
        times_ns = np.maximum.accumulate(batch.time_array)
        if self._first_ns is None:
            if self._step_ns < batch.dt_ns:
                raise EstimatorError(
                    f"{batch.label}: steps of {self._step_ns / 1e9:g} s "
                    f"are shorter than the sample interval of {batch.dt_ns / 1e9:g} s; take longer ones"
                )
            self._first_ns = int(times_ns[0])
        panes = np.maximum((times_ns - self._first_ns) // self._step_ns, self._pane)
        edges = [0, *(np.flatnonzero(np.diff(panes)) + 1).tolist(), len(batch)]
        done = []
        for start, stop in itertools.pairwise(edges):
            pane = int(panes[start])
            done += [self._close_pane() for _ in range(min(pane - self._pane, self._panes))]
            if pane > self._pane:
                self._close_pane()
                self._pane = pane
            self._now.update(batch if stop - start == len(batch) else batch.part(start, stop))
        return [each for each in done if each is not None]

    def finish(self) -> list[WindowEstimate]:
        """The window that ends with the last sample's interval, where one does; nothing may follow."""
        if self._first_ns is None:
            return []
        tracker = self._now.tracker
        end_ns = self._first_ns + (self._pane + 1) * self._step_ns
        if tracker.last_ns + tracker.dt_ns < end_ns:
            return []
        last = self._close_pane()
        return [] if last is None else [last]

    def _close_pane(self) -> WindowEstimate | None:
        done = self._now
        self._now = done.continuation()
        self._pane += 1
        if len(self._front) + len(self._back) == self._panes:
            self._drop_oldest()
        self._back.append(done)
        if self._back_merged is None:
            self._back_merged = done.copy()
        else:
            self._back_merged.merge(done)
        if self._pane < self._panes:
            return None
        assert self._first_ns is not None
        whole = self._back_merged
        if self._front:
            whole = self._front[-1].copy()
            whole.merge(self._back_merged)
        stop_ns = self._first_ns + self._pane * self._step_ns
        start_ns = stop_ns - self._panes * self._step_ns
        return WindowEstimate(start_ns, stop_ns, whole.samples, whole.missing, whole.estimate())

    def _drop_oldest(self) -> None:
        if not self._front:
            merged: PointEstimator | None = None
            while self._back:
                pane = self._back.pop()
                if merged is not None:
                    pane = pane.copy()
                    pane.merge(merged)
                merged = pane
                self._front.append(merged)
            self._back_merged = None
        self._front.pop()
