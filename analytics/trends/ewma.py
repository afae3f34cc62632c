"""Chart of exponentially weighted moving averages (Roberts 1959; NIST/SEMATECH e-Handbook 6.3.2.4)."""

from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter
from scipy.stats import norm

from stream.batch import FloatArray

WEIGHT = 0.2
WIDTH = 2.86
"""With `WEIGHT` a process in control is outside once in 370 points, as on a chart of individual values with 3 sigma."""


class EwmaChart(NamedTuple):
    """Averages and their limits at each point.

    Parameters
    ----------
    averages, lower, upper: shape (points,); in the unit of the values.
    weight, width: Weight of the newest point; limits in standard deviations of the average.
    """

    averages: FloatArray
    lower: FloatArray
    upper: FloatArray
    weight: float
    width: float

    @property
    def outside(self) -> list[int]:
        """Points at which the average is beyond its limits."""
        beyond = (self.averages > self.upper) | (self.averages < self.lower)
        return [int(each) for each in np.flatnonzero(beyond)]


def ewma_chart(
    values: FloatArray, centre: float, sigma: float, *, weight: float = WEIGHT, width: float = WIDTH
) -> EwmaChart:
    """Averages of a series and their limits.

    Notes
    -----
    E_i = w*x_i + (1 - w)*E_(i-1), E_0 = centre; limits centre -+ width*sigma*sqrt(w/(2 - w)*(1 - (1 - w)**(2i))).

    Examples
    --------
    >>> chart = ewma_chart(np.array([52.0, 47.0, 53.0]), 50.0, 2.0539, weight=0.3, width=3.0)
    >>> [round(float(each), 2) for each in chart.averages]
    [50.6, 49.52, 50.56]
    """
    averages = lfilter([weight], [1.0, weight - 1.0], values - centre) + centre
    grown = 1 - (1 - weight) ** (2 * np.arange(1, values.size + 1))
    half = width * sigma * np.sqrt(weight / (2 - weight) * grown)
    return EwmaChart(averages, centre - half, centre + half, weight, width)


def average_run_length(weight: float, width: float, shift: float = 0.0, states: int = 201) -> float:
    """Points until the average leaves steady limits, by the Markov chain of Brook and Evans (Lucas, Saccucci 1990).

    Parameters
    ----------
    weight, width: Of the chart.
    shift: By how many sigma the process has moved.
    states: Into how many states the way between the limits is divided.

    Examples
    --------
    >>> round(average_run_length(0.2, 2.86))
    371
    """
    half = width * np.sqrt(weight / (2 - weight))
    edges = np.linspace(-half, half, states + 1)
    middles = (edges[1:] + edges[:-1]) / 2
    reached = norm.cdf((edges[None, :] - (1 - weight) * middles[:, None]) / weight - shift)
    moves = np.diff(reached, axis=1)
    lengths = np.linalg.solve(np.eye(states) - moves, np.ones(states))
    return float(lengths[states // 2])
