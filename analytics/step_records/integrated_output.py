"""Integrated outputs: the angle that an axis has turned so far, or its pulses, as the rate of a stretch."""

import math
import re

import numpy as np

from analytics.step_records.series_statistics import SeriesStatistics, series_statistics
from stream.batch import FloatArray, IntArray
from stream.quantities import conversion, is_angular_rate

# as `is_integrated_output` in analytics/evaluation/views/06_body_axes.sql
_NAME = re.compile(r"angle_(?:[xyz]|heading|yaw|azimuth|pitch|roll)", re.IGNORECASE)
# Noise of the angle counts in the rate of a block as 1/length: blocks of a sample would hide the wander under it.
_BLOCKS = 64
_TURN_DEG = 360.0
_SLACK_DEG = 0.5


def is_integrated(signal: str) -> bool:
    """Whether a signal is the angle that an axis has turned so far.

    >>> [is_integrated(name) for name in ("angle_x", "angle_roll", "rate_x", "table_angle", "angle")]
    [True, True, False, False, False]
    """
    return _NAME.fullmatch(signal) is not None


def unwrapped(angles: FloatArray, unit_of_measure: str) -> FloatArray:
    """Angles that go on where the source began again after a turn: from 360 deg at 0, or from 180 at -180.

    Only within one turn of such a range, and where they leap by more than half a turn between samples.

    >>> unwrapped(np.array([350.0, 359.0, 8.0, 17.0]), "deg").tolist()
    [350.0, 359.0, 368.0, 377.0]
    >>> unwrapped(np.array([-90.0, 270.0, 700.0]), "deg").tolist()
    [-90.0, 270.0, 700.0]
    """
    if not _is_angle(unit_of_measure):
        return angles
    turn = _TURN_DEG / conversion(unit_of_measure, "deg")[0]
    low, high, slack = angles.min(), angles.max(), turn * _SLACK_DEG / _TURN_DEG
    is_one_turn = (low >= -slack and high <= turn + slack) or max(-low, high) <= turn / 2 + slack
    if not is_one_turn or np.abs(np.diff(angles)).max(initial=0.0) <= turn / 2:
        return angles
    return np.unwrap(angles, period=turn)


def _is_angle(unit_of_measure: str) -> bool:
    return is_angular_rate(f"{unit_of_measure}/s")


def rate_statistics(
    t_ns: IntArray, angles: FloatArray, unit_of_measure: str, step: float = 0.0
) -> SeriesStatistics | None:
    """Statistics of the rate, in the angle's unit per second; None of a single sample.

    The mean is (last - first)/(their time apart), whatever lies between. Its uncertainty is that of the mean of rates
    over at most 64 blocks, and not less than that of two angles quantised in `step`, sqrt(2) step/sqrt(12)/T.

    >>> t_ns = np.arange(6001) * 10_000_000
    >>> found = rate_statistics(t_ns, 3.0 + 0.5 * t_ns / 1e9, "deg", step=0.001)
    >>> found.mean, found.sd < 1e-9, float(f"{found.standard_uncertainty:.3g}")
    (0.5, True, 6.8e-06)
    """
    if len(t_ns) < 2:
        return None
    angles = unwrapped(angles, unit_of_measure)
    edges = np.unique(np.linspace(0, len(t_ns) - 1, min(_BLOCKS, len(t_ns) - 1) + 1).round().astype(np.int64))
    lasts_s = np.diff(t_ns[edges]) / 1e9
    rates = np.diff(angles[edges]) / lasts_s
    whole_s = float(t_ns[-1] - t_ns[0]) / 1e9
    block_ns = max(int((t_ns[-1] - t_ns[0]) // len(rates)), 1)
    at_ns = t_ns[0] + block_ns * np.arange(len(rates), dtype=np.int64)
    ones, zeros = np.ones(len(rates), np.int64), np.zeros(len(rates))
    found = series_statistics(
        at_ns, ones, rates, zeros, base_ns=block_ns, samples_per_block=1.0, window_ns=(int(t_ns[0]), int(t_ns[-1])),
        samples=np.empty(0),
    )  # fmt: skip
    quantised = step / math.sqrt(6.0) / whole_s
    u = found.standard_uncertainty if len(rates) > 1 else quantised or math.nan
    return found._replace(
        mean=float((angles[-1] - angles[0]) / whole_s), standard_uncertainty=u if math.isnan(u) else max(u, quantised),
        still=0.0,
    )  # fmt: skip
