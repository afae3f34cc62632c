"""How much a candidate explains, on one scale for all, and whether it explains runs that it was not fitted to."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from analytics.loop.tracing.joint_fit import JointFit
from analytics.loop.tracing.least_squares import orthonormal, project, solve
from stream.batch import FloatArray, IntArray

PRICE = 9.0
"""What a candidate pays for being one of many, in units of chi-square."""
FUNCTION_PRICE = 9.2
"""What a general function pays beside that: a named effect with the same fit is a hundred times likelier."""
LEAST_GAIN, LEAST_GAIN_OF_OTHERS = 2.0, 1.0  # nats
MOST_FROM_ONE = 0.98
_SMALLEST = 1e-12


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
    gains: shape (replicates,); logarithm of the likelihood ratio of each replicate, nats.
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
        others = self.total - float(self.gains.max())
        return self.total > LEAST_GAIN and others > LEAST_GAIN_OF_OTHERS and self.largest_share < MOST_FROM_ONE


def leave_one_out(joint: JointFit, replicates: Sequence[IntArray], tried: int) -> Replication:
    """Predict each replicate from all others, with and without the last columns.

    Every replicate is judged by its predictive density, so that what the others do not tell is no mistake.

    Parameters
    ----------
    joint: Fit with them.
    replicates: For each record, which replicate each block belongs to.
    tried: How many of the common columns, counted from the end, are tried.
    """
    grams = [_grams(whitened, number) for whitened, number in zip(joint.whitened, replicates, strict=True)]
    owns = [each.shape[1] for each in joint.hypothesis.own]
    whole = [project(each.sum(axis=0), own) for each, own in zip(grams, owns, strict=True)]
    blocks = sum(map(len, joint.whitened))
    gains = []
    for of_unit, own, unit in zip(grams, owns, whole, strict=True):
        # what the other units say of the common columns stands in as observations of them
        total = of_unit.sum(axis=0)
        common = slice(1 + own, None)
        total[common, common] += np.sum([each.normal for each in whole], axis=0) - unit.normal
        total[common, 0] += np.sum([each.right for each in whole], axis=0) - unit.right
        total[0, common] = total[common, 0]
        less = slice(0, total.shape[0] - tried)
        centred = np.eye(total.shape[0])
        centred[0, 1 : less.stop] = -solve(total[less, less][1:, 1:], total[1 : less.stop, 0]).coefficients
        total = centred @ total @ centred.T
        # one block's worth of knowledge that the coefficients are those of the fit without the effect
        vague = np.diag(np.diag(total) / blocks)
        vague[0, 0] = 0.0
        for gram in (centred @ each @ centred.T for each in of_unit):
            with_it = _score(total + vague) - _score(total - gram + vague)
            without = _score((total + vague)[less, less]) - _score((total - gram + vague)[less, less])
            gains.append(with_it - without)
    return Replication(np.array(gains))


def _score(gram: FloatArray) -> float:
    """Logarithm of the density of values, their coefficients integrated out, but for a constant."""
    normal, right = gram[1:, 1:], gram[1:, 0]
    scale = np.sqrt(np.diag(normal))
    scale = np.where(scale > 0, scale, 1.0)
    eigenvalues, vectors = np.linalg.eigh(normal / np.outer(scale, scale))
    kept = eigenvalues > _SMALLEST
    along = vectors[:, kept].T @ (right / scale)
    log_determinant = float(np.sum(np.log(eigenvalues[kept])) + 2 * np.sum(np.log(scale)))
    return -0.5 * (float(gram[0, 0] - np.sum(along**2 / eigenvalues[kept])) + log_determinant)


def _grams(whitened: FloatArray, replicate: IntArray) -> FloatArray:
    return np.array([whitened[replicate == each].T @ whitened[replicate == each] for each in np.unique(replicate)])


def by_replicate(joint: JointFit, replicates: Sequence[IntArray], column: int) -> list[tuple[FloatArray, FloatArray]]:
    """Information on one common column in each replicate of each record, and information times coefficient.

    All other columns are taken out over all replicates together.
    """
    found = []
    for whitened, number, own in zip(joint.whitened, replicates, joint.hypothesis.own, strict=True):
        at = 1 + own.shape[1] + column
        others = np.delete(whitened[:, 1:], at - 1, axis=1)
        basis = orthonormal(others)
        driver = whitened[:, at] - basis @ (basis.T @ whitened[:, at])
        residual = whitened[:, 0] - basis @ (basis.T @ whitened[:, 0])
        information = np.asarray(np.bincount(number, driver * driver), dtype=np.float64)
        found.append((information, np.asarray(np.bincount(number, driver * residual), dtype=np.float64)))
    return found
