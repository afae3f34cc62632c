"""Rates of change in the pieces of a signal and in its blocks, by which means are moved from one time to another."""

from functools import cache
from typing import NamedTuple

import numpy as np

from stream.batch import BoolArray, FloatArray, IntArray

MOVES = 5.0  # times the spread of quiet readings, from which a channel moves among them
WIDE = 0.02  # of the range of a signal, from which it moves where its pieces follow one another otherwise than noise
_NO_NOISE = 10.0  # over the root of the pieces: five standard deviations of the ratio of von Neumann
_STENCILS, _STENCIL_AT_END = (8, 10), 8  # equal pieces whose means a polynomial has
_KINK = (
    0.33  # of the second differences of those pieces in one, from which they step or bend: swings have a fifth in one
)
_SHARP = 10.0  # times the usual fourth difference, from which rough pieces are an edge and not noise
_TURNING = 0.01  # of the squares of second differences, below which those of fourth ones are no noise: a swing turns
_CLEAR = 4.0  # of the usual fourth difference, 5.6 times the noise of a piece, by which it changes in a block
_FAST = 0.5  # mean square of second differences over the variance: of swings of 7.5 pieces, 2 % at their end unknown
_EVEN = 0.1  # of the time from piece to piece by which it may differ
ORDERS = 5  # of derivatives: of readings 1 s apart on a swing of 0.1 Hz, 0.2 ms are left of 0.5 s


class Slopes(NamedTuple):
    """Mean rates of change in the pieces of a signal and in its blocks, per second, and mean further derivatives."""

    of_pieces: FloatArray
    of_blocks: FloatArray
    further_of_pieces: FloatArray  # shape (pieces, ORDERS - 1): second, third, ... per s^2, ...; 0 where it may step
    further_of_blocks: FloatArray
    is_smooth: BoolArray  # blocks whose slope its pieces give better than means of blocks
    piece_s: float  # length of a piece
    is_open: BoolArray  # blocks at a gap or an end, near which edges are not known since it swings within a few pieces


