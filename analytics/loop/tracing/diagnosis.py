"""From runs and a declared error model to a verdict."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import msgspec
import numpy as np

from analytics.loop.blocks.left_out import LeftOut
from analytics.loop.blocks.run_blocks import RunBlocks, stands_still
from analytics.loop.effects.base import Effect, Kind
from analytics.loop.effects.registry import effects_for, unavailable_effects
from analytics.loop.effects.turn_on import TURN_ON
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.model.noise import NoiseCoefficients
from analytics.loop.tracing.adequacy import noise_excess
from analytics.loop.tracing.candidates import Candidates, candidates_for
from analytics.loop.tracing.channel_limits import blind_terms, channel_limits
from analytics.loop.tracing.clock_bounds import with_bounds
from analytics.loop.tracing.detection_limits import detection_limits
from analytics.loop.tracing.error_report import error_table
from analytics.loop.tracing.error_result import ErrorTable
from analytics.loop.tracing.findings import findings, fitted_model, unreplicated
from analytics.loop.tracing.fitted_candidates import JUMP, LINE
from analytics.loop.tracing.followed_causes import with_causes
from analytics.loop.tracing.gapped_channels import gapped_channels
from analytics.loop.tracing.held_out_set import judge, open_held_out_set
from analytics.loop.tracing.joint_fit import fit_jointly
from analytics.loop.tracing.noise_agreement import disagreements, measured_noise
from analytics.loop.tracing.partial_channels import denied, partial_channels, with_gapped, with_rest
from analytics.loop.tracing.record import Record
from analytics.loop.tracing.result import Diagnosis, FoundEffect, Holdout, Verdict
from analytics.loop.tracing.run_scatter import (
    FAR,
    run_scatter,
    scatter_finding,
    scatter_limit,
    undeclared_scatter_limit,
)
from analytics.loop.tracing.screening import screen
from analytics.loop.tracing.selection import Search, Selected, hypothesis_of, search
from analytics.loop.tracing.stack import Stack, StackReport, in_segments, stacked
from analytics.loop.tracing.verdict_checks import gain_limit, holdout_limits, unexplained_error, untold_terms
from analytics.loop.tracing.white_variance import has_outliers, record_of
from stream.errors import BadInput

FEWEST_BLOCKS = 20
FEWEST_REPLICATES = 3
"""Fewer cannot be split into training and held-out set."""
FEWEST_BLOCKS_TO_SPLIT = 60
"""A single run that is shorter cannot be split either."""
FUNCTION = "function_of_"
"""How the names of free functions begin."""
FIRST_TIER = (Kind.LIBRARY, Kind.FUNCTION)
SECOND_TIER = (*FIRST_TIER, Kind.SECOND_TIER)


@dataclass(frozen=True)
class Case:
    """The data of one unit, split.

    Parameters
    ----------
    stack: All its blocks.
    report: What happened when they were stacked.
    replication: What its replicates are.
    held_out: Replicates that are held out; none where there are too few.
    training: The others.
    """

    stack: Stack
    report: StackReport
    replication: Literal["runs", "within_run"]
    held_out: tuple[str, ...]
    training: Record


def diagnose(
    runs: Sequence[RunBlocks],
    model: ErrorModel,
    *,
    effects: Mapping[str, Effect] | None = None,
    declared_noise: NoiseCoefficients | None = None,
    holdout: Sequence[str] | None = None,
    left_out: Sequence[LeftOut] = (),
    seed: int = 0,
    turn_on_is_declared: bool | None = None,
) -> Diagnosis:
    """Find what a declared error model lacks, or say that nothing is missing, or that the data cannot tell.

    Parameters
    ----------
    runs: Runs of one signal of one unit.
    model: The declared model.
    effects: What to look for; by default all effects that find their channels.
    declared_noise: What the unit's noise is known to be; else it is guessed from the runs, and an excess of noise
        cannot be told.
    holdout: Runs that are held out; by default the last third. None are held out where it is empty.
    left_out: What the reduction left out of the record.
    seed: Of the draws that give the number of independent tests.
    turn_on_is_declared: Whether the turn-on scatter of `declared_noise` is known from elsewhere, and not estimated from
        these runs; by default it is known where noise is declared.

    Raises
    ------
    BadInput: If the runs are not of one signal of one unit on one grid, or a run of `holdout` is not among them.
    """
    _check(runs, holdout)
    known = declared_noise is not None if turn_on_is_declared is None else turn_on_is_declared
    ask = _Ask(model, effects, declared_noise, tuple(left_out), seed, turn_on_is_declared=known)
    if effects is not None:
        return _diagnosed(runs, holdout, ask)
    whole, gapped = gapped_channels(runs, model.shaped(runs))
    found = _diagnosed(whole, holdout, ask)
    if gapped:
        found = with_gapped(found, runs, whole, gapped, lambda part, needed: _diagnosed(part, holdout, ask, needed))
    some = partial_channels(whole, holdout)
    return found if some is None else with_rest(found, _diagnosed(some.runs, holdout, ask), some)


@dataclass(frozen=True)
class _Ask:
    """What is asked of runs: see `diagnose`."""

    model: ErrorModel
    effects: Mapping[str, Effect] | None
    declared_noise: NoiseCoefficients | None
    left_out: tuple[LeftOut, ...]
    seed: int
    turn_on_is_declared: bool


def _diagnosed(
    runs: Sequence[RunBlocks], holdout: Sequence[str] | None, ask: _Ask, insisted: Sequence[str] = ()
) -> Diagnosis:
    model, declared_noise = ask.model.shaped(runs), ask.declared_noise
    stack, report = stacked(runs, model, insisted)
    report = report.with_left_out(ask.left_out)
    if missing := _missing(stack, model) or _missing_to_fit(stack, model, holdout or ()):
        return _not_enough(runs, missing, report)
    case = _split(stack, report, declared_noise, holdout)
    available = effects_for(stack.runs) if ask.effects is None else ask.effects
    rng = np.random.default_rng(ask.seed)
    candidates, found = _searched(case, available, model, rng)
    if better := _without_false_outliers(case, found, declared_noise):
        case = better
        candidates, found = _searched(case, available, model, rng)
    known = ask.turn_on_is_declared
    return _concluded(case, candidates, found, model, declared_noise, rng, turn_on_is_declared=known)


def case_of(
    runs: Sequence[RunBlocks],
    model: ErrorModel,
    declared: NoiseCoefficients | None,
    holdout: Sequence[str] | None = None,
) -> Case:
    """Runs of one unit, split into training and held-out set."""
    stack, report = stacked(runs, model.shaped(runs))
    return _split(stack, report, declared, holdout)


def _check(runs: Sequence[RunBlocks], holdout: Sequence[str] | None) -> None:
    for name in ("unit", "signal", "unit_of_measure", "block_s"):
        values = sorted({str(getattr(run, name)) for run in runs})
        if len(values) > 1:
            raise BadInput(f"runs to diagnose have several values of {name}: {', '.join(values)}; give one")
    known = [run.run for run in runs]
    if unknown := sorted(set(holdout or ()) - set(known)):
        raise BadInput(f"run to hold out is not there: {', '.join(unknown)}; the runs are {', '.join(known)}")
    if holdout and set(known) <= set(holdout):
        raise BadInput(f"all runs ({', '.join(known)}) are to be held out: leave some that the model is fitted to")


def _missing(stack: Stack, model: ErrorModel) -> tuple[str, ...]:
    """Say what is missing for a trace; empty where there is enough."""
    if len(stack) < FEWEST_BLOCKS:
        return (f"{len(stack)} blocks with signal and channels of the model are there, {FEWEST_BLOCKS} are needed",)
    if len(stack) < 3 * stack.design.shape[1]:
        return (
            f"{len(stack)} blocks for {stack.design.shape[1]} coefficients of '{model}'; three times as many needed",
        )
    value = stack.value
    if stands_still(value):
        return (f"the signal is {value[0]:g} throughout, as of an output that is dead or stuck",)
    return ()


def _missing_to_fit(stack: Stack, model: ErrorModel, holdout: Sequence[str]) -> tuple[str, ...]:
    """Say what is missing where the runs that were named are held out."""
    if not holdout or len(stack.runs) == 1:
        return ()
    missing = _missing(stack.part(~stack.of_replicates(holdout)), model)
    return tuple(f"without the runs held out: {each}" for each in missing)


def _not_enough(runs: Sequence[RunBlocks], missing: tuple[str, ...], report: StackReport) -> Diagnosis:
    return Diagnosis(
        verdict=Verdict.NOT_ENOUGH_DATA,
        units=tuple(sorted({run.unit for run in runs})),
        signal=runs[0].signal if runs else "",
        runs=tuple(run.run for run in runs),
        missing=missing,
        limits=(*_of_left_out(report.left_out), *report.limits),
        left_out=report.left_out,
    )


def _of_left_out(left_out: Sequence[LeftOut]) -> tuple[str, ...]:
    """Return the limits that losses set, without which a reader takes the rest for more than it is."""
    return tuple(each.sentence for each in left_out if each.is_grave)


def _split(
    stack: Stack, report: StackReport, declared: NoiseCoefficients | None, holdout: Sequence[str] | None
) -> Case:
    is_single = len(stack.runs) == 1
    whole = in_segments(stack) if is_single else stack
    names = whole.replicates
    if holdout is None:
        is_short = is_single and len(stack) < FEWEST_BLOCKS_TO_SPLIT
        held_out = () if is_short or len(names) < FEWEST_REPLICATES else names[len(names) - len(names) // 3 :]
    else:
        held_out = tuple(name for name in names if name in holdout)
    training = whole.part(~whole.of_replicates(held_out)) if held_out else whole
    replication: Literal["runs", "within_run"] = "within_run" if is_single else "runs"
    return Case(whole, report, replication, held_out, record_of(training, declared))


def _searched(
    case: Case, effects: Mapping[str, Effect], model: ErrorModel, rng: np.random.Generator
) -> tuple[Candidates, Search]:
    """Search the library; where that leaves structure, products and thresholds too."""
    records = [case.training]
    candidates = candidates_for(records, effects, model, FIRST_TIER, case.report.lost_channels)
    found = search(records, candidates, rng)
    if not _leaves_structure(records, candidates, found):
        return candidates, found
    more = candidates_for(records, effects, model, SECOND_TIER, case.report.lost_channels)
    again = search(records, more, rng)
    if any(each.fitted_candidate.kind is Kind.SECOND_TIER for each in again.selected):
        return more, again
    return candidates, found


def _without_false_outliers(case: Case, found: Search, declared: NoiseCoefficients | None) -> Case | None:
    """Return the case with blocks back in that a found effect explains; None where there are none."""
    columns = found.joint.hypothesis.common[0]
    if not columns.shape[1] or not has_outliers(case.training):
        return None
    record = record_of(case.training.stack, declared, columns)
    return None if np.array_equal(record.white, case.training.white) else replace(case, training=record)


def _leaves_structure(records: Sequence[Record], candidates: Candidates, found: Search) -> bool:
    """Whether too much noise is left, an unknown function, or what a threshold crossed now and then looks like.

    That is a jump, or a function of temperature that does not replicate.
    """
    if noise_excess(records[0], found.joint).is_excess:
        return True
    if any(each.fitted_candidate.kind is Kind.EVENT for each in found.selected) or (
        found.unreplicated and not found.selected
    ):
        return True
    return any(each.unknown_function_of for each in findings(records, candidates, found))


def _concluded(
    case: Case,
    candidates: Candidates,
    found: Search,
    model: ErrorModel,
    declared: NoiseCoefficients | None,
    rng: np.random.Generator,
    *,
    turn_on_is_declared: bool,
) -> Diagnosis:
    records = [case.training]
    every = [with_causes(each, case.stack.runs, model.effects) for each in findings(records, candidates, found)]
    held_out = case.stack.of_replicates(case.held_out) if case.held_out else np.ones(len(case.stack), dtype=bool)
    holdout = None
    if case.held_out and found.selected:
        box = open_held_out_set(case.stack, held_out, case.training, found)
        holdout = judge([box], records, found, case.held_out)
    every = [_asked(each, holdout) for each in every]
    refused = [each for each in every if each.confirmed is False]
    kept = _without(records, found, [each.name for each in refused])
    effects = tuple(_of_open_form(each, refused) for each in every if each.confirmed is not False)
    seen_once = tuple(refused) + tuple(unreplicated(records, found.unreplicated) if not found.selected else ())
    excess = noise_excess(case.training, kept.joint)
    is_excess = declared is not None and excess.is_excess
    noise = measured_noise(case.training, kept.joint.noises[0])
    tests = screen(candidates, kept.joint.hypothesis.designs, kept.joint.noises, rng).tests
    limits, blind = detection_limits(candidates, kept.joint, [each.name for each in effects], tests)
    box = open_held_out_set(case.stack, held_out, case.training, kept)
    names = case.held_out or case.stack.replicates
    error = error_table(box, kept, names, is_held_out=bool(case.held_out))
    untold = blind_terms(case.training, model.labels())
    scatter = run_scatter(box.record, kept.joint.noises[0])
    remarks: list[str] = []
    if declared is not None:
        known_scatter = scatter if turn_on_is_declared else None
        remarks += disagreements(declared, noise, excess, known_scatter)
    if not turn_on_is_declared and not any(each.replicates for each in effects) and scatter.ratio >= FAR:
        differing = scatter_finding(box.record, scatter, model.effects, effects_for(case.stack.runs))
        unit_of_measure = case.stack.runs[0].unit_of_measure
        if differing is not None:
            effects = (differing, *effects)
            remarks.append(scatter_limit(differing, scatter, len(case.stack.runs)))
        else:
            remarks.append(undeclared_scatter_limit(scatter, unit_of_measure))
    declared_model = fitted_model(model, case.training, kept, kept.null.noises[0], with_effects=False)
    effects = with_bounds(effects, declared_model)
    verdict = verdict_of(effects, seen_once, is_excess=is_excess, within_run=case.replication == "within_run")
    unexplained = unexplained_error(error) if case.held_out else None
    # that runs differ explains no error within them, and no term that none of them tells
    has_no_cause = verdict is Verdict.NOTHING_MISSING or (effects and all(each.name == TURN_ON for each in effects))
    if has_no_cause and (untold or unexplained):
        verdict = Verdict.NOT_ENOUGH_DATA if untold else Verdict.UNEXPLAINED
    limits = {name: each for name, each in limits.items() if name not in _meant(effects)}
    verdict = denied(verdict, case.report.left_out)
    return Diagnosis(
        verdict=verdict,
        left_out=case.report.left_out,
        units=(case.training.unit,),
        signal=case.stack.runs[0].signal,
        effects=effects,
        unreplicated=seen_once,
        holdout=holdout,
        error=error,
        noise=noise,
        declared_noise=declared,
        noise_excess=excess.ratio if declared is not None else None,
        detection_limits=limits,
        not_tested=_not_tested(case, candidates, blind),
        limits=(*_limits(case, untold, effects, holdout, declared, error, is_excess=is_excess), *remarks),
        missing=(*_untold(case, untold), *_of_left_out(case.report.left_out))
        if verdict is Verdict.NOT_ENOUGH_DATA
        else (),
        unexplained=unexplained,
        replication=case.replication,
        training_runs=case.training.stack.replicates,
        runs=case.stack.replicates,
        declared=declared_model,
        model=fitted_model(model, case.training, kept, noise, with_effects=True),
        judged=declared_model.fitted(
            *box.declared_alone,
            unit_of_measure=declared_model.unit_of_measure,
            units=declared_model.units,
            noise=msgspec.structs.asdict(noise),
        ),
    )


def _asked(effect: FoundEffect, holdout: Holdout | None) -> FoundEffect:
    """Return the effect with what the held-out runs say of it."""
    return effect if holdout is None else msgspec.structs.replace(effect, confirmed=holdout.confirms(effect.name))


def _of_open_form(found: FoundEffect, refused: Sequence[FoundEffect]) -> FoundEffect:
    """Return the effect; of unknown form where a free function of its channel was needed beside it but did not hold."""
    functions = [each for each in refused if each.name.startswith(FUNCTION)]
    channels = {channel for each in functions for channel in each.roles}.intersection(found.roles)
    if not channels or found.unknown_function_of:
        return found
    return msgspec.structs.replace(found, unknown_function_of=tuple(sorted(channels)))


def _without(records: Sequence[Record], found: Search, names: Sequence[str]) -> Search:
    """Return the search without the effects that the held-out runs refused."""
    if not names:
        return found
    kept: tuple[Selected, ...] = tuple(each for each in found.selected if each.fitted_candidate.name not in names)
    joint = fit_jointly(records, hypothesis_of(records, kept), found.joint.noises, restricted=True)
    return replace(found, selected=kept, joint=joint)


def verdict_of(
    effects: Sequence[FoundEffect], seen_once: Sequence[FoundEffect], *, is_excess: bool, within_run: bool
) -> Verdict:
    """Return the verdict that findings come to."""
    lasting = [each for each in effects if each.replicates]
    if any(each.unknown_function_of for each in lasting) and not within_run:
        return Verdict.UNKNOWN_FUNCTION
    if any(each.confounded for each in lasting):
        return Verdict.CONFOUNDED
    if lasting:
        is_confirmed = not within_run and any(each.confirmed for each in lasting)
        return Verdict.EFFECT_FOUND if is_confirmed else Verdict.UNREPLICATED
    if len(effects) > 1:
        return Verdict.UNEXPLAINED
    if effects or seen_once:
        return Verdict.UNREPLICATED
    return Verdict.UNEXPLAINED if is_excess else Verdict.NOTHING_MISSING


def _not_tested(case: Case, candidates: Candidates, blind: Sequence[str]) -> dict[str, str]:
    reasons = dict.fromkeys(blind, "these runs cannot tell it from the terms of the model")
    return {**unavailable_effects(case.stack.runs), **candidates.not_tested, **reasons}


def _no_held_out_set(case: Case) -> str:
    count = len(case.stack.replicates)
    if case.replication == "within_run":
        blocks = len(case.stack)
        needed = f"{FEWEST_BLOCKS_TO_SPLIT} or {FEWEST_REPLICATES} runs"
        return f"no held-out set: one run of {blocks} blocks; {needed} are needed"
    if count < FEWEST_REPLICATES:
        return f"no held-out set: {count} runs, {FEWEST_REPLICATES} are needed"
    return "no held-out set: none of the runs was held out"


def _meant(effects: Sequence[FoundEffect]) -> set[str]:
    """Names that a finding may mean: none of them is absent."""
    return {name for each in effects for name in (*each.companions, *(other.name for other in each.confounded))}


def _untold(case: Case, labels: Sequence[str]) -> tuple[str, ...]:
    return untold_terms(labels, case.training.stack.replicates, case.held_out)


def _limits(
    case: Case,
    untold: Sequence[str],
    effects: Sequence[FoundEffect],
    holdout: Holdout | None,
    declared: NoiseCoefficients | None,
    error: ErrorTable,
    *,
    is_excess: bool,
) -> tuple[str, ...]:
    limits = [
        *_of_left_out(case.report.left_out),
        *case.report.limits,
        *channel_limits(case.training),
        *_untold(case, untold),
    ]
    limits += [text for text in (unexplained_error(error) if case.held_out else None, gain_limit(error)) if text]
    if case.replication == "within_run":
        limits.append(
            "one run only: its segments stand for replicates, so that what is tied to this run shows as an effect"
        )
    elif len(case.training.stack.replicates) == 1:
        limits.append(
            "the model was fitted to one run alone: what is tied to that run is in its terms, and no other run bears "
            "it out"
        )
    if not case.held_out:
        limits.append(_no_held_out_set(case))
    if declared is None:
        limits.append(
            "no noise was declared: it was guessed from these runs, so that an excess of noise cannot be told"
        )
    if is_excess:
        limits.append("more noise than declared at averages of 300 to 3600 s, and nothing in the channels explains it")
    names = [each.name for each in effects]
    limits += holdout_limits(holdout, effects)
    if JUMP in names:
        limits.append("a jump happens once: runs that were held out cannot confirm it")
    if LINE in names:
        limits.append(
            f"a line faster than two blocks of {case.training.noise_model.block_s:g} s shows at a frequency folded "
            "into this band: the spectrum at the full sampling rate tells"
        )
        limits.append(
            "the phase of a line is that of each run: no model predicts it, so that it is in the errors after as in "
            "those before, and in what is told as noise alone"
        )
    return tuple(limits)
