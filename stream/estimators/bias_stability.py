"""Bias stability: the standard deviation of averaged output (GJB 2426A-2004 5.12.2, JJF 2014-2022 7.2.14).

Not bias instability, which is the floor of the Allan deviation (IEEE 952).
"""

import math
from typing import Self

from stream.batch import FloatArray, SampleBatch
from stream.clock import Piece
from stream.errors import EstimatorError
from stream.estimators.averages_kernel import (
    AVERAGES,
    BLOCK,
    COVARIANCE,
    EARLY_SQUARES,
    LATE_SQUARES,
    SQUARES,
    AveragesState,
    average_grid,
    average_times,
    begin_within,
    empty_averages,
    first_slot_of,
    merge_averages,
)
from stream.estimators.base import Estimator, NoEstimate, contiguous_runs, first_finite, for_kernel
from stream.estimators.confidence import deviation_limits
from stream.events import EstimatePoint

LEAST_SHARE = 0.9
_MOST_SECONDS = 1e9


class BiasStability(Estimator):
    """Standard deviation of consecutive means of `average_s` seconds.

    Parameters
    ----------
    average_s : float
        Averaging time P in seconds, at least one sample interval; read to the nanosecond.

    Raises
    ------
    EstimatorError
        If `average_s` is not between 1 ns and 1e9 s.

    Notes
    -----
    B_s = sqrt(sum (F_i - mean(F))**2 / (n - 1)), JJF 2014-2022 equation (29), of the means F_i that hold at
    least 90 % of their samples. Average i holds the samples whose time since the first, slot times nominal interval,
    lies in [i P, (i + 1) P): P need not be a whole number of intervals. Samples on no grid are taken by
    their true times. The average that is still being filled is not used.

    The limits are by chi-square with (n - 1)(1 - r**2)/(1 + r**2) degrees of freedom, r the correlation of neighbouring
    averages (Bartlett 1946, for a first-order process): those of a gyro are not white. Where the averages wander
    over the whole record, the limits are for this record; a longer one will have a larger deviation.
    Memory: 19 numbers.

    Examples
    --------
    >>> from uuid import UUID
    >>> import numpy as np
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

    variants = ({"average_s": 1.0}, {"average_s": 10.0}, {"average_s": 100.0})

    def __init__(self, average_s: float) -> None:
        super().__init__()
        if not 1e-9 <= average_s <= _MOST_SECONDS:
            raise EstimatorError(f"averages of {average_s} s: bias stability takes 1e-9 to 1e9 s")
        self.average_s = average_s
        self.key = f"bias_stability_{average_s:g}s"
        self.names = {"en": f"Bias stability ({average_s:g} s averages)", "zh": f"零偏稳定性({average_s:g} s 平均)"}
        self._average_ns = round(average_s * 1e9)
        self._state: AveragesState = empty_averages()

    @property
    def arguments(self) -> dict[str, int | float]:
        """Averaging time in seconds."""
        return {"average_s": self.average_s}

    def _take(self, batch: SampleBatch, pieces: list[Piece]) -> None:
        tracker = self._tracker
        if self._average_ns < tracker.dt_ns:
            return
        if tracker.irregular:
            origin_ns = tracker.first_ns
            times_ns = for_kernel(batch.time_array)
            values = for_kernel(batch.value_array)
            for _, start, stop in pieces:
                self._refer_to(values[start:stop])
                average_times(
                    *self._state,
                    self._reference,
                    self._average_ns,
                    LEAST_SHARE,
                    tracker.dt_ns,
                    origin_ns,
                    times_ns[start:stop],
                    values[start:stop],
                )
            return
        for first_slot, values in contiguous_runs(batch, pieces):
            self._refer_to(values)
            average_grid(
                *self._state,
                self._reference,
                self._average_ns,
                LEAST_SHARE,
                tracker.dt_ns,
                first_slot,
                values,
            )

    def _refer_to(self, values: FloatArray) -> None:
        if math.isnan(self._reference):
            self._reference = first_finite(values)

    def _go_on_from(self, earlier: Self) -> None:
        begin_within(self._state.places, int(earlier._state.places[BLOCK]))

    def _append(self, later: Self) -> None:
        block, dt_ns = int(self._state.places[BLOCK]), later._tracker.dt_ns
        if later._tracker.irregular or dt_ns == 0:
            expected = self._average_ns / max(dt_ns, 1)
        else:
            first, end = (first_slot_of(each, self._average_ns, dt_ns) for each in (block, block + 1))
            expected = float(end - first)
        merge_averages(*self._state, *later._state, expected, LEAST_SHARE)

    def estimate(self) -> tuple[EstimatePoint, ...] | NoEstimate:
        """One point at tau = P, from two averages on."""
        unit, signal, _ = self._signal
        places, numbers = self._state
        n = int(places[AVERAGES])
        if self._average_ns < self._tracker.dt_ns:
            return NoEstimate(
                f"unit {unit}, signal {signal}: averages of {self.average_s:g} s are shorter than the sample "
                f"interval of {self.sample_interval_s:g} s"
            )
        if n < 2:
            return NoEstimate(f"2 averages of {self.average_s:g} s needed, {n} seen")
        value = math.sqrt(float(numbers[SQUARES]) / (n - 1)) * self._factor
        if not math.isfinite(value):
            return NoEstimate(f"unit {unit}, signal {signal}: values too large to be squared; check the source")
        degrees = effective_degrees(n, self._neighbour_correlation())
        lo, hi = deviation_limits(value, degrees, self.confidence)
        return (EstimatePoint(tau_s=self.average_s, value=value, lo=lo, hi=hi, edf=degrees, n=n),)

    def _neighbour_correlation(self) -> float:
        numbers = self._state.numbers
        scale = math.sqrt(float(numbers[EARLY_SQUARES])) * math.sqrt(float(numbers[LATE_SQUARES]))
        # squares of tiny numbers vanish before the numbers do
        return max(-1.0, min(1.0, float(numbers[COVARIANCE]) / scale)) if scale > 0.0 else 0.0


def effective_degrees(n: int, correlation: float) -> float:
    """Degrees of freedom of the variance of `n` values whose neighbours correlate: Bartlett's, within 1 and n - 1.

    Examples
    --------
    >>> effective_degrees(101, 0.0), effective_degrees(101, 0.5), effective_degrees(101, 1.0)
    (100.0, 60.0, 1.0)
    """
    square = correlation * correlation
    return min(n - 1.0, max(1.0, (n - 1) * (1.0 - square) / (1.0 + square)))
