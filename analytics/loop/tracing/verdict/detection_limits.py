"""Detection limits of effects that were not found."""

from collections.abc import Sequence

import numpy as np
from scipy import stats

from analytics.loop.effects.base import EffectKind
from analytics.loop.effects.coefficient_units import coefficient_unit
from analytics.loop.tracing.result.finding import DetectionLimit
from analytics.loop.tracing.search.candidates import Candidates
from analytics.loop.tracing.search.evidence import PRICE
from analytics.loop.tracing.search.fitted_candidates import ALPHA
from analytics.loop.tracing.search.screening import LEAST_LEFT, pooled
from analytics.loop.tracing.whitening.joint_fit import JointFit
from analytics.loop.tracing.whitening.least_squares import solve

POWER = 1.282  # 90 %
CONFIDENCE = 1.96  # 95 %, two-sided


def detection_limits(
    candidates: Candidates, joint: JointFit, taken: Sequence[str], tests: float
) -> tuple[dict[str, DetectionLimit], tuple[str, ...]]:
    """Limits of the library's effects that are not in the model, and the effects that these runs do not excite.

    Of several shapes the largest limit is given; of several columns the norm of the coefficients.

    Parameters
    ----------
    joint, taken: Fit of the model found, and its effects.
    tests: Effective number of tests of the screening.
    """
    normal, right, before = pooled(candidates, joint.hypothesis.designs, joint.noises)
    least_z = max(float(np.sqrt(PRICE)), float(stats.norm.isf(ALPHA / tests / 2)))
    run = candidates.records[0].stack.runs[0]
    limits: dict[str, DetectionLimit] = {}
    blind: set[str] = set()
    for item in candidates.items:
        name = item.effect.name
        if item.effect.kind is not EffectKind.LIBRARY or name in taken:
            continue
        own = item.columns
        if not np.all(np.diag(normal)[own] > LEAST_LEFT * np.maximum(before[own], 1e-300)):
            blind.add(name)
            continue
        solution = solve(normal[own, own], right[own])
        scale = candidates.scale[own]
        error = float(np.sqrt(np.max(np.diag(solution.covariance) / scale**2)))
        size = float(np.linalg.norm(solution.coefficients / scale))
        limit = DetectionLimit(
            coefficient=(least_z + POWER) * error,
            absent_above=size + CONFIDENCE * error,
            unit_of_measure=coefficient_unit(item.effect, run.unit_of_measure, run),
        )
        if name not in limits or limit.coefficient > limits[name].coefficient:
            limits[name] = limit
    return limits, tuple(sorted(blind - limits.keys()))
