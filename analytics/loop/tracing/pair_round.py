"""Two effects that mask each other: neither explains anything without the other, both together do.

Their columns are alike and their sizes of opposite sign, as a hysteresis and a gradient that follow one cycle of
temperature; each alone then explains only what is left of their difference.
"""

from collections.abc import Callable, Sequence
from itertools import count

import numpy as np
from scipy import special, stats

from analytics.loop.effects.base import Kind, Role
from analytics.loop.model.noise import NoiseCoefficients
from analytics.loop.tracing.candidates import Candidate, Candidates
from analytics.loop.tracing.evidence import PRICE, leave_one_out, one_degree
from analytics.loop.tracing.fitted_candidates import FittedCandidate, least_noises
from analytics.loop.tracing.joint_fit import JointFit, fit_jointly
from analytics.loop.tracing.misfit import noise_inflation
from analytics.loop.tracing.record import Record
from analytics.loop.tracing.screening import LEAST_LEFT, family_p_value, own_whitening, pooled
from stream.batch import FloatArray

PAIR_PRICE = 2 * PRICE + 6.0
"""Each pays for being one of many, and the pair for being one of many more."""
PAIR_ALPHA = 1e-3
"""Family-wise chance of a false pair."""
LEAST_APART = 0.01
"""Part of the second effect that must be left beside the first; less is told by nobody's channels."""
_WORTH, _LEAST_STATISTIC = 1e-7, 32.0  # p-value of the screening, and its chi-square for two degrees of freedom
_MOST_FITTED = 5


def best_pair(
    records: Sequence[Record], candidates: Candidates, base: JointFit, tests: Callable[[], float]
) -> list[FittedCandidate]:
    """Return the two effects that explain most together; none where no pair passes.

    Parameters
    ----------
    records, candidates: The blocks, and what is tried on them.
    base: The model so far.
    tests: Returns the effective number of independent tests of single effects; called only if a pair is worth a fit.
    """
    found: list[tuple[float, list[FittedCandidate]]] = []
    worth = _worth_fitting(candidates, base, least_noises(records, base.noises))
    singles = tests() if worth else 1.0
    for each in worth:
        pair = _fitted(records, candidates, base, each, singles)
        if pair is not None:
            found.append(pair)
    return max(found, key=lambda each: each[0])[1] if found else []


def _worth_fitting(
    candidates: Candidates, base: JointFit, least: Sequence[NoiseCoefficients] | None
) -> list[tuple[Candidate, Candidate]]:
    """Pairs that pass the screening, best first, each pair of effects with its best shapes."""
    best: dict[tuple[str, str], tuple[float, int, tuple[Candidate, Candidate]]] = {}
    order = count()
    for noises in (base.noises, least):
        if noises is None:
            continue
        for log_p, pair in _screened(candidates, base.hypothesis.designs, noises):
            names = pair[0].effect.name, pair[1].effect.name
            if names not in best or log_p < best[names][0]:
                best[names] = log_p, next(order), pair
    return [pair for _, _, pair in sorted(best.values(), key=lambda each: each[:2])][:_MOST_FITTED]


def _screened(
    candidates: Candidates, designs: Sequence[FloatArray], noises: Sequence[NoiseCoefficients]
) -> list[tuple[float, tuple[Candidate, Candidate]]]:
    """P-values of pairs at a given noise: the first effect, and the second beside it."""
    normal, right, before = pooled(candidates, designs, noises)
    diagonal = np.diag(normal)
    told = diagonal > LEAST_LEFT * np.maximum(before, 1e-300)
    items = [
        each
        for each in candidates.items
        if each.effect.kind is Kind.LIBRARY and each.effect.role is Role.CAUSE and told[each.columns].all()
    ]
    whitening = {id(each): own_whitening(normal[each.columns, each.columns]) for each in items}
    statistic = {id(each): float(np.sum((whitening[id(each)] @ right[each.columns]) ** 2)) for each in items}
    found = []
    for number, first in enumerate(items):
        along = whitening[id(first)] @ normal[first.columns]
        beside = right - along.T @ (whitening[id(first)] @ right[first.columns])
        rest = diagonal - np.sum(along**2, axis=0)
        for second in items[number + 1 :]:
            at = second.columns
            if first.effect.name == second.effect.name or np.any(rest[at] < LEAST_APART * diagonal[at]):
                continue
            if second.width == 1:
                more, degrees = float(beside[at][0] ** 2 / rest[at][0]), 1
            else:
                own = own_whitening(normal[at, at] - along[:, at].T @ along[:, at])
                more, degrees = float(np.sum((own @ beside[at]) ** 2)), own.shape[0]
            whole = statistic[id(first)] + more
            if whole < _LEAST_STATISTIC:
                continue
            p_value = float(special.gammaincc((whitening[id(first)].shape[0] + degrees) / 2, whole / 2))
            # a pair in which one does all the work is no pair
            if p_value < _WORTH and min(more, whole - statistic[id(second)]) > PRICE:
                found.append((p_value, (first, second)))
    return found


def _fitted(
    records: Sequence[Record], candidates: Candidates, base: JointFit, pair: tuple[Candidate, Candidate], tests: float
) -> tuple[float, list[FittedCandidate]] | None:
    columns = [candidates.of_all(each) for each in pair]
    joint = fit_jointly(records, base.hypothesis.with_common(columns[0]).with_common(columns[1]), base.noises)
    ratio = 2 * (joint.log_likelihood - base.log_likelihood)
    degrees = sum(each.width for each in pair)
    replicates, runs = [record.stack.replicate for record in records], [record.stack.run_number for record in records]
    if not leave_one_out(joint, replicates, degrees).replicates:
        return None
    ratio /= noise_inflation(joint, replicates, runs, degrees)
    p_value = float(stats.chi2.sf(max(ratio, 0.0), degrees))
    gain = one_degree(ratio, degrees) - PAIR_PRICE
    if gain <= 0 or family_p_value(p_value, max(tests, tests**2 / 2)) >= PAIR_ALPHA:
        return None
    return gain, [
        FittedCandidate.of(each, own, joint, ratio, degrees, gain) for each, own in zip(pair, columns, strict=True)
    ]
