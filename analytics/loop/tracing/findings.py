"""Selected effects as the reader gets them: coefficients with limits and units, evidence, alternatives."""

from collections.abc import Mapping, Sequence

import numpy as np

from analytics.loop.effects.base import Effect, Kind
from analytics.loop.effects.coefficient_units import coefficient_unit
from analytics.loop.effects.registry import effect
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.model.noise import NoiseCoefficients
from analytics.loop.tracing.adequacy import WRONG_FORM, form_p_values, homogeneity
from analytics.loop.tracing.candidates import Candidates
from analytics.loop.tracing.fitted_candidates import FittedCandidate
from analytics.loop.tracing.least_squares import solve
from analytics.loop.tracing.line_scan import amplitude_of
from analytics.loop.tracing.record import Record
from analytics.loop.tracing.result import Coefficient, ConfoundedEffect, FoundEffect
from analytics.loop.tracing.selection import Search, Selected, own_fit
from stream.batch import FloatArray

CONFIDENCE = 1.96


def findings(records: Sequence[Record], candidates: Candidates, found: Search) -> list[FoundEffect]:
    """All selected effects, largest evidence first."""
    every = [_finding(records, candidates, found, each) for each in found.selected]
    return sorted(every, key=lambda each: -each.evidence)


def unreplicated(records: Sequence[Record], fitted_candidates: Sequence[FittedCandidate]) -> list[FoundEffect]:
    """What had evidence, but from one replicate alone."""
    every = []
    for each in fitted_candidates:
        if each.candidate is None:
            last = [(each.joint.own[place], -each.columns[place].shape[1]) for place in _places(each)]
            values = np.concatenate([solution.coefficients[start:] for solution, start in last])
            variance = np.concatenate([np.diag(solution.covariance)[start:] for solution, start in last])
            coefficients = _event_coefficients(records, each, values, variance)
        else:
            at = slice(each.joint.common.coefficients.size - each.columns[0].shape[1], None)
            theta, covariance = each.joint.common.coefficients[at], each.joint.common.covariance[at, at]
            coefficients = _coefficients(_effect_of(each), records, theta, covariance)
        share = each.replication.largest_share if each.replication else 1.0
        every.append(
            FoundEffect(
                name=each.name,
                parameters=each.parameters,
                coefficients=coefficients,
                significance=each.significance,
                evidence=float(each.evidence),
                roles=_roles(_effect_of(each)),
                largest_share=share,
                replicates=False,
            )
        )
    return every


def _effect_of(fitted_candidate: FittedCandidate) -> Effect:
    return effect(fitted_candidate.name) if fitted_candidate.candidate is None else fitted_candidate.candidate.effect


def _finding(records: Sequence[Record], candidates: Candidates, found: Search, which: Selected) -> FoundEffect:
    fitted_candidate = which.fitted_candidate
    own = _effect_of(fitted_candidate)
    forms = form_p_values(candidates, found.joint, which)
    same = homogeneity(records, found, which)
    unknown = [channel for channel, p_value in forms.items() if p_value < WRONG_FORM]
    has_namesake = any(each.name in own.aliases for each in which.confounded)
    if (
        (own.kind is Kind.FUNCTION and not has_namesake)
        or (which.leading_proxy and not unknown)
        or (same.p_value < WRONG_FORM and not unknown)
    ):
        unknown = list(own.needs)
    if which.is_common:
        at = found.common_columns(which)
        theta, covariance = found.joint.common.coefficients[at], found.joint.common.covariance[at, at]
        coefficients = _coefficients(own, records, theta, covariance)
    else:
        coefficients = _event_coefficients(records, fitted_candidate, *own_fit(found, which, _places(fitted_candidate)))
    return FoundEffect(
        name=fitted_candidate.name,
        parameters=fitted_candidate.parameters,
        coefficients=coefficients,
        significance=fitted_candidate.significance,
        evidence=float(fitted_candidate.evidence),
        roles=_roles(own),
        confounded=tuple(_confounded(each, fitted_candidate) for each in which.confounded),
        companions=which.companions,
        unknown_function_of=tuple(unknown),
        form_p_value=min(forms.values(), default=1.0),
        heterogeneity_p_value=same.p_value,
        largest_share=fitted_candidate.replication.largest_share if fitted_candidate.replication else 1.0,
        replicates=fitted_candidate.kind is not Kind.EVENT,
        by_run=dict(same.by_replicate),
    )


