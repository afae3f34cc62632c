"""Is what was found the right form, the same in all runs, and enough?"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from analytics.loop.effects.base import Kind
from analytics.loop.tracing.candidates import Candidates
from analytics.loop.tracing.evidence import by_replicate
from analytics.loop.tracing.joint_fit import JointFit
from analytics.loop.tracing.noise_fit import evaluate
from analytics.loop.tracing.record import Record, as_array
from analytics.loop.tracing.screening import tests_of_kind
from analytics.loop.tracing.selection import Search, Selected

WRONG_FORM = 1e-4
"""Below this p-value the form of an effect is not that of the library."""
NOISE_P_VALUE = 1e-3
NOISE_RATIO = 1.3
NOISE_AVERAGES_S = (300.0, 3600.0)
_LEAST_INFORMATION = 0.01


@dataclass(frozen=True)
class Homogeneity:
    """One coefficient run by run.

    Parameters
    ----------
    p_value: Of the test that it is the same in all.
    by_replicate: Coefficient and standard error in each replicate that tells something of it.
    """

    p_value: float
    by_replicate: Mapping[str, tuple[float, float]]


def form_p_values(candidates: Candidates, joint: JointFit, which: Selected) -> dict[str, float]:
    """By channel of an effect: p-value of the test that a free function of that channel has nothing to add."""
    candidate = which.fitted_candidate.candidate
    if candidate is None or candidate.effect.kind is Kind.FUNCTION:
        return {}
    return {
        result.candidate.effect.needs[0]: result.p_value
        for result in tests_of_kind(candidates, joint.hypothesis.designs, joint.noises, Kind.FUNCTION)
        if set(result.candidate.effect.needs) <= set(candidate.effect.needs)
    }


def homogeneity(records: Sequence[Record], found: Search, which: Selected) -> Homogeneity:
    """Whether the coefficients of an effect are the same in all runs (Cochran's Q of each column)."""
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
        told = information > _LEAST_INFORMATION * information.sum()
        if column == columns.start:
            table = {
                name: (float(s / w), float(1 / np.sqrt(w)))
                for name, w, s, is_told in zip(names, information, product, told, strict=True)
                if is_told
            }
        if np.count_nonzero(told) > 1:
            mean = product.sum() / information.sum()
            q = np.sum((product[told] - information[told] * mean) ** 2 / information[told])
            p_values.append(float(stats.chi2.sf(q, np.count_nonzero(told) - 1)))
    tested = max(1, len(p_values) - 1)
    return Homogeneity(min(1.0, min(p_values) * tested), table)


@dataclass(frozen=True)
class NoiseExcess:
    """Fitted noise beside the declared one.

    Parameters
    ----------
    ratio, least_ratio: Largest and least ratio of their variances at averages of 300 and 3600 s.
    p_value: Of the test that the noise is as declared.
    """

    ratio: float
    p_value: float
    least_ratio: float

    @property
    def is_excess(self) -> bool:
        """Whether there is more noise than declared."""
        return self.p_value < NOISE_P_VALUE and self.ratio > NOISE_RATIO


def noise_excess(record: Record, joint: JointFit, number: int = 0) -> NoiseExcess:
    """Compare the fitted noise of a record with the centre of its prior."""
    fitted, declared = joint.noises[number], record.prior.center
    columns = joint.hypothesis.designs[number]
    gain = evaluate(record, columns, fitted).log_likelihood - evaluate(record, columns, declared).log_likelihood
    ratios = [
        record.noise_model.average_variance(fitted, seconds) / record.noise_model.average_variance(declared, seconds)
        for seconds in NOISE_AVERAGES_S
    ]
    degrees = int(np.count_nonzero(as_array(declared)))
    return NoiseExcess(max(ratios), float(stats.chi2.sf(max(0.0, 2 * gain), degrees)), min(ratios))
