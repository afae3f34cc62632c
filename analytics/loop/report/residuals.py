"""Residuals of a diagnosed unit before and after, for the tables and figures of a report."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.model.noise import ModelNoise
from analytics.loop.tracing.case import case_of
from analytics.loop.tracing.result.diagnosis_result import Diagnosis
from analytics.loop.tracing.whitening.noise_variance import correlated_variance
from analytics.loop.tracing.whitening.unit_record import UnitRecord
from analytics.loop.tracing.whitening.white_variance import record_of
from stream.batch import BoolArray, FloatArray


@dataclass(frozen=True)
class Residuals:
    """Residuals of the declared model and of the model found, with the coefficients of the training.

    Parameters
    ----------
    record: The blocks, training and held out.
    noise: Fitted with the model found.
    held_out: Marks the held-out blocks.
    """

    record: UnitRecord
    noise: ModelNoise
    before: FloatArray
    after: FloatArray
    held_out: BoolArray

    @property
    def unit_of_measure(self) -> str:
        """Unit of the residuals."""
        return self.record.stack.runs[0].unit_of_measure

    @property
    def judged(self) -> BoolArray:
        """Marks the blocks on which errors are reported: the held-out blocks, or all if there are none."""
        return self.held_out if self.held_out.any() else np.ones(len(self.record), dtype=bool)

    def channel(self, name: str) -> FloatArray:
        """Block means of a channel that all runs have."""
        return self.record.stack.column(lambda run: run.mean(name))

    @property
    def channels(self) -> set[str]:
        """Channels that all runs have."""
        return set.intersection(*(set(run.channels) for run in self.record.stack.runs))

    def noise_variance(self, weights: FloatArray) -> float:
        """Variance of a weighted sum of the blocks due to the noise."""
        record = self.record
        space = record.noise_model.space(self.noise)
        total = float(space.white * np.sum(record.white * weights**2))
        number = record.stack.run_number
        for run in np.unique(number[weights != 0]):
            total += correlated_variance(record, self.noise, number == run, weights)
        return total


def residuals_of(runs: Sequence[RunBlocks], diagnosis: Diagnosis) -> Residuals | None:
    """Residuals of a diagnosed unit; None if there was not enough data for a diagnosis."""
    if diagnosis.judged is None or diagnosis.model is None or diagnosis.noise is None:
        return None
    held_out = [run for run in diagnosis.runs if run not in diagnosis.training_runs]
    used = [run for run in runs if run.run in diagnosis.runs]
    stack = case_of(used or runs, diagnosis.judged, diagnosis.noise, held_out).stack
    return Residuals(
        record=record_of(stack, diagnosis.noise),
        noise=diagnosis.noise,
        before=stack.column(diagnosis.judged.residual),
        after=stack.column(diagnosis.model.residual),
        held_out=stack.of_replicates(held_out),
    )
