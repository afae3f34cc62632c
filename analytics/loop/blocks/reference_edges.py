"""Blocks across edges of a reference rate, which its readings do not resolve."""

from typing import NamedTuple

import numpy as np

from analytics.loop.blocks.derived import AT_REST_DEG_PER_S, is_steady
from analytics.loop.blocks.run_blocks import RunBlocks
from stream.batch import BoolArray, FloatArray, IntArray
from stream.quantities import conversion, is_angular_rate

_BEYOND_NOISE = 3.0
_BEYOND_USUAL = 10.0
_AS_OFTEN = 1.05  # reference read this much less often than samples come may still cover the same times
_MOVING_DEG_PER_S, _ALONG = 0.1, 0.1
"""Change of a reference that is an edge in any run, if the signal follows it by more than this part."""
_FEWEST_STEADY = 10
_SEVERAL_S = 0.5  # between readings, up to which a second has several
_RESOLVED = 4.0  # readings a block, from which they show a ramp
_ONE_A_BLOCK = 1 + 1e-6  # part of a block between readings beyond which blocks have none of their own
_FOLLOWED = 0.02  # part of an edge by which the signal may differ where both are means over the same times
_HELD = 0.01  # of the range of a channel, within which it stays where it is


def ranges(slot: IntArray, block_s: float, t_s: FloatArray, lo: FloatArray, hi: FloatArray) -> FloatArray:
    """Range of a channel from the last reading before each block to the first after it.

    Readings come as seconds that begin at `t_s`, with the least and the greatest value of each.

    >>> t_s, value = np.array([0.0, 5.0, 10.0, 15.0, 20.0]), np.array([0.0, 0.0, 0.0, 7.0, 7.0])
    >>> ranges(np.array([0, 1, 2]), 5.0, t_s, value, value).tolist()
    [0.0, 0.0, 7.0]
    """
    if len(t_s) == 0:
        return np.full(len(slot), np.nan)
    first = np.maximum(np.searchsorted(t_s + 1.0, slot * block_s, side="right") - 1, 0)
    beyond = np.searchsorted(t_s, (slot + 1) * block_s, side="left") + 1
    edges = np.column_stack([first, np.minimum(np.maximum(beyond, first + 1), len(t_s))]).ravel()
    # one more at the end, since reduceat requires every index below the length
    least = np.minimum.reduceat(np.append(lo, np.inf), edges)[::2]
    most = np.maximum.reduceat(np.append(hi, -np.inf), edges)[::2]
    return np.asarray(most - least, dtype=np.float64)


def held(t_s: FloatArray, lo: FloatArray, hi: FloatArray) -> float:
    """Median time for which a channel stays where it is, by seconds as in `ranges`; 0 where it never does.

    >>> value = np.repeat([0.0, 7.0, -7.0], 20)
    >>> held(np.arange(60.0), value, value)
    19.0
    """
    if len(t_s) < 2:
        return 0.0
    moves = np.maximum(hi[1:], hi[:-1]) - np.minimum(lo[1:], lo[:-1]) > _HELD * (hi.max() - lo.min())
    edges = np.flatnonzero(np.concatenate([[True], moves, [True]]))
    lengths = np.diff(edges) - 1
    lengths = lengths[lengths > 1]
    return float(np.median(lengths) * np.median(np.diff(t_s))) if lengths.size else 0.0


def bends(
    slot: IntArray, block_s: float, t_s: FloatArray, lo: FloatArray, hi: FloatArray, interval_s: float,
    *, is_moved: bool,
) -> FloatArray:  # fmt: skip
    """Largest edge that a channel may have between two of its readings in each block, by what leaves a straight line.

    It is 0 on a ramp; where a ramp begins or ends it is what it would have changed by from one reading to the next, or
    over a second where means of seconds `is_moved` to other times. `interval_s` is that of the readings, the other
    arguments as of `ranges`.

    >>> t_s = np.arange(12.0)
    >>> value = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 3.0, 2.0, 1.0, 0.0, 0.0, 7.0, 7.0])
    >>> bends(np.array([0, 1, 2]), 4.0, t_s, value, value, 1.0, is_moved=True).tolist()
    [0.0, 2.0, 7.0]

    Of readings 0.1 s apart, a step within a second and a ramp:

    >>> lo, hi = np.array([0.0, 0.0, 0.0, 7.0, 7.0, 7.0]), np.array([0.0, 0.0, 7.0, 7.0, 7.0, 7.0])
    >>> bends(np.array([0]), 6.0, np.arange(6.0), lo, hi, 0.1, is_moved=False).round(9).tolist()
    [7.0]
    >>> lo = np.arange(6.0)
    >>> bends(np.array([0]), 6.0, np.arange(6.0), lo, lo + 0.9, 0.1, is_moved=True).round(9).tolist()
    [0.0]
    """
    if len(t_s) < 3:
        return ranges(slot, block_s, t_s, lo, hi)
    apart, change = np.diff(t_s), np.diff(0.5 * (lo + hi))
    bend = np.abs(np.diff(change / apart))
    if interval_s > _SEVERAL_S:
        bend *= np.maximum(apart[1:], apart[:-1])
    else:
        change = np.abs(change)
        within = (hi - lo)[1:-1] - np.maximum(change[1:], change[:-1])  # half of a step within a second
        jump = np.maximum(lo[1:] - hi[:-1], lo[:-1] - hi[1:]) - interval_s / apart * change  # one between two seconds
        bend = np.max([bend if is_moved else bend * interval_s, 2.0 * within, jump[1:], jump[:-1]], axis=0)
    first, end = (np.searchsorted(t_s, (slot + at) * block_s) for at in (0, 1))
    is_between = end <= first  # no reading is in the block: those before and after it count
    first = np.minimum(np.where(is_between, np.maximum(first - 1, 0), first), len(t_s) - 1)
    end = np.clip(end + is_between, first + 1, len(t_s))
    edges = np.column_stack([first, end]).ravel()
    return np.asarray(np.maximum.reduceat(np.concatenate([[0.0], bend, [0.0, 0.0]]), edges)[::2])


