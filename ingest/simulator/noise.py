"""Noise of a simulated gyro: white rate noise, flicker and rate random walk, drawn block by block.

Flicker and random walk are drawn as their exact means over hold intervals (0.1 s at 200 Hz) and held within
them. The mean is exact in distribution, so at every averaging time that is a multiple of the interval the
Allan deviation is that of the continuous process: nothing is lost to the lower rate.

Every process draws from a Generator of its own and in one fixed order, so the result does not depend on the
sizes of the blocks it is asked for.
"""

import math

import numpy as np
from numba import njit

from stream.batch import FloatArray

SHORTEST_CORRELATION_S = 0.02
CORRELATION_RATIO = 4.0
CORRELATION_TIMES = 14
SECONDS_PER_HOUR = 3600.0

_SERIES_BELOW = 0.01


@njit(cache=True, nogil=True)
def _interval_means(
    state: FloatArray,
    normals: FloatArray,
    decay: FloatArray,
    kick: FloatArray,
    weight: FloatArray,
    scatter: float,
    out: FloatArray,
) -> None:
    """Advance all processes by one interval per row of `normals` and write the sum of their means over it."""
    for i in range(normals.shape[0]):
        total = scatter * normals[i, state.shape[0]]
        for p in range(state.shape[0]):
            before = state[p]
            after = decay[p] * before + kick[p] * normals[i, p]
            total += weight[p] * (before + after)
            state[p] = after
        out[i] = total


class GaussMarkovSum:
    """Sum of independent first-order Gauss-Markov processes, as its exact means over consecutive intervals.

    Parameters
    ----------
    decay, kick: shape (p,); x_after = decay * x_before + kick * normal, over one interval.
    weight: shape (p,); the mean over the interval, given both ends, is expected at weight * (x_before + x_after).
    scatter: Standard deviation of the means about that, all processes together: given the ends they are independent.
    start_sd: shape (p,); standard deviation of the processes at time 0.
    generator: Where its normals come from; not to be shared.
    """

    def __init__(
        self,
        decay: FloatArray,
        kick: FloatArray,
        weight: FloatArray,
        scatter: float,
        start_sd: FloatArray,
        generator: np.random.Generator,
    ) -> None:
        self._decay, self._kick, self._weight = decay, kick, weight
        self._scatter = scatter
        self._generator = generator
        self._state = start_sd * generator.standard_normal(len(decay))

    def means(self, n: int) -> FloatArray:
        """Return the means over the next `n` intervals."""
        normals = self._generator.standard_normal((n, len(self._state) + 1))
        out = np.empty(n)
        _interval_means(self._state, normals, self._decay, self._kick, self._weight, self._scatter, out)
        return out


def ornstein_uhlenbeck(
    sd: FloatArray, correlation_s: FloatArray, interval_s: float, generator: np.random.Generator
) -> GaussMarkovSum:
    """Sum of stationary Ornstein-Uhlenbeck processes.

    Parameters
    ----------
    sd, correlation_s: shape (p,); standard deviation and correlation time of each: autocovariance sd^2
        exp(-abs(t)/correlation_s).
    interval_s: Interval of the means, seconds.
    generator: Where its normals come from.

    Notes
    -----
    With u = h/T: decay exp(-u), kick sd sqrt(1 - exp(-2u)), and the mean over h given both ends is normal
    about tanh(u/2)/u (x_before + x_after) with variance 2 sd^2 (u - 2 tanh(u/2))/u^2 (D. T. Gillespie, Phys.
    Rev. E 54 (1996) 2084, doi:10.1103/PhysRevE.54.2084, gives the joint distribution of the process and its
    integral).

    Examples
    --------
    >>> draught = ornstein_uhlenbeck(np.array([2.0]), np.array([5.0]), 1.0, np.random.default_rng(1))
    >>> bool(1.8 < draught.means(200_000).std() < 2.1)
    True
    """
    u = interval_s / correlation_s
    tanh = np.tanh(u / 2)
    # u - 2 tanh(u/2) loses all its digits where u is small
    bend = np.where(u < _SERIES_BELOW, u**3 / 12 * (1 - u**2 / 10), u - 2 * tanh)
    return GaussMarkovSum(
        decay=np.exp(-u),
        kick=sd * np.sqrt(-np.expm1(-2 * u)),
        weight=tanh / u,
        scatter=math.sqrt(float(np.sum(2 * sd**2 * bend / u**2))),
        start_sd=sd,
        generator=generator,
    )


def flicker_noise(
    bias_instability_deg_per_h: float, interval_s: float, generator: np.random.Generator
) -> GaussMarkovSum:
    """Flicker noise of bias instability B, in deg/h: an Allan floor of sqrt(2 ln 2/pi) B = 0.664 B.

    Parameters
    ----------
    bias_instability_deg_per_h: B, deg/h.
    interval_s: Interval of the means, seconds.
    generator: Where its normals come from.

    Notes
    -----
    IEEE 952-1997 C.1.1.3: two-sided power density B^2/(2 pi f). A sum of Ornstein-Uhlenbeck processes of
    equal variance v, with correlation times in the ratio r, has the density v/(2 ln r f) between the
    reciprocals of its outermost correlation times, so v = B^2 ln r/pi; r = 4 ripples by 0.3 %. Fourteen of
    them from 0.02 s to 1.3e6 s keep the floor within 2 % of 0.664 B from 0.5 s to 1e5 s; a longer record sees
    it bend down to white below 0.02 s and to a constant above 1.3e6 s. They start in their stationary state,
    as if they had always been running: at time 0 the process already stands about 2.5 B from 0.
    """
    correlation_s = SHORTEST_CORRELATION_S * CORRELATION_RATIO ** np.arange(CORRELATION_TIMES, dtype=np.float64)
    sd = np.full(CORRELATION_TIMES, bias_instability_deg_per_h * math.sqrt(math.log(CORRELATION_RATIO) / math.pi))
    return ornstein_uhlenbeck(sd, correlation_s, interval_s, generator)


def rate_random_walk(
    rate_random_walk_deg_per_h_per_sqrt_h: float, interval_s: float, generator: np.random.Generator
) -> GaussMarkovSum:
    """Rate random walk of coefficient K, in deg/h, 0 at time 0: Allan deviation K sqrt(tau/3), tau in h.

    Parameters
    ----------
    rate_random_walk_deg_per_h_per_sqrt_h: K, deg/h/sqrt(h): standard deviation after one hour.
    interval_s: Interval of the means, seconds.
    generator: Where its normals come from.

    Notes
    -----
    IEEE 952-1997 C.1.1.4. The mean over an interval h of a random walk with both ends known (a Brownian
    bridge) has the variance K^2 h/12 about their mean.
    """
    kick = rate_random_walk_deg_per_h_per_sqrt_h * math.sqrt(interval_s / SECONDS_PER_HOUR)
    return GaussMarkovSum(
        decay=np.ones(1),
        kick=np.array([kick]),
        weight=np.array([0.5]),
        scatter=kick / math.sqrt(12),
        start_sd=np.zeros(1),
        generator=generator,
    )


def white_sd_deg_per_h(angle_random_walk_deg_per_sqrt_h: float, sample_interval_s: float) -> float:
    """Standard deviation of one sample of white rate noise, deg/h: N / sqrt(sample interval in hours).

    IEEE 952-1997 C.1.1.1: Allan deviation N/sqrt(tau), tau in hours.

    Examples
    --------
    >>> round(white_sd_deg_per_h(0.02, 1.0), 9)
    1.2
    """
    return angle_random_walk_deg_per_sqrt_h / math.sqrt(sample_interval_s / SECONDS_PER_HOUR)
