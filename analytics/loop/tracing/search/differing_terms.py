"""Declared terms whose coefficients differ from run to run, such as a scale factor that does not repeat."""

from typing import NamedTuple

import numpy as np

from analytics.loop.tracing.search.evidence import by_replicate
from analytics.loop.tracing.whitening.joint_fit import JointFit
from analytics.methods.distributions import chi_square_sf

DIFFERS = 1e-4  # p-value of equal coefficients, for all terms of the model together
_LEAST_INFORMATION = 0.01  # share of all of it that a run has to have


class DifferingTerm(NamedTuple):
    """A declared term, by its column in the design; `spread` is the standard deviation of its coefficient over runs."""

    column: int
    p_value: float
    spread: float
    runs: int


def differing_terms(joint: JointFit) -> list[DifferingTerm]:
    """Terms of one unit's declared model whose coefficients differ between runs by more than the noise allows.

    Cochran's Q of each coefficient over the runs; the spread is the estimate of DerSimonian and Laird
    (doi:10.1016/0197-2456(86)90046-2). The bias is left out: its scatter is a part of the noise.
    """
    record = joint.records[0]
    if len(joint.records) > 1 or len(record.stack.runs) < 2:
        return []
    terms = [column for column, each in enumerate(record.design.T) if np.ptp(each) > 0]
    found = []
    for column in terms:
        ((information, product),) = by_replicate(joint, [record.stack.run_number], column, is_own=True)
        kept = information > _LEAST_INFORMATION * information.sum()
        weight, runs = information[kept], int(np.count_nonzero(kept))
        if runs < 2:
            continue
        each = product[kept] / weight
        q = float(np.sum(weight * (each - np.average(each, weights=weight)) ** 2))
        p_value = min(1.0, len(terms) * float(chi_square_sf(q, runs - 1)))
        if p_value < DIFFERS:
            between = (q - (runs - 1)) / (weight.sum() - (weight**2).sum() / weight.sum())
            found.append(DifferingTerm(column, p_value, float(np.sqrt(max(between, 0.0))), runs))
    return found
