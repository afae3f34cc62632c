"""From the search of one unit to its diagnosis: findings, held-out runs, errors, caveats, verdict."""

from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.notes.left_out import LeftOut
from analytics.loop.effects.events import TURN_ON
from analytics.loop.effects.registry import effect_name, effects_for, unavailable_effects
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.tracing.case import Case
from analytics.loop.tracing.held_out.error_report import error_shares, error_table
from analytics.loop.tracing.held_out.held_out_set import HeldOutSet, judge, open_held_out_set
from analytics.loop.tracing.held_out.run_walk import against_walk, follow_order
from analytics.loop.tracing.held_out.sole_run import sole_runs
from analytics.loop.tracing.result.diagnosis_result import Diagnosis, FoundEffect, ModelVerdict
from analytics.loop.tracing.result.holdout import ErrorTable, HeldOutAnswer, Holdout, HoldoutSlope
from analytics.loop.tracing.search.effect_search import Search, provisional
from analytics.loop.tracing.search.screening import Candidates, screen
from analytics.loop.tracing.verdict import noise_agreement as agreement
from analytics.loop.tracing.verdict.adequacy import detection_limits
from analytics.loop.tracing.verdict.caveats import (
    caveats,
    differing_caveats,
    hidden_delay_caveat,
    no_size_caveat,
    seen_once_caveat,
    undetermined_terms,
    unexplained_error,
    weak_terms,
)
from analytics.loop.tracing.verdict.effect_findings import (
    AGEING,
    fitted_model,
    may_be_delay,
    of_biases,
    unreplicated,
    with_ageing,
    with_causes,
    with_clock_bounds,
    with_hidden_delay,
)
from analytics.loop.tracing.verdict.held_out_caveats import holdout_caveats, refit_caveats
from analytics.loop.tracing.verdict.jump_rivals import with_coincidences
from analytics.loop.tracing.verdict.noise_over_channels import noise_trend
from analytics.loop.tracing.verdict.run_level import cause_of_biases, untested_biases
from analytics.loop.tracing.verdict.sensor_lag import with_sensor_lag
from analytics.loop.tracing.verdict.shape_bounds import bounded_findings

FAR_WORSE = 1.25  # ratio of RMS errors after and before from which an effect is refused whatever its slope
# standard errors by which the slope must exceed zero where the training runs show an effect in one of them: 1 in 2000
BEYOND_CHANCE = 3.29
FUNCTION = "function_of_"  # prefix of the names of free functions
_COLLINEAR = Bilingual("these runs cannot separate it from the terms of the model", "这些试验无法将其与模型的项区分")


