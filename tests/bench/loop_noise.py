"""Noise of a gyro at even instants, made without any state-space model, and nine ways in which it is not as declared.

White noise, 1/f noise by spectral synthesis, random walk as a running sum, and a scatter from turn-on to turn-on.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cholesky, solve_triangular, toeplitz

from stream.batch import FloatArray, IntArray

MISSPECIFIED = (
    "random_walk_3x",
    "steep_flicker",
    "heavy_tails",
    "rate_dependent_white",
    "undeclared_markov",
    "correlated_turn_on",
    "white_1p3",
    "bursts",
    "quantised",
)
EXCESSIVE = ("steep_flicker", "doubled")
"""Noise so far from the declared one that a diagnosis must say so: 1/f**3, and all coefficients twice as large."""
_PADDED = 8


@dataclass(frozen=True)
class Noise:
    """Coefficients of a gyro's noise.

    Parameters
    ----------
    n, b, k, turn_on : float
        Angle random walk in deg/sqrt(h), bias instability in deg/h (density B**2/(2 pi f)), rate random walk in
        deg/h/sqrt(h), scatter of the bias between power-ons in deg/h.
    """

    n: float = 0.005
    b: float = 0.01
    k: float = 0.006
    turn_on: float = 0.05


def flicker_density(b: float, frequency_hz: FloatArray, steepness: float = 1.0) -> FloatArray:
    """One-sided density in (deg/h)**2/Hz; a steeper one meets 1/f at 1 mHz."""
    return np.asarray(b**2 / (np.pi * frequency_hz) * (frequency_hz / 1e-3) ** (1.0 - steepness))


def flicker(b: float, size: int, step_s: float, rng: np.random.Generator, steepness: float = 1.0) -> FloatArray:
    """1/f**steepness noise from white phases and the square root of its density."""
    padded = 2 ** int(np.ceil(np.log2(_PADDED * size)))
    frequency_hz = np.fft.rfftfreq(padded, step_s)[1:]
    # below one period in three runs a steep density would be nothing but a huge constant
    density = flicker_density(b, np.maximum(frequency_hz, 1.0 / (3.0 * size * step_s)), steepness)
    amplitude = np.sqrt(density * padded / (4.0 * step_s))
    waves = (rng.standard_normal(frequency_hz.size) + 1j * rng.standard_normal(frequency_hz.size)) * amplitude
    return np.asarray(np.fft.irfft(np.concatenate(([0.0], waves)), padded)[:size])


def synthesise(
    rates: Sequence[FloatArray], step_s: float, noise: Noise, misspecified: str, rng: np.random.Generator
) -> list[FloatArray]:
    """Noise of each run in deg/h, at the instants at which the rate of the table is given in deg/s."""
    if misspecified not in ("", *MISSPECIFIED, *EXCESSIVE):
        raise ValueError(f"{misspecified!r} is none of {', '.join((*MISSPECIFIED, *EXCESSIVE))}")
    turn_on = rng.standard_normal(len(rates)) * noise.turn_on
    if misspecified == "correlated_turn_on":
        turn_on = np.cumsum(turn_on) * 0.7
    return [
        start + _one_run(rate, step_s, _as_it_is(noise, misspecified), misspecified, rng)
        for start, rate in zip(turn_on, rates, strict=True)
    ]


def _as_it_is(declared: Noise, misspecified: str) -> Noise:
    factors: Mapping[str, Noise] = {
        "random_walk_3x": replace(declared, k=3.0 * declared.k),
        "white_1p3": replace(declared, n=1.3 * declared.n),
        "doubled": replace(declared, n=2.0 * declared.n, b=2.0 * declared.b, k=2.0 * declared.k),
    }
    return factors.get(misspecified, declared)


def _one_run(rate: FloatArray, step_s: float, noise: Noise, misspecified: str, rng: np.random.Generator) -> FloatArray:
    size, hours = rate.size, step_s / 3600.0
    white = rng.standard_normal(size)
    if misspecified == "heavy_tails":
        # outliers as long as a block, so that its mean has heavy tails too
        scale = np.sqrt(3.0 / np.repeat(rng.chisquare(3.0, size // 15 + 1), 15)[:size])
        white = white * scale / np.sqrt(3.0)
    elif misspecified == "rate_dependent_white":
        white = white * (1.0 + 0.15 * np.abs(rate))
    elif misspecified == "bursts":
        is_burst = np.repeat(rng.random(size // 150 + 1) < 0.03, 150)[:size]
        white = np.where(is_burst, 5.0 * white, white)
    walk = np.cumsum(rng.standard_normal(size)) * noise.k * np.sqrt(hours)
    steepness = 3.0 if misspecified == "steep_flicker" else 1.0
    total = white * noise.n / np.sqrt(hours) + walk + flicker(noise.b, size, step_s, rng, steepness)
    if misspecified == "undeclared_markov":
        total = total + _markov(0.04, 900.0, size, step_s, rng)
    if misspecified == "quantised":
        # the angle is counted in whole quanta
        quantum_deg = 1e-3
        angle = np.floor(np.cumsum(total) * hours / quantum_deg + rng.random()) * quantum_deg
        total = np.diff(angle, prepend=0.0) / hours
    return np.asarray(total)


def _markov(sd: float, correlation_s: float, size: int, step_s: float, rng: np.random.Generator) -> FloatArray:
    frequency_hz = np.fft.rfftfreq(_PADDED * size, step_s)
    density = 4.0 * sd**2 * correlation_s / (1.0 + (2.0 * np.pi * frequency_hz * correlation_s) ** 2)
    waves = rng.standard_normal(frequency_hz.size) + 1j * rng.standard_normal(frequency_hz.size)
    amplitude = np.sqrt(density * _PADDED * size / (4.0 * step_s))
    return np.asarray(np.fft.irfft(waves * amplitude, _PADDED * size)[:size])


class DenseWhitener:
    """Whitens the block means of runs by the Cholesky factor of their covariance, written down in closed form.

    Parameters
    ----------
    slots : sequence of array of int
        Blocks of each run.
    block_s : float
    noise : Noise
        As declared.
    """

    def __init__(self, slots: Sequence[IntArray], block_s: float, noise: Noise) -> None:
        self._lengths = [slot.size for slot in slots]
        known: dict[bytes, FloatArray] = {}
        self._factors = []
        for slot in slots:
            key = np.asarray(slot).tobytes()
            if key not in known:
                known[key] = cholesky(block_covariance(np.asarray(slot, float), block_s, noise), lower=True)
            self._factors.append(known[key])

    def __call__(self, stacked: FloatArray) -> FloatArray:
        """Columns of all runs, one under the other."""
        parts = np.split(stacked, np.cumsum(self._lengths)[:-1])
        whitened = [
            solve_triangular(factor, part, lower=True) for factor, part in zip(self._factors, parts, strict=True)
        ]
        return np.concatenate(whitened)


def block_covariance(slot: FloatArray, block_s: float, noise: Noise) -> FloatArray:
    """Covariance of block means in (deg/h)**2: white, 1/f, random walk and turn-on."""
    hours = block_s / 3600.0
    order = (slot - slot[0]).astype(int)
    size = int(order[-1]) + 1
    # the mean of a block is a filter of the density
    padded = 2 ** int(np.ceil(np.log2(_PADDED * size))) * 16
    frequency_hz = np.fft.rfftfreq(padded, block_s / 16)[1:]
    floor_hz = 1.0 / (3.0 * size * block_s)
    density = flicker_density(noise.b, np.maximum(frequency_hz, floor_hz)) * np.sinc(frequency_hz * block_s) ** 2
    lags = np.fft.irfft(np.concatenate(([0.0], density)), padded) * padded / 2.0 * frequency_hz[0]
    pink = toeplitz(lags[: size * 16 : 16])[np.ix_(order, order)]
    earlier = np.minimum.outer(order, order)
    walk = noise.k**2 * hours * (earlier + 0.5 - np.eye(slot.size) / 6.0)
    return np.asarray(pink + walk + np.eye(slot.size) * noise.n**2 / hours + noise.turn_on**2)
