"""Is the form of a selected effect right, and its coefficient the same in all runs? Detection limits of the others."""

from collections.abc import Sequence

import numpy as np

from analytics.loop.effects.base import EffectKind, coefficient_unit
from analytics.loop.tracing.result.diagnosis_result import DetectionLimit
from analytics.loop.tracing.search.effect_search import Search, Selected
from analytics.loop.tracing.search.evidence import PRICE, by_replicate
from analytics.loop.tracing.search.fitted_candidates import ALPHA
from analytics.loop.tracing.search.screening import LEAST_LEFT, Candidates, pooled, tests_of_kind
from analytics.loop.tracing.whitening.joint_fit import JointFit
from analytics.loop.tracing.whitening.least_squares import solve
from analytics.methods.distributions import chi_square_sf, normal_isf
from stream.batch import FloatArray

WRONG_FORM = 1e-4  # p-value below which the form of an effect is rejected
_LEAST_INFORMATION = 0.01
POWER = 1.282  # 90 %
CONFIDENCE = 1.96  # 95 %, two-sided


def form_p_values(candidates: Candidates, joint: JointFit, which: Selected) -> dict[str, float]:
    """By channel of an effect: p-value of a free function of that channel beside the effect."""
    own = which.fitted.effect
    if not which.is_common or own.kind is EffectKind.FUNCTION:
        return {}
    return {
        result.candidate.effect.needs[0]: result.p_value
        for result in tests_of_kind(candidates, joint.hypothesis.designs, joint.noises, EffectKind.FUNCTION)
        if set(result.candidate.effect.needs) <= set(own.needs)
    }


def homogeneity(found: Search, which: Selected) -> tuple[float, dict[str, tuple[float, float]]]:
    """P-value of equal coefficients of an effect; the first and its standard error in each replicate that excites it.

    Cochran's Q of each coefficient over the replicates of a unit, summed over units, Bonferroni-corrected: units differ
    from each other without a wrong form.
    """
    columns, records = found.common_columns(which), found.joint.records
    replicates = [record.stack.replicate for record in records]
    names = [
        f"{record.unit} {name}" if len(records) > 1 else name for record in records for name in record.stack.replicates
    ]
    p_values, table = [1.0], {}
    for column in range(columns.start, columns.stop):
        pairs = by_replicate(found.joint, replicates, column)
        information = np.concatenate([each for each, _ in pairs])
        product = np.concatenate([each for _, each in pairs])
        excited = information > _LEAST_INFORMATION * information.sum()
        if column == columns.start:
            rows = zip(names, information, product, excited, strict=True)
            table = {name: (float(s / w), float(1 / np.sqrt(w))) for name, w, s, is_excited in rows if is_excited}
        least = _LEAST_INFORMATION * information.sum()
        of_units = [_cochran(*each, least) for each in pairs]
        if (degrees := sum(each for _, each in of_units)) > 0:
            p_values.append(float(chi_square_sf(sum(q for q, _ in of_units), degrees)))
    tested = max(1, len(p_values) - 1)
    return min(1.0, min(p_values) * tested), table


def _cochran(information: FloatArray, product: FloatArray, least: float) -> tuple[float, int]:
    """Cochran's Q of the replicates of a unit that have at least so much information, and its degrees of freedom."""
    excited = information > least
    if np.count_nonzero(excited) < 2:
        return 0.0, 0
    mean = product.sum() / information.sum()
    q = np.sum((product[excited] - information[excited] * mean) ** 2 / information[excited])
    return float(q), int(np.count_nonzero(excited)) - 1


def detection_limits(
    candidates: Candidates, joint: JointFit, taken: Sequence[str], tests: float
) -> tuple[dict[str, DetectionLimit], tuple[str, ...]]:
    """Limits of the library's effects that are not in the model, and the effects that these runs do not excite.

    `tests` is the effective number of tests of the screening. Of several shapes the largest limit is given; of several
    columns the norm of the coefficients.
    """
    normal, right, before = pooled(candidates, joint.hypothesis.designs, joint.noises)
    least_z = max(float(np.sqrt(PRICE)), normal_isf(ALPHA / tests / 2))
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
