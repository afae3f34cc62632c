"""Blocks across edges of the reference rate that its readings do not resolve."""

import numpy as np

from analytics.loop.blocks.derived import is_steady
from analytics.loop.blocks.run_blocks import RunBlocks
from stream.batch import BoolArray, FloatArray
from stream.quantities import conversion, is_angular_rate

_BEYOND_NOISE = 3.0
_BEYOND_USUAL = 10.0
_AS_OFTEN = 1.05
"""Largest ratio of the interval of the reference to that of the samples at which both may cover the same times."""
_MOVING_DEG_PER_S, _ALONG = 0.1, 0.1
"""Change of a reference that is an edge in any run, if the signal follows it by more than this part."""
_AT_REST_DEG_PER_S = 1e-3
_FEWEST_STEADY = 10
_FOLLOWED = 0.02
"""Part of an edge by which the signal may differ where both are means over the same times."""


def unresolved(
    run: RunBlocks, changes: FloatArray, interval_s: float, commanded: FloatArray, gone: BoolArray
) -> BoolArray:
    """Mark the blocks in which the reference rate changes faster than its readings resolve.

    Parameters
    ----------
    changes: shape (blocks,); range of the reference from the last reading before each block to the first after it.
    interval_s: Between readings, seconds.
    commanded: shape (blocks,); commanded rate throughout the block, deg/s, else NaN; a block that has it is kept.
    gone: shape (blocks,); blocks to ignore.

    Notes
    -----
    An edge somewhere between two readings gives the mean of a block of T an uncertainty of edge*interval/(sqrt(12)*T).
    A block is left out if that exceeds 3 standard deviations of the white noise of its mean, by the run's median, and
    10 times what is usual in the run (a tenth of its blocks are better). Where samples come as seldom as the readings,
    both may be means over the same times and show every edge as it is: then the samples decide, see `is_followed`.
    """
    channel = run.channels.get("input_rate")
    none = np.zeros(len(run), dtype=np.bool_)
    if channel is None or not is_angular_rate(run.unit_of_measure) or not is_angular_rate(channel.unit_of_measure):
        return none
    factor = conversion(channel.unit_of_measure, run.unit_of_measure)[0]
    edges = np.nan_to_num(changes) * factor
    unsure = edges * interval_s / (np.sqrt(12.0) * run.block_s)
    of_samples = run.white_variance * run.n
    of_samples = of_samples[np.isfinite(of_samples)]
    noise = np.sqrt((np.median(of_samples) if len(of_samples) else 0.0) / run.n)
    usual = float(np.quantile(unsure, 0.1))
    is_still = is_steady(run.channels.get("table_rate", channel), commanded)
    is_seen = (unsure <= np.maximum(_BEYOND_NOISE * noise, _BEYOND_USUAL * usual)) | is_still
    across = np.asarray(~is_seen & ~gone)
    if interval_s > _AS_OFTEN * run.block_s / float(np.median(run.n)):
        return across
    reference, least = channel.mean * factor, conversion("deg/s", run.unit_of_measure)[0] * _MOVING_DEG_PER_S
    # in a run that moves throughout, no block differs from what is usual
    moving = across | ((edges > least) & (unsure > _BEYOND_NOISE * noise) & ~is_still & ~gone)
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

    Examples
    --------
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
    return float(off @ y) / squares if squares > 0 and np.ptp(x) > _AT_REST_DEG_PER_S else None
