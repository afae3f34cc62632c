"""A resolution that is coarse beside the noise: how far the mean of rounded samples may be from that of the signal."""

import math
from statistics import NormalDist

import numpy as np

from stream.batch import FloatArray

_FEWEST, _MOST_LEVELS, _LOOK = 30, 16, 200
_LEAST_SHARE = 0.8  # of the three most frequent levels: of white noise above 1.2 steps, whose mean is right, it is less
_MARGIN = 2.0  # standard errors of a share
_TERMS = 10


def rounding_bound(values: FloatArray) -> float:
    """How far the mean of Gaussian noise that is rounded to a few levels may be off; 0 where it has many.

    The error is a Fourier series in where the mean lies between two levels, with amplitudes
    (q/(k pi)) exp(-2 (k pi sigma/q)^2) for the step q and k = 1, 2, ... (Widrow and Kollar, Quantization Noise, 2008);
    the bound is their sum, at most q/2. The noise sigma is what the shares of samples below and above the most frequent
    level say, each two standard errors of independent samples smaller: where there is none beyond doubt on one side,
    the bound is q/2.

    >>> noise = np.random.default_rng(1).standard_normal(100_000)
    >>> [float(f"{rounding_bound(np.round(sigma * noise + 0.2)):.2g}") for sigma in (0.15, 0.4, 0.6, 1.0, 20.0)]
    [0.5, 0.015, 0.00033, 2.1e-09, 0.0]
    """
    if values.size < _FEWEST or np.unique(values[:: -(-values.size // _LOOK)]).size > _MOST_LEVELS:
        return 0.0
    levels, counts = np.unique(values, return_counts=True)
    often = np.sort(np.argsort(-counts, kind="stable")[:3])
    if levels.size < 2 or counts[often].sum() < _LEAST_SHARE * values.size:
        return 0.0
    step, most = float(np.diff(levels[often]).min()), int(np.argmax(counts))
    apart = _from_mean(int(counts[:most].sum()), values.size) + _from_mean(int(counts[most + 1 :].sum()), values.size)
    terms = (math.exp(-2 * (k * math.pi / apart) ** 2) / (k * math.pi) for k in range(1, _TERMS + 1))
    return step * min(0.5, sum(terms))


def _from_mean(beyond: int, n: int) -> float:
    """How many sigma a threshold is from the mean at most, with some of `n` samples beyond it."""
    share = beyond / n
    least = share - _MARGIN * math.sqrt(share * (1 - share) / n)
    return -NormalDist().inv_cdf(least) if least > 0 else math.inf
