"""The likelihood ratio of one change of level in first-order autoregressive noise: a peer of `change_points`."""

from functools import lru_cache

import numpy as np

from stream.batch import FloatArray

_CORRELATIONS = (*(0.05 * step for step in range(20)), 0.98)
_CALIBRATED_AT = (0.0, 0.3, 0.5, 0.7, 0.9)
_LEAST_SEGMENT = 4


def autoregressive(rng: np.random.Generator, series: int, n: int, correlation: float) -> FloatArray:
    """Series of unit variance, of shape (series, n), each value correlated with the one before."""
    values = rng.standard_normal((series, n))
    for at in range(1, n):
        values[:, at] = correlation * values[:, at - 1] + np.sqrt(1 - correlation**2) * values[:, at]
    return np.asarray(values)


def ar_ratio(values: FloatArray) -> FloatArray:
    """Twice the log likelihood ratio of one change against none, of series (m, n); the correlation is free in both."""
    n = values.shape[1]
    without, with_change = (np.full(len(values), -np.inf) for _ in range(2))
    for correlation in _CORRELATIONS:
        base = 0.5 * np.log(1 - correlation**2)
        white, level = _whitened(values, correlation), _whitened(np.ones(n), correlation)
        white = white - np.outer(white @ level / (level @ level), level)  # the level is fitted
        squares = (white**2).sum(axis=1)
        without = np.maximum(without, base - 0.5 * n * np.log(squares))
        for at in range(_LEAST_SEGMENT, n - _LEAST_SEGMENT + 1):
            step = _whitened(np.asarray(np.arange(n) >= at, np.float64), correlation)
            step = step - level * (step @ level) / (level @ level)
            left = squares - (white @ step) ** 2 / (step @ step)
            with_change = np.maximum(with_change, base - 0.5 * n * np.log(left))
    return np.asarray(2 * (with_change - without))


@lru_cache
def ar_threshold(n: int, series: int = 3000) -> float:
    """The ratio that 1 % of steady series exceed at the worst correlation."""
    rng = np.random.default_rng([20261130, n])
    return float(max(np.quantile(ar_ratio(autoregressive(rng, series, n, each)), 0.99) for each in _CALIBRATED_AT))


def _whitened(values: FloatArray, correlation: float) -> FloatArray:
    first = np.sqrt(1 - correlation**2) * values[..., :1]
    return np.asarray(np.concatenate([first, values[..., 1:] - correlation * values[..., :-1]], axis=-1), np.float64)
