"""A general function of a channel as the sum of named effects of that channel, such as a polynomial of temperature."""

from collections.abc import Sequence

import numpy as np

from analytics.loop.effects.base import EffectKind, Role
from analytics.loop.tracing.search.evidence import PRICE, needed_lead, one_degree
from analytics.loop.tracing.search.fitted_candidates import FittedCandidate, beside, replicated_ratio
from analytics.loop.tracing.search.screening import Candidate, Candidates
from analytics.loop.tracing.whitening.joint_fit import JointFit
from analytics.loop.tracing.whitening.least_squares import orthonormal


def named_parts(candidates: Candidates, function: FittedCandidate, base: JointFit) -> list[FittedCandidate]:
    """Effects whose sum explains what a function does, each needed beside the others; empty if the function leads them.

    `base` is the model without the function. Each effect has a form without parameters and is of the function's channel
    alone; those that the others leave nothing to explain are dropped, the least first.
    """
    parts = [
        each
        for each in candidates.items
        if each.effect.kind is EffectKind.LIBRARY
        and each.effect.role is Role.CAUSE
        and not each.effect.parameters
        and set(each.effect.needs) == set(function.effect.needs)
    ]
    while len(parts) > 1:
        joint, ratio = _fitted(candidates, base, parts)
        strength = [_alone(joint, at) for at in _positions(parts)]
        least = int(np.argmin(strength))
        if strength[least] > PRICE:
            return _evident(candidates, function, base, parts, joint, ratio)
        del parts[least]
    return []


def _fitted(candidates: Candidates, base: JointFit, parts: Sequence[Candidate]) -> tuple[JointFit, float]:
    hypothesis = base.hypothesis
    for each in parts:
        hypothesis = hypothesis.with_common(candidates.of_all(each))
    return beside(base, hypothesis)


def _positions(parts: Sequence[Candidate]) -> list[slice]:
    """Columns of each, counted from the last one of all back."""
    left = sum(each.width for each in parts)
    found = []
    for each in parts:
        found.append(slice(-left, each.width - left or None))
        left -= each.width
    return found


def _alone(joint: JointFit, at: slice) -> float:
    """Chi-square of one degree of freedom of some of the last columns, beside all others."""
    total, width = 0.0, 0
    for whitened in joint.whitened:
        own = np.arange(whitened.shape[1])[at]
        others = orthonormal(np.delete(whitened, [0, *own], axis=1))
        left = whitened[:, [0, *own]]
        left = left - others @ (others.T @ left)
        total += float(np.sum((orthonormal(left[:, 1:]).T @ left[:, 0]) ** 2))
        width = own.size
    return float(one_degree(total, width * len(joint.whitened)))


def _evident(
    candidates: Candidates, function: FittedCandidate, base: JointFit, parts: Sequence[Candidate], joint: JointFit,
    ratio: float,
) -> list[FittedCandidate]:  # fmt: skip
    """The fitted parts, if they replicate and the function does not lead them."""
    degrees = sum(each.width for each in parts)
    left = replicated_ratio(base, joint, ratio, degrees)
    gain = -1.0 if left is None else float(one_degree(left, degrees)) - PRICE * len(parts)
    if left is None or gain <= 0 or function.evidence - gain >= needed_lead(function.evidence):
        return []
    return [
        FittedCandidate(each.effect, dict(each.shape), candidates.of_all(each), joint, left, degrees, gain)
        for each in parts
    ]
