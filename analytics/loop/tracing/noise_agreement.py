"""Does the noise that was declared agree with the noise that was measured? Either may be the larger."""

import math

import msgspec
import numpy as np

from analytics.loop.model.noise import NoiseCoefficients
from analytics.loop.tracing.adequacy import NOISE_P_VALUE, NoiseExcess
from analytics.loop.tracing.record import Record
from analytics.loop.tracing.run_scatter import RunScatter

MOST_APART = 1.25
"""Ratio of N as declared and as measured, either way, that is worth a word; the filter takes declared N for +-10 %."""
LEAST_OF_DECLARED = 1 / 1.3
"""Ratio of variances of long averages below which the declared noise is too large."""


def measured_noise(record: Record, noise: NoiseCoefficients) -> NoiseCoefficients:
    """Return the fitted noise with the white noise that the blocks show.

    The filter weighs each block by the scatter of its neighbours relative to the declared N, so that most of an error
    of the declared N is in the weights and not in the fitted N.
    """
    return msgspec.structs.replace(noise, N=noise.N * math.sqrt(float(np.median(record.white))))


def disagreements(
    declared: NoiseCoefficients, measured: NoiseCoefficients, excess: NoiseExcess, scatter: RunScatter | None
) -> list[str]:
    """Say where declared and measured noise disagree.

    Parameters
    ----------
    declared, measured: As declared, and as these runs show it.
    excess: Test of the noise at averages of 300 to 3600 s.
    scatter: Means of the runs; None where turn-on scatter was not declared.
    """
    told = []
    ratio = measured.N / declared.N
    if not 1 / MOST_APART < ratio < MOST_APART:
        told.append(
            f"white noise N was declared as {declared.N:.3g} and is {measured.N:.3g} in these runs: declared and "
            "measured noise disagree"
        )
    if excess.p_value < NOISE_P_VALUE and excess.least_ratio < LEAST_OF_DECLARED:
        told.append(
            f"less noise than declared at averages of 300 to 3600 s: its variance is {excess.least_ratio:.2g} times "
            "the declared one, so that small effects may have been taken for noise"
        )
    if scatter is not None and scatter.disagrees_with(declared.turn_on):
        told.append(
            f"turn-on scatter was declared as {declared.turn_on:.3g} and the runs scatter by {scatter.scatter:.3g}: "
            "declared and measured noise disagree"
        )
    return told
