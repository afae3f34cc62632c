"""Angle random walk by normalised bias stability (GJB 2426A-2004 5.12.5.4.1)."""

import math

import msgspec
import numpy as np

from stream.batch import FloatArray
from stream.errors import EstimatorError
from stream.estimators.base import LEAST_SHARE, NoEstimate
from stream.estimators.confidence import deviation_bounds
from stream.estimators.noise.noise_fit import NoiseCoefficient
from stream.estimators.noise.noise_model import ANGLE_RANDOM_WALK

MOST_INTERVAL_S = 0.01
LEAST_MEANS = 10
_SECOND_NS = 10**9


class NormalisedRandomWalk(msgspec.Struct, frozen=True, kw_only=True):
    """Angle random walk from the bias stability of means over 1 s.

    `coefficient` is RWC in deg/sqrt(h). The curve of the standard has the averaging times t0, 2 t0, 4 t0, ... and 1 s
    and the bias stability at each. `pieces` of the record were used.
    """

    coefficient: NoiseCoefficient
    taus_s: tuple[float, ...]
    bias_stability_deg_per_h: tuple[float, ...]
    pieces: int


def angle_random_walk_normalised(
    rates_deg_per_h: FloatArray, sample_interval_s: float, *, piece_s: float = 30.0, confidence: float = 0.95
) -> NormalisedRandomWalk | NoEstimate:
    """Angle random walk by the first method of the standard.

    Parameters
    ----------
    rates_deg_per_h: shape (n,); samples on a grid, NaN where one is missing.
    sample_interval_s: Interval t0 of the grid, read to the nanosecond.
    piece_s: Length of the pieces that a longer record is cut into, at least 10 s; a shorter rest is left out.
    confidence: Level of the bounds, between 0 and 1.

    Notes
    -----
    Equations (23) and (24): Bs(tau) = sqrt(sum (F_i - mean(F))^2/(n - 1)) of the means F_i over tau, and

        RWC = Bs(1 s) sqrt(1 s),    (deg/h) sqrt(s) / 60 = deg/sqrt(h).

    The standard requires t0 < 10 ms and a record of tens of seconds. Over hours the bias wanders and would count as
    random walk: for a longer record the median over pieces of tens of seconds is taken. A mean counts if it holds at
    least 90 % of its samples. Mean i over tau holds the samples whose time since the start of the piece lies in [i tau,
    (i + 1) tau), so that 1 s need not be a whole number of t0.

    Bounds are by chi-square with the degrees of freedom of one piece, for the median of several with those of all
    times the efficiency of a median: 1 for two pieces, whose median is their mean, down to 2/pi for many. They hold for
    white noise, which the method assumes; no correction is made for the median of chi-square, 1 % low at 30 means.

    Examples
    --------
    >>> rates = np.random.default_rng(1).standard_normal(12_000) * 6.0  # 0.6 (deg/h) sqrt(s) at 100 Hz
    >>> found = angle_random_walk_normalised(rates[:6000], 0.005)
    >>> found.coefficient.unit_of_measure, found.coefficient.lo < 6.0 * 0.005**0.5 / 60 < found.coefficient.hi
    ('deg/sqrt(h)', True)
    >>> angle_random_walk_normalised(rates, 0.01)
    NoEstimate(reason='sample interval of 0.01 s: the standard asks for less than 0.01 s (GJB 2426A-2004 5.12.5.4.1)')
    """
    interval_ns = round(sample_interval_s * _SECOND_NS)
    if interval_ns < 1 or piece_s < LEAST_MEANS or not 0.0 < confidence < 1.0:
        raise EstimatorError(
            f"sample interval {sample_interval_s} s, pieces of {piece_s} s, confidence {confidence}: give an interval "
            f"from 1 ns, pieces from {LEAST_MEANS} s and a confidence between 0 and 1"
        )
    if interval_ns >= round(MOST_INTERVAL_S * _SECOND_NS):
        return NoEstimate(
            f"sample interval of {sample_interval_s:g} s: the standard asks for less than {MOST_INTERVAL_S:g} s "
            "(GJB 2426A-2004 5.12.5.4.1)"
        )
    pieces = _pieces(rates_deg_per_h, max(1, round(piece_s * _SECOND_NS / interval_ns)))
    taus_ns = _averaging_times(interval_ns, min(len(rates_deg_per_h) * interval_ns, round(piece_s * _SECOND_NS)))
    stabilities = np.array([[_bias_stability(piece, interval_ns, tau) for tau in taus_ns] for piece in pieces])
    second = taus_ns.index(_SECOND_NS)
    held = [(n, squares) for n, squares in stabilities[:, second] if n >= LEAST_MEANS] if len(pieces) else []
    if not held:
        most = int(stabilities[:, second, 0].max()) if len(pieces) else 0
        return NoEstimate(f"{LEAST_MEANS} means of 1 s needed in a piece of {piece_s:g} s, {most} seen")
    curve = [
        (tau / _SECOND_NS, float(np.median([value for n, value in stabilities[:, column] if n >= LEAST_MEANS])))
        for column, tau in enumerate(taus_ns)
        if stabilities[:, column, 0].max() >= LEAST_MEANS
    ]
    value = dict(curve)[1.0]
    if not math.isfinite(value) or value == 0.0:
        return NoEstimate(
            f"bias stability of {value} deg/h at 1 s: the output is constant or too large; check the source"
        )
    degrees = float(sum(n - 1 for n, _ in held)) * median_efficiency(len(held))
    bounds = deviation_bounds(value, degrees, confidence)
    value, lo, hi = (each * ANGLE_RANDOM_WALK.per_si for each in (value, *bounds))
    unit = ANGLE_RANDOM_WALK.unit_of_measure
    return NormalisedRandomWalk(
        coefficient=NoiseCoefficient(value=value, lo=lo, hi=hi, unit_of_measure=unit, observable=True),
        taus_s=tuple(tau for tau, _ in curve),
        bias_stability_deg_per_h=tuple(stability for _, stability in curve),
        pieces=len(held),
    )


