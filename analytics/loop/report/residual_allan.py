"""Allan deviation of the residual before and after, from blocks on, over runs that may have gaps."""

import math
from dataclasses import dataclass

import numpy as np

from analytics.loop.report.residuals import Residuals
from stream.batch import FloatArray
from stream.estimators.confidence import deviation_bounds, least_edf

CONFIDENCE = 0.95


@dataclass(frozen=True)
class DeviationAt:
    """Allan deviation of the residual at one averaging time.

    Parameters
    ----------
    tau_s: Averaging time, seconds.
    before, after: With the declared model and with the model found.
    lo, hi: 95 % limits of `after`, by the least degrees of freedom of the plausible noises.
    floor: What the fitted noise alone gives.
    differences: How many overlapping differences there are.
    """

    tau_s: float
    before: float
    after: float
    lo: float
    hi: float
    floor: float
    differences: int


def residual_allan(residuals: Residuals) -> tuple[DeviationAt, ...]:
    """Overlapping Allan deviation of the residuals, pooled over the runs on which errors are told.

    Differences that reach over a gap or the end of a run do not count.
    """
    stack = residuals.record.stack
    rows = np.flatnonzero(residuals.judged)
    number = stack.run_number[rows]
    parts = [rows[number == run] for run in np.unique(number)]
    grids = [_on_grid(stack.slot[part], np.stack([residuals.before[part], residuals.after[part]])) for part in parts]
    longest = max(grid.shape[1] for grid in grids)
    found = []
    factor = 1
    while 2 * factor <= longest:
        at = _deviation(residuals, grids, factor)
        if at is not None:
            found.append(at)
        factor *= 2
    return tuple(found)


def _on_grid(slot: "np.ndarray[tuple[int, ...], np.dtype[np.int64]]", values: FloatArray) -> FloatArray:
    """Return values on the grid of a run, NaN in its gaps, shape (2, blocks)."""
    grid = np.full((2, slot[-1] + 1 - slot[0]), np.nan)
    grid[:, slot - slot[0]] = values
    return grid


def _deviation(residuals: Residuals, grids: list[FloatArray], factor: int) -> DeviationAt | None:
    squares, count, freedom = np.zeros(2), 0, 0.0
    for grid in grids:
        differences = _differences(grid, factor)
        windows = differences.shape[1]
        if windows:
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
    """Differences of neighbouring averages, at every block, without those that have a gap in them."""
    if grid.shape[1] < 2 * factor:
        return np.empty((2, 0))
    sums = np.concatenate([np.zeros((2, 1)), np.cumsum(np.nan_to_num(grid), axis=1)], axis=1)
    missing = np.concatenate([[0], np.cumsum(np.isnan(grid[0]))])
    means = (sums[:, factor:] - sums[:, :-factor]) / factor
    apart = means[:, factor:] - means[:, :-factor]
    return np.asarray(apart[:, missing[2 * factor :] == missing[: -2 * factor]])
