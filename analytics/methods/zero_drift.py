"""Uncertainty of a zero from a sequence of steps while it drifts."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.special import stdtr, stdtrit

from analytics.methods.confidence_bounds import CONFIDENCE
from stream.batch import FloatArray

# variance of the steps beyond the noise within them, in units of that, and the part of it that is drift
_BEYOND = 10.0 ** np.arange(-1, 6.5, 0.5)
_DRIFTING = (0.0, 0.1, 0.3, 0.6, 0.9, 1.0)
# prior weight of no scatter and no drift over each of these: chosen for coverage by simulation
_STILL = 20.0
# longest period of the drift, in lengths of the sequence
_PERIODS = 32
_MOST_STEPS = 400


class Sequence(NamedTuple):
    """Steps in order of time: the table turning, or at rest."""

    output: FloatArray  # shape (steps,), as all; mean output of each
    rate: FloatArray  # that was put in
    u: FloatArray  # standard uncertainty of the outputs from the noise within the steps; NaN if unknown
    freedom: FloatArray
    weights: FloatArray  # shape (steps,); the zero is the sum of the outputs with these weights


class Uncertainty(NamedTuple):
    """A standard uncertainty whose Student's t with these degrees of freedom gives the 95 % interval."""

    value: float
    freedom: float


def zero_uncertainty(steps: Sequence) -> Uncertainty | None:
    """Uncertainty of the zero against that of a much longer sequence; None where no step has an uncertainty.

    output = zero + k*rate + noise within the step + scatter from step to step + drift. The drift has a power spectral
    density of 1/f from a 32nd of the sequence's own lowest frequency on: bias instability, and much like the effect of
    a creeping temperature. Steps are taken as equally spaced. For each share of scatter and drift the variance
    of the zero follows from the weights; these are mixed by the restricted likelihoods of the shares. The noise within
    the steps bounds the drift from below; rests and rates, in the order in which they were measured, from above.
    Where only few steps lie far from the line, as of a nonlinearity, that is scatter.
    """
    known = np.isfinite(steps.u) & (steps.freedom > 0)
    n = steps.output.size
    if not known.any() or not 3 < n <= _MOST_STEPS:
        return None
    # scaled: squares of very large or small numbers would overflow
    size = max(float(np.abs(steps.output - steps.output[0]).max()), float(steps.u[known].max()))
    if not 0 < size < math.inf:
        return Uncertainty(0.0, float(n - 2)) if size == 0 else None
    freedom = np.maximum(steps.freedom[known], 1.0)
    within_freedom = float(freedom.sum())
    within = float(freedom @ (steps.u[known] / size) ** 2) / within_freedom
    fixed = np.column_stack([np.ones(n), steps.rate / max(float(np.abs(steps.rate).max()), 1e-300)])
    level = (steps.output - steps.output[0]) / size
    level -= level.mean()
    line = level - fixed @ np.linalg.lstsq(fixed, level, rcond=None)[0]
    spare = n - fixed.shape[1]
    # noise below rounding is set to the least scatter that the grid resolves
    within = max(within, float(line @ line) / spare * 2 / float(_BEYOND[-1]))
    if not within > 0:
        return Uncertainty(0.0, float(spare))
    noises = _noises(n)
    columns, values = noises.whitening @ fixed, noises.whitening @ line
    normal = columns.transpose(0, 2, 1) @ columns
    right = np.einsum("mij,mi->mj", columns, values)
    solved = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    squares = np.einsum("mi,mi->m", values, values) - np.einsum("mj,mj->m", right, solved)
    total = spare + within_freedom
    scale = np.maximum(squares, 0.0) + within_freedom * within
    likelihood = -0.5 * (noises.log_det + np.linalg.slogdet(normal)[1] + total * np.log(scale))
    likelihood[0] += math.log(_STILL)
    chance = np.exp(likelihood - likelihood.max())
    chance /= chance.sum()
    largest = float(np.abs(steps.weights).max())
    weights = steps.weights / largest
    variance = scale / total * np.einsum("i,mij,j->m", weights, noises.covariance, weights)
    errors = np.sqrt(np.maximum(variance, 1e-300))

    def outside(half: float) -> float:
        return float(chance @ (2 * stdtr(total, -half / errors))) - (1 - CONFIDENCE)

    half = brentq(outside, 0.0, 1e3 * float(errors.max()), xtol=1e-9 * float(errors.max()))
    return Uncertainty(float(half / stdtrit(spare, (1 + CONFIDENCE) / 2)) * size * largest, float(spare))


class _Noises(NamedTuple):
    """Covariances of the steps' means in units of the noise within them, and what makes them white."""

    covariance: FloatArray
    whitening: FloatArray
    log_det: FloatArray


@lru_cache(maxsize=32)
def _noises(n: int) -> _Noises:
    # covariance of the means of a drift; neighbours differ by a variance of 2
    frequency, lag = np.arange(1, 4 * _PERIODS * n) / (_PERIODS * n), np.arange(n)
    of_lag = np.cos(2 * math.pi * lag[:, None] * frequency) @ (np.sinc(frequency) ** 2 / frequency)
    of_lag /= of_lag[0] - of_lag[1]
    drift = of_lag[np.abs(lag[:, None] - lag[None, :])]
    shares = [(0.0, 0.0), *((beyond, part) for beyond in _BEYOND for part in _DRIFTING)]
    mixed = [np.eye(n) * (1 + beyond * (1 - part)) + beyond * part * drift for beyond, part in shares]
    covariance = np.array(mixed, np.float64)
    root = np.linalg.cholesky(covariance)
    log_det = 2 * np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
    return _Noises(covariance, np.linalg.inv(root), np.asarray(log_det, np.float64))
