"""Shapes between the tried ones: the width of a loop or the time constant that explains most.

A wrong shape leaves enough of a strong effect for a further effect that is not there.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from analytics.loop.effects.base import Effect, Shape, number
from analytics.loop.tracing.search.screening import Candidates
from analytics.loop.tracing.whitening.joint_fit import JointFit, normal_equations
from analytics.loop.tracing.whitening.least_squares import solve
from stream.batch import FloatArray, IntArray

_TRIED_AT_ONCE, _ROUNDS = 7, 3  # between two neighbours; each round leaves a quarter of the interval


def better_shape(candidates: Candidates, joint: JointFit, effect: Effect, shape: Shape) -> Shape | None:
    """The shape near `shape` that explains most; None if none explains clearly more.

    `joint` is a fit whose last common columns are those of `effect` at `shape`; its noise is kept. A number costs the
    logarithm of the number of blocks in chi-square, as by Schwarz's criterion.
    """
    best, first, most = shape, None, None
    for name, (value, low, high) in _brackets(candidates, effect, shape).items():
        for _ in range(_ROUNDS):
            between = [float(f"{each:.4g}") for each in np.linspace(low, high, _TRIED_AT_ONCE + 2)]
            values = list(dict.fromkeys((value, *between)))
            tried = [{**best, name: each} for each in values]
            explained = _explained(candidates, joint, effect, tried)
            first = explained[0] if first is None else first
            at = int(np.argmax(explained))
            best, value, most = tried[at], values[at], explained[at]
            step = (high - low) / (_TRIED_AT_ONCE + 1)
            low, high = max(low, value - step), min(high, value + step)
    if first is None or most is None or not most - first > np.log(sum(map(len, joint.records))):
        return None
    return best


def _brackets(candidates: Candidates, effect: Effect, shape: Shape) -> Mapping[str, tuple[float, float, float]]:
    """For each parameter that is a number: it, and its neighbours among the tried shapes."""
    shapes = [item.shape for item in candidates.items if item.effect.name == effect.name]
    found = {}
    for name, own in shape.items():
        if isinstance(own, list | tuple):
            continue
        value = number(shape, name)
        values = {number(each, name) for each in shapes}
        low = max((each for each in values if each < value), default=value)
        high = min((each for each in values if each > value), default=value)
        if low < high:
            found[name] = value, low, high
    return found


def _explained(candidates: Candidates, joint: JointFit, effect: Effect, tried: Sequence[Shape]) -> list[float]:
    """Chi-square of each shape together with the other common columns; -inf where a column has no value."""
    width = len(effect.columns(tried[0]))
    every = [candidates.at(effect, shape) for shape in tried]
    rest = [each[:, : each.shape[1] - width] for each in joint.hypothesis.common]
    common = [np.column_stack([kept, *(each[number] for each in every)]) for number, kept in enumerate(rest)]
    has_values = np.all([np.isfinite(each).all(axis=0) for each in common], axis=0)
    hypothesis = replace(joint.hypothesis, common=[np.where(has_values, each, 0.0) for each in common])
    normal, right = normal_equations(joint, hypothesis)
    others = rest[0].shape[1]
    return [
        _chi_square(normal, right, np.r_[:others, at : at + width]) if has_values[at : at + width].all() else -np.inf
        for at in range(others, len(right), width)
    ]


def _chi_square(normal: FloatArray, right: FloatArray, which: IntArray) -> float:
    return float(right[which] @ solve(normal[np.ix_(which, which)], right[which]).coefficients)
