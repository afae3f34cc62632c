"""Rate of change within the blocks of a channel that may step, such as a rate."""

import math

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from stream.batch import FloatArray, IntArray
from stream.compiled import kernel, kernel_part


def mean_slope_per_s(run: RunBlocks, channel: str, *, across_gaps: bool = True) -> FloatArray:
    """Mean time derivative within each block of a channel that may step, such as a rate; per second.

    Where the channel moves without steps it is that of its pieces, see `slopes_of`. Of a block without a reading in the
    blocks beside it, it is that between the readings before and after it, or NaN if not `across_gaps`; 0 where blocks
    between these were left out, as between the ramps of a table: what it does in them says nothing of this one.

    A step within the third block, of which only the mean is known:

    >>> from analytics.loop.blocks.run_blocks import Channel
    >>> one = np.ones(5)
    >>> step = Channel(np.array([0.0, 0.0, 4.0, 10.0, 10.0]), 0 * one, "deg/s")
    >>> run = RunBlocks("U", "r", "rate", np.arange(5), 10.0, 0, one, np.ones(5, int), one, "deg/h",
    ...                 {"table_rate": step})
    >>> mean_slope_per_s(run, "table_rate").round(6).tolist()
    [0.0, 0.0, 1.0, 0.0, 0.0]
    """
    its = run.channels[channel]
    slope = _edge_slope(run.slot, its.mean, its.spread, across_gaps) / run.block_s
    return slope if its.slope_per_s is None else np.where(np.isfinite(its.slope_per_s), its.slope_per_s, slope)


@kernel_part()
def _read_beside(value: FloatArray, i: int) -> tuple[int, int]:
    """The last block before i and the first after it that have a reading; i itself where there is none."""
    before = i - 1
    while before >= 0 and math.isnan(value[before]):
        before -= 1
    after = i + 1
    while after < value.size and math.isnan(value[after]):
        after += 1
    return before if before >= 0 else i, after if after < value.size else i


@kernel_part()
def slope_to_neighbours(slot: IntArray, value: FloatArray, i: int) -> float:
    """Slope per slot from the last reading before block i to the first after it."""
    first, last = _read_beside(value, i)
    return float((value[last] - value[first]) / (slot[last] - slot[first])) if last > first else np.nan


@kernel_part()
def _smaller_change(slot: IntArray, value: FloatArray) -> FloatArray:
    """The smaller of the changes from each block to those before and after it; 0 without such a block."""
    change = np.empty(value.size)  # loops, which compile in a quarter of the time of whole arrays
    for i in range(value.size):
        change[i] = np.inf
    for i in range(1, value.size):
        if slot[i] - slot[i - 1] == 1 and not (math.isnan(value[i]) or math.isnan(value[i - 1])):
            step = abs(value[i] - value[i - 1])
            change[i - 1] = min(change[i - 1], step)
            change[i] = step
    for i in range(value.size):
        if math.isinf(change[i]):
            change[i] = 0.0
    return change


@kernel
def _edge_slope(slot: IntArray, value: FloatArray, spread: FloatArray, across_gaps: bool) -> FloatArray:
    """Change of a channel from start to end of each block, per slot.

    The value at the edge between two blocks is their mean weighted by 1/spread**2: where the channel steps within one
    of them, the other, in which it is constant, determines the value at the edge. Blocks of one reading each, such as
    a mean, have no spread: the smaller of the changes to both neighbours replaces it (the minmod limiter).
    """
    slope = np.empty(value.size)
    smaller = _smaller_change(slot, value)
    for i in range(value.size):
        slope[i] = np.nan
        if math.isnan(value[i]):
            continue
        change, reach = 0.0, 0.0
        for side in (-1, 1):
            j = i + side
            if 0 <= j < value.size and slot[j] - slot[i] == side and not math.isnan(value[j]):
                width = spread if spread[i] > 0 or spread[j] > 0 else smaller
                mine, its = width[i] ** 2 + 1e-18, width[j] ** 2 + 1e-18
                edge = (value[i] * its + value[j] * mine) / (mine + its)
                change += side * (edge - value[i])
                reach += 0.5
        if reach > 0:
            slope[i] = change / reach
        elif across_gaps:
            first, last = _read_beside(value, i)
            is_cut_off = slot[last] - slot[first] > last - first  # by blocks that were left out
            slope[i] = 0.0 if is_cut_off else slope_to_neighbours(slot, value, i)
    return slope
