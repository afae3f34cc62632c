"""White noise of a sensor at rest, from means of 1 s about the mean of each rest."""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from stream.batch import FloatArray

_BLOCK_S = 1.0


class NoiseDensity(NamedTuple):
    """Standard deviation of means of 1 s: the sensor's unit times the root of a second."""

    value: float
    freedom: float


def noise_density(rests: Iterable[FloatArray], dt_s: float) -> NoiseDensity:
    """The density of white noise, pooled over rests; each rest has a mean of its own.

    Means of 1 s also see what single samples do not: noise that is correlated over some samples, and a quantisation
    step whose remainder is carried on.

    >>> rests = [np.random.default_rng(i).normal(5.0, 0.3, 1500) for i in range(50)]
    >>> density = noise_density(rests, 0.01)
    >>> round(density.value, 3), density.freedom
    (0.03, 700.0)
    """
    size = max(1, round(_BLOCK_S / dt_s))
    squares, freedom = 0.0, 0
    for rest in rests:
        blocks = len(rest) // size
        if blocks < 2:
            continue
        means = rest[len(rest) - blocks * size :].reshape(blocks, size).mean(axis=1)
        squares += float(np.square(means - means.mean()).sum())
        freedom += blocks - 1
    if not freedom:
        return NoiseDensity(math.inf, 1.0)
    return NoiseDensity(math.sqrt(squares / freedom * size * dt_s), float(freedom))
