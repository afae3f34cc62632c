"""Spectrum of the whitened residual: one everywhere where the noise model is right and nothing is missing."""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from analytics.loop.report.residuals import Residuals
from stream.batch import FloatArray

BINS_PER_DECADE = 8
FEWEST_BLOCKS = 16
CONFIDENCE = 0.95


@dataclass(frozen=True)
class WhitenedSpectrum:
    """Mean power in logarithmic bins of frequency, relative to white noise of unit variance.

    Parameters
    ----------
    frequency_hz: shape (bins,); middle of each bin.
    before, after: shape (bins,); of the residual of the declared model and of the model found; both whitened by the
        noise fitted with the latter.
    lo, hi: shape (bins,); between them 95 % of the bins lie where only that noise is left.
    """

    frequency_hz: FloatArray
    before: FloatArray
    after: FloatArray
    lo: FloatArray
    hi: FloatArray


def whitened_spectrum(residuals: Residuals) -> WhitenedSpectrum | None:
    """Spectrum over all runs; None where no run has 16 blocks."""
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
    lo, hi = (stats.chi2.ppf(p, 2 * count) / (2 * count) for p in (tail, 1 - tail))
    return WhitenedSpectrum(middle, mean[:, 0], mean[:, 1], lo, hi)
