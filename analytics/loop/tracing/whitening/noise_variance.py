"""Variance of averages of blocks that the noise model predicts."""

import itertools
from dataclasses import dataclass

import msgspec
import numpy as np
from numba import njit

from analytics.loop.model.error_model import ModelNoise
from analytics.loop.tracing.whitening.stack import UnitRecord
from analytics.loop.tracing.whitening.white_variance import LEAST_RATIO, OUTLIER_RATIO
from stream.batch import BoolArray, FloatArray, IntArray

_SQUARED_OUTLIER = 20.0  # variance of an outlier relative to its neighbours: it is at least 4.5 standard deviations off
LEAST_FILLED = 0.5  # least share of its blocks that an average needs


@dataclass(frozen=True)
class Averages:
    """Averages of consecutive blocks: `rows` are the blocks of each."""

    rows: tuple[IntArray, ...]

    def of(self, values: FloatArray) -> FloatArray:
        """Mean of values, or of columns, over each average."""
        sums = np.cumsum(values, axis=0)
        first = np.array([rows[0] for rows in self.rows])
        last = np.array([rows[-1] for rows in self.rows])
        size = (last + 1 - first).reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray((sums[last] - sums[first] + values[first]) / size)


def averages_of(record: UnitRecord, blocks: int, within: IntArray) -> Averages:
    """Averages of `blocks` consecutive blocks of one run, among the rows `within`."""
    number = record.stack.run_number[within]
    slot = record.stack.slot[within]
    found = []
    for run in np.unique(number):
        rows, own = within[number == run], slot[number == run]
        window = (own - own[0]) // blocks
        edges = np.flatnonzero(np.diff(window, prepend=-1, append=-1))
        pairs = itertools.pairwise(edges)
        found += [rows[first:end] for first, end in pairs if end - first >= LEAST_FILLED * blocks]
    return Averages(tuple(found))


def correlated_variance(record: UnitRecord, noise: ModelNoise, of_run: BoolArray, weights: FloatArray) -> float:
    """Variance of a weighted sum of the blocks of one run due to flicker, random walk and turn-on scatter.

    `of_run` marks these blocks; `weights` has all blocks of the record.
    """
    space = record.noise_model.space(noise)
    slot = record.stack.slot[of_run]
    on_grid = np.zeros(slot[-1] + 1 - slot[0])
    on_grid[slot - slot[0]] = weights[of_run]
    total = space.start * on_grid.sum() ** 2
    later = np.cumsum(on_grid[::-1])[::-1]
    total += space.walk * np.sum(later[1:] ** 2)
    for decay, variance in zip(space.decay, space.variance, strict=True):
        faded = _faded(on_grid, decay)
        total += variance * (np.sum(on_grid**2) + 2 * np.sum(on_grid * faded))
    return float(total)


@njit(cache=True, nogil=True)
def _faded(values, decay):  # type: ignore[no-untyped-def]
    """Sum of the earlier values, each faded by `decay` for every block since."""
    out = np.empty(values.size)
    total = 0.0
    for t in range(values.size):
        out[t] = total
        total = decay * values[t] + decay * total
    return out


def _white(record: UnitRecord) -> FloatArray:
    """Relative white variance of each block; that of outliers without the excess by which the filter ignores them."""
    is_outlier = record.white >= OUTLIER_RATIO * LEAST_RATIO
    return np.where(is_outlier, record.white * (_SQUARED_OUTLIER / OUTLIER_RATIO), record.white)


def within_run_variance(record: UnitRecord, noise: ModelNoise, averages: Averages) -> float:
    """Mean variance of averages about the mean of their run, without turn-on scatter."""
    quiet = msgspec.structs.replace(noise, turn_on=0.0)
    variance = expected_variance(record, quiet, averages)
    number = record.stack.run_number
    run_of = np.array([number[rows[0]] for rows in averages.rows])
    space = record.noise_model.space(quiet)
    total = 0.0
    for run in np.unique(run_of):
        own = [rows for rows, of in zip(averages.rows, run_of, strict=True) if of == run]
        weights = np.zeros(len(record))
        for rows in own:
            weights[rows] += 1 / rows.size / len(own)
        of_mean = correlated_variance(record, quiet, number == run, weights)
        of_mean += space.white * float(np.sum(_white(record) * weights**2))
        total += float(variance[run_of == run].sum()) - len(own) * of_mean
    return max(total, 0.0) / len(averages.rows)


def expected_variance(record: UnitRecord, noise: ModelNoise, averages: Averages) -> FloatArray:
    """Variance of each average, including turn-on scatter."""
    space = record.noise_model.space(noise)
    slot = record.stack.slot
    number = record.stack.run_number
    starts = slot[np.flatnonzero(record.steps == 0)]
    weight = _white(record)
    correlated: dict[bytes, float] = {}
    variances = []
    for rows in averages.rows:
        own = slot[rows] - slot[rows[0]]
        key = own.tobytes()
        if key not in correlated:
            apart = np.abs(own[:, None] - own[None, :])
            parts = [v * float(np.mean(d**apart)) for d, v in zip(space.decay, space.variance, strict=True)]
            correlated[key] = sum(parts)
        walked = slot[rows] - starts[number[rows[0]]]
        # mean of min(i, j) over all pairs of increasing numbers
        both = float(np.sum(walked * (2 * np.arange(rows.size, 0, -1) - 1))) / rows.size**2
        white = space.white * float(weight[rows].mean()) / rows.size
        variances.append(white + correlated[key] + space.start + space.walk * both)
    return np.array(variances)
