"""Chart of individual values and moving ranges (Shewhart; NIST/SEMATECH e-Handbook 6.3.2.2, ISO 7870-2)."""

import math
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from scipy.special import gammaln

from analytics.trends.words import Refused, Words
from stream.batch import FloatArray

D2 = 2 / math.sqrt(math.pi)
"""Mean of the range of two standard normal values, d2(2) = 1.128."""
D3 = math.sqrt(2 - 4 / math.pi)
"""Its standard deviation, d3(2) = 0.853."""
MEDIAN_RANGE = 0.9538725524
"""Its median, d4(2) = sqrt(2) * 0.6745."""
LEAST_POINTS = 8
WIDTH = 3.0


class Spread(StrEnum):
    """How the standard deviation of a process in control is had from its points."""

    MOVING_RANGE = "moving_range"
    """Mean moving range / d2, about the mean."""
    MEDIAN_MOVING_RANGE = "median_moving_range"
    """Median moving range / d4, about the median: single wild points do not widen the limits."""
    DEVIATION = "deviation"
    """Standard deviation / c4, about the mean; for a baseline that is known to be in control."""


class IndividualsChart(NamedTuple):
    """Centre and limits of a chart, from its first `baseline` points.

    Parameters
    ----------
    centre, sigma: Level and standard deviation of the process in control, in the unit of the values.
    lower, upper: centre -+ 3 sigma.
    moving_range, moving_range_upper: Expected moving range, d2*sigma, and its limit (d2 + 3*d3)*sigma.
    baseline: Points that they were computed from.
    spread: By which rule.
    """

    centre: float
    sigma: float
    lower: float
    upper: float
    moving_range: float
    moving_range_upper: float
    baseline: int
    spread: Spread


def c4(n: int) -> float:
    """Mean of the standard deviation of `n` standard normal values.

    Examples
    --------
    >>> round(c4(2), 4), round(c4(10), 4)
    (0.7979, 0.9727)
    """
    return math.sqrt(2 / (n - 1)) * math.exp(float(gammaln(n / 2) - gammaln((n - 1) / 2)))


def centre_and_sigma(values: FloatArray, spread: Spread) -> tuple[FloatArray, FloatArray]:
    """Level and standard deviation of series along the last axis."""
    ranges = np.abs(np.diff(values, axis=-1))
    if spread is Spread.MEDIAN_MOVING_RANGE:
        return np.median(values, axis=-1), np.median(ranges, axis=-1) / MEDIAN_RANGE
    centre = values.mean(axis=-1)
    if spread is Spread.DEVIATION:
        return centre, values.std(axis=-1, ddof=1) / c4(values.shape[-1])
    return centre, ranges.mean(axis=-1) / D2


def individuals_chart(
    values: FloatArray, *, baseline: int | None = None, spread: Spread = Spread.MOVING_RANGE
) -> IndividualsChart | Refused:
    """Limits for individual values.

    Parameters
    ----------
    values: shape (points,); in order of time.
    baseline: How many points from the first on the limits are computed from (phase I); all if left out.
    spread: By which rule.

    Notes
    -----
    With known centre and sigma a point of a process in control lies outside once in 370 points, the average run length.
    Limits from few points are themselves uncertain: from 30 points by moving ranges, one in about 200 lies outside.

    Examples
    --------
    >>> flow = np.array([49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1])
    >>> chart = individuals_chart(flow)
    >>> round(chart.centre, 2), round(chart.upper, 3), round(chart.lower, 3)
    (50.81, 55.802, 45.818)
    """
    first = values if baseline is None else values[:baseline]
    if first.size < LEAST_POINTS:
        return Refused(
            Words(
                f"{first.size} points, a chart's limits need {LEAST_POINTS}: measure on",
                f"仅有 {first.size} 点，确定控制限至少需要 {LEAST_POINTS} 点：请继续测量",
            )
        )
    centre, sigma = (float(each) for each in centre_and_sigma(first, spread))
    if not sigma > 1e-12 * abs(centre):
        return Refused(
            Words(
                "the values do not vary from point to point: a chart has no limits then",
                "各点数值无变化：无法确定控制限",
            )
        )
    return IndividualsChart(
        centre=centre,
        sigma=sigma,
        lower=centre - WIDTH * sigma,
        upper=centre + WIDTH * sigma,
        moving_range=D2 * sigma,
        moving_range_upper=(D2 + WIDTH * D3) * sigma,
        baseline=int(first.size),
        spread=spread,
    )
