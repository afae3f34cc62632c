"""What the search works on: the blocks of one unit with the white variance of each and what is known of its noise."""

from dataclasses import dataclass, replace

import numpy as np

from analytics.loop.model.noise import NoiseCoefficients
from analytics.loop.tracing.noise_model import NoiseModel
from analytics.loop.tracing.stack import Stack
from analytics.loop.tracing.whitening import Whitener
from stream.batch import FloatArray, IntArray

DECLARED_SPREAD = np.array([0.1, 0.7, 0.7, 0.7])
"""Standard deviation of the logarithm of N, B, K and turn-on about what was declared."""
ESTIMATED_SPREAD = np.array([0.3, 1.5, 1.5, 1.5])
"""The same about what was guessed from the data."""
SINGLE_RUN_SPREAD = np.array([0.3, 0.3, 0.3, 1.5])
"""The same where one run is all there is."""


@dataclass(frozen=True)
class NoisePrior:
    """Log-normal knowledge of the noise; a coefficient that is zero stays zero.

    Parameters
    ----------
    center: As declared, or as guessed from the data.
    spread: shape (4,); standard deviations of the logarithms.
    """

    center: NoiseCoefficients
    spread: FloatArray

    @property
    def values(self) -> FloatArray:
        """N, B, K and turn-on."""
        return as_array(self.center)

    def log_density(self, noise: NoiseCoefficients) -> float:
        """Logarithm of the density, but for a constant."""
        active = self.values > 0
        apart = np.log(as_array(noise)[active] / self.values[active]) / self.spread[active]
        return -0.5 * float(apart @ apart)


def as_array(noise: NoiseCoefficients) -> FloatArray:
    """N, B, K and turn-on as an array."""
    return np.array([noise.N, noise.B, noise.K, noise.turn_on])


def from_array(values: FloatArray) -> NoiseCoefficients:
    """Return the coefficients of an array of N, B, K and turn-on."""
    n, b, k, turn_on = map(float, values)
    return NoiseCoefficients(N=n, B=b, K=k, turn_on=turn_on)


@dataclass(frozen=True)
class Record:
    """The blocks of one unit, ready for the filter.

    Parameters
    ----------
    stack: The blocks.
    value: shape (n,); the signal.
    design: shape (n, p); the declared model.
    steps: shape (n,); for the filter.
    noise_model: How noise acts on them.
    prior: What is known of the noise.
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
        """Whose it is."""
        return self.stack.runs[0].unit

    def whitener(self, noise: NoiseCoefficients) -> Whitener:
        """Return the filter for this noise."""
        return Whitener.of(self.noise_model, noise, self.steps, self.white)

    def less(self, part: FloatArray) -> "Record":
        """Return the same blocks with a part of the signal taken away."""
        return replace(self, value=self.value - part)
