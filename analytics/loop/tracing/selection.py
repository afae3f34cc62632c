"""The search for what is missing: rounds of fitted_candidates, then swap and prune."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from analytics.loop.effects.base import Kind, Role
from analytics.loop.tracing.candidates import Candidates
from analytics.loop.tracing.evidence import PRICE
from analytics.loop.tracing.fitted_candidates import FittedCandidate, fitted_candidates
from analytics.loop.tracing.joint_fit import Hypothesis, JointFit, fit_jointly, nothing_more
from analytics.loop.tracing.pair_round import best_pair
from analytics.loop.tracing.record import Record
from analytics.loop.tracing.screening import screen
from stream.batch import FloatArray

MOST_EFFECTS = 4
_MOST_SWEEPS = 3


@dataclass(frozen=True)
class Selected:
    """An effect that was taken into the model, and what else could be meant.

    Parameters
    ----------
    fitted_candidate: The effect.
    confounded: Others that it does not lead by 12, or 3 %, of evidence.
    companions: Proxies of which the same is true.
    leading_proxy: A proxy that explains far more than this cause: then the cause acts in another way than its form
        says.
    """

    fitted_candidate: FittedCandidate
    confounded: tuple[FittedCandidate, ...]
    companions: tuple[str, ...]
    leading_proxy: str | None = None

    @property
    def is_common(self) -> bool:
        """Whether its coefficients are those of all units."""
        return self.fitted_candidate.candidate is not None


@dataclass(frozen=True)
class Search:
    """What the search came to.

    Parameters
    ----------
    selected: In the order in which they were found.
    null, joint: The declared model alone, and with all that was selected.
    unreplicated: What had evidence in the first round, but from one run alone.
    """

    selected: tuple[Selected, ...]
    null: JointFit
    joint: JointFit
    unreplicated: tuple[FittedCandidate, ...]

    def common_columns(self, which: Selected) -> slice:
        """Where the columns of a selected effect are among the common ones."""
        start = 0
        for each in self.selected:
            if not each.is_common:
                continue
            width = each.fitted_candidate.columns[0].shape[1]
            if each is which:
                return slice(start, start + width)
            start += width
        return slice(0, 0)

    def own_columns(self, which: Selected, number: int) -> slice:
        """Where the columns of a line or a jump are among the own ones of a record."""
        start = self.null.hypothesis.own[number].shape[1]
        for each in self.selected:
            width = 0 if each.is_common else each.fitted_candidate.columns[number].shape[1]
            if each is which:
                return slice(start, start + width)
            start += width
        return slice(0, 0)


def own_fit(found: Search, which: Selected, places: Iterable[int]) -> tuple[FloatArray, FloatArray]:
    """Coefficients of a line or a jump in these records, and the variance of each."""
    solutions = [(found.joint.own[place], found.own_columns(which, place)) for place in places]
    return (
        np.concatenate([solution.coefficients[at] for solution, at in solutions]),
        np.concatenate([np.diag(solution.covariance)[at] for solution, at in solutions]),
    )


def search(records: Sequence[Record], candidates: Candidates, rng: np.random.Generator) -> Search:
    """Find what the declared model lacks.

    Parameters
    ----------
    records: One for each unit.
    candidates: What is tried beside lines and jumps.
    rng: For the screening.
    """
    null = fit_jointly(records, nothing_more(records))
    joint = null
    selected: list[Selected] = []
    unreplicated: tuple[FittedCandidate, ...] = ()
    for _ in range(MOST_EFFECTS):
        found = fitted_candidates(records, candidates, joint, rng, [each.fitted_candidate.name for each in selected])
        if not selected:
            unreplicated = tuple(each for each in found if not each.replicates and each.evidence > 0)
        best = _chosen(found)
        if best is None:
            break
        selected.append(best)
        joint = best.fitted_candidate.joint
    common = [each for each in selected if each.is_common]
    if len(common) < 2 and len(selected) - len(common) + 2 <= MOST_EFFECTS:
        selected, joint = _with_pair(records, candidates, selected, joint, rng)
    elif len(common) >= 2:
        selected, joint = _refined(records, candidates, selected, joint, rng)
    joint = fit_jointly(records, hypothesis_of(records, selected), joint.noises, restricted=True)
    return Search(tuple(selected), null, joint, unreplicated)


def _with_pair(
    records: Sequence[Record],
    candidates: Candidates,
    selected: list[Selected],
    joint: JointFit,
    rng: np.random.Generator,
) -> tuple[list[Selected], JointFit]:
    """Take two effects that mask each other in the place of none or of one; each must be chosen beside the other.

    What is left of two that mask each other may look like a third, which then is the only one that is found.
    """
    events = [each for each in selected if not each.is_common]
    least = sum(each.fitted_candidate.evidence + each.fitted_candidate.lead for each in selected if each.is_common)
    base = fit_jointly(records, hypothesis_of(records, events), joint.noises) if least else joint
    pair = best_pair(
        records, candidates, base, lambda: screen(candidates, base.hypothesis.designs, base.noises, rng).tests
    )
    if not pair or pair[0].evidence <= least:
        return selected, joint
    both = [*events, *(Selected(each, (), ()) for each in pair)]
    refined, after = _refined(records, candidates, both, pair[0].joint, rng)
    is_kept = sum(each.is_common for each in refined) == len(pair)
    return (refined, after) if is_kept else (selected, joint)


def _chosen(found: Sequence[FittedCandidate]) -> Selected | None:
    """Return the best candidate that replicates; a proxy or an alias only where no cause will do."""
    usable = [each for each in found if each.replicates]
    if not usable or usable[0].evidence <= 0:
        return None
    best, leading = usable[0], None
    if best.kind is Kind.EVENT and _rivals(best, found):
        return None
    causes = [each for each in usable if each.role is Role.CAUSE and each.candidate is not None and each.evidence > 0]
    if best.role is Role.PROXY and causes:
        leading = best.name if best.evidence - causes[0].evidence > best.lead else None
        best = causes[0]
    elif best.role is Role.ALIAS and causes and best.evidence - causes[0].evidence < best.lead:
        best = causes[0]
    near = [each for each in usable if each is not best and (each.is_near(best) or _by_design(each, best))]
    return Selected(
        fitted_candidate=best,
        confounded=tuple(each for each in near if each.role is not Role.PROXY and not _contains(each, best)),
        companions=tuple(each.name for each in near if each.role is Role.PROXY),
        leading_proxy=leading,
    )


def _by_design(first: FittedCandidate, second: FittedCandidate) -> bool:
    """Whether one is a general function that names the other among its aliases.

    Then the design of the test and not the data decides between them, as between gravity and the bias of a mounting.
    """
    pairs = ((first, second), (second, first))
    return any(
        function.kind is Kind.FUNCTION
        and function.candidate is not None
        and other.name in function.candidate.effect.aliases
        for function, other in pairs
    )


def _rivals(jump: FittedCandidate, found: Sequence[FittedCandidate]) -> list[FittedCandidate]:
    """Effects that explain the one run as well as a jump does, though no other run bears them out."""
    near = max(0.0, jump.evidence - PRICE)
    return [each for each in found if not each.replicates and each.evidence > near]


def _contains(function: FittedCandidate, effect: FittedCandidate) -> bool:
    """Whether a candidate is a general function of the very channels of an effect: then it says nothing against it."""
    if function.kind is not Kind.FUNCTION or function.candidate is None or effect.candidate is None:
        return False
    return set(function.candidate.effect.needs) <= set(effect.candidate.effect.needs)


def _refined(
    records: Sequence[Record],
    candidates: Candidates,
    selected: list[Selected],
    joint: JointFit,
    rng: np.random.Generator,
) -> tuple[list[Selected], JointFit]:
    """Choose each effect anew beside the others, and drop those that the others make needless."""
    for _ in range(_MOST_SWEEPS):
        before = [each.fitted_candidate.name for each in selected]
        selected, joint = _sweep(records, candidates, selected, joint, rng)
        if [each.fitted_candidate.name for each in selected] == before:
            break
    return selected, joint


def _sweep(
    records: Sequence[Record],
    candidates: Candidates,
    selected: list[Selected],
    joint: JointFit,
    rng: np.random.Generator,
) -> tuple[list[Selected], JointFit]:
    for old in [each for each in selected if each.is_common]:
        others = [each for each in selected if each is not old]
        base = fit_jointly(records, hypothesis_of(records, others), joint.noises)
        taken = [each.fitted_candidate.name for each in others]
        best = _chosen(fitted_candidates(records, candidates, base, rng, taken, with_events=False))
        if best is None:
            selected, joint = [_as_before(old, each) for each in others], base
        else:
            selected, joint = [*others, _as_before(old, best)], best.fitted_candidate.joint
    return selected, joint


def _as_before(old: Selected, new: Selected) -> Selected:
    """Return an effect that takes the place of another, with all that were not told from it when that was chosen.

    A further effect may only mend what channels and forms lack, and must not decide between two of the first.
    """
    before = (old.fitted_candidate, *old.confounded)
    first = next((each for each in before if each.name == new.fitted_candidate.name), None)
    if first is None:
        return new
    shift, most = new.fitted_candidate.evidence - first.evidence, new.fitted_candidate.evidence
    known = {new.fitted_candidate.name, *(each.name for each in new.confounded)}
    more = [each for each in before if each.name not in known]
    carried = (replace(each, evidence=min(each.evidence + shift, most), at_most=None) for each in more)
    return replace(new, confounded=(*new.confounded, *carried))


def hypothesis_of(records: Sequence[Record], selected: Sequence[Selected]) -> Hypothesis:
    """Return the declared model with selected effects."""
    hypothesis = nothing_more(records)
    for each in selected:
        add = hypothesis.with_common if each.is_common else hypothesis.with_own
        hypothesis = add(each.fitted_candidate.columns)
    return hypothesis
