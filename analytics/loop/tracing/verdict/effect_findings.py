"""Selected effects as findings: coefficients with bounds and units, evidence, alternatives; the fitted model."""

from collections.abc import Mapping, Sequence

import msgspec
import numpy as np

from analytics.loop.effects.base import Effect, EffectKind
from analytics.loop.effects.coefficient_units import coefficient_unit
from analytics.loop.effects.registry import effect
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.model.noise import ModelNoise
from analytics.loop.tracing.result.finding import ConfoundedEffect, EffectCoefficient, FoundEffect
from analytics.loop.tracing.search.candidates import Candidates
from analytics.loop.tracing.search.effect_search import Search, Selected
from analytics.loop.tracing.search.fitted_candidates import FittedCandidate
from analytics.loop.tracing.search.line_scan import amplitude_of
from analytics.loop.tracing.verdict.adequacy import WRONG_FORM, form_p_values, homogeneity
from analytics.loop.tracing.whitening.least_squares import solve
from analytics.loop.tracing.whitening.unit_record import UnitRecord
from stream.batch import FloatArray

CONFIDENCE = 1.96


def findings(records: Sequence[UnitRecord], candidates: Candidates, found: Search) -> list[FoundEffect]:
    """All selected effects, largest evidence first."""
    every = [_finding(records, candidates, found, each) for each in found.selected]
    return sorted(every, key=lambda each: -each.evidence)


def unreplicated(records: Sequence[UnitRecord], fitted_candidates: Sequence[FittedCandidate]) -> list[FoundEffect]:
    """Candidates with evidence from one replicate only."""
    every = []
    for each in fitted_candidates:
        if each.is_common:
            at = slice(each.joint.common.coefficients.size - each.columns[0].shape[1], None)
            theta, covariance = each.joint.common.coefficients[at], each.joint.common.covariance[at, at]
            coefficients = _coefficients(each.effect, records, theta, covariance)
        else:
            last = [(each.joint.own[place], -each.columns[place].shape[1]) for place in _places(each)]
            values = np.concatenate([solution.coefficients[start:] for solution, start in last])
            variance = np.concatenate([np.diag(solution.covariance)[start:] for solution, start in last])
            coefficients = _event_coefficients(records, each, values, variance)
        every.append(_basic(each, coefficients, replicates=False))
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


def _finding(records: Sequence[UnitRecord], candidates: Candidates, found: Search, which: Selected) -> FoundEffect:
    fitted, own = which.fitted, which.fitted.effect
    forms = form_p_values(candidates, found.joint, which)
    same = homogeneity(records, found, which)
    unknown = [channel for channel, p_value in forms.items() if p_value < WRONG_FORM]
    is_nameless = own.kind is EffectKind.FUNCTION and not any(each.name in own.aliases for each in which.confounded)
    if is_nameless or (not unknown and (which.leading_proxy or same.p_value < WRONG_FORM)):
        unknown = list(own.needs)
    if which.is_common:
        coefficients = _coefficients(own, records, *found.common_fit(which))
    else:
        coefficients = _event_coefficients(records, fitted, *found.own_fit(which, _places(fitted)))
    return msgspec.structs.replace(
        _basic(fitted, coefficients, replicates=own.kind is not EffectKind.EVENT),
        confounded=tuple(_confounded(each, fitted) for each in which.confounded),
        companions=which.companions,
        unknown_function_of=tuple(unknown),
        form_p_value=min(forms.values(), default=1.0),
        heterogeneity_p_value=same.p_value,
        by_run=dict(same.by_replicate),
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


def _coefficients(
    own: Effect, records: Sequence[UnitRecord], theta: FloatArray, covariance: FloatArray
) -> tuple[EffectCoefficient, ...]:
    run = records[0].stack.runs[0]
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
    records: Sequence[UnitRecord], event: FittedCandidate, values: FloatArray, variance: FloatArray
) -> tuple[EffectCoefficient, ...]:
    """Size of a jump, or RMS amplitude of a line over the runs of all records."""
    unit = records[0].stack.runs[0].unit_of_measure
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
    unit = run.unit_of_measure
    joint = found.joint if with_effects else found.null
    model = declared
    for each in found.common if with_effects else ():
        model = model.with_term(each.name, each.fitted.parameters)
    p = record.design.shape[1]
    own_width = joint.hypothesis.own[0].shape[1]
    rows = np.concatenate([np.arange(p), own_width + np.arange(joint.common.coefficients.size)])
    whitened = joint.whitened[0][:, 1:]
    covariance = solve(whitened.T @ whitened, np.zeros(whitened.shape[1])).covariance[np.ix_(rows, rows)]
    coefficients = np.concatenate([joint.own[0].coefficients[:p], joint.common.coefficients])
    parameters: Mapping[str, float] = {"N": noise.N, "B": noise.B, "K": noise.K, "turn_on": noise.turn_on}
    return model.fitted(
        coefficients,
        covariance,
        unit_of_measure=unit,
        units=[
            unit if term.name == "bias" else coefficient_unit(effect(term.name), unit, run)
            for term in model.terms
            for _ in term.labels()
        ],
        noise=parameters,
    )
