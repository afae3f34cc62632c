"""Kernels: means over a block of functions of a channel, and filters over blocks at uneven times.

The readings within a block, or within each second of one in which the channel moves, are assumed normally distributed;
at zero spread the function of the mean results. Filters count gaps and blocks without a reading by their true duration.
"""

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from analytics.loop.blocks.edge_slope import slope_to_neighbours
from analytics.loop.blocks.inside import Inside
from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from stream.batch import FloatArray, IntArray
from stream.compiled import kernel
from stream.errors import BadInput, UnknownUnit
from stream.quantities import conversion

Phasor = npt.NDArray[np.complex128]

_LEAST_SPREAD = 1e-12
_PARTS = 8  # of a second on a ramp
_SLOPE_HALF_WIDTH_S = 60.0


def mean_magnitude(channel: Channel) -> FloatArray:
    """Mean of |x|.

    >>> mean_magnitude(Channel(np.array([-2.0, 0.0]), np.array([0.0, 1.0]), "deg/s")).round(3)
    array([2.   , 0.798])
    """
    return mean_excess(channel, 0.0) + mean_excess(mirrored(channel), 0.0)


def mean_excess(channel: Channel, limit: float) -> FloatArray:
    """Mean of max(x - limit, 0).

    >>> mean_excess(Channel(np.array([1.0, 3.0, 2.0]), np.array([0.0, 0.0, 1.0]), "deg/s"), 2.0).round(3)
    array([0.   , 1.   , 0.399])
    """

    def excess(mean: FloatArray, spread: FloatArray) -> FloatArray:
        over = mean - limit
        return over * _below(over / spread) + spread * _density(over / spread)

    return block_means(channel, excess)


def share_above(channel: Channel, limit: float) -> FloatArray:
    """Share of the block in which x > limit.

    >>> share_above(Channel(np.array([1.0, 3.0, 2.0]), np.array([0.0, 0.0, 1.0]), "degC"), 2.0)
    array([0. , 1. , 0.5])
    """
    return block_means(channel, lambda mean, spread: _below((mean - limit) / spread))


def mean_inside(channel: Channel, half_width: float) -> FloatArray:
    """Mean of x where |x| < half_width, else 0.

    >>> mean_inside(Channel(np.array([0.1, 3.0]), np.zeros(2), "deg/s"), 0.2)
    array([0.1, 0. ])
    """

    def inner(mean: FloatArray, spread: FloatArray) -> FloatArray:
        upper, lower = (half_width - mean) / spread, (-half_width - mean) / spread
        return mean * (_below(upper) - _below(lower)) + spread * (_density(lower) - _density(upper))

    return block_means(channel, inner)


def mirrored(channel: Channel) -> Channel:
    """The channel with its sign reversed."""
    inside = None if channel.inside is None else channel.inside.scaled(-1.0)
    return Channel(-channel.mean, channel.spread, channel.unit_of_measure, inside=inside)


def block_means(channel: Channel, of: Callable[[FloatArray, FloatArray], FloatArray]) -> FloatArray:
    """Means over blocks of a function of a channel; `of` gives its mean over readings of some mean and spread.

    >>> step = Inside(np.array([1, 1]), np.array([10.0, 20.0]), np.array([1.0, 4.0]), np.zeros(2))
    >>> block_means(Channel(np.array([1.0, 3.0]), np.array([0.0, 1.41]), "deg/s", inside=step), lambda m, s: m**3)
    array([ 1., 43.])
    """
    found = np.asarray(of(channel.mean, np.maximum(channel.spread, _LEAST_SPREAD)))
    if channel.inside is None or not channel.inside.row.size:
        return found
    inside = channel.inside
    exact = inside.means(_of_pieces(inside, of), found)
    has_value = np.isfinite(channel.mean)
    return np.where(has_value if found.ndim == 1 else has_value[:, None], exact, found)


def _of_pieces(inside: Inside, of: Callable[[FloatArray, FloatArray], FloatArray]) -> FloatArray:
    """Means of a function over the pieces; where readings are spread evenly, by parts of the piece.

    >>> one, spread = np.ones(1), np.array([3**-0.5])
    >>> even = Inside(np.array([0]), one, one, spread, is_even=one > 0)
    >>> _of_pieces(even, lambda m, s: m**2 + s**2).round(9)  # of 0 to 2
    array([1.33333333])
    """
    found = np.asarray(of(inside.mean, np.maximum(inside.spread, _LEAST_SPREAD)))
    if inside.is_even is None or not inside.is_even.any():
        return found
    mean, spread = inside.mean[inside.is_even], inside.spread[inside.is_even]
    at = np.sqrt(3.0) * (np.arange(1.0, 2 * _PARTS, 2.0) / _PARTS - 1.0)
    of_parts = [of(mean + each * spread, np.maximum(spread / _PARTS, _LEAST_SPREAD)) for each in at]
    found[inside.is_even] = np.mean(of_parts, axis=0)
    return found


def _below(z: FloatArray) -> FloatArray:
    from scipy.special import ndtr

    return np.asarray(ndtr(z))


def _density(z: FloatArray) -> FloatArray:
    clipped = np.clip(z, -40.0, 40.0)
    return np.asarray(np.exp(-0.5 * clipped**2) / np.sqrt(2.0 * np.pi))


def radians_per_unit(channel: Channel) -> float:
    """Factor from the unit of an angle to radians; BadInput if it is not a unit of angle, such as counts."""
    try:
        factor, _ = conversion(channel.unit_of_measure, "rad")
    except UnknownUnit as error:
        raise BadInput(f"an angle is needed in deg or rad, not in {channel.unit_of_measure}: convert it") from error
    if channel.unit_of_measure in {"count", "LSB", "1"}:
        raise BadInput(f"an angle is needed in deg or rad, not in {channel.unit_of_measure}: give it a scale")
    return factor


def phasor(run: RunBlocks, channel: str, harmonic: int) -> Phasor:
    """Mean of exp(1j*harmonic*angle) in each block.

    Without recorded phasors the angle is assumed to move uniformly within the block, over a range given by its spread.
    """
    angle = run.channels[channel]
    if angle.phasors is not None and harmonic <= len(angle.phasors):
        return np.asarray(angle.phasors[harmonic - 1], np.complex128)
    factor = harmonic * radians_per_unit(angle)
    swept = factor * np.sqrt(12.0) * angle.spread
    return np.asarray(np.exp(1j * factor * angle.mean) * np.sinc(swept / (2.0 * np.pi)), np.complex128)


@kernel
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


@kernel
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


@kernel
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
            slope[i] = slope_to_neighbours(slot, value, i)
    return slope


def lagged(run: RunBlocks, channel: str, time_constant_s: float) -> FloatArray:
    """A channel after a first-order lag that is in equilibrium at the run's first reading.

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
    """Output of a play (backlash) of this full width, centred on the first reading: the channel must pass the width."""
    return np.asarray(_play(run.mean(channel), width))


def slope_per_s(run: RunBlocks, channel: str, values: FloatArray | None = None) -> FloatArray:
    """Time derivative per second of a slow, noisy channel, or of `values` derived from it: slope over +-60 s."""
    half_width = max(1, round(_SLOPE_HALF_WIDTH_S / run.block_s))
    slope = _local_slope(run.slot, run.mean(channel) if values is None else values, half_width)
    return np.asarray(slope / run.block_s)