def _confounded(other: FittedCandidate, beside: FittedCandidate) -> ConfoundedEffect:
    own = _effect_of(other)
    width = other.columns[0].shape[1]
    fitted = other.candidate is not None and width > 0
    return ConfoundedEffect(
        name=other.name,
        parameters=other.parameters,
        evidence_behind=float(beside.evidence - other.evidence),
        role=other.role.value,
        separating_test=own.separating_test,
        separating_test_zh=own.separating_test_zh,
        coefficient=float(other.joint.common.coefficients[-width]) if fitted else None,
    )


def _roles(own: Effect) -> dict[str, str]:
    return dict.fromkeys(own.needs, own.role.value)


def _coefficients(
    own: Effect, records: Sequence[Record], theta: FloatArray, covariance: FloatArray
) -> tuple[Coefficient, ...]:
    run = records[0].stack.runs[0]
    unit = coefficient_unit(own, run.unit_of_measure, run)
    names = own.coefficients if len(own.coefficients) == theta.size else [str(n + 1) for n in range(theta.size)]
    reach = CONFIDENCE * np.sqrt(np.diag(covariance))
    return tuple(
        Coefficient(name, float(value), float(value - half), float(value + half), unit)
        for name, value, half in zip(names, theta, reach, strict=True)
    )


def _places(event: FittedCandidate) -> list[int]:
    """Which records a line or a jump is in."""
    return [number for number, columns in enumerate(event.columns) if columns.shape[1]]


def _event_coefficients(
    records: Sequence[Record], event: FittedCandidate, values: FloatArray, variance: FloatArray
) -> tuple[Coefficient, ...]:
    """Size of a jump, or amplitude of a line, root mean square over the runs of all records."""
    unit = records[0].stack.runs[0].unit_of_measure
    if event.kind is Kind.EVENT:
        half = CONFIDENCE * float(np.sqrt(variance[0]))
        return (Coefficient("", float(values[0]), float(values[0] - half), float(values[0] + half), unit),)
    amplitude, error = amplitude_of(values, variance)
    half = CONFIDENCE * error
    return (Coefficient("amplitude", amplitude, max(0.0, amplitude - half), amplitude + half, unit),)


def fitted_model(
    declared: ErrorModel, record: Record, found: Search, noise: NoiseCoefficients, *, with_effects: bool
) -> ErrorModel:
    """Return the declared model, or the model with the effects found, with the coefficients of the training.

    Lines and jumps do not predict anything; they are not a part of it.
    """
    run = record.stack.runs[0]
    joint = found.joint if with_effects else found.null
    model, units = declared, []
    for term in declared.terms:
        width = term.columns(run).shape[1]
        unit = run.unit_of_measure
        units += [unit if term.name == "bias" else coefficient_unit(effect(term.name), unit, run)] * width
    p = record.design.shape[1]
    rows = np.arange(p)
    if with_effects:
        for each in found.selected:
            if each.is_common:
                own = _effect_of(each.fitted_candidate)
                model = model.with_term(each.fitted_candidate.name, each.fitted_candidate.parameters)
                units += [coefficient_unit(own, run.unit_of_measure, run)] * each.fitted_candidate.columns[0].shape[1]
    own_width = joint.hypothesis.own[0].shape[1]
    rows = np.concatenate([rows, own_width + np.arange(joint.common.coefficients.size)])
    whitened = joint.whitened[0][:, 1:]
    covariance = solve(whitened.T @ whitened, np.zeros(whitened.shape[1])).covariance[np.ix_(rows, rows)]
    coefficients = np.concatenate([joint.own[0].coefficients[:p], joint.common.coefficients])
    parameters: Mapping[str, float] = {"N": noise.N, "B": noise.B, "K": noise.K, "turn_on": noise.turn_on}
    return model.fitted(coefficients, covariance, unit_of_measure=run.unit_of_measure, units=units, noise=parameters)
