"""Selected effects as findings: coefficients, evidence, alternatives; the fitted model."""

from collections.abc import Collection, Sequence

import msgspec
import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, EffectKind, Role, coefficient_unit
from analytics.loop.effects.registry import effect
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.tracing.result.diagnosis_result import BiasTest, ConfoundedEffect, EffectCoefficient, FoundEffect
from analytics.loop.tracing.search.effect_search import Search, Selected
from analytics.loop.tracing.search.event_scans import amplitude_of
from analytics.loop.tracing.search.fitted_candidates import CONFIDENCE, FittedCandidate
from analytics.loop.tracing.search.screening import Candidates
from analytics.loop.tracing.verdict.adequacy import WRONG_FORM, form_p_values, homogeneity
from analytics.loop.tracing.whitening.least_squares import solve
from analytics.loop.tracing.whitening.stack import UnitRecord
from analytics.methods.distributions import student_quantile
from stream.batch import FloatArray

AGEING, SCALE_FACTOR = "ageing", "scale_factor"
PER_HOUR = "s/h"  # unit of a clock error that grows


def unfitted(cause: Effect, *, recorded: bool, evidence_behind: float | None = None) -> ConfoundedEffect:
    """A cause that was not fitted, as an alternative."""
    return ConfoundedEffect(
        name=cause.name,
        parameters={},
        evidence_behind=evidence_behind,
        role=cause.role.value,
        separating_test=cause.separating_test,
        separating_test_zh=cause.separating_test_zh,
        recorded=recorded,
    )


def with_causes(found: FoundEffect, runs: Sequence[RunBlocks], declared: Collection[str]) -> FoundEffect:
    """A finding; that of a proxy with the causes that it follows and that the model does not declare."""
    own = effect(found.name)
    if own.role is not Role.PROXY:
        return found
    known = {found.name, *(each.name for each in found.confounded), *declared}
    causes = [each for each in map(effect, own.follows) if each.name not in known and not _stood_still(each, runs)]
    added = (
        unfitted(each, recorded=all(channel in run.channels for channel in each.needs for run in runs))
        for each in causes
    )
    return msgspec.structs.replace(found, confounded=(*found.confounded, *added))


def with_ageing(found: FoundEffect) -> FoundEffect:
    """A finding with ageing as an alternative, whose dates are not recorded."""
    if AGEING in (found.name, *(each.name for each in found.confounded)):
        return found
    return msgspec.structs.replace(found, confounded=(*found.confounded, unfitted(effect(AGEING), recorded=False)))


def of_biases(found: FoundEffect, test: BiasTest, training: UnitRecord) -> FoundEffect:
    """A finding of the biases of all runs; its bounds are those of as few values as the training has runs.

    Where no runs are held out the test has its coefficient as well, which is that of the model.
    """
    degrees = max(1, test.degrees - test.runs + len(training.stack.runs))
    wider = float(student_quantile(0.975, degrees)) / CONFIDENCE
    coefficients = []
    for each in found.coefficients:
        low, high = (each.value + wider * (bound - each.value) for bound in (each.lo, each.hi))
        coefficients.append(msgspec.structs.replace(each, lo=low, hi=high))
    if len(training.stack.runs) == test.runs:
        (own,) = coefficients
        test = msgspec.structs.replace(test, value=own.value, lo=own.lo, hi=own.hi)
    return msgspec.structs.replace(found, coefficients=tuple(coefficients), of_biases=test)


def with_clock_bounds(found: FoundEffect, declared: ErrorModel) -> FoundEffect:
    """A finding with the size that confounded clock errors would need; the plausible alternatives first."""
    others = [_bounded(other, declared) for other in found.confounded]
    return msgspec.structs.replace(found, confounded=tuple(sorted(others, key=lambda other: not other.is_plausible)))


def _bounded(other: ConfoundedEffect, declared: ErrorModel) -> ConfoundedEffect:
    bound = effect(other.name).clock_bound
    if bound is None or other.coefficient is None:
        return other
    term, most, unit = bound
    labels = declared.labels()
    if term not in labels:
        return other
    at = labels.index(term)
    error = float(np.sqrt(declared.covariance[at][at])) if declared.covariance else 0.0
    sensitivity = abs(declared.coefficients[at]) + CONFIDENCE * error
    if sensitivity == 0.0:
        return other
    return msgspec.structs.replace(other, implied=abs(other.coefficient) / sensitivity, most=most, implied_unit=unit)


