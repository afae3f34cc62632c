"""Scans for a spectral line at an unknown frequency, and for a step at an unknown time in one run."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy import fft, ndimage

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.tracing.search.screening import family_p_value
from analytics.loop.tracing.whitening.joint_fit import JointFit
from analytics.loop.tracing.whitening.least_squares import orthonormal
from analytics.loop.tracing.whitening.stack import UnitRecord
from analytics.loop.tracing.whitening.whitener import Whitener
from analytics.methods.distributions import chi_square_quantile, chi_square_sf, normal_sf
from stream.batch import BoolArray, FloatArray

LONGEST_PERIOD_BLOCKS = 80
SHORTEST_PERIOD_BLOCKS = 2.2
_PADDING = 4
_REFINEMENTS = 4
_WINDOW = 401  # grid points, about 100 independent ones, over which the spectrum is assumed smooth
EDGE_BLOCKS = 10  # a jump nearer to an end of its run is part of the turn-on scatter
SHORTEST_RUN_BLOCKS = 60  # in a shorter run a jump cannot be separated from a slow change
_EXACT = 120  # positions at which the norm of a whitened step is computed; it is interpolated between them
_MOTION = frozenset({"input_rate", "rate_o", "rate_s", "table_rate"})
_LINE_OF_MOTION = 100.0  # power over that of the frequencies beside it
_INDEPENDENT = 0.3  # share of the positions that count as independent tests


@dataclass(frozen=True)
class StrongestLine:
    """The strongest line."""

    frequency_hz: float
    p_value: float  # of this frequency alone
    family_p_value: float  # of the best of all frequencies
    powers: FloatArray  # shape (runs,); periodogram of each run at this frequency; its mean is 2 in white noise

    @property
    def largest_share(self) -> float:
        """Share of the strongest run in the power above noise."""
        above = np.maximum(self.powers - 2.0, 0.0)
        return float(above.max() / above.sum()) if above.any() else 1.0


def scan_lines(records: Sequence[UnitRecord], residuals: Sequence[FloatArray]) -> StrongestLine | None:
    """Strongest line of whitened residuals; None if the runs are too short.

    Frequencies at which the unit was moved are left out: what is there follows the motion.
    """
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
    local = ndimage.median_filter(total, _WINDOW, mode="nearest") / chi_square_quantile(0.5, degrees)
    level = np.where(_of_motion(records, size)[band], 0.0, total / np.maximum(local, 1.0))
    if not level.any():
        return None
    best = int(np.argmax(level))
    p_value = float(chi_square_sf(level[best], degrees))
    block_s = records[0].noise_model.block_s
    frequency_hz = float(per_block[band][best] / block_s)
    return StrongestLine(frequency_hz, p_value, min(1.0, p_value * level.size), spectra[:, best])


def _of_motion(records: Sequence[UnitRecord], size: int) -> BoolArray:
    """Marks the frequencies of a transform at which a rate of unit or table has a line."""
    marked = np.zeros(size // 2 + 1, dtype=np.bool_)
    for name in {each for record in records for run in record.stack.runs for each in run.channels.keys() & _MOTION}:
        total = np.zeros(marked.size)
        for record in records:
            for piece, _ in _by_run(record, record.stack.column(partial(_about_mean, name))):
                total += np.abs(fft.rfft(piece, size)) ** 2
        if total.any():
            beside = np.maximum(ndimage.median_filter(total, _WINDOW, mode="nearest"), 1e-12 * total.max())
            marked |= total > _LINE_OF_MOTION * beside
    return np.asarray(ndimage.binary_dilation(marked, iterations=_PADDING) if marked.any() else marked)


def _about_mean(name: str, run: RunBlocks) -> FloatArray:
    """A channel about its mean, 0 where it has no value."""
    value = run.mean(name) if name in run.channels else np.zeros(len(run))
    known = np.isfinite(value)
    return np.where(known, value - value[known].mean(), 0.0) if known.any() else np.zeros(len(run))


def between_grid_points(
    records: Sequence[UnitRecord], residuals: Sequence[FloatArray], line: StrongestLine
) -> StrongestLine:
    """The line at the frequency, near its grid point, at which its power is largest.

    A strong line off the grid would leave enough of itself for a second line beside it.
    """
    longest = max(piece.size for record, residual in zip(records, residuals, strict=True)
                  for piece, _ in _by_run(record, residual))  # fmt: skip
    step_hz = 1 / (_PADDING * longest * records[0].noise_model.block_s)
    found, powers = line.frequency_hz, line.powers
    for _ in range(_REFINEMENTS):
        near = found + step_hz * np.linspace(-1, 1, 2 * _PADDING + 1)
        every = [powers_at(records, residuals, float(each)) for each in near]
        best = int(np.argmax([each.sum() for each in every]))
        found, powers, step_hz = float(near[best]), every[best], step_hz / _PADDING
    return replace(line, frequency_hz=found, powers=powers)


def line_columns(record: UnitRecord, frequency_hz: float) -> FloatArray:
    """Cosine and sine of each run of a record as means of blocks, which attenuate them; shape (n, 2 * runs)."""
    number, block_s = record.stack.run_number, record.noise_model.block_s
    phase = 2 * np.pi * frequency_hz * block_s * record.stack.slot
    runs = np.sinc(frequency_hz * block_s) * (number[:, None] == np.arange(len(record.stack.runs)))
    return np.column_stack([runs * np.cos(phase)[:, None], runs * np.sin(phase)[:, None]])


def amplitude_of(values: FloatArray, variance: FloatArray) -> tuple[float, float]:
    """RMS amplitude of a line over runs and its standard uncertainty, from cosines and sines and their variances."""
    runs = values.size / 2
    amplitude = np.sqrt(max(0.0, float(np.sum(values**2 - variance)) / runs))
    return float(amplitude), float(np.sqrt(variance.mean() / runs))


def powers_at(records: Sequence[UnitRecord], residuals: Sequence[FloatArray], frequency_hz: float) -> FloatArray:
    """Periodogram of each run at one frequency; its mean is 2 in white noise."""
    powers = []
    for record, residual in zip(records, residuals, strict=True):
        for piece, blocks in _by_run(record, residual):
            turn = np.exp(-2j * np.pi * frequency_hz * record.noise_model.block_s * np.arange(piece.size))
            powers.append(float(np.abs(piece @ turn) ** 2 * 2 / blocks))
    return np.array(powers)


def _by_run(record: UnitRecord, residual: FloatArray) -> Iterator[tuple[FloatArray, int]]:
    """Residual of each run on its grid, zero in gaps, and its number of blocks."""
    slot, number = record.stack.slot, record.stack.run_number
    for run in range(len(record.stack.runs)):
        of_run = number == run
        grid = np.zeros(int(slot[of_run][-1] - slot[of_run][0]) + 1)
        grid[slot[of_run] - slot[of_run][0]] = residual[of_run]
        yield grid, int(np.count_nonzero(of_run))


@dataclass(frozen=True)
class StrongestJump:
    """The strongest jump: number of its record, of the run, and of the first block after it."""

    record: int
    run: int
    row: int
    z: float  # size over standard uncertainty
    family_p_value: float  # of the best of all positions


def scan_jumps(records: Sequence[UnitRecord], joint: JointFit) -> StrongestJump | None:
    """Strongest jump in the residual of a fit; None if all runs are too short."""
    ratios = [
        _ratios(record, record.whitener(noise), whitened[:, 1:], residual)
        for record, noise, whitened, residual in zip(
            records, joint.noises, joint.whitened, joint.residuals, strict=True
        )
    ]
    number = int(np.argmax([np.abs(ratio).max() for ratio in ratios]))
    row = int(np.argmax(np.abs(ratios[number])))
    z = float(ratios[number][row])
    if z == 0:
        return None
    tests = max(1.0, _INDEPENDENT * sum(map(np.count_nonzero, ratios)))
    p_value = family_p_value(float(2 * normal_sf(abs(z))), tests)
    return StrongestJump(number, int(records[number].stack.run_number[row]), row, z, p_value)


def jump_column(record: UnitRecord, row: int) -> FloatArray:
    """Step from a block to the end of its run, shape (n, 1)."""
    number = record.stack.run_number
    after = (np.arange(len(record)) >= row) & (number == number[row])
    return np.asarray(after[:, None], dtype=np.float64)


def _ratios(record: UnitRecord, whitener: Whitener, design: FloatArray, residual: FloatArray) -> FloatArray:
    """Size over uncertainty of a jump at each block; 0 near the ends of runs."""
    basis = orthonormal(design)
    back = whitener.adjoint(np.column_stack([residual, basis]))
    ratio = np.zeros(len(record))
    starts: list[int] = np.flatnonzero(record.steps == 0).tolist()
    for first, end in zip(starts, [*starts[1:], len(record)], strict=True):
        if end - first < SHORTEST_RUN_BLOCKS:
            continue
        sums = np.cumsum(back[first:end][::-1], axis=0)[::-1]
        before = _squared_lengths(whitener, first, end)
        left_over = before - np.sum(sums[:, 1:] ** 2, axis=1)
        resolved = left_over > 1e-3 * before
        resolved[:EDGE_BLOCKS] = resolved[-EDGE_BLOCKS:] = False
        ratio[first:end] = np.where(resolved, sums[:, 0] / np.sqrt(np.where(resolved, left_over, 1.0)), 0.0)
    return ratio


def _squared_lengths(whitener: Whitener, first: int, end: int) -> FloatArray:
    """Squared norm of a whitened step at each block of a run."""
    size = end - first
    rows = np.unique(np.linspace(0, size - 1, min(size, _EXACT)).astype(np.int64))
    steps = (np.arange(size)[:, None] >= rows).astype(np.float64)
    its = slice(first, end)
    of_run = Whitener(whitener.steps[its], whitener.decay, whitener.gain[its], whitener.innovation[its])
    exact = np.sum(of_run(steps) ** 2, axis=0)
    return np.asarray(np.interp(np.arange(size), rows, exact))