class Motion(NamedTuple):
    """What a reference rate does in and beside each block, in its standard unit, see `ranges` and `bends`."""

    changes: FloatArray
    bends: FloatArray
    interval_s: float  # between its readings


def unresolved(
    run: RunBlocks, motion: Motion, sample_variance: float, commanded: FloatArray, gone: BoolArray
) -> BoolArray:
    """Mark the blocks in which the reference rate changes faster than its readings resolve.

    A block with a rate `commanded` throughout, deg/s, is kept; those that are `gone` are ignored. `sample_variance` is
    that of the samples' noise where it is known without motion, else NaN.

    An edge somewhere between two readings gives the mean of a block of T an uncertainty of edge*interval/(sqrt(12)*T);
    a ramp does not. A block is left out if that exceeds 3 standard deviations of the white noise of its mean, by the
    run's median, and 10 times what is usual in the run (a tenth of its blocks are better). Where blocks have no reading
    of their own a straight line stands for the motion between two, and what is usual is no excuse. Where samples come
    as seldom as the readings, both may be means over the same times and show every edge as it is: then the samples
    decide, see `is_followed`; of few a block, ramps count as edges.
    """
    channel = run.channels.get("input_rate")
    none = np.zeros(len(run), dtype=np.bool_)
    if channel is None or not is_angular_rate(run.unit_of_measure) or not is_angular_rate(channel.unit_of_measure):
        return none
    factor = conversion(channel.unit_of_measure, run.unit_of_measure)[0]
    is_alike = motion.interval_s <= _AS_OFTEN * run.block_s / float(np.median(run.n))
    has_few = run.block_s < _RESOLVED * motion.interval_s
    edges = np.nan_to_num(motion.changes if is_alike and has_few else motion.bends) * factor
    unsure = edges * motion.interval_s / (np.sqrt(12.0) * run.block_s)
    of_samples = run.white_variance * run.n
    of_samples = of_samples[np.isfinite(of_samples)]
    variance = float(np.fmin(np.median(of_samples), sample_variance)) if len(of_samples) else 0.0
    noise = np.sqrt(variance / run.n)
    usual = float(np.quantile(unsure, 0.1))
    is_still = is_steady(run.channels.get("table_rate", channel), commanded)
    is_seen = (unsure <= np.maximum(_BEYOND_NOISE * noise, _BEYOND_USUAL * usual)) | is_still
    across = np.asarray(~is_seen & ~gone)
    reference, least = channel.mean * factor, conversion("deg/s", run.unit_of_measure)[0] * _MOVING_DEG_PER_S
    # in a run that moves throughout, no block differs from what is usual
    moving = across | ((edges > least) & (unsure > _BEYOND_NOISE * noise) & ~is_still & ~gone)
    if not is_alike:
        return moving if motion.interval_s > _ONE_A_BLOCK * run.block_s else across
    if is_followed(run.value, reference, edges, moving):
        return none
    known = np.isfinite(run.value) & np.isfinite(reference) & ~gone
    along = _slope_of_line(reference[known], run.value[known]) if known.any() else None
    return moving if along is not None and abs(along) > _ALONG else across


def is_followed(value: FloatArray, reference: FloatArray, edges: FloatArray, rows: BoolArray) -> bool:
    """Whether a signal follows its reference in blocks across edges as in others: both are means over one time.

    Readings at one moment of a block are wrong by a third of an edge in half of the edges. The difference of the signal
    from a line in the reference shows it; the line comes from the blocks without edges, if the rate varies there, and
    the scatter of those blocks is allowed for. Value, reference and edges are in one unit; `rows` are across edges.

    >>> reference = np.array([0.0, 0.0, 4.0, 10.0, 10.0, 3.0, -10.0, -10.0])
    >>> edges = np.abs(np.gradient(reference)) * 2
    >>> means, readings = 1.001 * reference, np.array([0.0, 0.0, 10.0, 10.0, 10.0, 10.0, -10.0, -10.0])
    >>> [is_followed(value, reference, edges, np.arange(8) % 3 == 2) for value in (means, readings)]
    [True, False]
    """
    known = np.isfinite(value) & np.isfinite(reference)
    rows = rows & known & (edges > 0)
    if not rows.any():
        return True
    steady = known & ~rows
    scale = _slope_of_line(reference[steady], value[steady]) if np.count_nonzero(steady) > 1 else None
    if scale is None:
        scale = _slope_of_line(reference[known], value[known])
    if scale is None:
        return False
    missed = value - scale * reference
    missed = np.abs(missed - np.median(missed[steady] if steady.any() else missed[known]))
    noise = float(np.median(missed[steady])) if np.count_nonzero(steady) >= _FEWEST_STEADY else 0.0
    allowed = _FOLLOWED * max(1.0, abs(scale)) * edges + _BEYOND_NOISE * noise
    return bool(np.median(missed[rows] / allowed[rows]) <= 1.0)


def _slope_of_line(x: FloatArray, y: FloatArray) -> float | None:
    """Slope of a line, None if x does not vary; near 0 for an axis perpendicular to the reference's own."""
    off = x - x.mean()
    squares = float(off @ off)
    return float(off @ y) / squares if squares > 0 and np.ptp(x) > AT_REST_DEG_PER_S else None
