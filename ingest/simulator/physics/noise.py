"""Noise of a gyro by the coefficients of IEEE 952: Q, N, B, K, R and Markov, in deg/h at the output."""

import msgspec
import numpy as np
from numba import njit

from ingest.simulator.noise import (
    SECONDS_PER_HOUR,
    GaussMarkovSum,
    flicker_noise,
    ornstein_uhlenbeck,
    rate_random_walk,
    white_sd_deg_per_h,
)
from ingest.simulator.physics.scale import NotNegative, Positive
from ingest.simulator.physics.seeds import Seeds
from stream.batch import FloatArray

FLICKER_HOLD_S = 0.02
_INTERVALS_AT_ONCE = 2048


class Markov(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """First-order Gauss-Markov noise.

    Parameters
    ----------
    sd_deg_per_h, correlation_s: Standard deviation and correlation time.

    Notes
    -----
    A disturbance with a memory: draughts, a control loop, a slow exchange of heat. Autocovariance
    s^2 exp(-abs(t)/T); Allan variance 2 s^2 (T/tau)(1 - (T/2 tau)(3 - 4 exp(-tau/T) + exp(-2 tau/T)))
    (IEEE 952-1997 C.1.2.1, with q_c^2 = 2 s^2/T).
    """

    sd_deg_per_h: NotNegative
    correlation_s: Positive


class Noise(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Noise of a gyro.

    Parameters
    ----------
    angle_quantum_arcsec: Step of the angle that the gyro counts; Q is the step over sqrt(12).
    angle_random_walk_deg_per_sqrt_h: N.
    bias_instability_deg_per_h: B; the floor of the Allan deviation is 0.664 B.
    rate_random_walk_deg_per_h_per_sqrt_h: K.
    rate_ramp_deg_per_h_per_h: R, with its sign; 0 at power-on.
    markov: Markov noises.

    Notes
    -----
    Shot noise of the detector makes white rate (N), electronics flicker (B), ageing and slow exchange of heat a walk
    (K) or ramp (R), and reading out a counter of angle the quantisation noise (Q): an error e of the angle that is
    new at every sample, uniform over one step, of which the rate sees (e_k - e_k-1)/dt. Allan variances
    3 Q^2/tau^2, N^2/tau, (2 ln 2/pi) B^2, K^2 tau/3, R^2 tau^2/2 (IEEE 952-1997 C.1.1).
    All refer to the output, behind the bandwidth of the gyro.
    """

    angle_quantum_arcsec: NotNegative = 0.0
    angle_random_walk_deg_per_sqrt_h: NotNegative = 0.0
    bias_instability_deg_per_h: NotNegative = 0.0
    rate_random_walk_deg_per_h_per_sqrt_h: NotNegative = 0.0
    rate_ramp_deg_per_h_per_h: float = 0.0
    markov: tuple[Markov, ...] = ()


@njit(cache=True, nogil=True)
def _add_held(held: FloatArray, hold: int, first: int, out: FloatArray) -> None:
    """Add held[(first + i) // hold] to out[i]."""
    j = first // hold
    left = hold - first % hold
    for i in range(out.shape[0]):
        if left == 0:
            j += 1
            left = hold
        left -= 1
        out[i] += held[j]


@njit(cache=True, nogil=True)
def _add_differences(angle: FloatArray, before: float, per_interval: float, out: FloatArray) -> float:
    for i in range(angle.shape[0]):
        out[i] += per_interval * (angle[i] - before)
        before = angle[i]
    return before


class HeldNoise:
    """A process drawn as its exact means over intervals of `hold` samples and held within them.

    Parameters
    ----------
    process: The process, of intervals of `hold` samples.
    hold: Samples in an interval.
    """

    def __init__(self, process: GaussMarkovSum, hold: int) -> None:
        self._process, self._hold = process, hold
        self._held = np.empty(0)
        self._used = 0

    def add(self, out: FloatArray) -> None:
        """Add the process to the next samples."""
        done = 0
        while done < len(out):
            if self._used == len(self._held) * self._hold:
                self._held = self._process.means(_INTERVALS_AT_ONCE)
                self._used = 0
            m = min(len(out) - done, len(self._held) * self._hold - self._used)
            _add_held(self._held, self._hold, self._used, out[done : done + m])
            self._used += m
            done += m


class NoiseEffect:
    """Noise of one power-on.

    Parameters
    ----------
    noise: What is planted.
    seeds: Of the power-on.
    interval_s: Sample interval.
    """

    def __init__(self, noise: Noise, seeds: Seeds, interval_s: float) -> None:
        self._noise = noise
        self._white = seeds.of_power_on("white")
        self._white_sd = white_sd_deg_per_h(noise.angle_random_walk_deg_per_sqrt_h, interval_s)
        self._angle = seeds.of_power_on("angle quantum")
        # arcsec/s is deg/h
        self._quantum_deg_per_h = noise.angle_quantum_arcsec / interval_s
        self._last_angle = float(self._angle.random())
        self._held: list[HeldNoise] = []
        if noise.bias_instability_deg_per_h > 0.0:
            # fourteen processes are dear: held within 0.02 s, the curve is that of the bank from 0.1 s on
            hold = max(1, round(FLICKER_HOLD_S / interval_s))
            flicker = flicker_noise(noise.bias_instability_deg_per_h, hold * interval_s, seeds.of_power_on("flicker"))
            self._held.append(HeldNoise(flicker, hold))
        if noise.rate_random_walk_deg_per_h_per_sqrt_h > 0.0:
            walk = rate_random_walk(noise.rate_random_walk_deg_per_h_per_sqrt_h, interval_s, seeds.of_power_on("walk"))
            self._held.append(HeldNoise(walk, 1))
        for i, markov in enumerate(noise.markov):
            sd, correlation_s = np.array([markov.sd_deg_per_h]), np.array([markov.correlation_s])
            process = ornstein_uhlenbeck(sd, correlation_s, interval_s, seeds.of_power_on(f"markov {i}"))
            self._held.append(HeldNoise(process, 1))

    def add(self, elapsed_s: FloatArray, out: FloatArray) -> None:
        """Add the noise, deg/h, of the next samples."""
        p = self._noise
        if p.angle_random_walk_deg_per_sqrt_h > 0.0:
            out += self._white_sd * self._white.standard_normal(len(out))
        if p.angle_quantum_arcsec > 0.0:
            angle = self._angle.random(len(out))
            self._last_angle = _add_differences(angle, self._last_angle, self._quantum_deg_per_h, out)
        if p.rate_ramp_deg_per_h_per_h != 0.0:
            out += p.rate_ramp_deg_per_h_per_h * (elapsed_s / SECONDS_PER_HOUR)
        for held in self._held:
            held.add(out)
