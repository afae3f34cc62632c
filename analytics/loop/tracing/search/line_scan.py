"""Scan for a spectral line at one unknown frequency; amplitude and phase are free in each run."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft, ndimage, stats

from analytics.loop.tracing.whitening.unit_record import UnitRecord
from stream.batch import FloatArray

LONGEST_PERIOD_BLOCKS = 80
SHORTEST_PERIOD_BLOCKS = 2.2
_PADDING = 4
_WINDOW = 401  # grid points, about 100 independent ones, over which the spectrum is assumed smooth


@dataclass(frozen=True)
class StrongestLine:
    """The strongest line.

    Parameters
    ----------
    p_value, family_p_value: Of this frequency alone, and of the best of all frequencies.
    powers: shape (runs,); periodogram of each run at this frequency; its mean is 2 in white noise.
    """

    frequency_hz: float
    p_value: float
    family_p_value: float
    powers: FloatArray

    @property
    def largest_share(self) -> float:
        """Share of the strongest run in the power above noise."""
        above = np.maximum(self.powers - 2.0, 0.0)
        return float(above.max() / above.sum()) if above.any() else 1.0


def scan_lines(records: Sequence[UnitRecord], residuals: Sequence[FloatArray]) -> StrongestLine | None:
    """Strongest line of whitened residuals; None if the runs are too short."""
    pieces = [piece for record, residual in zip(records, residuals, strict=True) for piece in _by_run(record, residual)]
    longest = max(piece.size for piece, _ in pieces)
    if longest < LONGEST_PERIOD_BLOCKS:
        return None
    size = _PADDING * fft.next_fast_len(longest)
    per_block = fft.rfftfreq(size)
    band = (per_block > max(1 / LONGEST_PERIOD_BLOCKS, 3 / longest)) & (per_block < 1 / SHORTEST_PERIOD_BLOCKS)
    spectra = np.array([np.abs(fft.rfft(piece, size)[band]) ** 2 * 2 / blocks for piece, blocks in pieces])
    degrees = 2 * len(pieces)
    total = spectra.sum(axis=0)
    local = ndimage.median_filter(total, _WINDOW, mode="nearest") / stats.chi2.median(degrees)
    level = total / np.maximum(local, 1.0)
    best = int(np.argmax(level))
    p_value = float(stats.chi2.sf(level[best], degrees))
    block_s = records[0].noise_model.block_s
    return StrongestLine(
        frequency_hz=float(per_block[band][best] / block_s),
        p_value=p_value,
        family_p_value=min(1.0, p_value * level.size),
        powers=spectra[:, best],
    )


def line_columns(record: UnitRecord, frequency_hz: float) -> FloatArray:
    """Cosine and sine of each run of a record, shape (n, 2 * runs)."""
    number = record.stack.run_number
    phase = 2 * np.pi * frequency_hz * record.noise_model.block_s * record.stack.slot
    runs = number[:, None] == np.arange(len(record.stack.runs))
    return np.column_stack([runs * np.cos(phase)[:, None], runs * np.sin(phase)[:, None]])


def amplitude_of(values: FloatArray, variance: FloatArray) -> tuple[float, float]:
    """RMS amplitude of a line over runs and its standard uncertainty, from cosines and sines and their variances."""
    runs = values.size / 2
    return (
        float(np.sqrt(max(0.0, float(np.sum(values**2 - variance)) / runs))),
        float(np.sqrt(variance.mean() / runs)),
    )


def powers_at(records: Sequence[UnitRecord], residuals: Sequence[FloatArray], frequency_hz: float) -> FloatArray:
    """Periodogram of each run at one frequency; its mean is 2 in white noise."""
    powers = []
    for record, residual in zip(records, residuals, strict=True):
        for piece, blocks in _by_run(record, residual):
            turn = np.exp(-2j * np.pi * frequency_hz * record.noise_model.block_s * np.arange(piece.size))
            powers.append(float(np.abs(piece @ turn) ** 2 * 2 / blocks))
    return np.array(powers)


def _by_run(record: UnitRecord, residual: FloatArray) -> list[tuple[FloatArray, int]]:
    """Residual of each run on its grid, zero in gaps, and its number of blocks."""
    slot, number = record.stack.slot, record.stack.run_number
    pieces = []
    for run in range(len(record.stack.runs)):
        of_run = number == run
        grid = np.zeros(int(slot[of_run][-1] - slot[of_run][0]) + 1)
        grid[slot[of_run] - slot[of_run][0]] = residual[of_run]
        pieces.append((grid, int(np.count_nonzero(of_run))))
    return pieces