def with_hidden_delay(found: FoundEffect, declared: ErrorModel, runs: Sequence[RunBlocks]) -> FoundEffect:
    """A finding that acts as a delay of the rate reference, with bounds that allow for what joining two rates leaves.

    It is not confirmed where these bounds contain zero.
    """
    own, labels = effect(found.name), declared.labels()
    hidden_s = max(run.hidden_delay_s for run in runs)
    of_clock = own.clock_bound is not None and own.clock_bound[0] == SCALE_FACTOR
    if hidden_s == 0.0 or SCALE_FACTOR not in labels or not (of_clock or own.needs == ("table_acceleration",)):
        return found
    reach = hidden_s * abs(declared.coefficients[labels.index(SCALE_FACTOR)])
    if own.clock_bound is not None and own.clock_bound[2] == PER_HOUR:
        reach /= max(float(run.time_s[-1]) for run in runs) / 3600.0
    wider = tuple(msgspec.structs.replace(each, lo=each.lo - reach, hi=each.hi + reach) for each in found.coefficients)
    is_nonzero = all(each.lo > 0.0 or each.hi < 0.0 for each in wider)
    return msgspec.structs.replace(found, coefficients=wider, confirmed=found.confirmed if is_nonzero else None)


def may_be_delay(found: FoundEffect, runs: Sequence[RunBlocks]) -> bool:
    """Whether a finding may be what joining two rates leaves, see `with_hidden_delay`."""
    acts = {"input_rate", "table_acceleration"}.intersection(found.roles) and any(run.hidden_delay_s for run in runs)
    own = effect(found.name)
    is_delay = own.needs == ("table_acceleration",) or own.clock_bound is not None
    return bool(acts) and is_delay and any(each.lo <= 0.0 <= each.hi for each in found.coefficients)


def findings(candidates: Candidates, found: Search) -> list[FoundEffect]:
    """All selected effects, largest evidence first."""
    return sorted((_finding(candidates, found, each) for each in found.selected), key=lambda each: -each.evidence)


def _stood_still(cause: Effect, runs: Sequence[RunBlocks]) -> bool:
    """Whether a channel of a cause has readings in all runs and never moves: then it did not cause what moves."""
    has_readings = all(
        channel in run.channels and np.isfinite(run.mean(channel)).any() for channel in cause.needs for run in runs
    )
    return has_readings and cause.unavailable(runs) is not None


def unreplicated(fitted_candidates: Sequence[FittedCandidate], *, as_one: bool = False) -> list[FoundEffect]:
    """Candidates with evidence from one replicate only; `as_one` with the others as alternatives of the first."""
    every = []
    for each in fitted_candidates[:1] if as_one else fitted_candidates:
        if each.is_common:
            at = slice(each.joint.common.coefficients.size - each.columns[0].shape[1], None)
            coefficients = _coefficients(each, each.joint.common.coefficients[at], each.joint.common.covariance[at, at])
        else:
            last = [(each.joint.own[place], -each.columns[place].shape[1]) for place in _places(each)]
            values = np.concatenate([solution.coefficients[start:] for solution, start in last])
            variance = np.concatenate([np.diag(solution.covariance)[start:] for solution, start in last])
            coefficients = _event_coefficients(each, values, variance)
        others = tuple(_confounded(other, each) for other in fitted_candidates[1:] if as_one)
        every.append(msgspec.structs.replace(_basic(each, coefficients, replicates=False), confounded=others))
    return every


def _basic(fitted: FittedCandidate, coefficients: tuple[EffectCoefficient, ...], *, replicates: bool) -> FoundEffect:
    return FoundEffect(
        name=fitted.name,
        parameters=fitted.parameters,
        coefficients=coefficients,
        significance=fitted.significance,
        evidence=float(fitted.evidence),
        roles=dict.fromkeys(fitted.effect.needs, fitted.effect.role.value),
        largest_share=fitted.replication.largest_share if fitted.replication else 1.0,
        replicates=replicates,
    )


