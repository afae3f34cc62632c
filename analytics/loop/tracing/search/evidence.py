"""Evidence of a candidate on a common scale, and its replication in runs that it was not fitted to."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from analytics.loop.tracing.whitening.joint_fit import JointFit
from analytics.loop.tracing.whitening.least_squares import orthonormal, project, solve
from stream.batch import FloatArray, IntArray

PRICE = 9.0
"""Multiplicity penalty of a candidate, in chi-square."""
FUNCTION_PRICE = 9.2
"""Additional penalty of a general function: a named effect of equal fit is a hundred times more likely."""
LEAST_GAIN, LEAST_GAIN_OF_OTHERS = 2.0, 1.0  # nats
MOST_FROM_ONE = 0.98
_SMALLEST = 1e-12


def one_degree(likelihood_ratio: float, degrees: int) -> float:
    """Equivalent chi-square of one degree of freedom.

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
    """Evidence of an effect: equivalent chi-square less penalties."""
    if likelihood_ratio <= 0:
        return -np.inf
    return one_degree(likelihood_ratio, degrees) - PRICE - (FUNCTION_PRICE if is_function else 0.0)


@dataclass(frozen=True)
class Replication:
    """Gain of an effect in each replicate if fitted to the others: `gains` are log likelihood ratios in nats."""

    gains: FloatArray

    @property
    def total(self) -> float:
        """Sum of the gains, nats."""
        return float(self.gains.sum())

    @property
    def largest_share(self) -> float:
        """Share of the best replicate in all positive gains."""
        won = float(self.gains[self.gains > 0].sum())
        return float(self.gains.max()) / won if won > 0 else 1.0

    @property
    def replicates(self) -> bool:
        """Whether the effect improves the prediction of more than one replicate."""
        others = self.total - float(self.gains.max())
        return self.total > LEAST_GAIN and others > LEAST_GAIN_OF_OTHERS and self.largest_share < MOST_FROM_ONE


def leave_one_out(joint: JointFit, replicates: Sequence[IntArray], tried: int) -> Replication:
    """Predictive density of each replicate given all others, with and without the last common columns.

    Parameters
    ----------
    joint: Fit with these columns.
    replicates: For each record, the replicate of each block.
    tried: Number of these columns.
    """
    grams = [_grams(whitened, number) for whitened, number in zip(joint.whitened, replicates, strict=True)]
    owns = [each.shape[1] for each in joint.hypothesis.own]
    whole = [project(each.sum(axis=0), own) for each, own in zip(grams, owns, strict=True)]
    blocks = sum(map(len, joint.whitened))
    gains = []
    for of_unit, own, unit in zip(grams, owns, whole, strict=True):
        # the information of the other units on the common columns
        total = of_unit.sum(axis=0)
        common = slice(1 + own, None)
        total[common, common] += np.sum([each.normal for each in whole], axis=0) - unit.normal
        total[common, 0] += np.sum([each.right for each in whole], axis=0) - unit.right
        total[0, common] = total[common, 0]
        less = slice(0, total.shape[0] - tried)
        centred = np.eye(total.shape[0])
        centred[0, 1 : less.stop] = -solve(total[less, less][1:, 1:], total[1 : less.stop, 0]).coefficients
        total = centred @ total @ centred.T
        # a weak prior, worth one block, at the coefficients of the fit without the effect
        vague = np.diag(np.diag(total) / blocks)
        vague[0, 0] = 0.0
        for gram in (centred @ each @ centred.T for each in of_unit):
            with_it = _score(total + vague) - _score(total - gram + vague)
            without = _score((total + vague)[less, less]) - _score((total - gram + vague)[less, less])
            gains.append(with_it - without)
    return Replication(np.array(gains))


def _score(gram: FloatArray) -> float:
    """Logarithm of the marginal density, coefficients integrated out, up to a constant."""
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

    The column is orthogonalised to all other columns over all replicates.
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
