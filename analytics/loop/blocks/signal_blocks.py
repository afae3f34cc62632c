"""Blocks of a stored signal, computed from the rollups, or from the samples where rollups do not fit."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from analytics.loop.blocks.inside import Inside, inside_of
from analytics.loop.blocks.piece_slopes import slopes_of
from analytics.loop.blocks.pieces import Grid, Pieces, SignalKey, pieces_of
from analytics.loop.blocks.run_blocks import SECOND_NS
from storage.sql.catalog import Catalog
from stream.batch import BoolArray, FloatArray, IntArray

LEAST_PAIRS = 8
FAR = 100.0  # an outlier leaves the readings of the seconds beside it by more than this many times their usual range
CALM = 0.1  # an outlier is not motion if the three readings on either side differ by less than this part of it
FEW, ALONE = 3.0, 0.6  # outliers of a second, at most, and the part by which one leaves the mean: motion has more
_BESIDE = 3  # pieces on either side whose range tells motion
MEDIAN_OF_SQUARE = 0.4549364231195728  # of a standard normal


@dataclass(frozen=True)
class SignalBlocks:
    """A signal of one run in blocks, in its own unit; each shape (blocks,).

    Times are seconds from the start of slot 0.
    """

    slot: IntArray  # increasing numbers of the blocks
    n: IntArray  # samples in each
    mean: FloatArray
    spread: FloatArray  # standard deviation of the samples in each
    centre_s: FloatArray  # mean time of the samples
    first_s: FloatArray
    last_s: FloatArray
    interval_s: FloatArray  # of the block for each sample
    white_variance: FloatArray  # of each mean, from the scatter within the block; NaN where unknown
    is_far: BoolArray  # whether the block contains an outlier, so that its mean is wrong
    far_reading: FloatArray  # that outlier, else NaN
    lowest: FloatArray  # reading
    slope_per_s: FloatArray  # mean rate of change
    further: FloatArray  # shape (blocks, orders): mean second, third, ... derivatives, per s^2, s^3, ...
    is_smooth: BoolArray  # whether it moves without a step at the edges of the block
    is_open: BoolArray  # whether the mean cannot be moved to another time, see `Slopes`
    steady_variance: float = np.nan  # of a sample, the white part less ramps and single edges; NaN if unknown
    farthest: float = 0.0  # outlier of the run; 0 where there is none
    inside: Inside | None = None  # pieces of the blocks in which the signal moves


def block_means(
    catalog: Catalog, grids: Mapping[SignalKey, Grid], block_s: float, *, rolled_up: bool = True
) -> dict[SignalKey, SignalBlocks]:
    """Block means of signals of runs, each on its grid; those without any are not in the result.

    From the rollups where blocks are whole seconds, unless `rolled_up` is false: their times have an uncertainty of
    half a second, which is negligible only for a signal of several samples a second.

    A block consists of pieces: the rollup's seconds, or thirty-two parts of a block that is not in whole seconds.
    With pieces i of n_i samples and mean m_i, the variance of a sample is the mean over neighbours within the block of
    (m_i - m_j)**2/(1/n_i + 1/n_j), that of the block's mean is this divided by the samples in it. Noise that is white
    between pieces counts in full, slow change hardly at all. A block of fewer than 8 such pairs takes the median over
    its run (divided by 0.455, the median of the square of a normal deviate).

    A block is marked where a single reading of a piece leaves the pieces before and after it by more than a hundred
    times their usual range: a fill value, a transmission error, a shock. Longer events and motion have more readings in
    between; with one reading a piece, the pieces beside it move, too.
    """
    if not grids:
        return {}
    block_ns = round(block_s * SECOND_NS)
    found = pieces_of(catalog, grids, block_ns, rolled_up=rolled_up)
    with np.errstate(over="ignore", invalid="ignore"):  # the square of a fill value
        return {key: _blocks(pieces, grids[key].t0_ns, block_ns) for key, pieces in found}


def _blocks(pieces: Pieces, t0_ns: int, block_ns: int) -> SignalBlocks:
    since_ns = pieces.start_ns - t0_ns
    slot = np.sign(since_ns) * (np.abs(since_ns) // block_ns)  # towards slot 0 before it
    first = np.flatnonzero(np.diff(slot, prepend=slot[0] - 1))
    weight = np.add.reduceat(pieces.n, first)
    count = np.diff(first, append=slot.size)
    number = np.repeat(np.arange(first.size), count)

    def total(value: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(number, value), np.float64)  # one after the other: what is equal stays equal

    means = total(pieces.mean) / count
    between = total((pieces.mean - means[number]) ** 2) / count
    far, extreme, beyond = _far(pieces)
    far_reading = np.full(first.size, np.nan)
    for at in np.flatnonzero(far)[np.argsort(beyond[far], kind="stable")]:  # the farthest of a block comes last
        far_reading[number[at]] = extreme[at]
    is_far = np.isfinite(far_reading)
    mean, spread = total(pieces.n * pieces.mean) / weight, np.sqrt(total(pieces.m2) / weight + between)
    slopes = slopes_of(pieces.start_ns, np.where(far, np.nan, pieces.mean), np.sqrt(pieces.m2 / pieces.n), number)
    return SignalBlocks(
        slot=slot[first],
        n=weight,
        mean=mean,
        spread=spread,
        centre_s=total(pieces.n * ((pieces.t_ns - t0_ns) / 1e9)) / weight,
        first_s=np.minimum.reduceat(since_ns, first) / 1e9,
        last_s=np.maximum.reduceat(pieces.end_ns - t0_ns, first) / 1e9,
        interval_s=block_ns / 1e9 / weight,
        white_variance=_sample_variance(pieces, number) / weight,
        is_far=is_far,
        far_reading=far_reading,
        lowest=np.minimum.reduceat(pieces.lo, first),
        steady_variance=_steady_variance(pieces, number),
        farthest=float(extreme[np.where(far, beyond, -np.inf).argmax()]) if is_far.any() else 0.0,
        slope_per_s=slopes.of_blocks,
        further=slopes.further_of_blocks,
        is_smooth=slopes.is_smooth,
        is_open=slopes.is_open,
        inside=inside_of(number, pieces.n, pieces.mean, pieces.m2, (mean, spread, is_far), slopes),
    )


def _sample_variance(pieces: Pieces, number: IntArray) -> FloatArray:
    """The white part of the variance of a sample in each block; NaN where it is unknown.

    It is from successive differences of the pieces: a drift within the block does not count.
    """
    within = np.diff(number) == 0
    steps = np.diff(pieces.mean)[within]
    variance = steps * steps / (1.0 / pieces.n[1:] + 1.0 / pieces.n[:-1])[within]
    block, blocks = number[1:][within], int(number[-1]) + 1
    pairs = np.bincount(block, minlength=blocks)
    own = np.bincount(block, variance, minlength=blocks) / np.maximum(pairs, 1)
    middle, average = (float(np.median(variance)), float(variance.mean())) if variance.size else (0.0, 0.0)
    typical = middle / MEDIAN_OF_SQUARE if middle > 0 else average
    return np.where(pairs >= LEAST_PAIRS, own, typical if typical > 0 else np.nan)


def _steady_variance(pieces: Pieces, number: IntArray) -> float:
    """The white part of the variance of a sample by the median of second differences; NaN where they are 0."""
    within = number[2:] == number[:-2]
    bends = np.diff(pieces.mean, 2)[within]
    if bends.size < LEAST_PAIRS:
        return np.nan
    weights = (1.0 / pieces.n[2:] + 4.0 / pieces.n[1:-1] + 1.0 / pieces.n[:-2])[within]
    return float(np.median(bends * bends / weights)) / MEDIAN_OF_SQUARE or np.nan


def _far(pieces: Pieces) -> tuple[BoolArray, FloatArray, FloatArray]:
    """Marks the pieces with an outlier; the extreme reading of each piece, and how far it is beyond those beside it."""
    n, mean, lo, hi = pieces.n, pieces.mean, pieces.lo, pieces.hi
    moves = np.abs(np.diff(mean))
    if not moves.size:
        return np.zeros(1, np.bool_), hi, np.zeros(1)
    above = hi - _extreme_beside(hi, 1)
    below = -_extreme_beside(-lo, 1) - lo
    beyond, extreme = np.maximum(above, below), np.where(above >= below, hi, lo)
    width = float(np.median(hi - lo)) + float(np.median(moves))
    usual = width if width > 0 else float(np.median(moves[moves > 0])) if (moves > 0).any() else np.inf
    unrest = _extreme_beside(hi, _BESIDE) + _extreme_beside(-lo, _BESIDE)
    off = np.abs(extreme - mean)
    is_single = np.where(n < 4, unrest <= CALM * beyond, off >= ALONE * beyond)
    has_few = (n < 16) | (pieces.m2 <= FEW * off**2)
    return np.asarray((beyond > FAR * usual) & is_single & has_few), extreme, beyond


def _extreme_beside(value: FloatArray, pieces: int) -> FloatArray:
    """Largest value of some pieces before and after each."""
    padded = np.concatenate([np.full(pieces, -np.inf), value, np.full(pieces, -np.inf)])
    beside = [padded[at : at + value.size] for at in range(2 * pieces + 1) if at != pieces]
    return np.asarray(np.max(beside, axis=0))
