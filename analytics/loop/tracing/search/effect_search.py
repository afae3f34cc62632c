"""The search for missing effects: rounds of fitted candidates, then replacement and pruning."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from analytics.loop.effects.base import EffectKind, Role
from analytics.loop.tracing.search.differing_terms import differing_terms
from analytics.loop.tracing.search.evidence import PRICE, look_alike
from analytics.loop.tracing.search.fitted_candidates import FittedCandidate, as_if_replicated, fitted_candidates
from analytics.loop.tracing.search.named_parts import named_parts
from analytics.loop.tracing.search.pair_round import best_pair
from analytics.loop.tracing.search.screening import Candidates, screen
from analytics.loop.tracing.search.unreplicated import unreplicated_of
from analytics.loop.tracing.whitening.joint_fit import Hypothesis, JointFit, fit_jointly, normal_equations, nothing_more
from analytics.loop.tracing.whitening.least_squares import solve
from analytics.loop.tracing.whitening.stack import UnitRecord
from stream.batch import FloatArray, IntArray

MOST_EFFECTS = 4
LEAST_SHARED = 0.5  # of what an effect explains beside the others, which a rival of it has to explain as well
_MOST_SWEEPS = 3


@dataclass(frozen=True)
class Selected:
    """A selected effect and the candidates that cannot be separated from it."""

    fitted: FittedCandidate
    confounded: tuple[FittedCandidate, ...]  # candidates that it does not lead by 12, or 3 %, of evidence
    companions: tuple[str, ...]  # names of the proxies among them
    leading_proxy: str | None = None  # explains far more than this cause: the form of the cause is wrong

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.fitted.name

    @property
    def is_common(self) -> bool:
        """Whether its coefficients hold for all units."""
        return self.fitted.is_common


@dataclass(frozen=True)
class Search:
    """Result of the search."""

    selected: tuple[Selected, ...]  # in the order of selection
    null: JointFit  # fit of the declared model alone
    joint: JointFit  # fit with all selected effects
    unreplicated: tuple[FittedCandidate, ...]  # with evidence beside the selected effects, but without replication
    beside: tuple[FittedCandidate, ...] = ()  # all candidates beside the selected effects; empty for several records

    @property
    def common(self) -> list[Selected]:
        """The selected effects but lines and jumps."""
        return [each for each in self.selected if each.is_common]

    def common_columns(self, which: Selected) -> slice:
        """Position of the columns of an effect among the common ones."""
        return _columns_of(which, [(each, each.fitted.columns[0].shape[1]) for each in self.common], 0)

    def common_fit(self, which: Selected) -> tuple[FloatArray, FloatArray]:
        """Common coefficients of an effect, and their covariance."""
        at = self.common_columns(which)
        return self.joint.common.coefficients[at], self.joint.common.covariance[at, at]

    def own_fit(self, which: Selected, places: Iterable[int]) -> tuple[FloatArray, FloatArray]:
        """Coefficients of a line or a jump in these records, and the variance of each."""
        solutions = [(self.joint.own[place], self._own_columns(which, place)) for place in places]
        return (
            np.concatenate([solution.coefficients[at] for solution, at in solutions]),
            np.concatenate([np.diag(solution.covariance)[at] for solution, at in solutions]),
        )

    def _own_columns(self, which: Selected, number: int) -> slice:
        events = [(each, each.fitted.columns[number].shape[1]) for each in self.selected if not each.is_common]
        return _columns_of(which, events, self.null.hypothesis.own[number].shape[1])

    def without(self, names: Sequence[str]) -> "Search":
        """The search without some effects, the others fitted again."""
        if not names:
            return self
        kept = tuple(each for each in self.selected if each.name not in names)
        records = self.joint.records
        joint = fit_jointly(records, _hypothesis_of(records, kept), self.joint.noises, restricted=True)
        return replace(self, selected=kept, joint=joint)


def _columns_of(which: Selected, widths: Sequence[tuple[Selected, int]], start: int) -> slice:
    """Position of the columns of an effect among those of others, from the column `start` on."""
    for each, width in widths:
        if each is which:
            return slice(start, start + width)
        start += width
    return slice(0, 0)


def search(candidates: Candidates, rng: np.random.Generator, given: Sequence[Selected] = ()) -> Search:
    """Find the effects that the declared model lacks beside those `given`, one record for each unit."""
    records = candidates.records
    null = joint = fit_jointly(records, nothing_more(records))
    selected = list(given)
    if given:
        joint = fit_jointly(records, _hypothesis_of(records, given), null.noises)
    beside: list[FittedCandidate] = []
    while len(selected) < MOST_EFFECTS:
        beside = _candidates_beside(candidates, joint, rng, selected)
        best = _chosen(beside)
        if best is None:
            break
        selected.append(best)
        joint = best.fitted.joint
    chosen = _as_chosen(selected)
    common = sum(each.is_common for each in selected)
    if common < 2 and len(selected) - common + 2 <= MOST_EFFECTS and not given:
        selected, joint = _with_pair(candidates, selected, joint, rng)
    elif common >= 2:
        selected, joint = _refined(candidates, selected, joint, rng, given)
    selected, joint = _with_named_parts(candidates, selected, joint, rng, given)
    if len(records) > 1 and selected:
        beside = []
    elif len(selected) == MOST_EFFECTS or _as_chosen(selected) != chosen:
        beside = _candidates_beside(candidates, joint, rng, selected)
    joint = fit_jointly(records, _hypothesis_of(records, selected), joint.noises, restricted=True)
    selected = _without_others_rivals(selected, joint)
    return Search(tuple(selected), null, joint, unreplicated_of(beside, beside_others=bool(selected)), tuple(beside))


def _as_chosen(selected: Sequence[Selected]) -> list[tuple[str, dict[str, Any]]]:
    return [(each.name, each.fitted.parameters) for each in selected]


def _candidates_beside(
    candidates: Candidates, joint: JointFit, rng: np.random.Generator, selected: Sequence[Selected]
) -> list[FittedCandidate]:
    # lines and jumps would pass for a coefficient that differs from run to run
    repeats = not differing_terms(joint)
    return fitted_candidates(candidates, joint, rng, [each.name for each in selected], with_events=repeats)


def provisional(found: Search) -> Search | None:
    """The search with the best effect that only one replicate shows clearly, for held-out runs to judge; None if none.

    Its look-alikes are those that would be confounded with it if all of them replicated.
    """
    every = [as_if_replicated(each) for each in found.beside if each.is_common]
    best = _chosen(sorted(every, key=lambda each: -each.evidence))
    if best is None or len(found.selected) >= MOST_EFFECTS:
        return None
    records, selected = found.joint.records, (*found.selected, best)
    joint = fit_jointly(records, _hypothesis_of(records, selected), found.joint.noises, restricted=True)
    return replace(found, selected=selected, joint=joint, unreplicated=(), beside=())


def _with_pair(
    candidates: Candidates, selected: list[Selected], joint: JointFit, rng: np.random.Generator
) -> tuple[list[Selected], JointFit]:
    """Replace none or one effect by two that mask each other, if each is selected beside the other.

    The difference of two such effects may resemble a third effect, which is then the only one found.
    """
    events = [each for each in selected if not each.is_common]
    least = sum(each.fitted.evidence + each.fitted.lead for each in selected if each.is_common)
    base = fit_jointly(joint.records, _hypothesis_of(joint.records, events), joint.noises) if least else joint
    pair = best_pair(candidates, base, lambda: screen(candidates, base.hypothesis.designs, base.noises, rng).tests)
    if not pair or pair[0].evidence <= least:
        return selected, joint
    both = [*events, *(Selected(each, (), ()) for each in pair)]
    refined, after = _refined(candidates, both, pair[0].joint, rng)
    is_kept = sum(each.is_common for each in refined) == len(pair)
    return (refined, after) if is_kept else (selected, joint)


def _with_named_parts(
    candidates: Candidates,
    selected: list[Selected],
    joint: JointFit,
    rng: np.random.Generator,
    given: Sequence[Selected],
) -> tuple[list[Selected], JointFit]:
    """Replace a general function by named effects of its channel, if their sum explains as much."""
    functions = [
        each
        for each in selected
        if each.fitted.effect.kind is EffectKind.FUNCTION and each.name not in [one.name for one in given]
    ]
    for function in functions:
        others = [each for each in selected if each is not function]
        base = fit_jointly(joint.records, _hypothesis_of(joint.records, others), joint.noises)
        parts = named_parts(candidates, function.fitted, base)
        if not parts or len(others) + len(parts) > MOST_EFFECTS:
            continue
        both = [*others, *(Selected(each, (), ()) for each in parts)]
        refined, after = _refined(candidates, both, parts[0].joint, rng, given)
        if not any(each.fitted.effect.kind is EffectKind.FUNCTION for each in refined):
            return refined, after
    return selected, joint


def _chosen(found: Sequence[FittedCandidate]) -> Selected | None:
    """The best candidate that replicates; a proxy or an alias only if no cause explains the data."""
    usable = [each for each in found if each.replicates and each.is_plausible]
    significant = [each for each in usable if not each.is_rival]
    if not significant or significant[0].evidence <= 0:
        return None
    best, leading = significant[0], None
    if best.effect.kind is EffectKind.EVENT and _has_rivals(best, found):
        return None
    causes = [each for each in significant if each.effect.role is Role.CAUSE and each.is_common and each.evidence > 0]
    if best.effect.role is Role.PROXY and causes:
        leading = best.name if best.evidence - causes[0].evidence > best.lead else None
        best = causes[0]
    elif best.effect.role is Role.ALIAS and causes and best.evidence - causes[0].evidence < best.lead:
        best = causes[0]
    # what a function with many coefficients adds to a named form of the same channel is for the test of that form
    best = next((each for each in causes if _contains(best, each) and _is_named(each) and each.is_near(best)), best)
    # the truth may fail to replicate where one run excites it most; then its look-alike must not be the only name
    others = [each for each in found if each.replicates or look_alike(each.effect, best.effect)]
    near = [each for each in others if each is not best and (each.is_near(best) or _by_design(each, best))]
    return Selected(
        fitted=best,
        confounded=tuple(each for each in near if each.effect.role is not Role.PROXY and not _contains(each, best)),
        companions=tuple(each.name for each in near if each.effect.role is Role.PROXY),
        leading_proxy=leading,
    )


def _by_design(first: FittedCandidate, second: FittedCandidate) -> bool:
    """Whether one is a general function with the other among its aliases.

    The design of the test separates them, not the data: for example gravity and the bias of a mounting.
    """
    pairs = (first, second), (second, first)
    return any(one.effect.kind is EffectKind.FUNCTION and other.name in one.effect.aliases for one, other in pairs)


def _has_rivals(jump: FittedCandidate, found: Sequence[FittedCandidate]) -> bool:
    """Whether an effect explains the one run as well as a jump, though it does not replicate."""
    near = max(0.0, jump.evidence - PRICE)
    return any(not (each.replicates or each.is_rival) and each.evidence > near for each in found)


def _contains(function: FittedCandidate, other: FittedCandidate) -> bool:
    """Whether a candidate is a general function of the channels of an effect: it is no alternative to it."""
    is_function = function.effect.kind is EffectKind.FUNCTION and other.is_common
    return is_function and set(function.effect.needs) <= set(other.effect.needs)


def _is_named(candidate: FittedCandidate) -> bool:
    """Whether an effect has a form of its own."""
    return candidate.effect.kind is EffectKind.LIBRARY and not candidate.effect.parameters


def _refined(
    candidates: Candidates,
    selected: list[Selected],
    joint: JointFit,
    rng: np.random.Generator,
    given: Sequence[Selected] = (),
) -> tuple[list[Selected], JointFit]:
    """Select each effect that is not given again beside the others, and drop those that become unnecessary."""
    kept = [each.name for each in given]
    for _ in range(_MOST_SWEEPS):
        before = [each.name for each in selected]
        for old in [each for each in selected if each.is_common and each.name not in kept]:
            others = [each for each in selected if each is not old]
            base = fit_jointly(joint.records, _hypothesis_of(joint.records, others), joint.noises)
            taken = [each.name for each in others]
            best = _chosen(fitted_candidates(candidates, base, rng, taken, with_events=False))
            if best is None:
                selected, joint = [_as_before(old, each) for each in others], base
            else:
                selected, joint = [*others, _as_before(old, best)], best.fitted.joint
        if [each.name for each in selected] == before:
            break
    return selected, joint


def _as_before(old: Selected, new: Selected) -> Selected:
    """The replacement of an effect, confounded with all candidates of the first selection.

    A further effect may only correct imperfect channels and forms; it must not decide between the first candidates.
    """
    before = (old.fitted, *old.confounded)
    first = next((each for each in before if each.name == new.name), None)
    if first is None:
        return new
    shift, most = new.fitted.evidence - first.evidence, new.fitted.evidence
    known = {new.name, *(each.name for each in new.confounded)}
    more = [each for each in before if each.name not in known]
    carried = (replace(each, evidence=min(each.evidence + shift, most), at_most=None) for each in more)
    return replace(new, confounded=(*new.confounded, *carried))


def _without_others_rivals(selected: Sequence[Selected], joint: JointFit) -> list[Selected]:
    """The selected effects without candidates that explain what another selected effect explains, or are that effect.

    Two effects of about the same strength have about the same evidence, though they explain different parts. A rival of
    an effect explains about as much as this beside the others, and hardly any of it beside this effect as well.
    """
    common = [each for each in selected if each.is_common]
    if len(common) < 2:
        return list(selected)
    return [
        replace(each, confounded=tuple(other for other in each.confounded if _is_of(each, other, common, joint)))
        if each.is_common
        else each
        for each in selected
    ]


def _is_of(effect: Selected, other: FittedCandidate, common: Sequence[Selected], joint: JointFit) -> bool:
    """Whether a candidate explains the same as an effect, and not what other effects explain."""
    if not other.is_common or _by_design(effect.fitted, other):
        return True
    hypothesis = replace(joint.hypothesis, common=tuple(np.empty((len(each), 0)) for each in joint.records))
    beside = [each.fitted for each in common if each is not effect and each.name != other.name]
    ends = [0]
    for each in (*beside, effect.fitted, other):
        hypothesis = hypothesis.with_common(each.columns)
        ends.append(ends[-1] + each.columns[0].shape[1])
    normal, right = normal_equations(joint, hypothesis)
    theirs, own, candidate = (np.arange(first, end) for first, end in ((0, ends[-3]), ends[-3:-1], ends[-2:]))

    def whole(*parts: IntArray) -> float:
        """Chi-square that these columns explain."""
        which = np.concatenate(parts)
        return float(right[which] @ solve(normal[np.ix_(which, which)], right[which]).coefficients)

    alone = whole(theirs)
    by_effect, by_other = whole(theirs, own) - alone, whole(theirs, candidate) - alone
    still = whole(theirs, own, candidate) - whole(theirs, own)
    return by_other >= LEAST_SHARED * by_effect and by_other - still >= LEAST_SHARED * by_other


def _hypothesis_of(records: Sequence[UnitRecord], selected: Sequence[Selected]) -> Hypothesis:
    hypothesis = nothing_more(records)
    for each in selected:
        add = hypothesis.with_common if each.is_common else hypothesis.with_own
        hypothesis = add(each.fitted.columns)
    return hypothesis
