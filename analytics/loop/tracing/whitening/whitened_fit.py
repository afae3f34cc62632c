"""Fit of the noise coefficients together with a regression: penalised maximum likelihood by scoring steps.

Each step uses the expected curvature, corrected along the step before it to the change of the gradient over it.
"""

from dataclasses import dataclass

import numpy as np

from analytics.loop.model.error_model import ModelNoise
from analytics.loop.tracing.whitening.least_squares import Solution, fit, log_determinant
from analytics.loop.tracing.whitening.nudged_noise import nudged_sums
from analytics.loop.tracing.whitening.stack import UnitRecord, as_array, from_array
from stream.batch import FloatArray, IntArray

_DIFFERENCE = 1e-3  # of a logarithm, for derivatives
_LONGEST_STEP = 1.5
ENOUGH = 0.02  # nats gained by a further step
_MOST_STEPS = 8
_LEAST_CURVED = 0.1  # of the expected curvature; less is not used
_FAR = 1.5  # logarithm of a ratio of noise coefficients


@dataclass(frozen=True)
class WhitenedFit:
    """Noise and regression fitted together."""

    noise: ModelNoise
    log_likelihood: float  # including the prior of the noise, maximised over the coefficients
    solution: Solution
    whitened: FloatArray  # shape (n, 1 + columns); value and columns, whitened by the fitted noise
    innovation: FloatArray  # shape (n,); see `Whitener`

    @property
    def residual(self) -> FloatArray:
        """Whitened residual."""
        return np.asarray(self.whitened[:, 0] - self.whitened[:, 1:] @ self.solution.coefficients)

    @property
    def of_blocks(self) -> FloatArray:
        """Logarithm of the likelihood of each block, given the preceding blocks of its run, without a constant."""
        return np.asarray(-0.5 * (np.log(self.innovation) + self.residual**2))


@dataclass(frozen=True)
class _Data:
    """Value and columns of a record, and whether the likelihood is restricted."""

    record: UnitRecord
    columns: FloatArray
    restricted: bool


def fit_noise(
    record: UnitRecord, columns: FloatArray, start: ModelNoise | None = None, *, restricted: bool = False
) -> WhitenedFit:
    """Fit the noise, from `start` or the centre of the prior, and the coefficients of all columns (n, k) to a record.

    If `restricted`, by the restricted likelihood (REML): its noise is unbiased, but likelihoods of different columns
    are not comparable.
    """
    data = _Data(record, np.column_stack([record.value, columns]), restricted)
    active = np.flatnonzero(record.prior.values > 0).astype(np.int64)
    current = _evaluate(data, start or record.prior.center)
    begin, center = as_array(start or record.prior.center)[active], record.prior.values[active]
    if np.any(np.abs(np.log(begin / center)) > _FAR):
        # noise fitted without a large effect is a poor start once the effect is in the model
        declared = _evaluate(data, record.prior.center)
        current = max((current, declared), key=lambda each: each.log_likelihood)
    too_large = float(np.sqrt(np.mean(current.residual**2)))
    if np.log(max(too_large, 1.0)) > _FAR:  # an error that the model lacks may be a million times the noise
        scaled = _evaluate(data, from_array(as_array(current.noise) * too_large))
        current = max((current, scaled), key=lambda each: each.log_likelihood)
    before: tuple[WhitenedFit, FloatArray] | None = None
    for _ in range(_MOST_STEPS):
        score, information = _derivatives(data, current, active)
        if before is not None:
            moved = np.log(as_array(current.noise)[active] / as_array(before[0].noise)[active])
            information = _with_secant(information, moved, before[1] - score)
        before = current, score
        step = np.asarray(np.linalg.solve(information, score), dtype=np.float64)
        if 0.5 * float(score @ step) < ENOUGH:
            break
        step = step * min(1.0, _LONGEST_STEP / float(np.abs(step).max()))
        better = _climb(data, current, active, step)
        if better is None:
            break
        current = better
    return current


def evaluate(record: UnitRecord, columns: FloatArray, noise: ModelNoise) -> WhitenedFit:
    """Regression with a given noise."""
    return _evaluate(_Data(record, np.column_stack([record.value, columns]), restricted=False), noise)


def _evaluate(data: _Data, noise: ModelNoise) -> WhitenedFit:
    whitener = data.record.whitener(noise)
    whitened = whitener(data.columns)
    solution = fit(whitened[:, 1:], whitened[:, 0])
    residual = whitened[:, 0] - whitened[:, 1:] @ solution.coefficients
    log_likelihood = -0.5 * (whitener.log_determinant + float(residual @ residual))
    log_likelihood += data.record.prior.log_density(noise)
    if data.restricted:
        log_likelihood -= 0.5 * log_determinant(whitened[:, 1:].T @ whitened[:, 1:])
    return WhitenedFit(noise, log_likelihood, solution, whitened, whitener.innovation)


def _derivatives(data: _Data, at: WhitenedFit, active: IntArray) -> tuple[FloatArray, FloatArray]:
    """Gradient and expected curvature of the log likelihood, in logarithms of the active coefficients.

    At the maximum over the coefficients of the columns, their change does not count: one column is whitened, the
    residual, unless the likelihood is restricted.
    """
    nudged = [_nudged(at.noise, which) for which in active]
    residual = data.columns[:, 0] - data.columns[:, 1:] @ at.solution.coefficients
    found = nudged_sums(data.record, residual, nudged, at.residual * np.sqrt(at.innovation), at.innovation)
    if data.restricted:
        gained = np.array([_evaluate(data, noise).log_likelihood - at.log_likelihood for noise in nudged])
    else:
        density = data.record.prior.log_density
        prior = np.array([density(noise) - density(at.noise) for noise in nudged])
        gained = prior - 0.5 * (found.wider + found.squares - float(at.residual @ at.residual))
    curvature = found.products / _DIFFERENCE**2 + np.diag(data.record.prior.spread[active] ** -2.0)
    return gained / _DIFFERENCE, curvature


def _nudged(noise: ModelNoise, which: int) -> ModelNoise:
    """The noise with one coefficient a little larger."""
    values = as_array(noise)
    values[which] *= np.exp(_DIFFERENCE)
    return from_array(values)


def _with_secant(curvature: FloatArray, moved: FloatArray, change: FloatArray) -> FloatArray:
    """The curvature, corrected along the last step to the `change` of the gradient over it (BFGS).

    The expected curvature in the logarithm of a small coefficient is too small: steps jump across the maximum.
    """
    expected = curvature @ moved
    if float(moved @ change) < _LEAST_CURVED * float(moved @ expected):
        return curvature
    past = np.outer(expected, expected) / float(moved @ expected)
    return np.asarray(curvature - past + np.outer(change, change) / float(moved @ change))


def _climb(data: _Data, at: WhitenedFit, active: IntArray, step: FloatArray) -> WhitenedFit | None:
    """The first improvement along a step that is halved up to four times."""
    values = as_array(at.noise)
    for _ in range(5):
        moved = values.copy()
        moved[active] *= np.exp(step)
        trial = _evaluate(data, from_array(moved))
        if trial.log_likelihood > at.log_likelihood:
            return trial
        step = step / 2
    return None