def conclude(
    case: Case,
    candidates: Candidates,
    found: Search,
    model: ErrorModel,
    declared: ModelNoise | None,
    rng: np.random.Generator,
    *,
    turn_on_is_declared: bool,
) -> Diagnosis:
    """The diagnosis of one unit; see `diagnosis.diagnose`."""
    training = case.training
    by_runs = cause_of_biases(case, candidates, found)
    found = found if by_runs is None else by_runs.found
    every = [with_causes(each, case.stack.runs, model.effects) for each in bounded_findings(candidates, found)]
    every = every if by_runs is None else [of_biases(each, by_runs.test, training) for each in every]
    answered = _answered(case, found)
    holdout, kept, box, error = answered.holdout, answered.kept, answered.box, answered.error
    if holdout is not None and by_runs is not None and not by_runs.test.is_in_training:
        holdout = holdout.not_independent(by_runs.found.selected[0].name)
    sole = sole_runs(answered.whole, found, None if by_runs is None else by_runs.test.value)
    kept_names = [each.name for each in kept.common]
    if kept is not found:  # those kept, beside each other only
        sole = {name: run for name, run in sole.items() if name not in kept_names} | sole_runs(box, kept)
    every = [msgspec.structs.replace(each, sole_run=sole.get(each.name)) for each in every]
    if holdout is not None:
        for name, run in sole.items():
            holdout = holdout.resting_on(name, run)
        every = [msgspec.structs.replace(each, confirmed=holdout.confirms(each.name)) for each in every]
    refused = [each for each in every if each.confirmed is False]
    judged = every
    if kept is not found:
        every = _refitted(every, bounded_findings(candidates, kept))
    noises, designs = kept.joint.noises, kept.joint.hypothesis.designs
    excess = agreement.noise_excess(training, kept.joint, None if declared is None else declared.most)
    noise = agreement.measured_noise(training, noises[0])
    tests = screen(candidates, designs, noises, rng).tests
    shares = error_shares(box, kept)
    effects = tuple(
        msgspec.structs.replace(_of_open_form(each, refused), error_share=shares.get(each.name))
        for each in every
        if each.confirmed is not False
    )
    if AGEING not in model.effects:
        along = follow_order(box, kept)
        effects = tuple(with_ageing(each) if each.name in along else each for each in effects)
    named = [*(each.name for each in effects), *(each.name for each in found.unreplicated if found.selected)]
    limits, blind = detection_limits(candidates, kept.joint, named, tests)
    undetermined = undetermined_terms(case, model.labels())
    scatter = agreement.run_scatter(box.record, noises[0])
    alone = holdout_caveats(holdout, [each for each in refused if each.sole_run is not None])
    remarks, hiding = [*answered.worse, *refit_caveats(judged, every, refused), *alone], None
    if declared is not None:
        remarks += agreement.disagreements(declared, noise, excess, scatter if turn_on_is_declared else None)
    if (
        not turn_on_is_declared
        and not any(each.replicates for each in effects)
        and scatter.ratio >= agreement.WORTH_A_WORD
    ):
        differing = agreement.scatter_finding(box.record, scatter, model.effects, effects_for(case.stack.runs))
        effects = effects if differing is None else (differing, *effects)
        remarks.append(agreement.scatter_caveat(differing, scatter, case.stack.runs))
        hiding = remarks[-1] if differing is None else None
    if not (effects or found.unreplicated or refused):
        remarks += untested_biases(case, model)
    declared_model = fitted_model(model, training, kept, kept.null.noises[0], with_effects=False)
    effects = tuple(
        with_hidden_delay(with_clock_bounds(each, declared_model), declared_model, case.stack.runs) for each in effects
    )
    effects = with_sensor_lag(effects, kept)
    hidden = [each for each in effects if may_be_delay(each, case.stack.runs)]
    remarks += map(hidden_delay_caveat, hidden)
    unsized = [at for at, each in enumerate(effects) if each.confirmed and each.has_no_size and each not in hidden]
    remarks += [no_size_caveat(effects[at]) for at in unsized]
    effects = tuple(
        msgspec.structs.replace(each, confirmed=None) if at in unsized else each for at, each in enumerate(effects)
    )
    effects = tuple(with_coincidences(each, case.stack.runs) for each in effects)
    once = [with_coincidences(each, case.stack.runs) for each in _seen_once(case, found)]
    remarks += map(seen_once_caveat, once if found.selected else ())
    seen_once = (*refused, *once)
    walks = [
        each
        for each in effects
        if each.sole_run is not None
        or (holdout is not None and (holdout.may_be_walk(each.name) or holdout.raises_error(each.name)))
        or (each.of_biases and not each.confirmed)
    ]
    is_excess = declared is not None and excess.is_excess
    doubtful = (*walks, *(each for each in (*hidden, *(effects[at] for at in unsized)) if each not in walks))
    verdict = verdict_of(
        [each for each in effects if each not in doubtful],
        (*seen_once, *doubtful),
        is_excess=is_excess and (excess.repeats or not (effects or seen_once)),
        within_run=case.replication == "within_run",
    )
    unsteady = differing_caveats(kept.joint, declared_model)
    remarks += unsteady + weak_terms(case, declared_model)
    trend = noise_trend(case.stack)
    remarks += [] if trend is None else [trend.sentence]
    unexplained = (unexplained_error(error) if case.held_out else None) or (unsteady[0] if unsteady else None)
    # turn-on scatter explains neither an error within runs nor an undetermined term
    is_scatter = bool(effects) and all(each.name == TURN_ON for each in effects)
    if (is_scatter or verdict is ModelVerdict.NOTHING_MISSING) and (undetermined or unexplained):
        verdict = ModelVerdict.NOT_ENOUGH_DATA if undetermined else ModelVerdict.UNEXPLAINED
    if trend is not None and verdict in (ModelVerdict.NOTHING_MISSING, ModelVerdict.UNEXPLAINED):
        verdict, unexplained = ModelVerdict.UNEXPLAINED, unexplained or trend.sentence
    verdict = denied(verdict, case.report.left_out)
    is_lacking = verdict is ModelVerdict.NOT_ENOUGH_DATA
    losses = tuple(each.sentence for each in case.report.left_out if each.is_grave)
    found_caveats = caveats(
        case, undetermined, effects, holdout, error, noise_is_declared=declared is not None, is_excess=is_excess
    )
    not_tested = {**unavailable_effects(case.stack.runs), **candidates.not_tested, **dict.fromkeys(blind, _COLLINEAR)}
    return Diagnosis(
        verdict=verdict,
        left_out=case.report.left_out,
        units=(training.unit,),
        signal=case.stack.runs[0].signal,
        effects=effects,
        unreplicated=seen_once,
        holdout=holdout,
        error=error,
        noise=noise,
        declared_noise=declared,
        noise_excess=excess.ratio if declared is not None else None,
        detection_limits={name: each for name, each in limits.items() if name not in _alternatives(effects)},
        not_tested=not_tested,
        limits=(*found_caveats, *remarks),
        missing=(*undetermined, *losses) if is_lacking else (),
        scatter=hiding,
        unexplained=unexplained,
        tests=float(tests),
        replication=case.replication,
        training_runs=training.stack.replicates,
        runs=case.stack.replicates,
        declared=declared_model,
        model=fitted_model(model, training, kept, noise, with_effects=True),
        judged=declared_model.fitted(
            *box.declared_alone,
            unit_of_measure=declared_model.unit_of_measure,
            units=declared_model.units,
            noise=noise.parameters(),
        ),
    )


