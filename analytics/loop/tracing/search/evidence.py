"""Evidence of a candidate on a common scale, its replication in other runs, and noise that passes for an effect."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft

from analytics.loop.effects.base import Effect, EffectKind, Role
from analytics.loop.tracing.whitening.joint_fit import JointFit
from analytics.loop.tracing.whitening.least_squares import orthonormal, project, solve
from analytics.methods.distributions import chi_square_isf, chi_square_log_sf
from stream.batch import BoolArray, FloatArray, IntArray

PRICE = 9.0  # multiplicity penalty of a candidate, in chi-square
FUNCTION_PRICE = 9.2  # added for a general function: a named effect of equal fit is a hundred times more likely
LEAST_GAIN, LEAST_GAIN_OF_OTHERS = 2.0, 1.0  # nats
MOST_FROM_ONE = 0.98
_SMALLEST = 1e-12
BY_CHANCE = 0.01
LEAST_LEAD, LEAST_SHARE_OF_LEAD = 12.0, 0.03  # evidence, and share of a large evidence, by which to lead others
ALIAS_SHARE_OF_LEAD = 0.25
"""The same between causes that are aliases of each other, such as the rate of temperature and a temperature gradient:
both follow one cause, and the noise of their channels must not decide."""
_EXACT_CHANNELS = frozenset({"input_rate", "rate_o", "rate_s", "time_since_power_on"})
"""Set by a table to parts in a million, or counted: no noise of theirs decides between two functions of them."""
_LEAST_LOG_P = -600.0  # exp of less is 0
TRUST = 4
_LEAST_SHARE = 0.01  # least share of the information that a replicate needs to count


def one_degree(likelihood_ratio: FloatArray | float, degrees: int) -> FloatArray:
    """Equivalent chi-square of one degree of freedom.

    >>> one_degree(30.0, 1).round(3), one_degree(30.0, 8).round(1)
    (np.float64(30.0), np.float64(13.7))
    """
    ratio = np.maximum(likelihood_ratio, 0.0)
    if degrees == 1:
        return ratio
    log_p = chi_square_log_sf(ratio, degrees)
    exact = chi_square_isf(np.exp(np.maximum(log_p, _LEAST_LOG_P)), 1)
    return np.where(log_p > _LEAST_LOG_P, exact, ratio - 2 * (degrees - 1))[()]


def penalty(effect: Effect) -> float:
    """Multiplicity penalty of an effect, in chi-square."""
    return PRICE + (FUNCTION_PRICE if effect.kind is EffectKind.FUNCTION else 0.0)


def evidence(likelihood_ratio: float, degrees: int, effect: Effect) -> float:
    """Evidence of an effect: equivalent chi-square less its penalty; -inf where it explains nothing."""
    return float(one_degree(likelihood_ratio, degrees)) - penalty(effect) if likelihood_ratio > 0 else -np.inf


def needed_lead(best: FloatArray | float) -> FloatArray:
    """Evidence by which the best candidate has to lead another.

    The wrong one of two leads by L with a probability of at most Phi(-sqrt(L)), however similar they are: 1 in 3700
    at 12, and an effect has some ten similar ones. Of a large effect a share of its own evidence is required, since
    channels are measured and forms are idealised no better than that.
    """
    return np.maximum(LEAST_LEAD, LEAST_SHARE_OF_LEAD * np.asarray(best))[()]


def leads(best: FloatArray | float, effect: Effect, other: FloatArray | float, its_effect: Effect) -> BoolArray:
    """Whether the data separate the best candidate from another, by the evidence of both."""
    lead = needed_lead(best)
    is_exact = _EXACT_CHANNELS.issuperset((*effect.needs, *its_effect.needs))
    if look_alike(effect, its_effect) and effect.role is its_effect.role is Role.CAUSE and not is_exact:
        lead = np.maximum(lead, ALIAS_SHARE_OF_LEAD * np.asarray(best))
    return np.subtract(best, other) >= lead


def look_alike(effect: Effect, other: Effect) -> bool:
    """Whether one is among the aliases of the other."""
    return other.name in _aliases(effect) or effect.name in _aliases(other)


def is_common(effect: Effect) -> bool:
    """Whether its coefficients hold for all units; those of lines and jumps do not."""
    return effect.kind not in (EffectKind.LINE, EffectKind.EVENT)


def _aliases(effect: Effect) -> tuple[str, ...]:
    return effect.aliases if is_common(effect) else ()


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
    """Predictive density of each replicate given all others, with and without the last `tried` common columns."""
    pairs = zip(joint.whitened, replicates, strict=True)
    grams = [
        np.array([rows.T @ rows for rows in (whitened[number == each] for each in np.unique(number))])
        for whitened, number in pairs
    ]
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


def by_replicate(
    joint: JointFit, replicates: Sequence[IntArray], column: int, *, is_own: bool = False
) -> list[tuple[FloatArray, FloatArray]]:
    """Information on one column in each replicate of each record, and information times coefficient.

    The column is a common one, or one of each record's own. It is orthogonalised to all other columns over all
    replicates.
    """
    found = []
    for whitened, number, own in zip(joint.whitened, replicates, joint.hypothesis.own, strict=True):
        at = 1 + column + (0 if is_own else own.shape[1])
        others = np.delete(whitened[:, 1:], at - 1, axis=1)
        basis = orthonormal(others)
        driver = whitened[:, at] - basis @ (basis.T @ whitened[:, at])
        residual = whitened[:, 0] - basis @ (basis.T @ whitened[:, 0])
        information = np.asarray(np.bincount(number, driver * driver), dtype=np.float64)
        found.append((information, np.asarray(np.bincount(number, driver * residual), dtype=np.float64)))
    return found


def noise_inflation(joint: JointFit, replicates: Sequence[IntArray], runs: Sequence[IntArray], tried: int) -> float:
    """Excess of the noise over its model at the time scale of the last `tried` common columns, as a ratio; at least 1.

    A wrong noise model makes noise pass for an effect. Two signs: the replicates disagree about the coefficients of the
    effect, and the whitened residual is not white at its time scale. `replicates` and `runs` are those of each block.
    """
    alone = [_alone(whitened, tried) for whitened in joint.whitened]
    return max(_disagreement(alone, replicates), redness([driver for driver, _ in alone], joint.residuals, runs))


def _alone(whitened: FloatArray, tried: int) -> tuple[FloatArray, FloatArray]:
    """The last columns and the value, orthogonalised to all other columns."""
    basis = orthonormal(whitened[:, 1 : whitened.shape[1] - tried])
    kept = np.column_stack([whitened[:, whitened.shape[1] - tried :], whitened[:, 0]])
    kept = kept - basis @ (basis.T @ kept)
    return kept[:, :-1], kept[:, -1]


def _disagreement(alone: Sequence[tuple[FloatArray, FloatArray]], replicates: Sequence[IntArray]) -> float:
    """Birge ratio of Cochran's Q over replicates, if significant."""
    parts = [
        (driver[number == each].T @ driver[number == each], driver[number == each].T @ residual[number == each])
        for (driver, residual), number in zip(alone, replicates, strict=True)
        for each in np.unique(number)
    ]
    normal = np.sum([each for each, _ in parts], axis=0)
    right = np.sum([each for _, each in parts], axis=0)
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    common, rank = _explained(normal / np.outer(scale, scale), right / scale)
    each = [_explained(own_normal / np.outer(scale, scale), own_right / scale) for own_normal, own_right in parts]
    degrees = sum(own_rank for _, own_rank in each) - rank
    return _excess(sum(statistic for statistic, _ in each) - common, degrees)


