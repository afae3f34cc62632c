"""Noise of a series that wanders from point to point and is measured with scatter: its likelihood beside steps."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from stream.batch import FloatArray
from stream.compiled import compiled


class Noise(NamedTuple):
    """A wander, e_i = correlation*e_(i-1) + white, and scatter beside it."""

    correlation: float
    share: float  # of the variance that is the wander's; the rest is scatter of the measurement

    @property
    def neighbours(self) -> float:
        """Correlation of neighbouring points."""
        return self.share * self.correlation


_CORRELATIONS = (0.2, 0.4, 0.55, 0.7, 0.8, 0.87, 0.92, 0.96, 0.99)
_SHARES = (1.0, 0.8, 0.6, 0.4, 0.2)
# where a wander is forgotten at once, its share is unknown
_LEAST_SHARED = 0.4
NOISES = (
    Noise(0.0, 1.0),
    *(Noise(r, share) for r in _CORRELATIONS for share in _SHARES if share == 1.0 or r >= _LEAST_SHARED),
)


def simulated(noise: Noise, series: int, n: int, rng: np.random.Generator) -> FloatArray:
    """Series of noise of unit variance, of shape (series, n)."""
    values = rng.standard_normal((series, n))
    if noise.correlation > 0:
        fresh = math.sqrt(1 - noise.correlation**2)
        for at in range(1, n):
            values[:, at] = noise.correlation * values[:, at - 1] + fresh * values[:, at]
    if noise.share < 1:
        values = math.sqrt(noise.share) * values + math.sqrt(1 - noise.share) * rng.standard_normal((series, n))
    return values


@lru_cache
def prior() -> FloatArray:
    """Weights of `NOISES`: half for those without scatter, which are fewer."""
    alone = np.array([each.share == 1.0 for each in NOISES])
    return np.asarray(np.where(alone, 0.5 / alone.sum(), 0.5 / (~alone).sum()), np.float64)


class Products(NamedTuple):
    """Inner products of series with the inverse covariance V of each noise of unit variance."""

    among: FloatArray  # shape (noises, m, m); x'V^-1 z of the series
    steps: FloatArray  # shape (noises, m, n); of each series with the step that begins at each point
    norms: FloatArray  # shape (noises, n); of each step with itself
    log_root: FloatArray  # shape (noises,); -0.5*log det V


def products(series: FloatArray) -> Products:
    """Of series of shape (m, n), with all noises; by the innovations of the state-space form, exact in O(m*n).

    >>> found = products(np.arange(12.0).reshape(2, 6))
    >>> white = found.among[0], found.steps[0, :, 4], found.norms[0]
    >>> [each.tolist() for each in white]
    [[[55.0, 145.0], [145.0, 451.0]], [9.0, 21.0], [6.0, 5.0, 4.0, 3.0, 2.0, 1.0]]
    """
    m, n = series.shape
    each = [np.empty((len(NOISES), *shape)) for shape in ((m, m), (m, n), (n,), ())]
    noises = np.array(NOISES)
    _products(np.ascontiguousarray(series, np.float64), noises[:, 0], noises[:, 1], *each)
    return Products(*each)


def _fill_products(
    series: FloatArray, correlations: FloatArray, shares: FloatArray, among: FloatArray, steps: FloatArray,
    norms: FloatArray, log_root: FloatArray,
) -> None:  # fmt: skip
    m, n = series.shape
    variance, gain = np.empty(n), np.empty(n)
    white = np.empty((m, n))
    for noise in range(correlations.size):
        r, share = correlations[noise], shares[noise]
        # of the predicted wander; the innovation adds the scatter
        predicted, root = share, 0.0
        for t in range(n):
            variance[t] = predicted + 1.0 - share
            gain[t] = predicted / variance[t]
            predicted = r * r * predicted * (1.0 - gain[t]) + share * (1.0 - r * r)
            root -= 0.5 * math.log(variance[t])
        log_root[noise] = root
        for row in range(m):
            state = 0.0
            for t in range(n):
                innovation = series[row, t] - state
                white[row, t] = innovation / math.sqrt(variance[t])
                state = r * (state + gain[t] * innovation)
            # the transposed filter gives V^-1 x, whose sums from each point on are the products with the steps
            back, total = 0.0, 0.0
            for t in range(n - 1, -1, -1):
                scaled = white[row, t] / math.sqrt(variance[t])
                total += scaled + r * gain[t] * back
                steps[noise, row, t] = total
                back = r * (1.0 - gain[t]) * back - scaled
        for row in range(m):
            for column in range(row + 1):
                total = 0.0
                for t in range(n):
                    total += white[row, t] * white[column, t]
                among[noise, row, column] = total
                among[noise, column, row] = total
        # squares of the innovations of a step from here on, as a quadratic function of the predicted state
        square, linear, constant = 0.0, 0.0, 0.0
        for t in range(n - 1, -1, -1):
            keep, take = r * (1.0 - gain[t]), r * gain[t]
            constant += 1.0 / variance[t] + square * take * take + linear * take
            linear = linear * keep - 2.0 / variance[t] + 2.0 * square * keep * take
            square = square * keep * keep + 1.0 / variance[t]
            norms[noise, t] = constant


_products = compiled(_fill_products)


class Reduced(NamedTuple):
    """A series beside fixed columns with each noise, the columns fitted."""

    freedom: int  # points less columns
    log_likelihood: FloatArray  # shape (noises,); restricted likelihood, up to a constant
    squares: FloatArray  # shape (noises,); sum of squares that remains
    across: FloatArray  # shape (noises, n); of each step with what remains
    information: FloatArray  # shape (noises, n); of each step beside the columns

    def with_steps(self) -> FloatArray:
        """Log-likelihood with one step more, of shape (noises, n), up to the same constant.

        Sizes have a flat prior in standard deviations of the noise, so that units of measure do not matter; its height,
        the root of the points, makes evidence of short and long series alike.
        """
        left = np.maximum(self.squares[:, None] - self.across**2 / self.information, 1e-12 * self.squares[:, None])
        gained = -0.5 * np.log(self.information / self.freedom) - 0.5 * self.freedom * np.log(left)
        return np.asarray(self.log_likelihood[:, None] + 0.5 * self.freedom * np.log(self.squares)[:, None] + gained)


def reduced(values: FloatArray, columns: FloatArray) -> Reduced:
    """Fit columns of shape (c, n) to values of shape (n,)."""
    c, n = columns.shape
    found = products(np.vstack([columns, values]))
    normal, right = found.among[:, :c, :c], found.among[:, :c, c]
    fitted = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    squares = found.among[:, c, c] - np.sum(right * fitted, axis=1)
    squares = np.maximum(squares, 1e-13 * found.among[:, c, c])
    beside = np.linalg.solve(normal, found.steps[:, :c])
    across = found.steps[:, c] - np.sum(fitted[:, :, None] * found.steps[:, :c], axis=1)
    information = np.maximum(found.norms - np.sum(beside * found.steps[:, :c], axis=1), 1e-12 * found.norms)
    log_likelihood = found.log_root - 0.5 * np.linalg.slogdet(normal)[1] - 0.5 * (n - c) * np.log(squares)
    return Reduced(n - c, log_likelihood, squares, across, information)
