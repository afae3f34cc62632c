"""Means over a block of functions of a channel, from its mean and spread, or its phasors, within the block.

The readings within a block are assumed normally distributed; at zero spread the function of the mean results.
"""

import numpy as np
import numpy.typing as npt

from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from stream.batch import FloatArray
from stream.errors import BadInput, UnknownUnit
from stream.quantities import conversion

Phasor = npt.NDArray[np.complex128]

_LEAST_SPREAD = 1e-12


def mean_magnitude(channel: Channel) -> FloatArray:
    """Mean of |x|.

    Examples
    --------
    >>> mean_magnitude(Channel(np.array([-2.0, 0.0]), np.array([0.0, 1.0]), "deg/s")).round(3)
    array([2.   , 0.798])
    """
    return mean_excess(channel, 0.0) + mean_excess(mirrored(channel), 0.0)


def mean_excess(channel: Channel, limit: float) -> FloatArray:
    """Mean of max(x - limit, 0).

    Examples
    --------
    >>> mean_excess(Channel(np.array([1.0, 3.0, 2.0]), np.array([0.0, 0.0, 1.0]), "deg/s"), 2.0).round(3)
    array([0.   , 1.   , 0.399])
    """
    over, spread = channel.mean - limit, np.maximum(channel.spread, _LEAST_SPREAD)
    return np.asarray(over * _below(over / spread) + spread * _density(over / spread))


def share_above(channel: Channel, limit: float) -> FloatArray:
    """Share of the block in which x > limit.

    Examples
    --------
    >>> share_above(Channel(np.array([1.0, 3.0, 2.0]), np.array([0.0, 0.0, 1.0]), "degC"), 2.0)
    array([0. , 1. , 0.5])
    """
    return _below((channel.mean - limit) / np.maximum(channel.spread, _LEAST_SPREAD))


def mean_inside(channel: Channel, half_width: float) -> FloatArray:
    """Mean of x where |x| < half_width, else 0.

    Examples
    --------
    >>> mean_inside(Channel(np.array([0.1, 3.0]), np.zeros(2), "deg/s"), 0.2)
    array([0.1, 0. ])
    """
    mean, spread = channel.mean, np.maximum(channel.spread, _LEAST_SPREAD)
    upper, lower = (half_width - mean) / spread, (-half_width - mean) / spread
    return np.asarray(mean * (_below(upper) - _below(lower)) + spread * (_density(lower) - _density(upper)))


def mirrored(channel: Channel) -> Channel:
    """The channel with its sign reversed."""
    return Channel(-channel.mean, channel.spread, channel.unit_of_measure)


def _below(z: FloatArray) -> FloatArray:
    from scipy.special import ndtr

    return np.asarray(ndtr(z))


def _density(z: FloatArray) -> FloatArray:
    clipped = np.clip(z, -40.0, 40.0)
    return np.asarray(np.exp(-0.5 * clipped**2) / np.sqrt(2.0 * np.pi))


def radians_per_unit(channel: Channel) -> float:
    """Factor from the unit of an angle to radians.

    Raises
    ------
    BadInput: If it is not a unit of angle, such as counts of an encoder.

    Examples
    --------
    >>> round(radians_per_unit(Channel(np.zeros(1), np.zeros(1), "deg")) * 180, 9)
    3.141592654
    """
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
