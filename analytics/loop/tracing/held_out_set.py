"""The held-out set: runs that took no part in the fit are predicted once, with frozen coefficients."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import stats

from analytics.loop.effects.base import Kind
from analytics.loop.tracing.candidates import effect_columns
from analytics.loop.tracing.least_squares import Solution, fit_of_clusters, solve
from analytics.loop.tracing.line_scan import amplitude_of, line_columns, powers_at
from analytics.loop.tracing.misfit import redness
from analytics.loop.tracing.record import Record
from analytics.loop.tracing.result import Answer, Holdout, HoldoutSlope
from analytics.loop.tracing.selection import Search, Selected, own_fit
from analytics.loop.tracing.stack import Stack
from analytics.loop.tracing.white_variance import record_of
from stream.batch import BoolArray, FloatArray

IS_THERE = 1.64
"""Standard errors by which the slope has to exceed zero: 5 % one-sided."""
SAME_SIZE = 3.29
"""Standard errors by which the slope may differ from one: of true effects 1 in 1000 is refused for its size."""
AGREES = 1.96
"""Standard errors within which a slope that does not differ from zero agrees with one as well."""
FOUR_OF_FIVE = 0.84
"""Standard errors more by which 4 of 5 true effects exceed `IS_THERE`: with fewer, not to be seen is no refusal."""
WON = 0.9
"""Share of the error that a prediction wins, as it is, of what it would win at its right size: then it will do."""
LINE_P_VALUE = 0.005


@dataclass(frozen=True)
class HeldOutSet:
    """Held-out blocks of one unit with what the training says of them.

    Parameters
    ----------
    record: All blocks of the unit, the training included, so that the filter knows what was before.
    held_out: shape (n,); which of them were held out.
    declared: shape (p,); coefficients of the declared model.
    before: shape (n,); its residual.
    predictions: shape (n, effects); what each common effect adds, less what the declared model would have taken of it.
    covariance: shape (p, p); of the declared coefficients.
    whitened: shape (held out, 1 + effects + p); residual, predictions and the declared columns, whitened by the noise
        of the training.
    """

    record: Record
    held_out: BoolArray
    declared: FloatArray
    before: FloatArray
    predictions: FloatArray
    covariance: FloatArray
    whitened: FloatArray

    @property
    def after(self) -> FloatArray:
        """Residual of the model with all effects."""
        return np.asarray(self.before - self.predictions.sum(axis=1))

    @cached_property
    def declared_alone(self) -> Solution:
        """Coefficients of the declared model for one who looks no further, and their covariance.

        Fitted with the noise of the training or by plain least squares, whichever predicts the held-out blocks better:
        with a random walk in the noise a slow effect is left to the noise, and what it wins would be flattered.
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
        """Residual of that."""
        return self._residual(self.declared_alone)

    def _residual(self, model: Solution) -> FloatArray:
        return np.asarray(self.record.value - self.record.design @ model.coefficients)


def open_held_out_set(
    stack: Stack, held_out: BoolArray, training: Record, found: Search, number: int = 0
) -> HeldOutSet:
    """Predict the held-out blocks of a unit from its training.

    The declared coefficients of the training are split into what they are without the effects, and what each effect
    adds to them; so the predictions of the effects and the residual of the declared model are independent.

    Parameters
    ----------
    stack: All blocks of the unit.
    held_out: Which of them were held out.
    training: The others.
    found: What the training came to.
    number: Which of its records the training is.
    """
    common = [each for each in found.selected if each.is_common]
    effects = [_columns_on(stack, each) for each in common]
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
        taken = solve(normal, trained.T @ driven).coefficients
        predictions[:, column] = effects[column] @ theta - record.design @ taken
        declared += taken
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


def _columns_on(stack: Stack, which: Selected) -> FloatArray:
    candidate = which.fitted_candidate.candidate
    assert candidate is not None
    return effect_columns(stack, candidate.effect, candidate.shape)


def judge(
    boxes: Sequence[HeldOutSet], trainings: Sequence[Record], found: Search, names: Sequence[str]
) -> Holdout | None:
    """Return what the held-out runs say of each effect; None where they can say nothing, as of a jump."""
    common = [each for each in found.selected if each.is_common]
    judged = _slopes(boxes, found, common, np.eye(len(common)), [each.fitted_candidate.name for each in common])
    judged += [
        _line_slope(boxes, trainings, found, each) for each in found.selected if each.fitted_candidate.kind is Kind.LINE
    ]
    if not judged:
        return None
    if len(common) < 2:
        return Holdout(tuple(names), judged[0], tuple(judged))
    (total,) = _slopes(boxes, found, common, np.ones((len(common), 1)), ["all"])
    return Holdout(tuple(names), total, tuple(judged))


def _slopes(
    boxes: Sequence[HeldOutSet], found: Search, common: Sequence[Selected], sums: FloatArray, names: Sequence[str]
) -> list[HoldoutSlope]:
    """Regression of the residual on sums of predictions, all units together."""
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
    strength = np.array([_relative_error(found, each) ** -2 for each in common]) @ sums
    errors = np.sqrt(np.maximum(np.diag(variance), 1e-300))
    return [
        _slope(name, float(slope), float(error), float(squared**-0.5))
        for name, slope, error, squared in zip(names, solution.coefficients, errors, strength, strict=True)
    ]