class _Answered(NamedTuple):
    """The answer of the held-out runs, the effects that they leave, the error with these, and what made it worse."""

    holdout: Holdout | None
    whole: HeldOutSet  # with all effects
    kept: Search
    box: HeldOutSet
    error: ErrorTable
    worse: tuple[Bilingual, ...]


def _seen_once(case: Case, found: Search) -> list[FoundEffect]:
    """What one training run alone shows; not confirmed where the held-out runs excite it, and do not show it."""
    seen = unreplicated(found.unreplicated, as_one=bool(found.selected))
    slope = _slope_later(case, found) if seen else None
    if slope is None or slope.answer is not HeldOutAnswer.REFUSED:
        return seen
    return [msgspec.structs.replace(each, confirmed=False) if each.name == slope.effect else each for each in seen]


def replicated_later(case: Case, found: Search) -> Search | None:
    """The search with an effect that one training run shows, if held-out runs show it as well, far beyond chance."""
    slope = _slope_later(case, found)
    if slope is None or not slope.accepted or slope.slope < BEYOND_CHANCE * slope.slope_se:
        return None
    return provisional(found)


def _slope_later(case: Case, found: Search) -> HoldoutSlope | None:
    """The answer of the held-out runs on the best effect that one training run shows; None if there is none."""
    tried = None if not case.held_out or case.replication == "within_run" else provisional(found)
    if tried is None:
        return None
    box = open_held_out_set(case.stack, case.held_out_blocks, case.training, tried)
    answer = against_walk(judge([box], tried, case.held_out), [box], tried)
    return None if answer is None else answer.slope(tried.selected[-1].name)