def median_efficiency(n: int) -> float:
    """Variance of the mean of `n` normal values over that of their median; within 2 % of the exact one.

    >>> [round(median_efficiency(n), 2) for n in (1, 2, 3, 4, 5, 10, 1000)]
    [1.0, 1.0, 0.73, 0.84, 0.69, 0.72, 0.64]
    """
    return 1.0 if n == 1 else min(1.0, 2 / math.pi + (0.29 if n % 2 else 0.81) / n)


def _pieces(rates: FloatArray, length: int) -> list[FloatArray]:
    """Whole pieces; a record shorter than two of them is one."""
    if len(rates) < 2 * length:
        return [rates] if len(rates) else []
    return [rates[start : start + length] for start in range(0, len(rates) - length + 1, length)]


def _averaging_times(interval_ns: int, piece_ns: int) -> list[int]:
    """t0, 2 t0, 4 t0, ... as long as a piece holds enough means, and 1 s; nanoseconds, ascending."""
    times = {_SECOND_NS}
    tau = interval_ns
    while tau * LEAST_MEANS <= piece_ns:
        times.add(tau)
        tau *= 2
    return sorted(times)


def _bias_stability(rates: FloatArray, interval_ns: int, tau_ns: int) -> tuple[float, float]:
    """How many means over tau there are, and their standard deviation; the last mean counts only if it is full."""
    times_ns = np.arange(len(rates), dtype=np.int64) * interval_ns
    bins = times_ns // tau_ns
    whole = len(rates) * interval_ns // tau_ns
    finite = np.isfinite(rates) & (bins < whole)
    if whole < 2 or not finite.any():
        return 0.0, 0.0
    reference = rates[finite][0]
    counts = np.bincount(bins[finite], minlength=whole)
    slots = np.bincount(bins, minlength=whole)[:whole]
    valid = counts >= LEAST_SHARE * slots
    if valid.sum() < 2:
        return float(valid.sum()), 0.0
    sums = np.bincount(bins[finite], weights=rates[finite] - reference, minlength=whole)
    return float(valid.sum()), float(np.std(sums[valid] / counts[valid], ddof=1))
