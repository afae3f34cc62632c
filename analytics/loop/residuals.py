"""Residuals of a diagnosed unit before and after, their Allan deviation and whitened spectrum."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.model.error_model import ModelNoise
from analytics.loop.tracing.case import case_of
from analytics.loop.tracing.result.diagnosis_result import Diagnosis
from analytics.loop.tracing.whitening.noise_variance import correlated_variance
from analytics.loop.tracing.whitening.stack import UnitRecord
from analytics.loop.tracing.whitening.white_variance import record_of
from analytics.methods.distributions import chi_square_quantile
from stream.batch import BoolArray, FloatArray, IntArray
from stream.estimators.confidence import deviation_bounds, least_edf

CONFIDENCE = 0.95
BINS_PER_DECADE = 8
FEWEST_BLOCKS = 16


@dataclass(frozen=True)
class Residuals:
    """Residuals of the declared model and of the model found, with the coefficients of the training."""

    record: UnitRecord  # the blocks, training and held out
    noise: ModelNoise  # fitted with the model found
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
    held_out = diagnosis.held_out_runs
    used = [run for run in runs if run.run in diagnosis.runs]
    stack = case_of(used or runs, diagnosis.judged, diagnosis.noise, held_out).stack
    return Residuals(
        record=record_of(stack, diagnosis.noise),
        noise=diagnosis.noise,
        before=stack.column(diagnosis.judged.residual),
        after=stack.column(diagnosis.model.residual),
        held_out=stack.of_replicates(held_out),
    )


@dataclass(frozen=True)
class DeviationAt:
    """Allan deviation of the residual at one averaging time, with the declared model and with the model found."""

    tau_s: float
    before: float
    after: float
    lo: float  # 95 % confidence bounds of `after`, with the least degrees of freedom of the plausible noises
    hi: float
    floor: float  # of the fitted noise alone
    differences: int  # number of overlapping differences


def residual_allan(residuals: Residuals) -> tuple[DeviationAt, ...]:
    """Overlapping Allan deviation, pooled over runs; differences across a gap or the end of a run do not count."""
    stack = residuals.record.stack
    rows = np.flatnonzero(residuals.judged)
    number = stack.run_number[rows]
    grids = []
    for run in np.unique(number):
        part = rows[number == run]
        slot = stack.slot[part]
        grid = np.full((2, slot[-1] + 1 - slot[0]), np.nan)
        grid[:, slot - slot[0]] = residuals.before[part], residuals.after[part]
        grids.append(grid)
    longest = max(grid.shape[1] for grid in grids)
    factors = [2**power for power in range(longest.bit_length()) if 2 * 2**power <= longest]
    found = [_deviation(residuals, grids, factor) for factor in factors]
    return tuple(each for each in found if each is not None)


def _deviation(residuals: Residuals, grids: list[FloatArray], factor: int) -> DeviationAt | None:
    squares, count, freedom = np.zeros(2), 0, 0.0
    for grid in grids:
        differences = _differences(grid, factor)
        if windows := differences.shape[1]:
            squares += np.sum(differences**2, axis=1)
            count += windows
            freedom += least_edf(factor, windows, factor)
    if not count:
        return None
    before, after = (math.sqrt(float(each) / 2 / count) for each in squares)
    model = residuals.record.noise_model
    tau_s = factor * model.block_s
    lo, hi = deviation_bounds(after, freedom, CONFIDENCE)
    floor = math.sqrt(model.average_variance(residuals.noise, tau_s))
    return DeviationAt(tau_s, before, after, lo, hi, floor, count)


def _differences(grid: FloatArray, factor: int) -> FloatArray:
    """Differences of adjacent averages, at every block, without those that contain a gap."""
    if grid.shape[1] < 2 * factor:
        return np.empty((2, 0))
    sums: FloatArray = np.concatenate([np.zeros((2, 1)), np.cumsum(np.nan_to_num(grid), axis=1)], axis=1)
    missing: IntArray = np.concatenate([[0], np.cumsum(np.isnan(grid[0]))])
    means: FloatArray = (sums[:, factor:] - sums[:, :-factor]) / factor
    apart = means[:, factor:] - means[:, :-factor]
    return np.asarray(apart[:, missing[2 * factor :] == missing[: -2 * factor]])


@dataclass(frozen=True)
class WhitenedSpectrum:
    """Mean power in logarithmic bins of frequency, relative to white noise of variance one; arrays of shape (bins,)."""

    frequency_hz: FloatArray
    before: FloatArray  # of the residual of the declared model
    after: FloatArray  # of the model found, both whitened by the fitted noise
    lo: FloatArray  # 95 % of the bins are between the bounds if only that noise is left
    hi: FloatArray


def whitened_spectrum(residuals: Residuals) -> WhitenedSpectrum | None:
    """Spectrum over all runs; None if no run has 16 blocks."""
    record = residuals.record
    both = record.whitener(residuals.noise)(np.column_stack([residuals.before, residuals.after]))
    number = record.stack.run_number
    frequencies, powers = [], []
    for run in range(len(record.stack.runs)):
        part = both[number == run]
        n = len(part)
        if n < FEWEST_BLOCKS:
            continue
        transformed = np.fft.rfft(part - part.mean(axis=0), axis=0)[1 : (n + 1) // 2]
        powers.append(np.abs(transformed) ** 2 / n)
        frequencies.append(np.arange(1, len(transformed) + 1) / (n * record.noise_model.block_s))
    if not powers:
        return None
    return _binned(np.concatenate(frequencies), np.concatenate(powers))


def _binned(frequency_hz: FloatArray, power: FloatArray) -> WhitenedSpectrum:
    number = np.floor(np.log10(frequency_hz / frequency_hz.min()) * BINS_PER_DECADE + 1e-9).astype(np.int64)
    bins = np.unique(number)
    count = np.array([np.count_nonzero(number == each) for each in bins])
    mean = np.stack([power[number == each].mean(axis=0) for each in bins])
    middle = np.array([np.exp(np.log(frequency_hz[number == each]).mean()) for each in bins])
    tail = (1 - CONFIDENCE) / 2
    lo, hi = (chi_square_quantile(p, 2 * count) / (2 * count) for p in (tail, 1 - tail))
    return WhitenedSpectrum(middle, mean[:, 0], mean[:, 1], lo, hi)
