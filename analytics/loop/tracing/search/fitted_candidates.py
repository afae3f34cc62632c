"""Candidates of one round that pass the screening, each fitted together with the noise, and their evidence."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from analytics.loop.effects.base import Effect
from analytics.loop.effects.registry import effect
from analytics.loop.model.error_model import ModelNoise
from analytics.loop.tracing.search.between_runs import BetweenRuns, calibrated_ratio
from analytics.loop.tracing.search.between_shapes import better_shape
from analytics.loop.tracing.search.event_scans import (
    between_grid_points,
    jump_column,
    line_columns,
    scan_jumps,
    scan_lines,
)
from analytics.loop.tracing.search.evidence import (
    PRICE,
    Replication,
    evidence,
    is_common,
    leads,
    leave_one_out,
    look_alike,
    needed_lead,
    noise_inflation,
    one_degree,
)
from analytics.loop.tracing.search.screening import Candidates, Screen, Screened, family_p_value, screen
from analytics.loop.tracing.whitening.joint_fit import Hypothesis, JointFit, fit_jointly
from analytics.loop.tracing.whitening.stack import UnitRecord, as_array, from_array
from analytics.methods.distributions import chi_square_isf, chi_square_sf
from stream.batch import FloatArray

ALPHA = 0.01  # family-wise error rate of the library, and of jumps
LINE_ALPHA = 0.001  # the same for lines: imperfectly whitened noise resembles a line most of all
SCREENED, SCREENED_FROM_FEW = 1e-3, 2.0  # p-value for a fit; with few tests twice what one of them needs
MOST_FITTED, MOST_FITTED_IN_FLEET = 10, 5
UNMASKED = 1e-4
MOST_UNMASKED = 8
RIVAL = 0.05  # p-value from which an effect that looks like a chosen one is fitted as well
SWALLOWED = 0.25  # excess of the logarithm of a fitted noise coefficient over the declared one that may hide an effect
EXCESS_AVERAGE_S, GROSS_EXCESS = 3600.0, 4.0  # ratio to the declared variance at which the noise model is not trusted
_SAME_EVIDENCE = 6  # decimals of the evidence that decide; beyond them, candidates are ordered by name on every machine
CONFIDENCE = 1.96
RESHAPED = 0.5  # share of the largest evidence from which a candidate's shape is sought between the tried ones
LINE, JUMP = "periodic_line", "jump"
LINE_MOST_FROM_ONE = 0.9


@dataclass(frozen=True)
class FittedCandidate:
    """One explanation of the residual, fitted together with the noise."""

    effect: Effect
    parameters: dict[str, Any]
    columns: Sequence[FloatArray]  # on each record, in natural units
    joint: JointFit
    # twice the gain in log likelihood, noise fitted with and without it, over the noise inflation
    likelihood_ratio: float
    degrees: int  # of freedom
    evidence: float
    replication: Replication | None = None  # None for a line or a jump
    replicates: bool = True
    is_rival: bool = False  # not significant by itself; it looks like another that is
    is_plausible: bool = True  # its size, if it is a clock error
    at_most: float | None = None  # evidence before the noise inflation; None where that was not taken into account

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.effect.name

    @property
    def is_common(self) -> bool:
        """Whether its coefficients hold for all units."""
        return is_common(self.effect)

    def is_near(self, best: "FittedCandidate") -> bool:
        """Whether the data cannot separate it from the best candidate.

        Its own noise inflation is left out here, since a wrong form also makes coefficients disagree between runs; that
        of the best candidate counts for both.
        """
        own = self.evidence if self.at_most is None else self.at_most
        return not leads(best.evidence, best.effect, own / max(best.inflation, 1.0) if own > 0 else own, self.effect)

    @property
    def inflation(self) -> float:
        """Ratio of its evidence without and with the noise inflation; 1 where that was not taken into account."""
        return 1.0 if self.at_most is None or self.evidence <= 0 else self.at_most / self.evidence

    @property
    def lead(self) -> float:
        """Evidence by which it has to lead another candidate."""
        return float(needed_lead(self.evidence))

    @property
    def significance(self) -> float:
        """Equivalent z of a test with one degree of freedom."""
        return float(np.sqrt(one_degree(self.likelihood_ratio, self.degrees)))


def fitted_candidates(
    candidates: Candidates, base: JointFit, rng: np.random.Generator, taken: Sequence[str], *, with_events: bool = True
) -> list[FittedCandidate]:
    """All explanations of the residual of a fit, largest evidence first, including those that do not replicate.

    `base` is the current model, which has the effects `taken`; `with_events` scans for lines and jumps as well.
    Slightly negative evidence is included, since such a candidate may be confounded with another.
    """
    first = screen(candidates, base.hypothesis.designs, base.noises, rng, taken)
    found = []
    chosen = _worth_fitting(candidates, base, rng, taken, first)
    effects = [group[0].candidate.effect for group in chosen]
    for group in (*chosen, *_rivals(effects, first)):
        may_be_rival = any(look_alike(each, group[0].candidate.effect) for each in effects)
        fitted = _fitted(candidates, base, group, first, may_be_rival=may_be_rival)
        if fitted is not None and fitted.evidence > -PRICE:
            found.append(_discounted(fitted))
    most = max((each.evidence for each in found), default=0.0)
    found = [_reshaped(candidates, base, each) if each.evidence > RESHAPED * most else each for each in found]
    found = [replace(each, is_plausible=_has_plausible_size(candidates.terms, each)) for each in found]
    if with_events:
        found += [each for each in (_line(base), _jump(base)) if each is not None]
    return sorted(found, key=lambda each: (-round(each.evidence, _SAME_EVIDENCE), each.name))


def _worth_fitting(
    candidates: Candidates, base: JointFit, rng: np.random.Generator, taken: Sequence[str], first: Screen
) -> list[list[Screened]]:
    """Effects that pass the screening, each with its shapes, best first.

    Fitted noise far above the declared one may hide an effect (ageing in the turn-on scatter, warm-up in the random
    walk): a second screening at the declared noise unmasks it. So may a turn-on scatter that was estimated with the
    effect in it: of effects screened with less scatter, those pass that explain enough of the biases of the runs.
    """
    worth = max(SCREENED, SCREENED_FROM_FEW * ALPHA / first.tests)
    chosen = [group for group in first.by_effect() if group[0].p_value < worth]
    del chosen[MOST_FITTED if len(base.records) == 1 else MOST_FITTED_IN_FLEET :]
    if (noises := least_noises(base)) is not None:
        second = screen(candidates, base.hypothesis.designs, noises, rng, taken)
        chosen += [group for group in _others(second, chosen) if group[0].p_value < UNMASKED][:MOST_UNMASKED]
    if (between := BetweenRuns.of(base)) is not None:
        third = screen(candidates, base.hypothesis.designs, [between.less], rng, taken)
        before = {id(each.candidate): each for each in first.results}
        chosen += [
            group
            for group in _others(third, chosen)
            if between.p_value(before.get(id(group[0].candidate)), group[0]) < worth
        ][:MOST_UNMASKED]
    return chosen


def _others(screened: Screen, chosen: Sequence[Sequence[Screened]]) -> list[list[Screened]]:
    """Results of the effects that are not chosen yet, by effect, best first."""
    names = {group[0].candidate.effect.name for group in chosen}
    return [group for group in screened.by_effect() if group[0].candidate.effect.name not in names]


def _rivals(effects: Sequence[Effect], first: Screen) -> list[list[Screened]]:
    """Effects that look like a chosen one and just missed the screening: without them it would be the only name."""
    names = {each.name for each in effects}
    return [
        group
        for group in first.by_effect()
        if (other := group[0].candidate.effect).name not in names
        and group[0].p_value < RIVAL
        and any(look_alike(each, other) for each in effects)
    ]


def least_noises(base: JointFit) -> Sequence[ModelNoise] | None:
    """The smaller of fitted and declared noise of each record; None if no fitted noise may hide an effect."""
    least = [_least(noise, record) for noise, record in zip(base.noises, base.records, strict=True)]
    if not any(least):
        return None
    return [each or noise for noise, each in zip(base.noises, least, strict=True)]


def _least(noise: ModelNoise, record: UnitRecord) -> ModelNoise | None:
    """The smaller of fitted and declared noise if the fitted noise is much larger."""
    fitted, declared = as_array(noise), record.prior.values
    active = declared > 0
    if not np.any(np.log(fitted[active][1:] / declared[active][1:]) > SWALLOWED):
        return None
    return from_array(np.minimum(fitted, declared))


def beside(base: JointFit, hypothesis: Hypothesis) -> tuple[JointFit, float]:
    """A further hypothesis fitted to the records of a fit, and twice its gain in log likelihood."""
    joint = fit_jointly(base.records, hypothesis, base.noises)
    return joint, 2 * (joint.log_likelihood - base.log_likelihood)


def _fitted(
    candidates: Candidates, base: JointFit, group: Sequence[Screened], screened: Screen, *, may_be_rival: bool
) -> FittedCandidate | None:
    """The better fit of the two best shapes of an effect; None if it fails the family-wise test, unless a rival."""
    best: FittedCandidate | None = None
    for result in group[: 2 if len(base.records) == 1 else 1]:
        item = result.candidate
        columns = candidates.of_all(item)
        joint, ratio = beside(base, base.hypothesis.with_common(columns))
        ratio = calibrated_ratio(joint, ratio, columns[0].shape[1])
        p_value = float(chi_square_sf(max(ratio, 0.0), result.degrees))
        is_by_chance = family_p_value(p_value, screened.tests) >= ALPHA
        if (is_by_chance and not may_be_rival) or (best and ratio <= best.likelihood_ratio):
            continue
        degrees = result.degrees + (len(group) > 1)
        evidence = _evidence(joint, ratio, degrees, item.effect)
        best = FittedCandidate(
            item.effect, dict(item.shape), columns, joint, ratio, degrees, evidence, is_rival=is_by_chance
        )
    return best


def _reshaped(candidates: Candidates, base: JointFit, each: FittedCandidate) -> FittedCandidate:
    """A candidate at the shape between the tried ones that explains clearly more; itself if there is none."""
    shape = better_shape(candidates, each.joint, each.effect, each.parameters)
    if shape is None:
        return each
    columns = candidates.at(each.effect, shape)
    joint, ratio = beside(base, base.hypothesis.with_common(columns))
    ratio = calibrated_ratio(joint, ratio, columns[0].shape[1])
    evidence = _evidence(joint, ratio, each.degrees, each.effect)
    fitted = replace(
        each,
        parameters=dict(shape),
        columns=columns,
        joint=joint,
        likelihood_ratio=ratio,
        evidence=evidence,
        at_most=None,
    )
    better = _discounted(fitted)
    return better if better.evidence > each.evidence else each


def _has_plausible_size(terms: Sequence[str], each: FittedCandidate) -> bool:
    """Whether a clock error needs no larger clock error than there is, by the declared term that it acts through."""
    bound = each.effect.clock_bound
    if bound is None or bound[0] not in terms:
        return True
    at = terms.index(bound[0])
    sensitivity = max(
        abs(float(own.coefficients[at])) + CONFIDENCE * float(np.sqrt(own.covariance[at, at])) for own in each.joint.own
    )
    return abs(float(each.joint.common.coefficients[-1])) <= bound[1] * sensitivity


def _evidence(joint: JointFit, ratio: float, degrees: int, effect: Effect) -> float:
    """Evidence of a fit; the penalty doubles if its noise is far from the declared noise."""
    excess = [
        record.noise_model.average_variance(noise, EXCESS_AVERAGE_S)
        / record.noise_model.average_variance(record.prior.center, EXCESS_AVERAGE_S)
        for record, noise in zip(joint.records, joint.noises, strict=True)
    ]
    price = PRICE if max(excess) > GROSS_EXCESS else 0.0
    return evidence(ratio, degrees, effect) - price


def _discounted(each: FittedCandidate) -> FittedCandidate:
    """The candidate with its replication, and its evidence reduced by the noise inflation."""
    replicates = [record.stack.replicate for record in each.joint.records]
    replication = leave_one_out(each.joint, replicates, each.columns[0].shape[1])
    each = replace(each, replication=replication, replicates=replication.replicates)
    each = _inflated(each) if each.replicates else each
    # the cached columns of a fleet would fill the memory
    return replace(each, joint=replace(each.joint)) if len(each.joint.records) > 1 else each


def as_if_replicated(each: FittedCandidate) -> FittedCandidate:
    """A candidate of one replicate as if it replicated."""
    return each if each.replicates else _inflated(replace(each, replicates=True))


def _inflated(each: FittedCandidate) -> FittedCandidate:
    """The candidate with its evidence reduced by the noise inflation."""
    replicates = [record.stack.replicate for record in each.joint.records]
    runs = [record.stack.run_number for record in each.joint.records]
    width = each.columns[0].shape[1]
    ratio = each.likelihood_ratio / noise_inflation(each.joint, replicates, runs, width)
    evidence = _evidence(each.joint, ratio, each.degrees, each.effect)
    return replace(each, likelihood_ratio=ratio, evidence=evidence, at_most=each.evidence)


def replicated_ratio(base: JointFit, joint: JointFit, ratio: float, degrees: int) -> float | None:
    """The likelihood ratio of the last columns of a fit over the noise inflation; None if they do not replicate."""
    stacks = [record.stack for record in base.records]
    replicates = [stack.replicate for stack in stacks]
    if not leave_one_out(joint, replicates, degrees).replicates:
        return None
    inflation = noise_inflation(joint, replicates, [stack.run_number for stack in stacks], degrees)
    return calibrated_ratio(joint, ratio, degrees) / inflation


def _line(base: JointFit) -> FittedCandidate | None:
    records = base.records
    line = scan_lines(records, base.residuals)
    if line is None or line.family_p_value >= LINE_ALPHA:
        return None
    line = between_grid_points(records, base.residuals, line)
    columns = tuple(line_columns(record, line.frequency_hz) for record in records)
    joint, ratio = beside(base, base.hypothesis.with_own(columns))
    fitted_p_value = float(chi_square_sf(max(ratio, 0.0), 2 * line.powers.size))
    strength = float(chi_square_isf(max(line.p_value, fitted_p_value, 1e-300), 1))
    gain = strength - 2 * np.log(sum(map(len, records)))
    if gain <= 0:
        return None
    replicates = line.powers.size == 1 or line.largest_share < LINE_MOST_FROM_ONE
    shape = {"frequency_hz": line.frequency_hz}
    return FittedCandidate(effect(LINE), shape, columns, joint, strength, 1, gain, replicates=replicates)


def _jump(base: JointFit) -> FittedCandidate | None:
    records = base.records
    jump = scan_jumps(records, base)
    if jump is None or jump.family_p_value >= ALPHA:
        return None
    columns = tuple(
        jump_column(record, jump.row) if number == jump.record else np.empty((len(record), 0))
        for number, record in enumerate(records)
    )
    joint, ratio = beside(base, base.hypothesis.with_own(columns))
    gain = ratio - 3 * np.log(sum(map(len, records)))
    if gain <= 0:
        return None
    run = records[jump.record].stack.runs[jump.run]
    slot = records[jump.record].stack.slot[jump.row]
    shape = {"run": run.run, "at_s": float(slot * run.block_s)}
    return FittedCandidate(effect(JUMP), shape, columns, joint, ratio, 1, gain)
