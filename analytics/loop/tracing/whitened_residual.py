"""What a fitted error model leaves of a run, whitened: of unit variance and uncorrelated, if both are right."""

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.model.noise import NoiseCoefficients
from analytics.loop.tracing.noise_model import NoiseModel
from analytics.loop.tracing.whitening import Whitener
from stream.batch import FloatArray


def whitened_residual(
    model: ErrorModel, run: RunBlocks, noise: NoiseCoefficients, *, longest_s: float | None = None
) -> FloatArray:
    """Residual of each block, given those before it, in standard deviations; NaN where a channel is missing.

    Parameters
    ----------
    model: With coefficients.
    run: The run.
    noise: Of the signal. A block whose own scatter tells another white variance keeps that one.
    longest_s: Length of the longest run that the noise was fitted to, seconds; by default of this run.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> run = RunBlocks("U1", "r1", "rate", np.arange(500), 36.0, 0, 7.0 + rng.normal(0.0, 2.0, 500),
    ...                 np.full(500, 9), np.full(500, 4.0), "deg/h")
    >>> model = ErrorModel.parse("bias").fitted([7.0])
    >>> left = whitened_residual(model, run, NoiseCoefficients(N=0.2, B=0.0, K=0.0, turn_on=0.0))
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
