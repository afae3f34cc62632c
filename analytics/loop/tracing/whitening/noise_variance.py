"""Variance of averages of blocks that the noise model predicts."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import msgspec
import numpy as np

from analytics.loop.model.error_model import ModelNoise
from analytics.loop.tracing.whitening.stack import UnitRecord
from analytics.loop.tracing.whitening.white_variance import LEAST_RATIO, OUTLIER_RATIO
from stream.batch import BoolArray, FloatArray, IntArray
from stream.compiled import kernel

_SQUARED_OUTLIER = 20.0  # variance of an outlier relative to its neighbours: it is at least 4.5 standard deviations off
MOST_COVARIANCES = 48  # averages of a run whose covariance is computed
LEAST_FILLED = 0.5  # least share of its blocks that an average needs


@dataclass(frozen=True)
class Averages:
    """Averages of consecutive blocks: `rows` are the blocks of each."""

    rows: tuple[IntArray, ...]

    @cached_property
    def first(self) -> IntArray:
        """First block of each."""
        return np.array([rows[0] for rows in self.rows], dtype=np.int64)

    @cached_property
    def last(self) -> IntArray:
        """Last block of each."""
        return np.array([rows[-1] for rows in self.rows], dtype=np.int64)

    def of(self, values: FloatArray) -> FloatArray:
        """Mean of values, or of columns, over each average."""
        sums = np.cumsum(values, axis=0)
        size = (self.last + 1 - self.first).reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray((sums[self.last] - sums[self.first] + values[self.first]) / size)


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
    """Variance of a weighted sum of the blocks of one run, see `correlated_covariance`."""
    return float(correlated_covariance(record, noise, of_run, weights[:, None])[0, 0])


def correlated_covariance(record: UnitRecord, noise: ModelNoise, of_run: BoolArray, weights: FloatArray) -> FloatArray:
    """Covariance of weighted sums of the blocks of one run due to flicker, random walk and turn-on scatter.

    `of_run` marks these blocks; `weights` has all blocks of the record, and a column for each sum.
    """
    space = record.noise_model.space(noise)
    slot = record.stack.slot[of_run]
    on_grid = np.zeros((slot[-1] + 1 - slot[0], weights.shape[1]))
    on_grid[slot - slot[0]] = weights[of_run]
    sums = on_grid.sum(axis=0)
    later = np.cumsum(on_grid[::-1], axis=0)[::-1][1:]
    total = space.start * np.outer(sums, sums) + space.walk * (later.T @ later)
    for decay, variance in zip(space.decay, space.variance, strict=True):
        faded = on_grid.T @ _faded(on_grid, decay)  # of earlier blocks
        total += variance * (on_grid.T @ on_grid + faded + faded.T)
    return np.asarray(total)


def squares_spread(record: UnitRecord, noise: ModelNoise, averages: Averages) -> float:
    """Relative standard deviation of the sum of squares of averages about the mean of their run.

    sqrt(2 tr(C^2))/tr(C) with the covariance C of the averages; of a long run the first `MOST_COVARIANCES` stand for
    the others.
    """
    trace = squares = 0.0
    quiet = msgspec.structs.replace(noise, turn_on=0.0)
    for of_run, own in _by_run(record, averages):
        weights = np.zeros((len(record), min(len(own), MOST_COVARIANCES)))
        for column, rows in enumerate(own[:MOST_COVARIANCES]):
            weights[rows, column] = 1 / rows.size
        covariance = correlated_covariance(record, quiet, of_run, weights)
        covariance += record.noise_model.space(quiet).white * (weights.T * _white(record)) @ weights
        centred = covariance - covariance.mean(axis=0)
        centred -= centred.mean(axis=1, keepdims=True)
        scale = len(own) / weights.shape[1]
        trace += scale * float(np.trace(centred))
        squares += scale * float(np.sum(centred**2))
    return float(np.sqrt(2 * squares)) / trace if trace > 0 else 0.0


def _by_run(record: UnitRecord, averages: Averages) -> Iterator[tuple[BoolArray, list[IntArray]]]:
    """The blocks of each run with averages, and the rows of each of these."""
    number = record.stack.run_number
    run_of = number[averages.first]
    for run in np.unique(run_of):
        yield number == run, [rows for rows, of in zip(averages.rows, run_of, strict=True) if of == run]


@kernel
def _faded(values: FloatArray, decay: float) -> FloatArray:
    """Sum of the earlier rows, each faded by `decay` for every block since."""
    out = np.empty(values.shape)
    total = np.zeros(values.shape[1])
    for t in range(values.shape[0]):
        for c in range(values.shape[1]):  # expressions of whole rows take seconds to compile
            out[t, c] = total[c]
            total[c] = decay * values[t, c] + decay * total[c]
    return out


def _white(record: UnitRecord) -> FloatArray:
    """Relative white variance of each block; that of outliers without the excess by which the filter ignores them."""
    is_outlier = record.white >= OUTLIER_RATIO * LEAST_RATIO
    return np.where(is_outlier, record.white * (_SQUARED_OUTLIER / OUTLIER_RATIO), record.white)


def within_run_variance(record: UnitRecord, noise: ModelNoise, averages: Averages) -> float:
    """Mean variance of averages about the mean of their run, without turn-on scatter."""
    quiet = msgspec.structs.replace(noise, turn_on=0.0)
    total = float(expected_variance(record, quiet, averages).sum())
    for of_run, own in _by_run(record, averages):
        weights = np.zeros(len(record))
        sizes = [rows.size for rows in own]
        weights[np.concatenate(own)] = np.repeat(1 / np.array(sizes) / len(own), sizes)
        of_mean = correlated_variance(record, quiet, of_run, weights)
        of_mean += record.noise_model.space(quiet).white * float(np.sum(_white(record) * weights**2))
        total -= len(own) * of_mean
    return max(total, 0.0) / len(averages.rows)


def expected_variance(record: UnitRecord, noise: ModelNoise, averages: Averages) -> FloatArray:
    """Variance of each average, including turn-on scatter."""
    space = record.noise_model.space(noise)
    slot, number = record.stack.slot, record.stack.run_number
    starts = slot[record.steps == 0]
    sizes = averages.last + 1 - averages.first
    average, rows = np.repeat(np.arange(sizes.size), sizes), np.concatenate(averages.rows)
    place = rows - averages.first[average]
    walked = slot[rows] - starts[number[rows]]
    # mean of min(i, j) over all pairs of increasing numbers
    both = np.bincount(average, walked * (2 * (sizes[average] - place) - 1)) / sizes**2
    white = space.white * np.bincount(average, _white(record)[rows]) / sizes**2
    correlated = np.empty(sizes.size)
    known: dict[bytes, float] = {}
    for at, (first, last) in enumerate(zip(averages.first, averages.last, strict=True)):
        own = slot[first : last + 1] - slot[first]
        key = own.tobytes()
        if key not in known:
            apart = np.abs(own[:, None] - own[None, :])
            known[key] = sum(v * float(np.mean(d**apart)) for d, v in zip(space.decay, space.variance, strict=True))
        correlated[at] = known[key]
    return np.asarray(white + correlated + space.start + space.walk * both)
