"""The input of the search: blocks of one unit, the white variance of each, and the prior of the noise."""

from dataclasses import dataclass, replace

import numpy as np

from analytics.loop.model.noise import ModelNoise
from analytics.loop.tracing.whitening.block_noise import NoiseModel
from analytics.loop.tracing.whitening.stack import Stack
from analytics.loop.tracing.whitening.whitener import Whitener
from stream.batch import FloatArray, IntArray

DECLARED_SPREAD = np.array([0.1, 0.7, 0.7, 0.7])
"""Standard deviation of the logarithm of N, B, K and turn-on scatter about the declared values."""
ESTIMATED_SPREAD = np.array([0.3, 1.5, 1.5, 1.5])
"""The same about values estimated from the data."""
SINGLE_RUN_SPREAD = np.array([0.3, 0.3, 0.3, 1.5])
"""The same for a single run."""


@dataclass(frozen=True)
class NoisePrior:
    """Log-normal prior of the noise; a coefficient of zero stays zero.

    Parameters
    ----------
    center: Declared noise, or noise estimated from the data.
    spread: shape (4,); standard deviations of the logarithms.
    """

    center: ModelNoise
    spread: FloatArray

    @property
    def values(self) -> FloatArray:
        """N, B, K and turn-on scatter."""
        return as_array(self.center)

    def log_density(self, noise: ModelNoise) -> float:
        """Logarithm of the density, up to a constant."""
        active = self.values > 0
        apart = np.log(as_array(noise)[active] / self.values[active]) / self.spread[active]
        return -0.5 * float(apart @ apart)


def as_array(noise: ModelNoise) -> FloatArray:
    """N, B, K and turn-on scatter as an array."""
    return np.array([noise.N, noise.B, noise.K, noise.turn_on])


def from_array(values: FloatArray) -> ModelNoise:
    """Inverse of `as_array`."""
    n, b, k, turn_on = map(float, values)
    return ModelNoise(N=n, B=b, K=k, turn_on=turn_on)


@dataclass(frozen=True)
class UnitRecord:
    """The blocks of one unit as the filter reads them.

    Parameters
    ----------
    value: shape (n,); the signal.
    design: shape (n, p); columns of the declared model.
    steps: shape (n,); see `Whitener`.
    noise_model: Action of noise coefficients on these blocks.
    white: shape (n,); white variance of each block relative to that of `prior.center`.
    """

    stack: Stack
    value: FloatArray
    design: FloatArray
    steps: IntArray
    noise_model: NoiseModel
    prior: NoisePrior
    white: FloatArray

    def __len__(self) -> int:
        return self.value.size

    @property
    def unit(self) -> str:
        """The unit's serial number."""
        return self.stack.runs[0].unit

    def whitener(self, noise: ModelNoise) -> Whitener:
        """The filter for this noise."""
        return Whitener.of(self.noise_model, noise, self.steps, self.white)

    def less(self, part: FloatArray) -> "UnitRecord":
        """The same blocks with a part of the signal subtracted."""
        return replace(self, value=self.value - part)