def _answered(case: Case, found: Search) -> _Answered:
    """Judge each effect by its slope; then refuse effects, the worst first, until the error is not far above before.

    The slope of whitened blocks alone does not see a slow error that the noise model allows for.
    """
    holdout = None
    whole = open_held_out_set(case.stack, case.held_out_blocks, case.training, found)
    if case.held_out and found.selected:
        holdout = against_walk(judge([whole], found, case.held_out), [whole], found)
    worse: list[Bilingual] = []
    while True:
        kept = (
            found
            if holdout is None
            else found.without([e.name for e in found.selected if holdout.confirms(e.name) is False])
        )
        box = whole if kept is found else open_held_out_set(case.stack, case.held_out_blocks, case.training, kept)
        error = error_table(box, kept, case.held_out or case.stack.replicates, is_held_out=bool(case.held_out))
        row, shares = error.reference, error_shares(box, kept)
        if row is None or error.most_gained is not None:  # an effect of seconds adds noise at best to averages of hours
            return _Answered(holdout, whole, kept, box, error, tuple(worse))
        is_worse = row.after > FAR_WORSE * row.before and row.after_within > FAR_WORSE * row.before_within
        if holdout is None or not shares or not is_worse:
            # turn-on scatter may raise the error by less where a true effect is small
            if holdout is not None and row.after > FAR_WORSE * row.before:
                holdout = holdout.raising_error()
            return _Answered(holdout, whole, kept, box, error, tuple(worse))
        worst = min(shares, key=lambda name: shares[name])
        holdout = holdout.refusing(worst)
        name = effect_name(worst)
        sizes = f"{row.before:.3g}", f"{row.after:.3g} {error.unit_of_measure}", f"{row.averaging_s:g} s"
        worse.append(
            Bilingual(
                f"{name} is refused whatever its slope: with it the RMS error of the held-out runs over {sizes[2]} "
                f"rises from {sizes[0]} to {sizes[1]}",
                f"{name.zh}不论斜率如何均予否定：加入后留出试验在{sizes[2]}平均时间上的均方根误差由{sizes[0]}升至{sizes[1]}",
            )
        )


def _refitted(every: Sequence[FoundEffect], kept: Sequence[FoundEffect]) -> list[FoundEffect]:
    """The findings, those kept with what the fit without the refused ones gives: the model found has the same."""
    again = {each.name: each for each in kept}
    return [
        msgspec.structs.replace(
            each,
            coefficients=fresh.coefficients,
            parameter_bounds=fresh.parameter_bounds,
            by_run=fresh.by_run,
            heterogeneity_p_value=fresh.heterogeneity_p_value,
        )
        if (fresh := again.get(each.name)) is not None
        else each
        for each in every
    ]


def _of_open_form(found: FoundEffect, refused: Sequence[FoundEffect]) -> FoundEffect:
    """The effect; of unknown form if the held-out runs refused a free function of its channel beside it."""
    functions = [each for each in refused if each.name.startswith(FUNCTION)]
    channels = {channel for each in functions for channel in each.roles}.intersection(found.roles)
    if not channels or found.unknown_function_of:
        return found
    return msgspec.structs.replace(found, unknown_function_of=tuple(sorted(channels)), parameter_bounds={})


def _alternatives(effects: Sequence[FoundEffect]) -> set[str]:
    """Names that the data cannot separate from a finding: none of them is absent."""
    return {name for each in effects for name in (*each.companions, *(other.name for other in each.confounded))}


def verdict_of(
    effects: Sequence[FoundEffect], seen_once: Sequence[FoundEffect], *, is_excess: bool, within_run: bool
) -> ModelVerdict:
    """The verdict on these findings; `is_excess` if there is more noise than declared, and they do not explain it."""
    lasting = [each for each in effects if each.replicates]
    if any(each.unknown_function_of for each in lasting) and not within_run:
        return ModelVerdict.UNKNOWN_FUNCTION
    if any(each.confounded for each in lasting):
        return ModelVerdict.CONFOUNDED
    if lasting:
        is_confirmed = not within_run and any(each.confirmed for each in lasting)
        return ModelVerdict.EFFECT_FOUND if is_confirmed else ModelVerdict.UNREPLICATED
    if is_excess or len(effects) > 1:
        return ModelVerdict.UNEXPLAINED
    return ModelVerdict.UNREPLICATED if effects or seen_once else ModelVerdict.NOTHING_MISSING


def denied(verdict: ModelVerdict, left_out: Sequence[LeftOut]) -> ModelVerdict:
    """The verdict; if much was left out, the remainder cannot show that nothing is missing."""
    if verdict is ModelVerdict.NOTHING_MISSING and any(each.is_grave for each in left_out):
        return ModelVerdict.NOT_ENOUGH_DATA
    return verdict
