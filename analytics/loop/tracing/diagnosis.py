"""The diagnosis of one unit: from runs and a declared error model to a verdict."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from analytics.loop.blocks.notes.left_out import LeftOut
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, EffectKind
from analytics.loop.effects.registry import effects_for
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.tracing.case import Case, check_runs, missing_data, split
from analytics.loop.tracing.partial_channels import gapped_channels, partial_channels, with_gapped, with_rest
from analytics.loop.tracing.processors import single_blas
from analytics.loop.tracing.result.diagnosis_result import Diagnosis, ModelVerdict
from analytics.loop.tracing.search.effect_search import Search, search
from analytics.loop.tracing.search.screening import Candidates, candidates_for
from analytics.loop.tracing.verdict.conclusion import conclude, replicated_later
from analytics.loop.tracing.verdict.effect_findings import findings
from analytics.loop.tracing.verdict.noise_agreement import noise_excess
from analytics.loop.tracing.whitening.stack import stacked
from analytics.loop.tracing.whitening.white_variance import record_of
from stream.errors import GyrofleetError

FIRST_TIER = (EffectKind.LIBRARY, EffectKind.FUNCTION)
_OTHER_WEIGHT = 0.7  # change of the logarithm of the white variance of a block from which the search is repeated
SECOND_TIER = (*FIRST_TIER, EffectKind.SECOND_TIER)


def diagnose(
    runs: Sequence[RunBlocks],
    model: ErrorModel,
    *,
    effects: Mapping[str, Effect] | None = None,
    declared_noise: ModelNoise | None = None,
    holdout: Sequence[str] | None = None,
    left_out: Sequence[LeftOut] = (),
    seed: int = 0,
    turn_on_is_declared: bool | None = None,
) -> Diagnosis:
    """Find effects that a declared error model lacks, or report that none is missing or that the data cannot tell.

    Parameters
    ----------
    effects: Effects to test; by default all whose channels are recorded.
    declared_noise: Without it the noise is estimated from the runs, and excess noise cannot be detected.
    holdout: Runs to hold out; by default the last third; none if empty.
    left_out: Parts of the record that the reduction left out.
    seed: Of the draws that give the number of independent tests.
    turn_on_is_declared: Whether the turn-on scatter of `declared_noise` is independent of these runs; by default yes.

    Raises
    ------
    BadInput: If the runs are not of one signal of one unit on one grid, or a run of `holdout` is not among them.
    """
    check_runs(runs, holdout)
    known = declared_noise is not None if turn_on_is_declared is None else turn_on_is_declared
    trace = _Trace(model, effects, declared_noise, holdout, tuple(left_out), seed, turn_on_is_declared=known)
    if effects is not None:
        return trace.of(runs)
    whole, gapped = gapped_channels(runs, model.shaped(runs))
    found = trace.of(whole)
    if gapped:
        found = with_gapped(found, runs, whole, gapped, trace.of)
    some = partial_channels(whole, holdout)
    return found if some is None else with_rest(found, trace.of(some.runs), some)


@dataclass(frozen=True)
class Asked:
    """The arguments of `diagnose` for one unit, to hand them to another process."""

    runs: Sequence[RunBlocks]
    model: ErrorModel
    effects: Mapping[str, Effect] | None = None
    declared_noise: ModelNoise | None = None
    holdout: Sequence[str] | None = None
    left_out: Sequence[LeftOut] = ()
    seed: int = 0
    turn_on_is_declared: bool | None = None


def diagnosed(asked: Asked) -> Diagnosis:
    """The diagnosis of one unit, see `diagnose`."""
    with single_blas():
        return diagnose(
            asked.runs,
            asked.model,
            effects=asked.effects,
            declared_noise=asked.declared_noise,
            holdout=asked.holdout,
            left_out=asked.left_out,
            seed=asked.seed,
            turn_on_is_declared=asked.turn_on_is_declared,
        )


def diagnosed_or_why_not(asked: Asked) -> Diagnosis | str:
    """The diagnosis of one unit, or why there is none."""
    try:
        return diagnosed(asked)
    except GyrofleetError as error:
        return str(error)


@dataclass(frozen=True)
class _Trace:
    """The arguments of `diagnose`, for several sets of runs and channels."""

    model: ErrorModel
    effects: Mapping[str, Effect] | None
    declared_noise: ModelNoise | None
    holdout: Sequence[str] | None
    left_out: tuple[LeftOut, ...]
    seed: int
    turn_on_is_declared: bool

    def of(self, runs: Sequence[RunBlocks], insisted: Sequence[str] = ()) -> Diagnosis:
        """The diagnosis of these runs; channels that are `insisted` on are kept whatever their gaps."""
        model, declared = self.model.shaped(runs), self.declared_noise
        stack, report = stacked(runs, model, insisted)
        report = report.with_left_out(self.left_out)
        if missing := missing_data(stack, model, self.holdout or ()):
            return Diagnosis(
                verdict=ModelVerdict.NOT_ENOUGH_DATA,
                units=tuple(sorted({run.unit for run in runs})),
                signal=runs[0].signal if runs else "",
                runs=tuple(run.run for run in runs),
                missing=(missing,),
                limits=(*(each.sentence for each in report.left_out if each.is_grave), *report.limits),
                left_out=report.left_out,
            )
        known = self.turn_on_is_declared
        case = split(stack, report, declared, self.holdout, turn_on_is_declared=known)
        available = effects_for(stack.runs) if self.effects is None else self.effects
        rng = np.random.default_rng(self.seed)
        candidates, found = _searched(case, available, model, rng)
        if better := _reweighted(case, found, declared):
            case = better
            candidates, found = _searched(case, available, model, rng)
        return conclude(case, candidates, found, model, declared, rng, turn_on_is_declared=known)


def _searched(
    case: Case, effects: Mapping[str, Effect], model: ErrorModel, rng: np.random.Generator
) -> tuple[Candidates, Search]:
    """Search the library; then beside what one training run shows, if held-out runs show it as well."""
    candidates, found = _searched_in_training(case, effects, model, rng)
    while (given := replicated_later(case, found)) is not None:
        found = search(candidates, rng, given.selected)
    return candidates, found


def _searched_in_training(
    case: Case, effects: Mapping[str, Effect], model: ErrorModel, rng: np.random.Generator
) -> tuple[Candidates, Search]:
    """Search the library; if structure is left, what is tried late as well: products, in a single run thresholds."""

    def is_late(its: Effect) -> bool:
        return its.kind is EffectKind.SECOND_TIER or (its.is_late_in_one_run and case.replication == "within_run")

    early = {name: each for name, each in effects.items() if not is_late(each)}
    candidates = candidates_for([case.training], early, model, FIRST_TIER, case.report.lost_channels)
    found = search(candidates, rng)
    if not _leaves_structure(case, candidates, found):
        return candidates, found
    more = candidates_for([case.training], effects, model, SECOND_TIER, case.report.lost_channels)
    again = search(more, rng)
    return (more, again) if any(is_late(each.fitted.effect) for each in again.selected) else (candidates, found)


def _reweighted(case: Case, found: Search, declared: ModelNoise | None) -> Case | None:
    """The case without outliers and with the white noise that found effects leave; None if they change neither."""
    columns = found.joint.hypothesis.common[0]
    if not columns.shape[1]:
        return None
    known = case.training.prior.turn_on_is_declared
    record = record_of(case.training.stack, declared, columns, turn_on_is_declared=known)
    changed = np.abs(np.log(record.white / case.training.white)) > _OTHER_WEIGHT
    return replace(case, training=record) if changed.any() else None


def _leaves_structure(case: Case, candidates: Candidates, found: Search) -> bool:
    """Whether excess noise, an unknown function, a jump, or an effect that does not replicate is left."""
    if noise_excess(case.training, found.joint).is_slow_excess or (found.unreplicated and not found.selected):
        return True
    if any(each.fitted.effect.kind is EffectKind.EVENT for each in found.selected):
        return True
    return any(each.unknown_function_of for each in findings(candidates, found))
