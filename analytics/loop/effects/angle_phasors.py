"""Means over a block of exp(1j*k*angle)."""

import numpy as np
import numpy.typing as npt

from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from stream.errors import BadInput, UnknownUnit
from stream.quantities import conversion

Phasor = npt.NDArray[np.complex128]


def radians_per_unit(channel: Channel) -> float:
    """Factor from the unit of an angle to radians.

    Raises
    ------
    BadInput: If the unit is that of no angle, such as counts of an encoder.

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

    Where the channel comes without means of its own, it is taken to have moved evenly within the block, as far as its
    spread says.
    """
    angle = run.channels[channel]
    if angle.phasors is not None and harmonic <= len(angle.phasors):
        return np.asarray(angle.phasors[harmonic - 1], np.complex128)
    factor = harmonic * radians_per_unit(angle)
    swept = factor * np.sqrt(12.0) * angle.spread
    return np.asarray(np.exp(1j * factor * angle.mean) * np.sinc(swept / (2.0 * np.pi)), np.complex128)