def slopes_of(start_ns: IntArray, mean: FloatArray, spread: FloatArray, number: IntArray) -> Slopes:
    """Slopes of pieces that begin at `start_ns`, with their means (NaN where unknown), spreads and numbers of blocks.

    The value at an edge between pieces is that of a polynomial with the means of up to ten about it. Where they step,
    or are fewer than eight, it is that of the piece with the smaller spread, in which it does not step; or that of each
    piece by itself, with half of the smaller of the changes to its neighbours (minmod): none beside a step.

    >>> sine = -np.diff(np.cos(0.2 * np.pi * np.arange(101.0))) / (0.2 * np.pi)  # of 0.1 Hz, means of seconds
    >>> found = slopes_of(np.arange(100) * 10**9, sine, np.ones(100), np.arange(100) // 3)
    >>> times_s = np.arange(3.0, 31.0, 3.0)
    >>> exact = np.diff(np.sin(0.2 * np.pi * times_s)) / 3.0
    >>> bool(found.is_smooth[1:10].all()), bool(np.abs(found.of_blocks[2:10] - exact[1:]).max() < 1e-5)
    (True, True)
    """
    size, starts = mean.size, np.diff(start_ns)
    first = np.flatnonzero(np.diff(number, prepend=number[:1] - 1))
    if size < 2:
        none = np.zeros(first.size, np.bool_)
        of_pieces, of_blocks = (np.zeros((each, ORDERS)) for each in (size, first.size))
        return Slopes(of_pieces[:, 0], of_blocks[:, 0], of_pieces[:, 1:], of_blocks[:, 1:], none, 0.0, none)
    piece_ns = float(np.median(starts))
    joined = (np.abs(starts - piece_ns) <= _EVEN * piece_ns) & np.isfinite(mean[1:] + mean[:-1])
    before, after = np.append(False, joined), np.append(joined, False)  # whether a piece has one before, and after it
    begin, end = _beside_steps(mean, spread, before, after)
    # derivatives per piece at begin and end, where it is smooth
    turned_in, turned_out = (np.full((size, ORDERS - 1), np.nan) for _ in range(2))
    is_open = np.zeros(size, np.bool_)
    known = mean[np.isfinite(mean)]
    moves = known.size > 0 and not is_noise(np.zeros(known.size, np.int64), known, np.array([known.size]))
    bend, sharp = np.abs(np.diff(mean, 2)), np.abs(np.diff(mean, 4))
    usual = float(np.nanmedian(sharp)) if np.isfinite(sharp).any() else 0.0
    for pieces in _STENCILS if moves else ():
        if size < pieces:
            break
        about = np.lib.stride_tricks.sliding_window_view(mean, pieces)
        bends, squares = (np.lib.stride_tricks.sliding_window_view(each, pieces - 2) for each in (bend, bend**2))
        smooth = np.lib.stride_tricks.sliding_window_view(joined, pieces - 1).all(axis=1)
        fourth = np.lib.stride_tricks.sliding_window_view(sharp, pieces - 4)
        roughness, bending = (fourth**2).sum(axis=1), squares.sum(axis=1)
        is_rough = roughness > bending  # of swings of six pieces and faster, and short ramps
        range_ = np.ptp(about, axis=1)
        smooth &= (range_ > WIDE * np.ptp(known)) | (roughness < _TURNING * bending)
        # where a swing has no curvature only its noise bends
        smooth &= bends.max(axis=1) <= np.maximum(_KINK * bends.sum(axis=1), WIDE * range_)
        smooth &= ~(is_rough & (fourth.max(axis=1) > np.maximum(_SHARP * usual, WIDE * range_)))
        swings = squares.mean(axis=1) > _FAST * np.var(about, axis=1)
        weights = _at_edges(pieces)
        for at in range(pieces + 1):
            of = np.flatnonzero(smooth)
            if at != pieces // 2:  # beside a gap or an end, where no other pieces are
                if pieces != _STENCIL_AT_END:
                    continue
                of = of[~before[of]] if at < pieces // 2 else of[~after[of + pieces - 1]]
            derivatives = about[of] @ weights[:, at].T
            value, slope = derivatives[:, 0], derivatives[:, 1:]
            if at < pieces:
                is_open[of + at] |= (at < pieces // 2) & swings[of]
                begin[of + at], turned_in[of + at] = value, slope
            if at > 0:
                is_open[of + at - 1] |= (at > pieces // 2) & swings[of]
                end[of + at - 1], turned_out[of + at - 1] = value, slope
    last = np.append(first[1:], size) - 1
    piece_s = piece_ns / 1e9
    seconds = np.add.reduceat(np.full(size, piece_s), first)
    # what changes across a gap is of no piece
    across = np.append(0.0, np.where(joined, begin[1:] - end[:-1], 0.0))
    across[first] = 0.0
    changes = np.add.reduceat(np.nan_to_num(end - begin) + across, first)
    per_s = piece_s ** -np.arange(1.0, ORDERS)
    turned = (turned_out[last] - turned_in[first]) * per_s / seconds[:, None]
    is_smooth = np.isfinite(turned).all(axis=1)
    # so do pieces beside rests and bends, where it changes by far more than noise; else means of blocks have less noise
    inside = np.fmax.reduceat(mean, first) - np.fmin.reduceat(mean, first)
    is_clear = inside > _CLEAR * usual
    is_smooth |= is_clear & moves & np.logical_and.reduceat(np.isfinite(mean), first)
    return Slopes(
        np.nan_to_num((end - begin) / piece_s),
        changes / seconds,
        np.nan_to_num((turned_out - turned_in) * per_s / piece_s),
        np.nan_to_num(turned),
        is_smooth,
        piece_s,
        is_open[first] | is_open[last],
    )


def _beside_steps(
    mean: FloatArray, spread: FloatArray, before: BoolArray, after: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Values at the begin and end of pieces that may step."""
    change = np.where(after[:-1], np.diff(mean), np.nan)
    into, out = np.append(np.nan, change), np.append(change, np.nan)
    into, out = np.where(before, into, out), np.where(after, out, into)
    half = np.nan_to_num(np.where(into * out > 0, 0.5 * np.sign(into) * np.minimum(abs(into), abs(out)), 0.0))
    begin, end = mean - half, mean + half
    steps_after = np.flatnonzero(after[:-1] & (spread[1:] > MOVES * spread[:-1]))
    begin[steps_after + 1] = end[steps_after] = mean[steps_after]
    steps_before = np.flatnonzero(before[1:] & (spread[:-1] > MOVES * spread[1:])) + 1
    begin[steps_before] = end[steps_before - 1] = mean[steps_before]
    return begin, end


@cache
def _at_edges(pieces: int) -> FloatArray:
    """Weights of the means of equal pieces in derivatives at each edge, of the polynomial that has these means.

    Shape (ORDERS, pieces + 1, pieces), the value first.

    >>> (_at_edges(2)[:2] * 2).round(9).tolist()
    [[[3.0, -1.0], [1.0, 1.0], [-1.0, 3.0]], [[-2.0, 2.0], [-2.0, 2.0], [-2.0, 2.0]]]
    """
    edges = np.arange(pieces + 1.0) - pieces / 2.0
    power = np.arange(1, pieces + 1)
    means = np.diff(edges[:, None] ** power, axis=0) / power  # of x**(power - 1) over each piece
    of_means = np.linalg.inv(means)
    weights, factor = [], np.ones(pieces)
    for order in range(ORDERS):
        weights.append((factor * edges[:, None] ** np.maximum(power - 1 - order, 0)) @ of_means)
        factor = factor * (power - 1 - order)
    return np.array(weights)


def is_noise(number: IntArray, mean: FloatArray, pieces: IntArray) -> bool:
    """Whether pieces within blocks follow one another like white noise (von Neumann, DOI 10.1214/aoms/1177731677)."""
    steps = np.diff(mean)[np.diff(number) == 0]
    degrees = mean.size - int(np.count_nonzero(pieces))
    if not steps.size or degrees < 1:
        return True
    of_block = np.bincount(number, mean, minlength=pieces.size) / np.maximum(pieces, 1)
    variance = float(np.sum((mean - of_block[number]) ** 2)) / degrees
    ratio = float(np.mean(steps**2)) / variance if variance > 0.0 else 2.0
    return bool(abs(ratio - 2.0) <= _NO_NOISE / steps.size**0.5)
