"""Held-out runs are predicted once, with frozen coefficients: effects are confirmed, refused, or cannot be judged."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from analytics.loop.effects.base import EffectKind
from analytics.loop.tracing.result.holdout import HeldOutAnswer, Holdout, HoldoutSlope
from analytics.loop.tracing.search.effect_search import Search, Selected
from analytics.loop.tracing.search.event_scans import amplitude_of, line_columns, powers_at
from analytics.loop.tracing.search.evidence import redness
from analytics.loop.tracing.search.screening import effect_columns
from analytics.loop.tracing.whitening.least_squares import Solution, fit_of_clusters, solve
from analytics.loop.tracing.whitening.stack import Stack, UnitRecord
from analytics.loop.tracing.whitening.white_variance import record_of
from analytics.methods.distributions import chi_square_sf, normal_log_density
from stream.batch import BoolArray, FloatArray

IS_PRESENT = 1.64  # standard errors by which the slope has to exceed zero: 5 % one-sided
SAME_SIZE = 3.29  # standard errors by which the slope may differ from one: refuses 1 in 1000 true effects
ODDS = 3.0  # likelihood of a slope if the effect is absent, over that if it is right, from which it is refused
LEAST_GAIN = 0.9  # gain of a prediction relative to its gain at the right size that is sufficient
LINE_P_VALUE = 0.005


@dataclass(frozen=True)
class HeldOutSet:
    """Held-out blocks of one unit with their predictions; n blocks in all, p declared coefficients."""

    record: UnitRecord  # all blocks of the unit: the filter needs those before the held-out ones
    held_out: BoolArray  # shape (n,); marks the held-out blocks
    declared: FloatArray  # shape (p,); coefficients of the declared model
    before: FloatArray  # shape (n,); its residual
    predictions: FloatArray  # shape (n, effects); each common effect, less its share in the declared coefficients
    covariance: FloatArray  # shape (p, p); of the declared coefficients
    # by the training's noise, (held out, 1 + effects + p); residual, predictions, declared columns
    whitened: FloatArray

    @property
    def after(self) -> FloatArray:
        """Residual of the model with all effects."""
        return np.asarray(self.before - self.predictions.sum(axis=1))

    @property
    def information(self) -> FloatArray:
        """Inverse of the covariance of the declared coefficients, whose units differ by orders of magnitude.

        Zero for what the training does not excite: nothing is known of it.
        """
        size = np.sqrt(np.diag(self.covariance))
        size[size == 0] = 1.0
        scale = np.outer(size, size)
        return np.asarray(np.linalg.pinv(self.covariance / scale, hermitian=True) / scale)

    @property
    def whitened_after(self) -> FloatArray:
        """The same, whitened, of the held-out blocks."""
        return np.asarray(self.whitened[:, 0] - self.whitened[:, 1 : 1 + self.predictions.shape[1]].sum(axis=1))

    @cached_property
    def declared_alone(self) -> Solution:
        """Coefficients of the declared model without the search, and their covariance.

        Fitted with the noise of the training or by ordinary least squares, whichever predicts the held-out blocks
        better: a random walk in the noise may absorb a slow effect, which would flatter the gain of that effect.
        """
        weighted = Solution(self.declared, self.covariance)
        if not self.predictions.shape[1]:
            return weighted
        trained = np.ones_like(self.held_out) if self.held_out.all() else ~self.held_out
        value, design, replicate = self.record.value, self.record.design, self.record.stack.replicate
        plain = fit_of_clusters(design[trained], value[trained], replicate[trained])
        if plain is None:
            return weighted
        return min((weighted, plain), key=lambda each: float((self._residual(each)[self.held_out] ** 2).mean()))

    @cached_property
    def before_alone(self) -> FloatArray:
        """Residual of the declared model without the search."""
        return self._residual(self.declared_alone)

    def _residual(self, model: Solution) -> FloatArray:
        return np.asarray(self.record.value - self.record.design @ model.coefficients)


def open_held_out_set(
    stack: Stack, held_out: BoolArray, training: UnitRecord, found: Search, number: int = 0
) -> HeldOutSet:
    """Predict the held-out blocks of a unit, in `stack` all of them, from its training, record `number` of the search.

    The declared coefficients of the training are split into their values without the effects and the part that each
    effect adds, so that the predictions and the residual of the declared model are independent.
    """
    common = found.common
    effects = [effect_columns(stack, each.fitted.effect, each.fitted.parameters) for each in common]
    record = record_of(stack, training.prior.center, np.column_stack(effects) if effects else None)
    p = training.design.shape[1]
    whitened = found.joint.whitened[number]
    trained = whitened[:, 1 : 1 + p]
    normal = trained.T @ trained
    first = 1 + found.joint.hypothesis.own[number].shape[1]
    predictions = np.empty((len(record), len(common)))
    declared = found.joint.own[number].coefficients[:p].copy()
    for column, each in enumerate(common):
        at = found.common_columns(each)
        theta = found.joint.common.coefficients[at]
        driven = whitened[:, first + at.start : first + at.stop] @ theta
        absorbed = solve(normal, trained.T @ driven).coefficients
        predictions[:, column] = effects[column] @ theta - record.design @ absorbed
        declared += absorbed
    before = record.value - record.design @ declared
    data = np.column_stack([before, predictions, record.design])
    return HeldOutSet(
        record=record,
        held_out=held_out,
        declared=declared,
        before=before,
        predictions=predictions,
        covariance=solve(normal, np.zeros(p)).covariance,
        whitened=record.whitener(found.joint.noises[number])(data)[held_out],
    )


def judge(boxes: Sequence[HeldOutSet], found: Search, names: Sequence[str]) -> Holdout | None:
    """The answer of the held-out runs `names` on each effect; None if there is nothing to test, as of a jump."""
    common = found.common
    judged = _slopes(boxes, found, common, np.eye(len(common)), [each.name for each in common])
    judged += [_line_slope(boxes, found, each) for each in found.selected if each.fitted.effect.kind is EffectKind.LINE]
    if not judged:
        return None
    if len(common) < 2:
        return Holdout(tuple(names), judged[0], tuple(judged))
    (total,) = _slopes(boxes, found, common, np.ones((len(common), 1)), ["all"])
    return Holdout(tuple(names), total, tuple(judged))


def fitted_error(box: HeldOutSet) -> Solution:
    """Slopes of the effects and errors of the declared coefficients in the held-out blocks, with their covariance.

    The errors of the declared coefficients have their covariance of the training; slopes are free.
    """
    width, columns = box.predictions.shape[1], box.whitened[:, 1:]
    solution = fit_with_training(box, box.whitened[:, 0], np.zeros(width))
    left = box.whitened[:, 0] - columns @ solution.coefficients
    excess = redness([columns[:, :width]], [left], [box.record.stack.run_number[box.held_out]])
    return Solution(solution.coefficients, solution.covariance * excess)


def fit_with_training(box: HeldOutSet, residual: FloatArray, of_effects: FloatArray) -> Solution:
    """Fit predictions and declared columns to a whitened residual of the held-out blocks.

    The declared coefficients have their covariance of the training; `of_effects` is the information on each effect.
    """
    width, columns = box.predictions.shape[1], box.whitened[:, 1:]
    known = np.zeros((columns.shape[1], columns.shape[1]))
    known[:width, :width] = np.diag(of_effects)
    known[width:, width:] = box.information
    return solve(known + columns.T @ columns, columns.T @ residual)


def _slopes(
    boxes: Sequence[HeldOutSet], found: Search, common: Sequence[Selected], sums: FloatArray, names: Sequence[str]
) -> list[HoldoutSlope]:
    """Regression of the residual on sums of predictions, over all units."""
    if not common:
        return []
    width = len(common)
    parts = [(box.whitened[:, 0], box.whitened[:, 1 : 1 + width] @ sums, box.whitened[:, 1 + width :]) for box in boxes]
    normal = np.sum([predicted.T @ predicted for _, predicted, _ in parts], axis=0)
    right = np.sum([predicted.T @ residual for residual, predicted, _ in parts], axis=0)
    solution = solve(normal, right)
    variance = solution.covariance.copy()
    for box, (_, predicted, design) in zip(boxes, parts, strict=True):
        through_declared = solution.covariance @ predicted.T @ design
        variance += through_declared @ box.covariance @ through_declared.T
    left = [residual - predicted @ solution.coefficients for residual, predicted, _ in parts]
    runs = [box.record.stack.run_number[box.held_out] for box in boxes]
    variance *= redness([predicted for _, predicted, _ in parts], left, runs)
    strength = np.array([max(information(found, each), 1e-12) for each in common]) @ sums
    errors = np.sqrt(np.maximum(np.diag(variance), 1e-300))
    return [
        _slope(name, float(slope), float(error), float(squared**-0.5))
        for name, slope, error, squared in zip(names, solution.coefficients, errors, strength, strict=True)
    ]


def information(found: Search, which: Selected) -> float:
    """Squared inverse of the relative standard error of the size of an effect in the training."""
    theta, covariance = found.common_fit(which)
    return float(theta @ np.linalg.pinv(covariance) @ theta)


def _slope(name: str, slope: float, slope_se: float, training_se: float) -> HoldoutSlope:
    is_present = slope - IS_PRESENT * slope_se > 0
    # the form of a large effect is never exact, so that its size need not agree within chance
    is_sufficient = (slope - 1) ** 2 <= (1 - LEAST_GAIN) * slope**2
    is_right = is_present and (is_sufficient or not differs(slope, slope_se, training_se))
    answer = answer_of(is_right=is_right, slope=slope, slope_se=slope_se, training_se=training_se)
    return HoldoutSlope(name, slope, slope_se, float(training_se), answer is HeldOutAnswer.CONFIRMED, answer)


def answer_of(*, is_right: bool, slope: float, slope_se: float, training_se: float) -> HeldOutAnswer:
    """The answer of a slope: it confirms, it speaks against the effect, or it leaves both possible.

    >>> answer_of(is_right=True, slope=2.0, slope_se=0.9, training_se=0.1)
    <HeldOutAnswer.NO_POWER: 'no_power'>
    >>> answer_of(is_right=False, slope=0.43, slope_se=0.35, training_se=0.1)
    <HeldOutAnswer.NO_POWER: 'no_power'>
    >>> answer_of(is_right=False, slope=0.1, slope_se=0.35, training_se=0.1)
    <HeldOutAnswer.REFUSED: 'refused'>
    """
    if is_right and slope_se * IS_PRESENT <= 1:
        return HeldOutAnswer.CONFIRMED
    absent = normal_log_density(slope, 0.0, slope_se)
    right = normal_log_density(slope, 1.0, math.hypot(slope_se, training_se))
    is_refused = absent - right >= math.log(ODDS) or differs(slope, slope_se, training_se)
    return HeldOutAnswer.REFUSED if is_refused else HeldOutAnswer.NO_POWER


def differs(slope: float, slope_se: float, training_se: float) -> bool:
    """Whether a slope differs significantly from one.

    >>> differs(0.7, 0.1, 0.1), differs(0.9, 0.02, 0.01)
    (False, True)
    """
    return abs(slope - 1) >= SAME_SIZE * math.hypot(slope_se, training_se)


def _line_slope(boxes: Sequence[HeldOutSet], found: Search, which: Selected) -> HoldoutSlope:
    """Ratio of a line's amplitudes in held-out and training runs; confirmed if the line is present at all."""
    frequency_hz = which.fitted.parameters["frequency_hz"]
    records = [record_of(box.record.stack.part(box.held_out), box.record.prior.center) for box in boxes]
    powers = powers_at(records, [box.whitened_after for box in boxes], frequency_hz)
    amplitude, error = amplitude_of(*_line_on(boxes, found, frequency_hz))
    trained, trained_error = amplitude_of(*found.own_fit(which, range(len(found.joint.records))))
    trained = max(trained, trained_error, 1e-300)
    accepted = float(chi_square_sf(powers.sum(), 2 * powers.size)) < LINE_P_VALUE
    slope, slope_se, training_se = amplitude / trained, error / trained, trained_error / trained
    answer = HeldOutAnswer.CONFIRMED
    if not accepted:
        answer = answer_of(is_right=False, slope=slope, slope_se=slope_se, training_se=training_se)
    return HoldoutSlope(which.name, slope, slope_se, training_se, accepted, answer)


def _line_on(boxes: Sequence[HeldOutSet], found: Search, frequency_hz: float) -> tuple[FloatArray, FloatArray]:
    """Cosine and sine of a line in each held-out run, in the unit of the signal, and the variance of each."""
    values, variances = [], []
    for number, box in enumerate(boxes):
        columns = line_columns(box.record, frequency_hz)
        columns = columns[:, np.any(columns[box.held_out] != 0, axis=0)]
        whitened = box.record.whitener(found.joint.noises[number])(columns)[box.held_out]
        solution = solve(whitened.T @ whitened, whitened.T @ box.whitened_after)
        values.append(solution.coefficients)
        variances.append(np.diag(solution.covariance))
    return np.concatenate(values), np.concatenate(variances)
