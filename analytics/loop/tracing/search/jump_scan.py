"""Scan for a step at an unknown time in one run: a matched filter in the whitened space."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from analytics.loop.tracing.search.screening import family_p_value
from analytics.loop.tracing.whitening.joint_fit import JointFit
from analytics.loop.tracing.whitening.least_squares import orthonormal
from analytics.loop.tracing.whitening.unit_record import UnitRecord
from analytics.loop.tracing.whitening.whitener import Whitener
from stream.batch import FloatArray

EDGE_BLOCKS = 10
"""A jump nearer to an end of its run is part of the turn-on scatter."""
SHORTEST_RUN_BLOCKS = 60
"""In a shorter run a jump cannot be separated from a slow change."""
_EXACT = 120  # positions at which the norm of a whitened step is computed; it is interpolated between them
_INDEPENDENT = 0.3  # share of the positions that count as independent tests


@dataclass(frozen=True)
class StrongestJump:
    """The strongest jump.

    Parameters
    ----------
    record, run, row: Number of the record, of its run, and of the first block after the jump.
    z: Size over standard uncertainty.
    family_p_value: Of the best of all positions.
    """

    record: int
    run: int
    row: int
    z: float
    family_p_value: float


def scan_jumps(records: Sequence[UnitRecord], joint: JointFit) -> StrongestJump | None:
    """Strongest jump in the residual of a fit; None if all runs are too short."""
    best: StrongestJump | None = None
    positions = 0
    for number, record in enumerate(records):
        whitener = record.whitener(joint.noises[number])
        ratio = _ratios(record, whitener, joint.whitened[number][:, 1:], joint.residuals[number])
        positions += int(np.count_nonzero(ratio))
        row = int(np.argmax(np.abs(ratio)))
        if ratio[row] and (best is None or abs(ratio[row]) > abs(best.z)):
            best = StrongestJump(number, int(record.stack.run_number[row]), row, float(ratio[row]), 1.0)
    if best is None:
        return None
    p_value = float(2 * stats.norm.sf(abs(best.z)))
    tests = max(1.0, _INDEPENDENT * positions)
    return StrongestJump(best.record, best.run, best.row, best.z, family_p_value(p_value, tests))


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
    starts = np.flatnonzero(record.steps == 0)
    for first, end in zip(starts, [*starts[1:], len(record)], strict=True):
        if end - first < SHORTEST_RUN_BLOCKS:
            continue
        sums = np.cumsum(back[first:end][::-1], axis=0)[::-1]
        before = _squared_lengths(whitener, int(first), int(end))
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
    of_run = Whitener(
        whitener.steps[first:end], whitener.decay, whitener.gain[first:end], whitener.innovation[first:end]
    )
    exact = np.sum(of_run(steps) ** 2, axis=0)
    return np.asarray(np.interp(np.arange(size), rows, exact))
