"""Noise inflation: excess of the noise over its model at the time scale of an effect.

A wrong noise model makes noise pass for an effect. Two signs: the replicates disagree about the coefficients of the
effect, and the whitened residual is not white at its time scale.
"""

from collections.abc import Sequence

import numpy as np
from scipy import fft, stats

from analytics.loop.tracing.whitening.joint_fit import JointFit
from analytics.loop.tracing.whitening.least_squares import orthonormal
from stream.batch import FloatArray, IntArray

BY_CHANCE = 0.01
TRUST = 4
_LEAST_SHARE = 0.01
"""Least share of the information that a replicate needs to count."""


def noise_inflation(joint: JointFit, replicates: Sequence[IntArray], runs: Sequence[IntArray], tried: int) -> float:
    """Ratio of the noise variance to its model at the time scale of the last common columns; at least 1.

    Parameters
    ----------
    joint: Fit with these columns.
    replicates, runs: For each record, the replicate and the run of each block.
    tried: Number of these columns.
    """
    alone = [_alone(whitened, tried) for whitened in joint.whitened]
    return max(_disagreement(alone, replicates), redness([driver for driver, _ in alone], joint.residuals, runs))


def _alone(whitened: FloatArray, tried: int) -> tuple[FloatArray, FloatArray]:
    """The last columns and the value, orthogonalised to all other columns."""
    basis = orthonormal(whitened[:, 1 : whitened.shape[1] - tried])
    kept = np.column_stack([whitened[:, whitened.shape[1] - tried :], whitened[:, 0]])
    kept = kept - basis @ (basis.T @ kept)
    return kept[:, :-1], kept[:, -1]


def _disagreement(alone: Sequence[tuple[FloatArray, FloatArray]], replicates: Sequence[IntArray]) -> float:
    """Birge ratio of Cochran's Q over replicates, if significant."""
    parts = [
        (driver[number == each].T @ driver[number == each], driver[number == each].T @ residual[number == each])
        for (driver, residual), number in zip(alone, replicates, strict=True)
        for each in np.unique(number)
    ]
    normal = np.sum([each for each, _ in parts], axis=0)
    right = np.sum([each for _, each in parts], axis=0)
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    common, rank = _explained(normal / np.outer(scale, scale), right / scale)
    each = [_explained(own_normal / np.outer(scale, scale), own_right / scale) for own_normal, own_right in parts]
    degrees = sum(own_rank for _, own_rank in each) - rank
    return _excess(sum(statistic for statistic, _ in each) - common, degrees)


def _explained(normal: FloatArray, right: FloatArray) -> tuple[float, int]:
    """Chi-square of columns scaled to an information of one in all, and its degrees of freedom."""
    eigenvalues, vectors = np.linalg.eigh(normal)
    resolved = eigenvalues > _LEAST_SHARE
    return float(np.sum((vectors[:, resolved].T @ right) ** 2 / eigenvalues[resolved])), int(np.count_nonzero(resolved))


def redness(drivers: Sequence[FloatArray], residuals: Sequence[FloatArray], runs: Sequence[IntArray]) -> float:
    """Power of whitened residuals by octave of frequency, weighted by the power of the columns; at least 1."""
    octaves = 1 + int(np.log2(max(max(np.bincount(number)) for number in runs)))
    residual_power, driver_power, count = np.zeros(octaves), np.zeros(octaves), np.zeros(octaves, dtype=np.int64)
    for driver, residual, number in zip(drivers, residuals, runs, strict=True):
        basis = orthonormal(driver)
        for run in np.unique(number):
            of_run = number == run
            octave = np.log2(np.maximum(np.arange(np.count_nonzero(of_run)), 1)).astype(np.int64)
            count += np.bincount(octave, minlength=octaves)
            residual_power += np.bincount(octave, _power(residual[of_run]), minlength=octaves)
            for column in basis[of_run].T:
                driver_power += np.bincount(octave, _power(column), minlength=octaves)
    excess = [_excess(power, int(degrees)) for power, degrees in zip(residual_power, count, strict=True)]
    total = float(driver_power.sum())
    return float(driver_power @ np.array(excess)) / total if total > 0 else 1.0


def _power(values: FloatArray) -> FloatArray:
    return np.asarray(fft.dct(values, norm="ortho") ** 2)


def _excess(chi_square: float, degrees: int) -> float:
    """Chi-square over degrees of freedom if significant, else 1; the noise model counts as `TRUST` agreeing degrees."""
    if degrees < 1 or chi_square < float(stats.chi2.isf(BY_CHANCE, degrees)):
        return 1.0
    return (chi_square + TRUST) / (degrees + TRUST)
