"""Whitening: a Kalman filter turns blocks with correlated noise into blocks with white noise of unit variance.

The filter applies the inverse Cholesky factor of the noise covariance of a run to any number of columns in time
proportional to the number of blocks. Gaps between blocks are treated exactly.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from stream.batch import FloatArray, IntArray

SECONDS_PER_HOUR = 3600.0
STEP_OF_LADDER = 6.4  # ratio of correlation times: the sum of the states stays within 0.4 dB of 1/f


@dataclass(frozen=True)
class StateSpace:
    """Noise coefficients as parameters of a Kalman filter over blocks."""

    white: float  # variance of the white noise of a block mean
    start: float  # variance of the random-walk state at the start of a run
    walk: float  # increase of that variance per block
    decay: FloatArray  # shape (states,); per block, of each Ornstein-Uhlenbeck state
    variance: FloatArray  # shape (states,); stationary, of each


@dataclass(frozen=True)
class NoiseModel:
    """Action of noise coefficients on blocks of a given length in runs of a given length.

    Flicker is a sum of Ornstein-Uhlenbeck states whose correlation times span from twice the block to 3/4 of the
    longest run, each with the same variance, so that the sum has the spectrum B**2/(2*pi*f) in between.

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

    @cached_property
    def correlation_s(self) -> FloatArray:
        """Correlation times of the flicker states, seconds."""
        shortest = 2 * self.block_s
        longest = max(0.75 * self.longest_s, shortest)
        states = 1 + round(math.log(longest / shortest) / math.log(STEP_OF_LADDER))
        return np.geomspace(shortest, longest, states) if states > 1 else np.array([longest])

    def space(self, noise: ModelNoise) -> StateSpace:
        """State space of these coefficients."""
        return StateSpace(
            white=noise.N**2 / self.block_h,
            start=noise.turn_on**2,
            walk=noise.K**2 * self.block_h,
            decay=self._decay,
            variance=np.full(self._decay.size, self._flicker_share * noise.B**2),
        )

    @cached_property
    def _decay(self) -> FloatArray:
        return np.asarray(np.exp(-self.block_s / self.correlation_s))

    @cached_property
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


