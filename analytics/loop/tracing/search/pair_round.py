"""Pairs of effects that mask each other: each is found only together with the other.

Their columns are similar and their coefficients have opposite signs, such as hysteresis and gradient over one
temperature cycle; each alone explains only their difference.
"""

from collections.abc import Callable, Sequence
from itertools import count

import numpy as np
from scipy import special

from analytics.loop.effects.base import EffectKind, Role
from analytics.loop.model.error_model import ModelNoise
from analytics.loop.tracing.search.evidence import PRICE, one_degree
from analytics.loop.tracing.search.fitted_candidates import FittedCandidate, beside, least_noises, replicated_ratio
from analytics.loop.tracing.search.screening import (
    LEAST_LEFT,
    Candidate,
    Candidates,
    family_p_value,
    own_whitening,
    pooled,
)
from analytics.loop.tracing.whitening.joint_fit import JointFit
from analytics.methods.distributions import chi_square_sf
from stream.batch import FloatArray

PAIR_PRICE = 2 * PRICE + 6.0  # multiplicity penalty of a pair: that of each effect, and one for the number of pairs
PAIR_ALPHA = 1e-3  # family-wise error rate of pairs
LEAST_APART = 0.01  # least share of the second effect that is orthogonal to the first
_WORTH, _LEAST_STATISTIC = 1e-7, 32.0  # p-value of the screening, and its chi-square for two degrees of freedom
_MOST_FITTED = 5


def best_pair(candidates: Candidates, base: JointFit, tests: Callable[[], float]) -> list[FittedCandidate]:
    """The pair of effects with the most evidence beside the model `base`; empty if no pair passes.

    `tests` gives the effective number of independent tests of single effects; it is called only if a pair is fitted.
    """
    worth = _worth_fitting(candidates, base)
    singles = tests() if worth else 1.0
    pairs = [_fitted(candidates, base, each, singles) for each in worth]
    return max((pair for pair in pairs if pair), key=lambda pair: pair[0].evidence, default=[])


def _worth_fitting(candidates: Candidates, base: JointFit) -> list[tuple[Candidate, Candidate]]:
    """Pairs that pass the screening with their best shapes, best first."""
    best: dict[tuple[str, str], tuple[float, int, tuple[Candidate, Candidate]]] = {}
    order = count()
    for noises in (base.noises, least_noises(base)):
        for p_value, pair in _screened(candidates, base.hypothesis.designs, noises) if noises else ():
            names = pair[0].effect.name, pair[1].effect.name
            if names not in best or p_value < best[names][0]:
                best[names] = p_value, next(order), pair
    return [pair for _, _, pair in sorted(best.values(), key=lambda each: each[:2])][:_MOST_FITTED]


def _screened(
    candidates: Candidates, designs: Sequence[FloatArray], noises: Sequence[ModelNoise]
) -> list[tuple[float, tuple[Candidate, Candidate]]]:
    """P-values of pairs with a given noise."""
    normal, right, before = pooled(candidates, designs, noises)
    diagonal = np.diag(normal)
    resolved = diagonal > LEAST_LEFT * np.maximum(before, 1e-300)
    items = [
        each
        for each in candidates.items
        if each.effect.kind is EffectKind.LIBRARY and each.effect.role is Role.CAUSE and resolved[each.columns].all()
    ]
    is_single = np.array([each.width == 1 for each in items], dtype=np.bool_)
    starts = np.array([each.start for each in items], dtype=np.int64)
    whitening = {id(each): own_whitening(normal[each.columns, each.columns]) for each in items}
    statistic = {id(each): float(np.sum((whitening[id(each)] @ right[each.columns]) ** 2)) for each in items}
    found = []
    for number, first in enumerate(items):
        along = whitening[id(first)] @ normal[first.columns]
        beside = right - along.T @ (whitening[id(first)] @ right[first.columns])
        rest = diagonal - np.sum(along**2, axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):  # of columns within the span of the first
            too_small = is_single & ~(statistic[id(first)] + (beside**2 / rest)[starts] >= _LEAST_STATISTIC)
        for second in (items[at] for at in np.flatnonzero(~too_small) if at > number):
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
            # both effects must contribute
            if p_value < _WORTH and min(more, whole - statistic[id(second)]) > PRICE:
                found.append((p_value, (first, second)))
    return found


def _fitted(
    candidates: Candidates, base: JointFit, pair: tuple[Candidate, Candidate], tests: float
) -> list[FittedCandidate]:
    columns = [candidates.of_all(each) for each in pair]
    hypothesis = base.hypothesis.with_common(columns[0]).with_common(columns[1])
    joint, ratio = beside(base, hypothesis)
    degrees = sum(each.width for each in pair)
    left = replicated_ratio(base, joint, ratio, degrees)
    if left is None:
        return []
    p_value = float(chi_square_sf(max(left, 0.0), degrees))
    gain = float(one_degree(left, degrees)) - PAIR_PRICE
    if gain <= 0 or family_p_value(p_value, max(tests, tests**2 / 2)) >= PAIR_ALPHA:
        return []
    return [
        FittedCandidate(each.effect, dict(each.shape), own, joint, left, degrees, gain)
        for each, own in zip(pair, columns, strict=True)
    ]
