"""Noise model of a trace: white noise, flicker, random walk and turn-on scatter, as a state space of blocks."""

import math
from dataclasses import dataclass

import numpy as np

from analytics.loop.model.noise import ModelNoise
from stream.batch import FloatArray

SECONDS_PER_HOUR = 3600.0
STEP_OF_LADDER = 6.4  # ratio of correlation times: the sum of the states stays within 0.4 dB of 1/f


@dataclass(frozen=True)
class StateSpace:
    """Noise coefficients as parameters of a Kalman filter over blocks.

    Parameters
    ----------
    white: Variance of the white noise of a block mean.
    start: Variance of the random-walk state at the start of a run.
    walk: Increase of that variance per block.
    decay, variance: shape (states,); decay per block and stationary variance of each Ornstein-Uhlenbeck state.
    """

    white: float
    start: float
    walk: float
    decay: FloatArray
    variance: FloatArray


@dataclass(frozen=True)
class NoiseModel:
    """Action of noise coefficients on blocks of a given length in runs of a given length.

    Flicker is a sum of Ornstein-Uhlenbeck states whose correlation times span from twice the block to 3/4 of the
    longest run, each with the same variance, so that the sum has the spectrum B**2/(2*pi*f) in between.

    Examples
    --------
    >>> model = NoiseModel(block_s=30.0, longest_s=21600.0)
    >>> model.correlation_s.round().tolist()
    [60.0, 388.0, 2506.0, 16200.0]
    >>> model.space(ModelNoise(N=0.01, B=0.0, K=0.0, turn_on=0.0)).white  # 0.01**2 / (30 s in hours)
    0.012
    """

    block_s: float
    longest_s: float

    @property
    def block_h(self) -> float:
        """Length of a block in hours."""
        return self.block_s / SECONDS_PER_HOUR

    @property
    def correlation_s(self) -> FloatArray:
        """Correlation times of the flicker states, seconds."""
        shortest = 2 * self.block_s
        longest = max(0.75 * self.longest_s, shortest)
        states = 1 + round(math.log(longest / shortest) / math.log(STEP_OF_LADDER))
        return np.geomspace(shortest, longest, states) if states > 1 else np.array([longest])

    def space(self, noise: ModelNoise) -> StateSpace:
        """State space of these coefficients."""
        correlation_s = self.correlation_s
        return StateSpace(
            white=noise.N**2 / self.block_h,
            start=noise.turn_on**2,
            walk=noise.K**2 * self.block_h,
            decay=np.exp(-self.block_s / correlation_s),
            variance=np.full(correlation_s.size, self._flicker_share() * noise.B**2),
        )

    def _flicker_share(self) -> float:
        """Variance of each flicker state per B**2."""
        correlation_s = self.correlation_s[:, None]
        lowest, highest = 1 / max(self.longest_s, 8 * self.block_s), 1 / (5 * self.block_s)
        frequency = np.geomspace(lowest, highest, 60)
        unit = np.sum(2 * correlation_s / (1 + (2 * np.pi * frequency * correlation_s) ** 2), axis=0)
        return float(np.exp(np.mean(np.log(1 / (2 * np.pi * frequency) / unit))))

    def average_variance(self, noise: ModelNoise, averaging_s: float) -> float:
        """Allan variance at an averaging time."""
        tau_h = averaging_s / SECONDS_PER_HOUR
        return noise.N**2 / tau_h + 2 * math.log(2) / math.pi * noise.B**2 + noise.K**2 * tau_h / 3

    def covariance(self, noise: ModelNoise, slot: FloatArray, white: FloatArray) -> FloatArray:
        """Dense covariance of the blocks of one run; `white` is relative to the white variance of `noise`."""
        space = self.space(noise)
        since_start = slot - slot[0]
        apart = np.abs(slot[:, None] - slot[None, :])
        total = np.diag(space.white * white) + space.start
        total += space.walk * np.minimum(since_start[:, None], since_start[None, :])
        for decay, variance in zip(space.decay, space.variance, strict=True):
            total += variance * decay**apart
        return np.asarray(total)
