"""Control charts of individual values, and of exponentially weighted moving averages.

Shewhart (NIST/SEMATECH e-Handbook 6.3.2.2, ISO 7870-2); Roberts 1959 (e-Handbook 6.3.2.4).
"""

import math
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from scipy.special import gammaln

from analytics.trends.words import NotComputed, not_computed
from stream.batch import FloatArray

D2 = 2 / math.sqrt(math.pi)  # mean of the range of two standard normal values, d2(2) = 1.128
D3 = math.sqrt(2 - 4 / math.pi)  # its standard deviation, d3(2) = 0.853
MEDIAN_RANGE = 0.9538725524  # its median, d4(2) = sqrt(2) * 0.6745
LEAST_POINTS = 8
WIDTH = 3.0
_ALIKE = 1e-9  # share of the largest range below which two values are one
# a process in control leaves these bounds once in 370 points, as on a chart of individual values with 3 sigma
EWMA_WEIGHT, EWMA_WIDTH = 0.2, 2.86


class Spread(StrEnum):
    """How the standard deviation of a process in control is estimated from its points."""

    MOVING_RANGE = "moving_range"  # mean moving range / d2, about the mean
    # median moving range / d4, about the median: single outliers do not widen the limits
    MEDIAN_MOVING_RANGE = "median_moving_range"
    DEVIATION = "deviation"  # standard deviation / c4, about the mean; for a baseline that is known to be in control


class IndividualsChart(NamedTuple):
    """Centre and limits of a chart, from its first `baseline` points."""

    centre: float  # level of the process in control, in the unit of the values, and its standard deviation
    sigma: float
    lower: float  # centre -+ 3 sigma
    upper: float
    moving_range: float  # expected moving range, d2*sigma, and its limit (d2 + 3*d3)*sigma
    moving_range_upper: float
    baseline: int
    spread: Spread


def c4(n: int) -> float:
    """Mean of the standard deviation of `n` standard normal values.

    >>> round(c4(2), 4), round(c4(10), 4)
    (0.7979, 0.9727)
    """
    return math.sqrt(2 / (n - 1)) * math.exp(float(gammaln(n / 2) - gammaln((n - 1) / 2)))


def sigma_of_ranges(values: FloatArray) -> FloatArray:
    """Standard deviation of series along the last axis, from the median of their moving ranges.

    Where more than half of successive values are alike (coarse resolution, copies) the median is 0, and the mean range
    is taken.

    >>> round(float(sigma_of_ranges(np.array([1.0, 1.0, 1.0, 1.2, 1.2, 1.2]))), 4)
    0.0354
    """
    ranges = np.abs(np.diff(values, axis=-1))
    of_median = np.median(ranges, axis=-1) / MEDIAN_RANGE
    return np.where(of_median > _ALIKE * ranges.max(axis=-1), of_median, ranges.mean(axis=-1) / D2)


def centre_and_sigma(values: FloatArray, spread: Spread) -> tuple[FloatArray, FloatArray]:
    """Level and standard deviation of series along the last axis."""
    if spread is Spread.MEDIAN_MOVING_RANGE:
        return np.median(values, axis=-1), sigma_of_ranges(values)
    centre = values.mean(axis=-1)
    if spread is Spread.DEVIATION:
        return centre, values.std(axis=-1, ddof=1) / c4(values.shape[-1])
    return centre, np.abs(np.diff(values, axis=-1)).mean(axis=-1) / D2


def individuals_chart(
    values: FloatArray, *, baseline: int | None = None, spread: Spread = Spread.MOVING_RANGE
) -> IndividualsChart | NotComputed:
    """Control limits for individual values in order of time.

    They are computed from the first `baseline` points (phase I), by default from all. With known centre and sigma a
    point of a process in control lies outside once in 370 points, the average run length. Limits from few points are
    themselves uncertain: from 30 points by moving ranges, one in about 200 lies outside.

    >>> flow = np.array([49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1])
    >>> chart = individuals_chart(flow)
    >>> round(chart.centre, 2), round(chart.upper, 3), round(chart.lower, 3)
    (50.81, 55.802, 45.818)
    """
    first = values if baseline is None else values[:baseline]
    if first.size < LEAST_POINTS:
        return not_computed("chart_short", points=first.size, s="s" * (first.size != 1), least=LEAST_POINTS)
    centre, sigma = (float(each) for each in centre_and_sigma(first, spread))
    if not sigma > 1e-12 * abs(centre):
        return not_computed("chart_constant")
    lower, upper = centre - WIDTH * sigma, centre + WIDTH * sigma
    return IndividualsChart(centre, sigma, lower, upper, D2 * sigma, (D2 + WIDTH * D3) * sigma, int(first.size), spread)


class EwmaChart(NamedTuple):
    """Moving averages and their limits at each point, in the unit of the values."""

    averages: FloatArray
    lower: FloatArray
    upper: FloatArray
    weight: float  # of the newest point
    width: float  # limits in standard deviations of the average

    @property
    def outside(self) -> list[int]:
        """Points whose average lies beyond its limits."""
        return np.flatnonzero((self.averages > self.upper) | (self.averages < self.lower)).tolist()


def ewma_chart(
    values: FloatArray, centre: float, sigma: float, *, weight: float = EWMA_WEIGHT, width: float = EWMA_WIDTH
) -> EwmaChart:
    """Exponentially weighted moving averages of a series and their limits.

    E_i = w*x_i + (1 - w)*E_(i-1), E_0 = centre; limits centre -+ width*sigma*sqrt(w/(2 - w)*(1 - (1 - w)**(2i))).

    >>> chart = ewma_chart(np.array([52.0, 47.0, 53.0]), 50.0, 2.0539, weight=0.3, width=3.0)
    >>> [round(float(each), 2) for each in chart.averages]
    [50.6, 49.52, 50.56]
    """
    from scipy.signal import lfilter

    averages = lfilter([weight], [1.0, weight - 1.0], values - centre) + centre
    grown = 1 - (1 - weight) ** (2 * np.arange(1, values.size + 1))
    half = width * sigma * np.sqrt(weight / (2 - weight) * grown)
    return EwmaChart(averages, centre - half, centre + half, weight, width)
