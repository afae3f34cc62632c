"""How much a candidate explains, on one scale for all, and whether it explains runs that it was not fitted to."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from analytics.tracing.joint_fit import JointFit
from analytics.tracing.least_squares import project, solve
from stream.batch import FloatArray, IntArray

PRICE = 9.0
"""What a candidate pays for being one of many, in units of chi-square."""
FUNCTION_PRICE = 9.2
"""What a general function pays beside that: a named effect with the same fit is a hundred times likelier."""
LEAST_GAIN = 2.0  # nats
MOST_FROM_ONE = 0.98


def one_degree(likelihood_ratio: float, degrees: int) -> float:
    """Chi-square of one degree of freedom that is as unlikely as this one of several.

    Examples
    --------
    >>> round(one_degree(30.0, 1), 3), round(one_degree(30.0, 8), 1)
    (30.0, 13.7)
    """
    if likelihood_ratio <= 0:
        return 0.0
    log_p = float(stats.chi2.logsf(likelihood_ratio, degrees))
    if log_p > -600:
        return float(stats.chi2.isf(np.exp(log_p), 1))
    return likelihood_ratio - 2 * (degrees - 1)


def evidence(likelihood_ratio: float, degrees: int, *, is_function: bool) -> float:
    """Evidence for an effect: what it explains less what it pays."""
    if likelihood_ratio <= 0:
        return -np.inf
    return one_degree(likelihood_ratio, degrees) - PRICE - (FUNCTION_PRICE if is_function else 0.0)


@dataclass(frozen=True)
class Replication:
    """What an effect gains in each replicate when it is fitted to the others.

    Parameters
    ----------
    gains : array of shape (replicates,)
        Logarithm of the likelihood ratio of each replicate, nats.
    """

    gains: FloatArray

    @property
    def total(self) -> float:
        """All gains, nats."""
        return float(self.gains.sum())

    @property
    def largest_share(self) -> float:
        """Part of all that was won that the best replicate won."""
        won = float(self.gains[self.gains > 0].sum())
        return float(self.gains.max()) / won if won > 0 else 1.0

    @property
    def replicates(self) -> bool:
        """Whether other replicates are predicted better with the effect, and not one alone."""
        return self.total > LEAST_GAIN and self.largest_share < MOST_FROM_ONE


def leave_one_out(joint: JointFit, replicates: Sequence[IntArray], tried: int) -> Replication:
    """Predict each replicate from all others, with and without the last columns.

    Parameters
    ----------
    joint : JointFit
        Fit with them.
    replicates : sequence of array of int
        For each record, which replicate each block belongs to.
    tried : int
        How many of the common columns, counted from the end, are tried.
    """
    grams = [_grams(whitened, number) for whitened, number in zip(joint.whitened, replicates, strict=True)]
    owns = [each.shape[1] for each in joint.hypothesis.own]
    whole = [project(each.sum(axis=0), own) for each, own in zip(grams, owns, strict=True)]
    normal = np.sum([each.normal for each in whole], axis=0)
    right = np.sum([each.right for each in whole], axis=0)
    gains = []
    for of_unit, own, unit in zip(grams, owns, whole, strict=True):
        together = of_unit.sum(axis=0)
        for gram in of_unit:
            rest = project(together - gram, own)
            less_normal, less_right = normal - unit.normal + rest.normal, right - unit.right + rest.right
            without = _error(together - gram, gram, own, less_normal, less_right, tried)
            gains.append(0.5 * (without - _error(together - gram, gram, own, less_normal, less_right, 0)))
    return Replication(np.array(gains))


def by_replicate(joint: JointFit, replicates: Sequence[IntArray], column: int) -> list[tuple[FloatArray, FloatArray]]:
    """Coefficient of one common column in each replicate of each record: information, and information times coefficient.

    All other columns are taken out over all replicates together.
    """
    found = []
    for whitened, number, own in zip(joint.whitened, replicates, joint.hypothesis.own, strict=True):
        at = 1 + own.shape[1] + column
        others = np.delete(whitened[:, 1:], at - 1, axis=1)
        scaled = others / np.maximum(np.linalg.norm(others, axis=0), 1e-300)
        basis = _orthonormal(scaled)
        driver = whitened[:, at] - basis @ (basis.T @ whitened[:, at])
        residual = whitened[:, 0] - basis @ (basis.T @ whitened[:, 0])
        found.append((np.bincount(number, driver * driver), np.bincount(number, driver * residual)))
    return found


def _orthonormal(columns: FloatArray) -> FloatArray:
    if not columns.shape[1]:
        return columns
    left, singular, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, singular > 1e-6 * singular[0]])


def _grams(whitened: FloatArray, replicate: IntArray) -> FloatArray:
    return np.array([whitened[replicate == each].T @ whitened[replicate == each] for each in np.unique(replicate)])


def _error(
    rest: FloatArray, left_out: FloatArray, own: int, normal: FloatArray, right: FloatArray, dropped: int
) -> float:
    """Squared whitened error in the replicate left out, predicted from the rest without the last `dropped` columns."""
    kept = normal.shape[0] - dropped
    theta = solve(normal[:kept, :kept], right[:kept]).coefficients
    first, last = slice(1, 1 + own), slice(1 + own, 1 + own + kept)
    beta = solve(rest[first, first], rest[first, 0] - rest[first, last] @ theta).coefficients
    weights = np.concatenate([[1.0], -beta, -theta, np.zeros(dropped)])
    return float(weights @ left_out @ weights)
