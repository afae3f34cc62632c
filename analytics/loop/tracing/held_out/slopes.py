"""Slopes of the held-out residual on the predictions: effects are confirmed, refused, or cannot be judged."""

import math
from collections.abc import Sequence

import numpy as np
from scipy import stats

from analytics.loop.effects.base import EffectKind
from analytics.loop.tracing.held_out.held_out_set import HeldOutSet
from analytics.loop.tracing.result.holdout import HeldOutAnswer, Holdout, HoldoutSlope
from analytics.loop.tracing.search.effect_search import Search, Selected
from analytics.loop.tracing.search.line_scan import amplitude_of, line_columns, powers_at
from analytics.loop.tracing.search.noise_inflation import redness
from analytics.loop.tracing.whitening.least_squares import solve
from analytics.loop.tracing.whitening.white_variance import record_of
from stream.batch import FloatArray

IS_PRESENT = 1.64
"""Standard errors by which the slope has to exceed zero: 5 % one-sided."""
SAME_SIZE = 3.29
"""Standard errors by which the slope may differ from one: 1 in 1000 true effects is refused for its size."""
AGREES = 1.96
"""Standard errors within which a slope that does not differ from zero agrees with one."""
FOUR_OF_FIVE = 0.84
"""Additional standard errors for 80 % power; with less power an absent effect is not refused."""
LEAST_GAIN = 0.9
"""Gain of a prediction relative to its gain at the right size that is sufficient."""
LINE_P_VALUE = 0.005


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
    """The answer of a slope; one that is too uncertain to separate 1 from 0 has no power.

    Examples
    --------
    >>> answer_of(is_right=True, slope=2.0, slope_se=0.9, training_se=0.1)
    <HeldOutAnswer.NO_POWER: 'no_power'>
    >>> answer_of(is_right=False, slope=0.43, slope_se=0.47, training_se=0.1)
    <HeldOutAnswer.NO_POWER: 'no_power'>
    >>> answer_of(is_right=False, slope=-6.0, slope_se=0.9, training_se=0.1)
    <HeldOutAnswer.REFUSED: 'refused'>
    """
    if slope_se * IS_PRESENT > 1:
        return HeldOutAnswer.REFUSED if differs(slope, slope_se, training_se) else HeldOutAnswer.NO_POWER
    if is_right:
        return HeldOutAnswer.CONFIRMED
    agrees = slope > 0 and abs(slope - 1) < AGREES * math.hypot(slope_se, training_se)
    has_no_power = agrees and slope_se * (IS_PRESENT + FOUR_OF_FIVE) > 1
    return HeldOutAnswer.NO_POWER if has_no_power else HeldOutAnswer.REFUSED


def differs(slope: float, slope_se: float, training_se: float) -> bool:
    """Whether a slope differs significantly from one.

    Examples
    --------
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
    accepted = float(stats.chi2.sf(powers.sum(), 2 * powers.size)) < LINE_P_VALUE
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