def _slope(name: str, slope: float, slope_se: float, training_se: float) -> HoldoutSlope:
    is_there = slope - IS_THERE * slope_se > 0
    # of a large effect chance is a small part: its form is never exact, and it does not repeat to a thousandth
    will_do = (slope - 1) ** 2 <= (1 - WON) * slope**2
    is_told = is_there and (will_do or not differs(slope, slope_se, training_se))
    answer = answer_of(is_told=is_told, slope=slope, slope_se=slope_se, training_se=training_se)
    return HoldoutSlope(name, slope, slope_se, float(training_se), answer is Answer.CONFIRMED, answer)


def answer_of(*, is_told: bool, slope: float, slope_se: float, training_se: float) -> Answer:
    """What a slope says; one that is too wide to tell 1 from 0 says nothing, whatever it is by luck.

    Examples
    --------
    >>> answer_of(is_told=True, slope=2.0, slope_se=0.9, training_se=0.1)
    <Answer.NO_POWER: 'no_power'>
    >>> answer_of(is_told=False, slope=0.43, slope_se=0.47, training_se=0.1)
    <Answer.NO_POWER: 'no_power'>
    >>> answer_of(is_told=False, slope=-6.0, slope_se=0.9, training_se=0.1)
    <Answer.REFUSED: 'refused'>
    """
    if slope_se * IS_THERE > 1:
        return Answer.REFUSED if differs(slope, slope_se, training_se) else Answer.NO_POWER
    if is_told:
        return Answer.CONFIRMED
    agrees = slope > 0 and abs(slope - 1) < AGREES * math.hypot(slope_se, training_se)
    return Answer.NO_POWER if agrees and slope_se * (IS_THERE + FOUR_OF_FIVE) > 1 else Answer.REFUSED


def differs(slope: float, slope_se: float, training_se: float) -> bool:
    """Whether a slope differs from one by more than chance.

    Examples
    --------
    >>> differs(0.7, 0.1, 0.1), differs(0.9, 0.02, 0.01)
    (False, True)
    """
    return abs(slope - 1) >= SAME_SIZE * math.hypot(slope_se, training_se)


def _line_slope(
    boxes: Sequence[HeldOutSet], trainings: Sequence[Record], found: Search, which: Selected
) -> HoldoutSlope:
    """Ratio of a line's amplitudes in held-out and training runs; accepted where the line is there at all."""
    frequency_hz = which.fitted_candidate.parameters["frequency_hz"]
    records = [record_of(box.record.stack.part(box.held_out), box.record.prior.center) for box in boxes]
    residuals = [box.whitened[:, 0] - box.whitened[:, 1 : 1 + box.predictions.shape[1]].sum(axis=1) for box in boxes]
    there = powers_at(records, residuals, frequency_hz)
    amplitude, error = amplitude_of(*_line_on(boxes, found, frequency_hz))
    trained, trained_error = amplitude_of(*own_fit(found, which, range(len(trainings))))
    trained = max(trained, trained_error, 1e-300)
    accepted = float(stats.chi2.sf(there.sum(), 2 * there.size)) < LINE_P_VALUE
    slope, slope_se, training_se = amplitude / trained, error / trained, trained_error / trained
    # a line has a phase of its own in each run: it is there or it is not
    is_wide = answer_of(is_told=accepted, slope=slope, slope_se=slope_se, training_se=training_se) is Answer.NO_POWER
    answer = Answer.CONFIRMED if accepted else Answer.NO_POWER if is_wide else Answer.REFUSED
    return HoldoutSlope(which.fitted_candidate.name, slope, slope_se, training_se, accepted, answer)


def _line_on(boxes: Sequence[HeldOutSet], found: Search, frequency_hz: float) -> tuple[FloatArray, FloatArray]:
    """Cosine and sine of a line in each held-out run, in the unit of the signal, and the variance of each."""
    values, variances = [], []
    for number, box in enumerate(boxes):
        columns = line_columns(box.record, frequency_hz)
        columns = columns[:, np.any(columns[box.held_out] != 0, axis=0)]
        whitened = box.record.whitener(found.joint.noises[number])(columns)[box.held_out]
        residual = box.whitened[:, 0] - box.whitened[:, 1 : 1 + box.predictions.shape[1]].sum(axis=1)
        solution = solve(whitened.T @ whitened, whitened.T @ residual)
        values.append(solution.coefficients)
        variances.append(np.diag(solution.covariance))
    return np.concatenate(values), np.concatenate(variances)


def _relative_error(found: Search, which: Selected) -> float:
    """Relative standard error of the size of an effect in the training runs."""
    at = found.common_columns(which)
    theta, covariance = found.joint.common.coefficients[at], found.joint.common.covariance[at, at]
    strength = float(theta @ np.linalg.pinv(covariance) @ theta)
    return float(max(strength, 1e-12) ** -0.5)