@dataclass(frozen=True)
class Whitener:
    """Kalman gains for the blocks of one unit, its runs concatenated."""

    steps: IntArray  # shape (n,); blocks since the preceding block; 0 at the first block of each run
    decay: FloatArray  # shape (states,); of each correlated state per block
    gain: FloatArray  # shape (n, states + 1); Kalman gains
    innovation: FloatArray  # shape (n,); variance of each block given the preceding blocks of its run

    @classmethod
    def of(cls, model: NoiseModel, noise: ModelNoise, steps: IntArray, white: FloatArray) -> "Whitener":
        """Filter for this noise; `white` is the white variance of each block relative to that of `noise`."""
        space = model.space(noise)
        gain = np.empty((steps.size, space.decay.size + 1))
        innovation = np.empty(steps.size)
        _filter_gains(
            steps, space.white * white, space.walk, space.start, space.decay, space.variance, gain, innovation
        )
        return cls(steps, space.decay, gain, innovation)

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the noise covariance."""
        return float(np.sum(np.log(self.innovation)))

    def __call__(self, columns: FloatArray) -> FloatArray:
        """Whitened columns, shape (n, columns)."""
        out = np.empty(columns.shape)
        _whiten(np.ascontiguousarray(columns), self.steps, self.decay, self.gain, self.innovation, out)
        return out

    def colour(self, columns: FloatArray) -> FloatArray:
        """Invert the whitening: white columns of variance one become noise of this covariance."""
        out = np.empty(columns.shape)
        _colour(np.ascontiguousarray(columns), self.steps, self.decay, self.gain, self.innovation, out)
        return out

    def adjoint(self, columns: FloatArray) -> FloatArray:
        """Apply the transpose: `sum(self(x) * u) == sum(x * self.adjoint(u))` for any x."""
        out = np.empty(columns.shape)
        _whiten_adjoint(np.ascontiguousarray(columns), self.steps, self.decay, self.gain, self.innovation, out)
        return out


def whitened_residual(
    model: ErrorModel, run: RunBlocks, noise: ModelNoise, *, longest_s: float | None = None
) -> FloatArray:
    """Whitened residual of a fitted error model in each block of a run; NaN where a channel is missing.

    It has unit variance and is uncorrelated if model and noise are right. A block whose own scatter gives another
    white variance than `noise` keeps that variance. `longest_s` is the length of the longest run that the noise was
    fitted to, by default of this run.

    >>> rng = np.random.default_rng(1)
    >>> run = RunBlocks("U1", "r1", "rate", np.arange(500), 36.0, 0, 7.0 + rng.normal(0.0, 2.0, 500),
    ...                 np.full(500, 9), np.full(500, 4.0), "deg/h")
    >>> model = ErrorModel.parse("bias").fitted([7.0])
    >>> left = whitened_residual(model, run, ModelNoise(N=0.2, B=0.0, K=0.0, turn_on=0.0))
    >>> 0.9 < float(left.std()) < 1.1
    True
    """
    residual = model.residual(run)
    kept = np.isfinite(residual)
    if not kept.any():
        return residual
    slot = run.slot[kept]
    length_s = float(run.slot[-1] + 1 - run.slot[0]) * run.block_s
    noise_model = NoiseModel(run.block_s, length_s if longest_s is None else longest_s)
    expected = noise_model.space(noise).white
    own = run.white_variance[kept]
    relative = np.where(np.isfinite(own) & (own > 0.0), own / expected, 1.0)
    steps = np.diff(slot, prepend=slot[0])
    whitened = np.full(len(run), np.nan)
    whitened[kept] = Whitener.of(noise_model, noise, steps, relative)(residual[kept, None])[:, 0]
    return whitened


@njit(cache=True, nogil=True, fastmath=True)
def _begin(covariance, start, variance):  # type: ignore[no-untyped-def]
    covariance[:] = 0.0
    covariance[0, 0] = start
    for i in range(variance.size):
        covariance[i + 1, i + 1] = variance[i]


@njit(cache=True, nogil=True, fastmath=True)
def _step(step, walk, decay, variance, shrink, grow):  # type: ignore[no-untyped-def]
    """Set what a number of blocks multiplies the covariance by, and what it adds on the diagonal."""
    shrink[0, 0], grow[0] = 1.0, walk * step
    for i in range(decay.size):
        factor = decay[i] ** step
        shrink[0, i + 1] = shrink[i + 1, 0] = factor
        grow[i + 1] = variance[i] * (1 - factor * factor)
        for j in range(decay.size):
            shrink[i + 1, j + 1] = factor * decay[j] ** step


@njit(cache=True, nogil=True, fastmath=True)
def _filter_gains(steps, white, walk, start, decay, variance, gain, innovation):  # type: ignore[no-untyped-def]
    n, states = steps.size, decay.size + 1
    column, grow = np.empty(states), np.empty(states)
    covariance, shrink = np.zeros((states, states)), np.empty((states, states))
    prepared = 0  # number of blocks that `shrink` and `grow` are for
    for t in range(n):
        if steps[t] == 0:
            _begin(covariance, start, variance)
        else:
            if steps[t] != prepared:
                prepared = steps[t]
                _step(prepared, walk, decay, variance, shrink, grow)
            for i in range(states):
                for j in range(states):
                    covariance[i, j] *= shrink[i, j]
                covariance[i, i] += grow[i]
        total = white[t]
        for i in range(states):
            row = 0.0
            for j in range(states):
                row += covariance[i, j]
            column[i] = row
            total += row
        innovation[t] = total
        per_total = 1 / total
        for i in range(states):
            own = column[i] * per_total
            gain[t, i] = own
            for j in range(states):
                covariance[i, j] -= own * column[j]


@njit(cache=True, nogil=True, fastmath=True)
def _whiten(columns, steps, decay, gain, innovation, out):  # type: ignore[no-untyped-def]
    n, width = columns.shape
    states = decay.size + 1
    state = np.zeros((states, width))
    for t in range(n):
        step = steps[t]
        if step == 0:
            state[:] = 0.0
        else:
            for i in range(1, states):
                factor = decay[i - 1] if step == 1 else decay[i - 1] ** step
                for c in range(width):
                    state[i, c] *= factor
        scale = 1 / np.sqrt(innovation[t])
        for c in range(width):
            out[t, c] = columns[t, c] - state[0, c]
        for i in range(1, states):
            for c in range(width):
                out[t, c] -= state[i, c]
        for i in range(states):
            for c in range(width):
                state[i, c] += gain[t, i] * out[t, c]
        for c in range(width):
            out[t, c] *= scale


@njit(cache=True, nogil=True, fastmath=True)
def _colour(columns, steps, decay, gain, innovation, out):  # type: ignore[no-untyped-def]
    n, width = columns.shape
    states = decay.size + 1
    state = np.zeros((states, width))
    for t in range(n):
        if steps[t] == 0:
            state[:] = 0.0
        else:
            for i in range(1, states):
                factor = decay[i - 1] ** steps[t]
                for c in range(width):
                    state[i, c] *= factor
        scale = np.sqrt(innovation[t])
        for c in range(width):
            out[t, c] = scale * columns[t, c]
            for i in range(states):
                out[t, c] += state[i, c]
        for i in range(states):
            for c in range(width):
                state[i, c] += gain[t, i] * scale * columns[t, c]


@njit(cache=True, nogil=True, fastmath=True)
def _whiten_adjoint(columns, steps, decay, gain, innovation, out):  # type: ignore[no-untyped-def]
    n, width = columns.shape
    states = decay.size + 1
    state = np.zeros((states, width))
    for t in range(n - 1, -1, -1):
        scale = 1 / np.sqrt(innovation[t])
        for c in range(width):
            out[t, c] = scale * columns[t, c]
        for i in range(states):
            for c in range(width):
                out[t, c] += gain[t, i] * state[i, c]
        step = steps[t]
        for i in range(states):
            factor = 1.0 if i == 0 or step == 0 else decay[i - 1] ** step
            for c in range(width):
                state[i, c] = 0.0 if step == 0 else factor * (state[i, c] - out[t, c])
