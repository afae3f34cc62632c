"""What the closed loop looks at: one run of one unit as means over blocks of time, with the channels beside them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from stream.batch import FloatArray, IntArray

# The standard names. Channels of other names take part under their own.
STANDARD_CHANNELS = (
    *("input_rate", "rate_o", "rate_s", "table_rate", "table_angle", "table_acceleration"),
    *("gravity_i", "gravity_o", "gravity_s"),
    *("temperature", "case_temperature", "chamber_temperature", "chamber_setpoint"),
    *("supply_voltage", "supply_current", "magnetic_i", "magnetic_o", "magnetic_s"),
    *("vibration", "humidity", "time_since_power_on", "day", "position"),
)
HARMONICS = 4
_ROUNDING = 1e-14


@dataclass(frozen=True)
class Channel:
    """One channel, reduced to the blocks of its run.

    Parameters
    ----------
    mean: shape (blocks,); mean of each block; NaN where the channel has no reading near it.
    spread: shape (blocks,); standard deviation of the readings within the block (not of their mean); 0 where it cannot
        be known.
    unit_of_measure: Of both.
    phasors: shape (harmonics, blocks); for an angle: mean of exp(1j*k*angle) within the block for k = 1, 2, ...
        `HARMONICS`; `mean` is then unwrapped.
    """

    mean: FloatArray
    spread: FloatArray
    unit_of_measure: str
    phasors: "np.ndarray[tuple[int, ...], np.dtype[np.complex128]] | None" = None


@dataclass(frozen=True)
class RunBlocks:
    """One run of one unit, reduced to block means; only blocks that have the signal are kept.

    Parameters
    ----------
    unit, run: Whose it is. A segment of a run that replicates within a run is called ``RUN#2`` and so on.
    signal: Name of the signal.
    slot: shape (blocks,); number of each block on the run's grid: block b covers [slot*block_s, (slot + 1)*block_s) s
        from `t0_ns` on. Increasing; where it leaps there is a gap.
    block_s: Length of a block in seconds.
    t0_ns: Moment from which slots count, ns, UTC.
    value: shape (blocks,); mean of the signal in each block, in `unit_of_measure`, finite.
    n: shape (blocks,); samples behind each mean.
    white_variance: shape (blocks,); variance of each block mean as the scatter of the samples inside the block tells it
        (white noise); NaN where a block has too few samples to tell.
    unit_of_measure: Of the signal, in its result unit (deg/h for an angular rate).
    channels: By standard name, or by their own; any may be missing.
    is_date_known: Whether `t0_ns` is a true moment.

    Examples
    --------
    >>> ones = np.ones(3)
    >>> blocks = RunBlocks("FOG-1", "r1", "rate", np.array([0, 1, 5]), 30.0, 0, ones, ones.astype(int), ones, "deg/h")
    >>> len(blocks), blocks.time_s
    (3, array([ 15.,  45., 165.]))
    """

    unit: str
    run: str
    signal: str
    slot: IntArray
    block_s: float
    t0_ns: int
    value: FloatArray
    n: IntArray
    white_variance: FloatArray
    unit_of_measure: str
    channels: Mapping[str, Channel] = field(default_factory=lambda: MappingProxyType({}))
    is_date_known: bool = True

    def __len__(self) -> int:
        return self.value.size

    @property
    def time_s(self) -> FloatArray:
        """Middle of each block, seconds from `t0_ns`."""
        return np.asarray((self.slot + 0.5) * self.block_s, dtype=np.float64)

    def mean(self, channel: str) -> FloatArray:
        """Block means of a channel that is there."""
        return self.channels[channel].mean


def stands_still(value: FloatArray) -> bool:
    """Whether a signal does not change by more than rounding: the output of a sensor that is dead or stuck.

    Examples
    --------
    >>> stands_still(np.array([0.1 + 0.2, 0.3])), stands_still(np.array([0.3, 0.31]))
    (True, False)
    """
    return bool(np.ptp(value) <= _ROUNDING * np.abs(value).max())
