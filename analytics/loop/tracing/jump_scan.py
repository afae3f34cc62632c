"""Scan for one jump at an unknown time in one run: a matched filter in the whitened space, at every block."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from analytics.loop.tracing.joint_fit import JointFit
from analytics.loop.tracing.least_squares import orthonormal
from analytics.loop.tracing.record import Record
from analytics.loop.tracing.screening import family_p_value
from analytics.loop.tracing.whitening import Whitener
from stream.batch import FloatArray

EDGE_BLOCKS = 10
"""A jump nearer to an end of its run is a part of the turn-on scatter."""
SHORTEST_RUN_BLOCKS = 60
"""In a shorter run a jump is not told from a slow change."""
_EXACT = 120  # positions of a run at which the length of a whitened step is computed; between them it is interpolated
_INDEPENDENT = 0.3  # part of the positions that count as tests of their own


@dataclass(frozen=True)
class Jump:
    """The strongest jump.

    Parameters
    ----------
    record, run, row: Where: record, run of the record, first block behind the jump among the record's blocks.
    z: Its size over its uncertainty at the noise that was given.
    family_p_value: Chance that the best of all positions is as good.
    """

    record: int
    run: int
    row: int
    z: float
    family_p_value: float


def scan_jumps(records: Sequence[Record], joint: JointFit) -> Jump | None:
    """Strongest jump in what a fit leaves; None where all runs are too short."""
    best: Jump | None = None
    positions = 0
    for number, record in enumerate(records):
        whitener = record.whitener(joint.noises[number])
        ratio = _ratios(record, whitener, joint.whitened[number][:, 1:], joint.residuals[number])
        positions += int(np.count_nonzero(ratio))
        row = int(np.argmax(np.abs(ratio)))
        if ratio[row] and (best is None or abs(ratio[row]) > abs(best.z)):
            best = Jump(number, int(record.stack.run_number[row]), row, float(ratio[row]), 1.0)
    if best is None:
        return None
    p_value = float(2 * stats.norm.sf(abs(best.z)))
    tests = max(1.0, _INDEPENDENT * positions)
    return Jump(best.record, best.run, best.row, best.z, family_p_value(p_value, tests))


def jump_column(record: Record, row: int) -> FloatArray:
    """Step from a block to the end of its run, shape (n, 1)."""
    number = record.stack.run_number
    after = (np.arange(len(record)) >= row) & (number == number[row])
    return np.asarray(after[:, None], dtype=np.float64)


def _ratios(record: Record, whitener: Whitener, design: FloatArray, residual: FloatArray) -> FloatArray:
    """Size over uncertainty of a jump at each block; 0 near the ends of runs and where it cannot be told."""
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
        told = left_over > 1e-3 * before
        told[:EDGE_BLOCKS] = told[-EDGE_BLOCKS:] = False
        ratio[first:end] = np.where(told, sums[:, 0] / np.sqrt(np.where(told, left_over, 1.0)), 0.0)
    return ratio


def _squared_lengths(whitener: Whitener, first: int, end: int) -> FloatArray:
    """Squared length of a whitened step from each block of a run on."""
    size = end - first
    rows = np.unique(np.linspace(0, size - 1, min(size, _EXACT)).astype(np.int64))
    steps = (np.arange(size)[:, None] >= rows).astype(np.float64)
    of_run = Whitener(
        whitener.steps[first:end], whitener.decay, whitener.gain[first:end], whitener.innovation[first:end]
    )
    exact = np.sum(of_run(steps) ** 2, axis=0)
    return np.asarray(np.interp(np.arange(size), rows, exact))
