"""Filters over blocks at uneven times: gaps and blocks without a reading count by their true duration."""

import math

import numba
import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from stream.batch import FloatArray, IntArray

_SLOPE_HALF_WIDTH_S = 60.0


@numba.njit(cache=True)
def _lagged(time_s: FloatArray, value: FloatArray, time_constant_s: float) -> FloatArray:
    lagged = np.full(value.size, np.nan)
    before = -1
    for i in range(value.size):
        if math.isnan(value[i]):
            continue
        if before < 0:
            lagged[i] = value[i]
        else:
            step_s = time_s[i] - time_s[before]
            slope = (value[i] - value[before]) / step_s
            # exact for an input that is linear between two readings
            start = lagged[before] - value[before] + slope * time_constant_s
            lagged[i] = value[i] - slope * time_constant_s + start * math.exp(-step_s / time_constant_s)
        before = i
    return lagged


@numba.njit(cache=True)
def _play(value: FloatArray, width: float) -> FloatArray:
    played = np.full(value.size, np.nan)
    state = np.nan
    for i in range(value.size):
        if math.isnan(value[i]):
            continue
        if math.isnan(state):
            state = value[i]
        elif value[i] - state > width / 2:
            state = value[i] - width / 2
        elif state - value[i] > width / 2:
            state = value[i] + width / 2
        played[i] = state
    return played


@numba.njit(cache=True)
def _slope_to_neighbours(slot: IntArray, value: FloatArray, i: int) -> float:
    """Slope per slot from the last reading before block i to the first after it."""
    before = i - 1
    while before >= 0 and math.isnan(value[before]):
        before -= 1
    after = i + 1
    while after < value.size and math.isnan(value[after]):
        after += 1
    first = before if before >= 0 else i
    last = after if after < value.size else i
    return float((value[last] - value[first]) / (slot[last] - slot[first])) if last > first else np.nan


@numba.njit(cache=True)
def _local_slope(slot: IntArray, value: FloatArray, half_width: int) -> FloatArray:
    """Slope per slot of a straight line through the readings at most `half_width` slots away."""
    slope = np.full(value.size, np.nan)
    for i in range(value.size):
        if math.isnan(value[i]):
            continue
        first = i
        while first > 0 and slot[i] - slot[first - 1] <= half_width:
            first -= 1
        last = i
        while last + 1 < value.size and slot[last + 1] - slot[i] <= half_width:
            last += 1
        count, at, total, at_at, at_value = 0, 0.0, 0.0, 0.0, 0.0
        for j in range(first, last + 1):
            if not math.isnan(value[j]):
                x = float(slot[j] - slot[i])
                v = value[j] - value[i]
                count += 1
                at += x
                total += v
                at_at += x * x
                at_value += x * v
        if count >= 2:
            slope[i] = (at_value - at * total / count) / (at_at - at * at / count)
        else:
            slope[i] = _slope_to_neighbours(slot, value, i)
    return slope


@numba.njit(cache=True)
def _edge_slope(slot: IntArray, value: FloatArray, spread: FloatArray) -> FloatArray:
    """Change of a channel from start to end of each block, per slot.

    The value at the edge between two blocks is their mean weighted by 1/spread**2: where the channel steps within one
    of them, the other, in which it is constant, determines the value at the edge.
    """
    slope = np.full(value.size, np.nan)
    for i in range(value.size):
        if math.isnan(value[i]):
            continue
        change, reach = 0.0, 0.0
        for side in (-1, 1):
            j = i + side
            if 0 <= j < value.size and slot[j] - slot[i] == side and not math.isnan(value[j]):
                mine, its = spread[i] ** 2 + 1e-18, spread[j] ** 2 + 1e-18
                edge = (value[i] * its + value[j] * mine) / (mine + its)
                change += side * (edge - value[i])
                reach += 0.5
        slope[i] = change / reach if reach > 0 else _slope_to_neighbours(slot, value, i)
    return slope


def lagged(run: RunBlocks, channel: str, time_constant_s: float) -> FloatArray:
    """A channel after a first-order lag that is in equilibrium at the run's first reading.

    Examples
    --------
    >>> from analytics.loop.blocks.run_blocks import Channel
    >>> one = np.ones(4)
    >>> step = Channel(np.array([0.0, 0.0, 1.0, 1.0]), 0 * one, "degC")
    >>> run = RunBlocks("U", "r", "rate", np.array([0, 1, 2, 92]), 10.0, 0, one, np.ones(4, int), one, "deg/h",
    ...                 {"temperature": step})
    >>> lagged(run, "temperature", 300.0).round(3)
    array([0.   , 0.   , 0.016, 0.951])
    """
    return np.asarray(_lagged(run.time_s, run.mean(channel), time_constant_s))


def played(run: RunBlocks, channel: str, width: float) -> FloatArray:
    """Output of a play (backlash) of full width `width`, centred on the run's first reading.

    After a reversal the output follows only when the channel has passed the width.
    """
    return np.asarray(_play(run.mean(channel), width))


def slope_per_s(run: RunBlocks, channel: str, values: FloatArray | None = None) -> FloatArray:
    """Time derivative per second of a slow, noisy channel, or of `values` derived from it: slope over +-60 s."""
    half_width = max(1, round(_SLOPE_HALF_WIDTH_S / run.block_s))
    slope = _local_slope(run.slot, run.mean(channel) if values is None else values, half_width)
    return np.asarray(slope / run.block_s)


def mean_slope_per_s(run: RunBlocks, channel: str) -> FloatArray:
    """Mean time derivative within each block of a channel that may step, such as a rate; per second."""
    its = run.channels[channel]
    return np.asarray(_edge_slope(run.slot, its.mean, its.spread) / run.block_s)