def _explained(normal: FloatArray, right: FloatArray) -> tuple[float, int]:
    """Chi-square of columns scaled to an information of one in all, and its degrees of freedom."""
    eigenvalues, vectors = np.linalg.eigh(normal)
    resolved = eigenvalues > _LEAST_SHARE
    return float(np.sum((vectors[:, resolved].T @ right) ** 2 / eigenvalues[resolved])), int(np.count_nonzero(resolved))


def redness(drivers: Sequence[FloatArray], residuals: Sequence[FloatArray], runs: Sequence[IntArray]) -> float:
    """Power of whitened residuals by octave of frequency, weighted by the power of the columns; at least 1."""
    octaves = 1 + int(np.log2(max(max(np.bincount(number)) for number in runs)))
    residual_power, driver_power, count = np.zeros(octaves), np.zeros(octaves), np.zeros(octaves, dtype=np.int64)
    for driver, residual, number in zip(drivers, residuals, runs, strict=True):
        basis = orthonormal(driver)
        for run in np.unique(number):
            of_run = number == run
            octave = np.log2(np.maximum(np.arange(np.count_nonzero(of_run)), 1)).astype(np.int64)
            count += np.bincount(octave, minlength=octaves)
            residual_power += np.bincount(octave, _power(residual[of_run]), minlength=octaves)
            for column in basis[of_run].T:
                driver_power += np.bincount(octave, _power(column), minlength=octaves)
    beyond = [_excess(power, int(degrees)) - 1.0 for power, degrees in zip(residual_power, count, strict=True)]
    total = float(driver_power.sum())
    return 1.0 + float(driver_power @ np.array(beyond)) / total if total > 0 else 1.0


def _power(values: FloatArray) -> FloatArray:
    return np.asarray(fft.dct(values, norm="ortho") ** 2)


def _excess(chi_square: float, degrees: int) -> float:
    """Chi-square over degrees of freedom if significant, else 1; the noise model counts as `TRUST` agreeing degrees."""
    if degrees < 1 or chi_square < float(chi_square_isf(BY_CHANCE, degrees)):
        return 1.0
    return (chi_square + TRUST) / (degrees + TRUST)
