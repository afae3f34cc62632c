"""Noise of a gyro by the coefficients of IEEE 952 (Q, N, B, K, R and Markov), in deg/h at the output.

Slow processes are drawn as their exact means over an interval and held within it: at every averaging time that is a
multiple of the interval the Allan deviation is that of the continuous process. Every process draws from its own
generator in one fixed order, so the samples do not depend on block sizes.
"""

import math
from collections.abc import Callable

import msgspec
import numpy as np

from ingest.simulator.physics.draws import SECONDS_PER_HOUR, NotNegative, Positive, Seeds
from stream.batch import FloatArray
from stream.compiled import compiled

SHORTEST_CORRELATION_S = 0.02
CORRELATION_RATIO = 4.0
CORRELATION_TIMES = 14
FLICKER_HOLD_S = 0.02

_SERIES_BELOW = 0.01


class Markov(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """First-order Gauss-Markov noise: a disturbance with a memory, such as draughts or a control loop.

    Autocovariance s^2 exp(-abs(t)/T); Allan variance 2 s^2 (T/tau)(1 - (T/2 tau)(3 - 4 exp(-tau/T) + exp(-2 tau/T)))
    (IEEE 952-1997 C.1.2.1, with q_c^2 = 2 s^2/T).
    """

    sd_deg_per_h: NotNegative
    correlation_s: Positive


class Noise(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Noise of a gyro.

    Shot noise of the detector makes white rate noise (N), electronics flicker (B), ageing and slow heat exchange a walk
    (K) or ramp (R), and an angle counter quantisation noise (Q): an angle error e, new at every sample and uniform over
    one step, of which the rate sees (e_k - e_k-1)/dt. Allan variances 3 Q^2/tau^2, N^2/tau, (2 ln 2/pi) B^2, K^2 tau/3,
    R^2 tau^2/2 (IEEE 952-1997 C.1.1). All refer to the output, behind the bandwidth of the gyro.
    """

    angle_quantum_arcsec: NotNegative = 0.0  # step of the angle counter; Q is the step over sqrt(12)
    angle_random_walk_deg_per_sqrt_h: NotNegative = 0.0  # N
    bias_instability_deg_per_h: NotNegative = 0.0  # B; the floor of the Allan deviation is 0.664 B
    rate_random_walk_deg_per_h_per_sqrt_h: NotNegative = 0.0  # K
    rate_ramp_deg_per_h_per_h: float = 0.0  # R, with its sign; 0 at power-on
    markov: tuple[Markov, ...] = ()


@compiled
def _interval_means(
    state: FloatArray, normals: FloatArray, decay: FloatArray, kick: FloatArray, weight: FloatArray, scatter: float,
    out: FloatArray,
) -> None:  # fmt: skip
    """Advance all processes by one interval per row of `normals` and write the sum of their means over it."""
    for i in range(normals.shape[0]):
        total = scatter * normals[i, state.shape[0]]
        for p in range(state.shape[0]):
            before = state[p]
            after = decay[p] * before + kick[p] * normals[i, p]
            total += weight[p] * (before + after)
            state[p] = after
        out[i] = total


@compiled
def _repeat_each(values: FloatArray, hold: int, used: int, out: FloatArray) -> None:
    """Write each value `hold` times, the first `used` fewer."""
    j, left = 0, hold - used
    for i in range(out.shape[0]):
        if left == 0:
            j += 1
            left = hold
        left -= 1
        out[i] = values[j]


@compiled
def _add_differences(angle: FloatArray, before: float, per_interval: float, out: FloatArray) -> float:
    for i in range(angle.shape[0]):
        out[i] += per_interval * (angle[i] - before)
        before = angle[i]
    return before


class HeldNoise:
    """Values of a source, each held for `hold` samples; `source(n)` returns its next n values."""

    def __init__(self, source: Callable[[int], FloatArray], hold: int) -> None:
        self._source, self._hold = source, hold
        self._values = np.empty(0)  # the one that is held, and those after it
        self._used = 0

    def take(self, n: int, ahead: int = 0) -> FloatArray:
        """The next `n` samples; the values of `ahead` further ones may be drawn from the source at once."""
        if self._hold == 1:
            return self._source(n)
        if -(-(self._used + n) // self._hold) > len(self._values):
            missing = -(-(self._used + n + ahead) // self._hold) - len(self._values)
            self._values = np.concatenate([self._values, self._source(missing)])
        out = np.empty(n)
        _repeat_each(self._values, self._hold, self._used, out)
        whole, self._used = divmod(self._used + n, self._hold)
        self._values = self._values[whole:]
        return out


class GaussMarkovSum:
    """Sum of p independent first-order Gauss-Markov processes, as its exact means over consecutive intervals.

    Over one interval x_after = decay * x_before + kick * normal; given both ends, the mean over it has the expectation
    weight * (x_before + x_after), about which the means of all processes together have the standard deviation
    `scatter`. The arrays have the shape (p,); `start_sd` is of time 0. The `generator` is not to be shared.
    """

    def __init__(
        self, decay: FloatArray, kick: FloatArray, weight: FloatArray, scatter: float, start_sd: FloatArray,
        generator: np.random.Generator,
    ) -> None:  # fmt: skip
        self._decay, self._kick, self._weight = decay, kick, weight
        self._scatter, self._generator = scatter, generator
        self._state = start_sd * generator.standard_normal(len(decay))

    def means(self, n: int) -> FloatArray:
        """The means over the next `n` intervals."""
        normals = self._generator.standard_normal((n, len(self._state) + 1))
        out = np.empty(n)
        _interval_means(self._state, normals, self._decay, self._kick, self._weight, self._scatter, out)
        return out


def ornstein_uhlenbeck(
    sd: FloatArray, correlation_s: FloatArray, interval_s: float, generator: np.random.Generator
) -> GaussMarkovSum:
    """Sum of stationary Ornstein-Uhlenbeck processes with these standard deviations and correlation times, shape (p,).

    With u = h/T: decay exp(-u), kick sd sqrt(1 - exp(-2u)), and the mean over h given both ends is normal about
    tanh(u/2)/u (x_before + x_after) with variance 2 sd^2 (u - 2 tanh(u/2))/u^2 (D. T. Gillespie, Phys. Rev. E 54 (1996)
    2084, doi:10.1103/PhysRevE.54.2084, gives the joint distribution of the process and its integral).

    >>> draught = ornstein_uhlenbeck(np.array([2.0]), np.array([5.0]), 1.0, np.random.default_rng(1))
    >>> bool(1.8 < draught.means(200_000).std() < 2.1)
    True
    """
    u = interval_s / correlation_s
    tanh = np.tanh(u / 2)
    # u - 2 tanh(u/2) loses all its digits where u is small
    bend = np.where(u < _SERIES_BELOW, u**3 / 12 * (1 - u**2 / 10), u - 2 * tanh)
    return GaussMarkovSum(
        decay=np.exp(-u), kick=sd * np.sqrt(-np.expm1(-2 * u)), weight=tanh / u,
        scatter=math.sqrt(float(np.sum(2 * sd**2 * bend / u**2))), start_sd=sd, generator=generator,
    )  # fmt: skip


def flicker_noise(
    bias_instability_deg_per_h: float, interval_s: float, generator: np.random.Generator
) -> GaussMarkovSum:
    """Flicker noise of bias instability B, in deg/h: an Allan floor of sqrt(2 ln 2/pi) B = 0.664 B.

    IEEE 952-1997 C.1.1.3: two-sided power density B^2/(2 pi f). A sum of Ornstein-Uhlenbeck processes of
    equal variance v, with correlation times in the ratio r, has the density v/(2 ln r f) between the
    reciprocals of its outermost correlation times, so v = B^2 ln r/pi; r = 4 ripples by 0.3 %. Fourteen of
    them from 0.02 s to 1.3e6 s keep the floor within 2 % of 0.664 B from 0.5 s to 1e5 s; a longer record sees
    it bend down to white below 0.02 s and to a constant above 1.3e6 s. They start in their stationary state:
    at time 0 the process already has a standard deviation of about 2.5 B.
    """
    correlation_s = SHORTEST_CORRELATION_S * CORRELATION_RATIO ** np.arange(CORRELATION_TIMES, dtype=np.float64)
    sd = np.full(CORRELATION_TIMES, bias_instability_deg_per_h * math.sqrt(math.log(CORRELATION_RATIO) / math.pi))
    return ornstein_uhlenbeck(sd, correlation_s, interval_s, generator)


def rate_random_walk(
    rate_random_walk_deg_per_h_per_sqrt_h: float, interval_s: float, generator: np.random.Generator
) -> GaussMarkovSum:
    """Rate random walk of coefficient K, in deg/h, 0 at time 0: Allan deviation K sqrt(tau/3), tau in h.

    IEEE 952-1997 C.1.1.4. The mean over an interval h of a random walk with both ends known (a Brownian
    bridge) has the variance K^2 h/12 about their mean.
    """
    kick = rate_random_walk_deg_per_h_per_sqrt_h * math.sqrt(interval_s / SECONDS_PER_HOUR)
    return GaussMarkovSum(
        decay=np.ones(1), kick=np.array([kick]), weight=np.array([0.5]), scatter=kick / math.sqrt(12),
        start_sd=np.zeros(1), generator=generator,
    )  # fmt: skip


def white_sd_deg_per_h(angle_random_walk_deg_per_sqrt_h: float, sample_interval_s: float) -> float:
    """Standard deviation of one sample of white rate noise, deg/h: N / sqrt(sample interval in hours).

    IEEE 952-1997 C.1.1.1: Allan deviation N/sqrt(tau), tau in hours.

    >>> round(white_sd_deg_per_h(0.02, 1.0), 9)
    1.2
    """
    return angle_random_walk_deg_per_sqrt_h / math.sqrt(sample_interval_s / SECONDS_PER_HOUR)


class NoiseEffect:
    """Noise of one power-on."""

    def __init__(self, noise: Noise, seeds: Seeds, interval_s: float, hold_s: float) -> None:
        self._noise = noise
        self._white = seeds.of_power_on("white")
        self._white_sd = white_sd_deg_per_h(noise.angle_random_walk_deg_per_sqrt_h, interval_s)
        self._angle = seeds.of_power_on("angle quantum")
        # arcsec/s is deg/h
        self._quantum_deg_per_h = noise.angle_quantum_arcsec / interval_s
        self._last_angle = float(self._angle.random())
        self._slow: list[Callable[[int], FloatArray]] = []
        if noise.bias_instability_deg_per_h > 0.0:
            # fourteen processes take time: held for 0.02 s, the Allan deviation is unchanged from 0.1 s on
            hold = max(1, round(FLICKER_HOLD_S / hold_s))
            flicker = flicker_noise(noise.bias_instability_deg_per_h, hold * hold_s, seeds.of_power_on("flicker"))
            self._slow.append(HeldNoise(flicker.means, hold).take)
        if noise.rate_random_walk_deg_per_h_per_sqrt_h > 0.0:
            k = noise.rate_random_walk_deg_per_h_per_sqrt_h
            self._slow.append(rate_random_walk(k, hold_s, seeds.of_power_on("walk")).means)
        for i, markov in enumerate(noise.markov):
            sd, correlation_s = np.array([markov.sd_deg_per_h]), np.array([markov.correlation_s])
            self._slow.append(ornstein_uhlenbeck(sd, correlation_s, hold_s, seeds.of_power_on(f"markov {i}")).means)

    def add_slow(self, elapsed_s: FloatArray, out: FloatArray) -> None:
        """Add the noise that is held, deg/h, of the next hold intervals."""
        if self._noise.rate_ramp_deg_per_h_per_h != 0.0:
            out += self._noise.rate_ramp_deg_per_h_per_h * (elapsed_s / SECONDS_PER_HOUR)
        for means in self._slow:
            out += means(len(out))

    def add_fast(self, rate_deg_per_s: FloatArray) -> None:
        """Add the white and quantisation noise, deg/s, of the next samples."""
        if self._noise.angle_random_walk_deg_per_sqrt_h > 0.0:
            white = self._white.standard_normal(len(rate_deg_per_s))
            white *= self._white_sd / SECONDS_PER_HOUR
            rate_deg_per_s += white
        if self._noise.angle_quantum_arcsec > 0.0:
            angle = self._angle.random(len(rate_deg_per_s))
            step = self._quantum_deg_per_h / SECONDS_PER_HOUR
            self._last_angle = _add_differences(angle, self._last_angle, step, rate_deg_per_s)
