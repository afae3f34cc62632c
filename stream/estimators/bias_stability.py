"""Bias stability, not instability: the deviation of averaged output (GJB 2426A-2004 5.12.2, JJF 2014-2022 7.2.14)."""

import math
from typing import Self

import numpy as np

from stream.batch import FloatArray, SampleBatch, first_finite, writable
from stream.clock import Piece
from stream.errors import EstimatorError
from stream.estimators.base import LEAST_SHARE, NoEstimate, PointEstimator, Points
from stream.estimators.confidence import deviation_bounds
from stream.estimators.kernels import averages_kernel as kernel
from stream.events import EstimatePoint

_MOST_SECONDS = 1e9
_MOST_AVERAGES = 1_000_000


class BiasStability(PointEstimator):
    """Standard deviation of consecutive means of `average_s` seconds, of the whole record or a rolling window.

    The averaging time P is `average_s`, 1e-9 to 1e9 s and at least one sample interval; 0 for the raw samples. A
    rolling window of `window_s` has 2 to 1,000,000 averages; 0 is the whole record.

    Notes
    -----
    B_s = sqrt(sum (F_i - mean(F))**2 / (n - 1)), JJF 2014-2022 equation (29), of the means F_i that hold at
    least 90 % of their samples; GJB 2426A-2004 equation (20) is the same of the raw samples. Average i holds the
    samples whose time since the first, slot times nominal interval, lies in [i P, (i + 1) P): P need not be a whole
    number of intervals. Samples on no grid are averaged by their true times. The average that is still being filled
    is not used.

    A window is computed from its averages: nothing is subtracted from a sum, so that an outlier has no effect once it
    has left the window.

    The bounds are by chi-square with (n - 1)(1 - r**2)/(1 + r**2) degrees of freedom, r the correlation of neighbouring
    averages (Bartlett 1946, for a first-order process): those of a gyro are not white. Where the averages wander
    over the whole record, the bounds are for this record; a longer one will have a larger deviation.
    Memory: 19 numbers, and 2 for each average in the window.

    Examples
    --------
    >>> from uuid import UUID
    >>> estimator = BiasStability(average_s=2.0)
    >>> estimator.estimate()
    NoEstimate(reason='2 averages of 2 s needed, 0 seen')
    >>> batch = SampleBatch("FOG-1", "rate", "r1", UUID(int=1), 0, 0, 10**9, "deg/h",
    ...                     values=np.array([1.0, 3.0, 2.0, 6.0, 4.0]))
    >>> estimator.update(batch)
    >>> point = estimator.estimate()[0]
    >>> point.tau_s, round(point.value, 6), point.n
    (2.0, 1.414214, 2)
    """

    variants = (
        {"average_s": 0.0},
        {"average_s": 1.0},
        {"average_s": 10.0},
        {"average_s": 100.0},
        {"average_s": 10.0, "window_s": 3600.0},
    )

    def __init__(self, average_s: float, window_s: float = 0.0) -> None:
        super().__init__()
        if average_s != 0.0 and not 1e-9 <= average_s <= _MOST_SECONDS:
            raise EstimatorError(f"averages of {average_s} s: bias stability takes 1e-9 to 1e9 s, or 0 for raw samples")
        averages = _averages_in(window_s, average_s)
        self.average_s, self.window_s = average_s, window_s
        of = f"{average_s:g}s" if average_s else "raw"
        over = f"_over_{window_s:g}s" if window_s else ""
        self.key = f"bias_stability_{of}{over}"
        english = f"{average_s:g} s averages" if average_s else "raw samples"
        chinese = f"{average_s:g} s 平均" if average_s else "原始采样"
        if window_s:
            english, chinese = f"{english}, last {window_s:g} s", f"{chinese},最近 {window_s:g} s"
        self.names = {"en": f"Bias stability ({english})", "zh": f"零偏稳定性({chinese})"}
        self._average_ns = round(average_s * 1e9)
        self._state: kernel.AveragesState = kernel.empty_averages(averages)

    @property
    def arguments(self) -> dict[str, int | float]:
        """Averaging time and window in seconds."""
        return {"average_s": self.average_s, "window_s": self.window_s}

    def _take(self, batch: SampleBatch, pieces: list[Piece]) -> None:
        if self.tracker.irregular and self.tracker.dt_ns <= self._average_ns:
            self._take_timed(batch, pieces)
        else:
            super()._take(batch, pieces)

    def _take_run(self, first_slot: int, values: FloatArray) -> None:
        self._set_reference(values)
        if self._average_ns == 0:
            kernel.take_samples(*self._state, self._reference, first_slot, values)
        elif self._average_ns >= self.tracker.dt_ns:
            dt_ns = self.tracker.dt_ns
            kernel.average_grid(*self._state, self._reference, self._average_ns, LEAST_SHARE, dt_ns, first_slot, values)

    def _take_timed(self, batch: SampleBatch, pieces: list[Piece]) -> None:
        tracker = self.tracker
        times_ns, values = writable(batch.time_array), batch.own_values
        for _, start, stop in pieces:
            self._set_reference(values[start:stop])
            kernel.average_times(
                *self._state, self._reference, self._average_ns, LEAST_SHARE, tracker.dt_ns, tracker.first_ns,
                times_ns[start:stop], values[start:stop],
            )  # fmt: skip

    def _set_reference(self, values: FloatArray) -> None:
        if math.isnan(self._reference):
            self._reference = first_finite(values)

    def _continue_from(self, earlier: Self) -> None:
        tracker, block = self.tracker, int(earlier._state.places[kernel.BLOCK])
        if self._average_ns == 0:
            is_within = False
        elif tracker.irregular or tracker.dt_ns == 0:
            is_within = True
        else:
            is_within = tracker.next_slot != kernel.first_slot_of(block, self._average_ns, tracker.dt_ns)
        kernel.begin_at(self._state.places, block, is_within=is_within)

    def _append(self, later: Self) -> None:
        block, dt_ns = int(self._state.places[kernel.BLOCK]), later.tracker.dt_ns
        if self._average_ns == 0:
            expected = 1.0
        elif later.tracker.irregular or dt_ns == 0:
            expected = self._average_ns / max(dt_ns, 1)
        else:
            first, end = (kernel.first_slot_of(each, self._average_ns, dt_ns) for each in (block, block + 1))
            expected = float(end - first)
        kernel.merge_averages(*self._state, *later._state, expected, LEAST_SHARE if self._average_ns else 1.0)

    def estimate(self) -> Points | NoEstimate:
        """One point at tau = P, from two averages on."""
        if 0 < self._average_ns < self.tracker.dt_ns:
            unit, signal, _ = self._signal
            return NoEstimate(
                f"unit {unit}, signal {signal}: averages of {self.average_s:g} s are shorter than the sample "
                f"interval of {self.sample_interval_s:g} s"
            )
        if self.window_s:
            n, squares, correlation = self._statistics_of_window()
        else:
            n, numbers = int(self._state.places[kernel.AVERAGES]), self._state.numbers.tolist()
            early, late = numbers[kernel.EARLY_SQUARES], numbers[kernel.LATE_SQUARES]
            squares, correlation = numbers[kernel.SQUARES], _correlation(numbers[kernel.COVARIANCE], early, late)
        if n < 2:
            what = f"averages of {self.average_s:g} s" if self.average_s else "samples"
            within = f" within {self.window_s:g} s" if self.window_s else ""
            return NoEstimate(f"2 {what} needed{within}, {n} seen")
        value = math.sqrt(squares / (n - 1)) * self._factor
        if not math.isfinite(value):
            return self._too_large()
        degrees = effective_degrees(n, correlation)
        lo, hi = deviation_bounds(value, degrees, self.confidence)
        tau_s = self.average_s or self.sample_interval_s
        return (EstimatePoint(tau_s=tau_s, value=value, lo=lo, hi=hi, edf=degrees, n=n),)

    def _statistics_of_window(self) -> tuple[int, float, float]:
        """Number of averages, sum of squares about their mean, correlation of neighbours."""
        places, _, ring, blocks = self._state
        in_window = np.flatnonzero(blocks >= max(0, int(places[kernel.BLOCK]) - len(ring)))
        in_window = in_window[np.argsort(blocks[in_window])]
        averages = ring[in_window]
        if len(averages) < 2:
            return len(averages), 0.0, 0.0
        with np.errstate(over="ignore", invalid="ignore"):
            squares = float(np.sum(np.square(averages - averages.mean())))
            is_pair = np.diff(blocks[in_window]) == 1
            early, late = averages[:-1][is_pair], averages[1:][is_pair]
            if len(early) == 0:
                return len(averages), squares, 0.0
            early, late = early - early.mean(), late - late.mean()
            correlation = _correlation(float(early @ late), float(early @ early), float(late @ late))
        return len(averages), squares, correlation


