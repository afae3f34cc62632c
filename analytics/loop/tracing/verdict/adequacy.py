"""Tests of a selected effect: is its form right, and is its coefficient the same in all runs?"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from analytics.loop.effects.base import EffectKind
from analytics.loop.tracing.search.candidates import Candidates
from analytics.loop.tracing.search.effect_search import Search, Selected
from analytics.loop.tracing.search.evidence import by_replicate
from analytics.loop.tracing.search.screening import tests_of_kind
from analytics.loop.tracing.whitening.joint_fit import JointFit
from analytics.loop.tracing.whitening.unit_record import UnitRecord

WRONG_FORM = 1e-4
"""P-value below which the form of an effect is rejected."""
_LEAST_INFORMATION = 0.01


@dataclass(frozen=True)
class Homogeneity:
    """Test of equal coefficients in all replicates; first coefficient and standard error in each that excites it."""

    p_value: float
    by_replicate: Mapping[str, tuple[float, float]]


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


def homogeneity(records: Sequence[UnitRecord], found: Search, which: Selected) -> Homogeneity:
    """Cochran's Q of each coefficient of an effect over replicates, Bonferroni-corrected."""
    columns = found.common_columns(which)
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
            table = {
                name: (float(s / w), float(1 / np.sqrt(w)))
                for name, w, s, is_excited in zip(names, information, product, excited, strict=True)
                if is_excited
            }
        if np.count_nonzero(excited) > 1:
            mean = product.sum() / information.sum()
            q = np.sum((product[excited] - information[excited] * mean) ** 2 / information[excited])
            p_values.append(float(stats.chi2.sf(q, np.count_nonzero(excited) - 1)))
    tested = max(1, len(p_values) - 1)
    return Homogeneity(min(1.0, min(p_values) * tested), table)