def _finding(candidates: Candidates, found: Search, which: Selected) -> FoundEffect:
    fitted, own = which.fitted, which.fitted.effect
    forms = form_p_values(candidates, found.joint, which)
    same_p_value, by_run = homogeneity(found, which)
    unknown = [channel for channel, p_value in forms.items() if p_value < WRONG_FORM]
    is_nameless = own.kind is EffectKind.FUNCTION and not any(each.name in own.aliases for each in which.confounded)
    if is_nameless or (not unknown and (which.leading_proxy or same_p_value < WRONG_FORM)):
        unknown = list(own.needs)
    if which.is_common:
        coefficients = _coefficients(fitted, *found.common_fit(which))
    else:
        coefficients = _event_coefficients(fitted, *found.own_fit(which, _places(fitted)))
    return msgspec.structs.replace(
        _basic(fitted, coefficients, replicates=own.kind is not EffectKind.EVENT),
        confounded=tuple(_confounded(each, fitted) for each in which.confounded),
        companions=which.companions,
        unknown_function_of=tuple(unknown),
        form_p_value=min(forms.values(), default=1.0),
        heterogeneity_p_value=same_p_value,
        by_run=by_run,
    )


def _confounded(other: FittedCandidate, beside: FittedCandidate) -> ConfoundedEffect:
    width = other.columns[0].shape[1]
    return ConfoundedEffect(
        name=other.name,
        parameters=other.parameters,
        evidence_behind=float(beside.evidence - other.evidence),
        role=other.effect.role.value,
        separating_test=other.effect.separating_test,
        separating_test_zh=other.effect.separating_test_zh,
        coefficient=float(other.joint.common.coefficients[-width]) if other.is_common and width > 0 else None,
    )


def _coefficients(fitted: FittedCandidate, theta: FloatArray, covariance: FloatArray) -> tuple[EffectCoefficient, ...]:
    own, run = fitted.effect, fitted.joint.records[0].stack.runs[0]
    unit = coefficient_unit(own, run.unit_of_measure, run)
    names = own.coefficients if len(own.coefficients) == theta.size else [str(n + 1) for n in range(theta.size)]
    reach = CONFIDENCE * np.sqrt(np.diag(covariance))
    return tuple(
        EffectCoefficient(name, float(value), float(value - half), float(value + half), unit)
        for name, value, half in zip(names, theta, reach, strict=True)
    )


def _places(event: FittedCandidate) -> list[int]:
    """Numbers of the records with a line or a jump."""
    return [number for number, columns in enumerate(event.columns) if columns.shape[1]]


def _event_coefficients(
    event: FittedCandidate, values: FloatArray, variance: FloatArray
) -> tuple[EffectCoefficient, ...]:
    """Size of a jump, or RMS amplitude of a line over the runs of all records."""
    unit = event.joint.records[0].stack.runs[0].unit_of_measure
    if event.effect.kind is EffectKind.EVENT:
        half = CONFIDENCE * float(np.sqrt(variance[0]))
        return (EffectCoefficient("", float(values[0]), float(values[0] - half), float(values[0] + half), unit),)
    amplitude, error = amplitude_of(values, variance)
    half = CONFIDENCE * error
    return (EffectCoefficient("amplitude", amplitude, max(0.0, amplitude - half), amplitude + half, unit),)


def fitted_model(
    declared: ErrorModel, record: UnitRecord, found: Search, noise: ModelNoise, *, with_effects: bool
) -> ErrorModel:
    """The declared model, or the model found, with coefficients of the training; lines and jumps predict nothing."""
    run = record.stack.runs[0]
    unit, joint = run.unit_of_measure, found.joint if with_effects else found.null
    model = declared
    for each in found.common if with_effects else ():
        model = model.with_term(each.name, each.fitted.parameters)
    p = record.design.shape[1]
    own_width = joint.hypothesis.own[0].shape[1]
    rows = np.concatenate([np.arange(p), own_width + np.arange(joint.common.coefficients.size)])
    whitened = joint.whitened[0][:, 1:]
    covariance = solve(whitened.T @ whitened, np.zeros(whitened.shape[1])).covariance[np.ix_(rows, rows)]
    coefficients = np.concatenate([joint.own[0].coefficients[:p], joint.common.coefficients])
    units = [
        unit if term.name == "bias" else coefficient_unit(effect(term.name), unit, run)
        for term in model.terms
        for _ in term.labels()
    ]
    parameters = noise.parameters()
    return model.fitted(coefficients, covariance, unit_of_measure=unit, units=units, noise=parameters)
