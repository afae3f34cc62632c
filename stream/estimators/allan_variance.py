"""Overlapping Allan deviation while the samples flow (IEEE 952-2020, NIST SP 1065 5.2.4, JJF 2014-2022 7.2.20)."""

import math
from types import MappingProxyType
from typing import Self

import numpy as np

from stream.batch import FloatArray, IntArray, first_finite
from stream.errors import EstimatorError
from stream.estimators.base import LEAST_SHARE, NoEstimate, PointEstimator, Points, held_share
from stream.estimators.confidence import deviation_bounds
from stream.estimators.kernels.pyramid_kernel import PyramidState, begin_at, empty_state, merge, push
from stream.estimators.noise.noise_exponent import Identified, identify
from stream.events import EstimatePoint

LEVELS = 27
OVERLAP = 16
OCTAVE_DIVISIONS = frozenset({1, 2, 4, 8})


class AllanDeviation(PointEstimator):
    """Overlapping Allan deviation at octaves of the averaging time, in bounded memory.

    An octave has `points_per_octave`, 1, 2, 4 or 8, averaging times; another number is an EstimatorError.

    Notes
    -----
    With window means M_i of n blocks of 2**k samples and tau = n 2**k dt,

        AVAR(tau) = sum (M_(i+n) - M_i)**2 / (2 C)    over the C pairs i at a distance of 2**k samples,

    n = 1 .. 31 for k = 0 and 16 .. 31 for k > 0. Up to tau = 16 dt this is the full overlap, beyond it one of 1/16 tau
    or closer, whose equivalent degrees of freedom are those of the full overlap to 0.5 %. Blocks are sums
    relative to the first valid sample and keep the count of their valid samples. A window counts if it holds at least
    90 % of its samples; the mean of those it holds then stands for all, and the lower bound allows for what this adds
    to white noise (`held_share`). Taus reach from dt to 2**30 dt and more.

    Erratum: JJF 2014-2022 7.2.20 (34)-(39) and GJB 2426A-2004 5.12.5.4.2 print clusters of k + 1 terms over k and
    differences of clusters one sample apart, which falls as 1/tau**2 whatever the noise.

    Bounds are by chi-square with the least equivalent degrees of freedom of the noises that are plausible at each
    averaging time (`noise_exponent`, `confidence`). Memory: 31 KB at one point per octave.

    Examples
    --------
    >>> from uuid import UUID
    >>> from stream.batch import SampleBatch
    >>> estimator = AllanDeviation()
    >>> estimator.estimate()
    NoEstimate(reason='2 samples needed, 0 seen')
    >>> batch = SampleBatch("FOG-1", "rate", "r1", UUID(int=1), 0, 0, 10**9, "deg/h",
    ...                     values=np.array([1.0, 3.0, 2.0, 6.0, 4.0]))
    >>> estimator.update(batch)
    >>> [(point.tau_s, point.value, point.n) for point in estimator.estimate()]
    [(1.0, 1.7677669529663689, 4), (2.0, 1.6007810593582121, 2)]
    """

    key = "allan_deviation"
    names = MappingProxyType({"en": "Allan deviation", "zh": "Allan 标准差"})

    def __init__(self, points_per_octave: int = 1) -> None:
        super().__init__()
        check_points_per_octave(points_per_octave)
        self._lags = _lag_table(points_per_octave)
        history = 2 * int(self._lags.max())
        self._points_per_octave = points_per_octave
        self._state: PyramidState = empty_state(LEVELS, history, self._lags.shape[1])

    @property
    def arguments(self) -> dict[str, int | float]:
        """Points per octave."""
        return {"points_per_octave": self._points_per_octave}

    def _take_run(self, first_slot: int, values: FloatArray) -> None:
        if self.tracker.irregular:
            return
        if self._reference != self._reference:  # NaN: no finite value yet
            self._reference = first_finite(values)
        push(*self._state, self._lags, LEAST_SHARE, self._reference, first_slot, values)

    def _continue_from(self, earlier: Self) -> None:
        begin_at(self._state, earlier.tracker.next_slot)

    def _append(self, later: Self) -> None:
        merge(*self._state, self._lags, LEAST_SHARE, *later._state)

    def estimate(self) -> Points | NoEstimate:
        """Deviation at every averaging time that has at least one pair of windows, shortest first."""
        if self.tracker.irregular:
            return self._no_grid("Allan deviation")
        state = self._state
        levels, columns = np.nonzero(state.windows)
        if len(levels) == 0:
            return NoEstimate(self._too_little())
        lags = self._lags[np.minimum(levels, 1), columns]
        order = np.argsort(lags << levels)
        levels, columns, lags = levels[order], columns[order], lags[order]
        factors, windows = lags << levels, state.windows[levels, columns]
        variances = state.squares[levels, columns] / (2.0 * windows * np.square(factors, dtype=np.float64))
        values = np.sqrt(variances) * self._factor
        if not np.isfinite(values).all():
            return self._too_large()
        noises = identify(factors, variances, windows, lags)
        rows = zip(factors.tolist(), values.tolist(), windows.tolist(), noises, strict=True)
        held = held_share(self.samples, self.missing)
        return tuple(
            allan_point(
                factor * self.tracker.dt_ns / 1e9, value, n, noise, self.confidence, held if factor > 1 else 1.0
            )
            for factor, value, n, noise in rows
        )

    def _too_little(self) -> str:
        if self.samples < 2:
            return f"2 samples needed, {self.samples} seen"
        return (
            f"2 neighbouring averages with {LEAST_SHARE:.0%} of their samples needed, none seen: "
            f"{self.samples} samples, {self.missing} missing"
        )


def check_points_per_octave(number: int) -> None:
    """Refuse a number of averaging times in an octave that is not offered."""
    if number not in OCTAVE_DIVISIONS:
        raise EstimatorError(f"{number} points per octave: 1, 2, 4 or 8 are offered")


def allan_point(
    tau_s: float, value: float, windows: int, noise: Identified, confidence: float, held: float = 1.0
) -> EstimatePoint:
    """A point of a curve with its confidence bounds, the lower one for averages of a share `held` of their samples."""
    lo, hi = deviation_bounds(value, noise.edf, confidence)
    lo *= math.sqrt(held)
    return EstimatePoint(tau_s=tau_s, value=value, lo=lo, hi=hi, edf=noise.edf, n=windows, plausible=noise.plausible)


def _lag_table(points_per_octave: int) -> IntArray:
    """Window lengths in blocks: row 0 for level 0, row 1 for the others; padded with zeros."""
    top = list(range(OVERLAP, 2 * OVERLAP, OVERLAP // points_per_octave))
    low = [lag for octave in (1, 2, 4, 8) for lag in range(octave, 2 * octave, max(1, octave // points_per_octave))]
    table = np.zeros((2, len(low) + len(top)), np.int64)
    table[0] = low + top
    table[1, : len(top)] = top
    return table
