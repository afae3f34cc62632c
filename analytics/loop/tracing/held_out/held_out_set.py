"""The held-out set: runs that took no part in the fit are predicted once, with frozen coefficients."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from analytics.loop.tracing.search.candidates import effect_columns
from analytics.loop.tracing.search.effect_search import Search
from analytics.loop.tracing.whitening.least_squares import Solution, fit_of_clusters, solve
from analytics.loop.tracing.whitening.stack import Stack
from analytics.loop.tracing.whitening.unit_record import UnitRecord
from analytics.loop.tracing.whitening.white_variance import record_of
from stream.batch import BoolArray, FloatArray


@dataclass(frozen=True)
class HeldOutSet:
    """Held-out blocks of one unit with their predictions.

    Parameters
    ----------
    record: All blocks of the unit, since the filter needs the blocks before the held-out ones.
    held_out: shape (n,); marks the held-out blocks.
    declared: shape (p,); coefficients of the declared model.
    before: shape (n,); its residual.
    predictions: shape (n, effects); contribution of each common effect, less its share in the declared coefficients.
    covariance: shape (p, p); of the declared coefficients.
    whitened: shape (held out, 1 + effects + p); residual, predictions and declared columns, whitened by the noise of
        the training.
    """

    record: UnitRecord
    held_out: BoolArray
    declared: FloatArray
    before: FloatArray
    predictions: FloatArray
    covariance: FloatArray
    whitened: FloatArray

    @property
    def after(self) -> FloatArray:
        """Residual of the model with all effects."""
        return np.asarray(self.before - self.predictions.sum(axis=1))

    @property
    def whitened_after(self) -> FloatArray:
        """The same, whitened, of the held-out blocks."""
        return np.asarray(self.whitened[:, 0] - self.whitened[:, 1 : 1 + self.predictions.shape[1]].sum(axis=1))

    @cached_property
    def declared_alone(self) -> Solution:
        """Coefficients of the declared model without the search, and their covariance.

        Fitted with the noise of the training or by ordinary least squares, whichever predicts the held-out blocks
        better: a random walk in the noise may absorb a slow effect, which would flatter the gain of that effect.
        """
        weighted = Solution(self.declared, self.covariance)
        if not self.predictions.shape[1]:
            return weighted
        trained = np.ones_like(self.held_out) if self.held_out.all() else ~self.held_out
        value, design, replicate = self.record.value, self.record.design, self.record.stack.replicate
        plain = fit_of_clusters(design[trained], value[trained], replicate[trained])
        if plain is None:
            return weighted
        return min((weighted, plain), key=lambda each: float((self._residual(each)[self.held_out] ** 2).mean()))

    @cached_property
    def before_alone(self) -> FloatArray:
        """Residual of the declared model without the search."""
        return self._residual(self.declared_alone)

    def _residual(self, model: Solution) -> FloatArray:
        return np.asarray(self.record.value - self.record.design @ model.coefficients)


def open_held_out_set(
    stack: Stack, held_out: BoolArray, training: UnitRecord, found: Search, number: int = 0
) -> HeldOutSet:
    """Predict the held-out blocks of a unit from its training.

    The declared coefficients of the training are split into their values without the effects and the part that each
    effect adds, so that the predictions and the residual of the declared model are independent.

    Parameters
    ----------
    stack: All blocks of the unit.
    training: The blocks that were fitted, record `number` of the search.
    """
    common = found.common
    effects = [effect_columns(stack, each.fitted.effect, each.fitted.parameters) for each in common]
    record = record_of(stack, training.prior.center, np.column_stack(effects) if effects else None)
    p = training.design.shape[1]
    whitened = found.joint.whitened[number]
    trained = whitened[:, 1 : 1 + p]
    normal = trained.T @ trained
    first = 1 + found.joint.hypothesis.own[number].shape[1]
    predictions = np.empty((len(record), len(common)))
    declared = found.joint.own[number].coefficients[:p].copy()
    for column, each in enumerate(common):
        at = found.common_columns(each)
        theta = found.joint.common.coefficients[at]
        driven = whitened[:, first + at.start : first + at.stop] @ theta
        absorbed = solve(normal, trained.T @ driven).coefficients
        predictions[:, column] = effects[column] @ theta - record.design @ absorbed
        declared += absorbed
    before = record.value - record.design @ declared
    data = np.column_stack([before, predictions, record.design])
    return HeldOutSet(
        record=record,
        held_out=held_out,
        declared=declared,
        before=before,
        predictions=predictions,
        covariance=solve(normal, np.zeros(p)).covariance,
        whitened=record.whitener(found.joint.noises[number])(data)[held_out],
    )
