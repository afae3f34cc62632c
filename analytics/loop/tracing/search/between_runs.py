"""Evidence from the biases of few runs alone is worth less than the same evidence of many blocks."""

from dataclasses import dataclass

import msgspec
import numpy as np

from analytics.loop.model.error_model import ModelNoise
from analytics.loop.tracing.search.screening import Screened
from analytics.loop.tracing.whitening.joint_fit import JointFit
from analytics.loop.tracing.whitening.least_squares import fit, project, solve
from analytics.loop.tracing.whitening.stack import UnitRecord
from analytics.methods.distributions import chi_square_isf, f_sf
from stream.batch import FloatArray

FREE_TURN_ON = 1e3  # factor on the turn-on scatter with which the bias of each run is free
UNMASKED_SHARE = 0.1  # of the turn-on scatter that is left where an effect explains most of it
_DEGREES_OF_DECLARED = 1.0  # of freedom that a declared scatter adds, known within a factor of two
_LARGEST_SHARE = 1 - 1e-6
_ALIKE = 1e-3  # part of a column between runs, over its scale, below which it does not differ between them


def free_biases(noise: ModelNoise) -> ModelNoise:
    """The noise with a free bias in each run."""
    turn_on = FREE_TURN_ON * max(noise.turn_on, noise.N, noise.B, noise.K)
    return msgspec.structs.replace(noise, turn_on=turn_on)


def _within_runs(joint: JointFit, tried: int) -> float:
    """Chi-square of the last `tried` columns of a single unit with a free bias in each run."""
    record, designs = joint.records[0], joint.hypothesis.designs[0]
    whitened = record.whitener(free_biases(joint.noises[0]))(np.column_stack([record.value, designs]))
    left = project(whitened.T @ whitened, designs.shape[1] - tried)
    return float(left.right @ solve(left.normal, left.right).coefficients)


def calibrated_ratio(joint: JointFit, ratio: float, tried: int) -> float:
    """The likelihood ratio of the last `tried` columns of a single unit, as a chi-square of as many degrees.

    The part of the biases of n runs is n*ln(1 + k*F/v) with k coefficients and v = n - 1 - k degrees left, where
    the turn-on scatter is fitted to the same runs: the chi-square with the p-value of F takes its place. Where the
    scatter is declared, only of effects with more coefficients than degrees left: these runs cannot test them.
    """
    if len(joint.records) > 1 or ratio <= 0:
        return ratio
    record = joint.records[0]
    runs = len(record.stack.runs)
    differing = _differing(record, joint.hypothesis.designs[0][:, -tried:]) if runs > 1 else 0
    if not differing:
        return ratio
    is_declared = record.prior.turn_on_is_declared
    left = runs - 1 - differing + (_DEGREES_OF_DECLARED if is_declared else 0.0)
    if is_declared and left > differing:
        return ratio
    within = min(_within_runs(joint, tried), ratio)
    if left <= 0:
        return within
    statistic = float(np.expm1(min((ratio - within) / runs, 100.0))) * left / differing
    between = float(chi_square_isf(max(f_sf(statistic, differing, left), 1e-300), differing))
    return min(ratio, within + between)


def _differing(record: UnitRecord, columns: FloatArray) -> int:
    """How many of the columns differ between runs, as combinations that are independent."""
    number = record.stack.run_number
    blocks = np.bincount(number)
    means = np.column_stack([np.bincount(number, column) / blocks for column in columns.T])
    scale = np.abs(columns).max(axis=0)
    scaled = (means - means.mean(axis=0)) / np.where(scale > 0, scale, 1.0)
    return int(np.linalg.matrix_rank(scaled, tol=_ALIKE))


@dataclass(frozen=True)
class BetweenRuns:
    """The scatter of the biases of n runs, which was estimated with an effect in it."""

    runs: int
    chi_square: float  # of the biases, with the fitted scatter
    less: ModelNoise  # the fitted noise with a tenth of the scatter

    @staticmethod
    def of(base: JointFit) -> "BetweenRuns | None":
        """The biases beside the model of a single unit; None of several, of one run, or if the scatter is declared."""
        record = base.records[0]
        if len(base.records) > 1 or record.prior.turn_on_is_declared or len(record.stack.runs) < 2:
            return None
        data = np.column_stack([record.value, base.hypothesis.designs[0]])

        def left(noise: ModelNoise) -> float:
            whitened = record.whitener(noise)(data)
            residual = whitened[:, 0] - whitened[:, 1:] @ fit(whitened[:, 1:], whitened[:, 0]).coefficients
            return float(residual @ residual)

        fitted = base.noises[0]
        less = msgspec.structs.replace(fitted, turn_on=UNMASKED_SHARE * fitted.turn_on)
        return BetweenRuns(len(record.stack.runs), _between(left(fitted), left(less)), less)

    def p_value(self, whole: Screened | None, unmasked: Screened) -> float:
        """P-value of what an effect explains of the biases, by its tests with the whole scatter and with a tenth.

        1 if it was tested with one of them only.
        """
        if whole is None or (left := self.runs - 1 - whole.degrees) <= 0 or self.chi_square <= 0:
            return 1.0
        share = min(max(_between(whole.statistic, unmasked.statistic) / self.chi_square, 0.0), _LARGEST_SHARE)
        return f_sf(share / (1 - share) * left / whole.degrees, whole.degrees, left)


def _between(whole: float, unmasked: float) -> float:
    """The part of a chi-square that the biases of runs give: with a tenth of their scatter it is a hundred times it."""
    return (unmasked - whole) / (UNMASKED_SHARE**-2 - 1)