def _correlation(products: float, early_squares: float, late_squares: float) -> float:
    scale = math.sqrt(early_squares) * math.sqrt(late_squares)
    # squares of tiny numbers vanish before the numbers do
    return max(-1.0, min(1.0, products / scale)) if scale > 0.0 else 0.0


def _averages_in(window_s: float, average_s: float) -> int:
    if window_s == 0.0:
        return 0
    averages = round(window_s / average_s) if average_s and math.isfinite(window_s) else 0
    if not 2 <= averages <= _MOST_AVERAGES or not math.isclose(averages * average_s, window_s, rel_tol=1e-9):
        raise EstimatorError(
            f"a window of {window_s:g} s with averages of {average_s:g} s: it takes a whole number of averages, "
            f"2 to {_MOST_AVERAGES:,}"
        )
    return averages


def effective_degrees(n: int, correlation: float) -> float:
    """Degrees of freedom of the variance of `n` values with correlated neighbours: Bartlett's, within 1 and n - 1.

    >>> effective_degrees(101, 0.0), effective_degrees(101, 0.5), effective_degrees(101, 1.0)
    (100.0, 60.0, 1.0)
    """
    square = correlation * correlation
    return min(n - 1.0, max(1.0, (n - 1) * (1.0 - square) / (1.0 + square)))
