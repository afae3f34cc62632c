"""From runs and a declared error model to a verdict."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import msgspec
import numpy as np

from analytics.effects.base import Effect, Kind
from analytics.effects.registry import effects_for, unavailable_effects
from analytics.error_model import ErrorModel
from analytics.run_blocks import RunBlocks, stands_still
from analytics.tracing.adequacy import noise_excess
from analytics.tracing.candidates import Candidates, candidates_for
from analytics.tracing.channel_limits import blind_terms, channel_limits
from analytics.tracing.contenders import JUMP, LINE
from analytics.tracing.detection_limits import detection_limits
from analytics.tracing.error_report import error_table
from analytics.tracing.findings import findings, fitted_model, unreplicated
from analytics.tracing.joint_fit import fit_jointly
from analytics.tracing.lockbox import differs, judge, open_lockbox
from analytics.tracing.record import Record
from analytics.tracing.result import Diagnosis, FoundEffect, Holdout, NoiseCoefficients, Verdict
from analytics.tracing.screening import screen
from analytics.tracing.selection import Search, Selected, hypothesis_of, search
from analytics.tracing.stack import Stack, StackReport, in_segments, stacked
from analytics.tracing.white_variance import has_outliers, record_of
from stream.errors import BadInput

FEWEST_BLOCKS = 20
FEWEST_REPLICATES = 3
"""Fewer cannot be split into training and lockbox."""
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
    stack : Stack
        All its blocks.
    report : StackReport
        What happened when they were stacked.
    replication : "runs" or "within_run"
        What its replicates are.
    held_out : tuple of str
        Replicates that are held out; none where there are too few.
    training : Record
        The others.
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
    seed: int = 0,
) -> Diagnosis:
    """Find what a declared error model lacks, or say that nothing is missing, or that the data cannot tell.

    Parameters
    ----------
    runs : sequence of RunBlocks
        Runs of one signal of one unit.
    model : ErrorModel
        The declared model.
    effects : mapping of str to Effect, optional
        What to look for; by default all effects that find their channels.
    declared_noise : NoiseCoefficients, optional
        What the unit's noise is known to be; else it is guessed from the runs, and an excess of noise cannot be told.
    holdout : sequence of str, optional
        Runs that are held out; by default the last third. None are held out where it is empty.
    seed : int
        Of the draws that give the number of independent tests.

    Raises
    ------
    BadInput
        If the runs are not of one signal of one unit on one grid, or a run of `holdout` is not among them.
    """
    _check(runs, holdout)
    model = model.shaped(runs)
    stack, report = stacked(runs, model)
    if missing := _missing(stack, model) or _missing_to_fit(stack, model, holdout or ()):
        return _not_enough(runs, missing, report)
    case = _split(stack, report, declared_noise, holdout)
    available = effects_for(stack.runs) if effects is None else effects
    rng = np.random.default_rng(seed)
    candidates, found = _searched(case, available, model, rng)
    if better := _without_false_outliers(case, found, declared_noise):
        case = better
        candidates, found = _searched(case, available, model, rng)
    return _concluded(case, candidates, found, model, declared_noise, rng)


def case_of(
    runs: Sequence[RunBlocks],
    model: ErrorModel,
    declared: NoiseCoefficients | None,
    holdout: Sequence[str] | None = None,
) -> Case:
    """Runs of one unit, split into training and lockbox."""
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
        limits=report.limits,
    )


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
    if any(each.contender.kind is Kind.SECOND_TIER for each in again.selected):
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
    if any(each.contender.kind is Kind.EVENT for each in found.selected) or (found.unreplicated and not found.selected):
        return True
    return any(each.unknown_function_of for each in findings(records, candidates, found))


def _concluded(
    case: Case,
    candidates: Candidates,
    found: Search,
    model: ErrorModel,
    declared: NoiseCoefficients | None,
    rng: np.random.Generator,
) -> Diagnosis:
    records = [case.training]
    every = findings(records, candidates, found)
    held_out = case.stack.of_replicates(case.held_out) if case.held_out else np.ones(len(case.stack), dtype=bool)
    holdout = None
    if case.held_out and found.selected:
        box = open_lockbox(case.stack, held_out, case.training, found)
        holdout = judge([box], records, found, case.held_out)
    every = [_asked(each, holdout) for each in every]
    refused = [each for each in every if each.confirmed is False]
    kept = _without(records, found, [each.name for each in refused])
    effects = tuple(_of_open_form(each, refused) for each in every if each.confirmed is not False)
    seen_once = tuple(refused) + tuple(unreplicated(records, found.unreplicated) if not found.selected else ())
    excess = noise_excess(case.training, kept.joint)
    is_excess = declared is not None and excess.is_excess
    noise = kept.joint.noises[0]
    tests = screen(candidates, kept.joint.hypothesis.designs, kept.joint.noises, rng).tests
    limits, blind = detection_limits(candidates, kept.joint, [each.name for each in effects], tests)
    box = open_lockbox(case.stack, held_out, case.training, kept)
    names = case.held_out or case.stack.replicates
    declared_model = fitted_model(model, case.training, kept, kept.null.noises[0], with_effects=False)
    return Diagnosis(
        verdict=verdict_of(effects, seen_once, is_excess=is_excess, within_run=case.replication == "within_run"),
        units=(case.training.unit,),
        signal=case.stack.runs[0].signal,
        effects=effects,
        unreplicated=seen_once,
        holdout=holdout,
        error=error_table(box, kept, names, is_held_out=bool(case.held_out)),
        noise=noise,
        declared_noise=declared,
        noise_excess=excess.ratio if declared is not None else None,
        detection_limits=limits,
        not_tested=_not_tested(case, candidates, blind),
        limits=_limits(case, model, effects, holdout, declared, is_excess=is_excess),
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
    answers = [each.accepted for each in holdout.effects if each.effect == effect.name] if holdout else []
    return msgspec.structs.replace(effect, confirmed=answers[0]) if answers else effect


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
    kept: tuple[Selected, ...] = tuple(each for each in found.selected if each.contender.name not in names)
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
        return Verdict.UNREPLICATED if within_run else Verdict.EFFECT_FOUND
    if len(effects) > 1:
        return Verdict.UNEXPLAINED
    if effects or seen_once:
        return Verdict.UNREPLICATED
    return Verdict.UNEXPLAINED if is_excess else Verdict.NOTHING_MISSING


def _not_tested(case: Case, candidates: Candidates, blind: Sequence[str]) -> dict[str, str]:
    reasons = dict.fromkeys(blind, "these runs cannot tell it from the terms of the model")
    return {**unavailable_effects(case.stack.runs), **candidates.not_tested, **reasons}


def _no_lockbox(case: Case) -> str:
    count = len(case.stack.replicates)
    if case.replication == "within_run":
        blocks = len(case.stack)
        return (
            f"no lockbox: one run of {blocks} blocks; {FEWEST_BLOCKS_TO_SPLIT} or {FEWEST_REPLICATES} runs are needed"
        )
    if count < FEWEST_REPLICATES:
        return f"no lockbox: {count} runs, {FEWEST_REPLICATES} are needed"
    return "no lockbox: none of the runs was held out"


def _limits(
    case: Case,
    model: ErrorModel,
    effects: Sequence[FoundEffect],
    holdout: Holdout | None,
    declared: NoiseCoefficients | None,
    *,
    is_excess: bool,
) -> tuple[str, ...]:
    limits = [*case.report.limits, *channel_limits(case.training), *blind_terms(case.training, model.labels())]
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
        limits.append(_no_lockbox(case))
    if declared is None:
        limits.append(
            "no noise was declared: it was guessed from these runs, so that an excess of noise cannot be told"
        )
    if is_excess:
        limits.append("more noise than declared at averages of 300 to 3600 s, and nothing in the channels explains it")
    names = [each.name for each in effects]
    limits += [
        f"{each.effect}: the held-out runs show {each.slope:.3g} ± {each.slope_se:.2g} times what was predicted, more "
        "than chance: its form is not exact, or it changes from run to run"
        for each in (holdout.effects if holdout else ())
        if each.effect in names and each.effect != LINE and differs(each.slope, each.slope_se, each.training_se)
    ]
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
