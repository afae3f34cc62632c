"""Data of the closed loop: one run of one unit as means over blocks of time, with the channels beside the signal."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from analytics.loop.blocks.inside import Inside
from stream.batch import BoolArray, FloatArray, IntArray

HARMONICS = 4
SECOND_NS = 10**9
_ROUNDING = 1e-14

ComplexArray = npt.NDArray[np.complex128]


@dataclass(frozen=True)
class Channel:
    """One channel, reduced to the blocks of its run."""

    mean: FloatArray  # shape (blocks,); NaN where the channel has no reading near the block
    # shape (blocks,); standard deviation of the readings within the block, not of their mean; 0 if unknown
    spread: FloatArray
    unit_of_measure: str
    # of an angle, shape (HARMONICS, blocks): mean of exp(1j*k*angle), k = 1, 2, ...; `mean` is unwrapped
    phasors: ComplexArray | None = None
    inside: Inside | None = None  # of the blocks in which it moves, where its readings are more than one a block
    slope_per_s: FloatArray | None = None  # mean rate of change in blocks where it moves without steps, else NaN

    def part(self, rows: BoolArray | slice) -> "Channel":
        """The channel at some of the blocks."""
        phasors = None if self.phasors is None else self.phasors[:, rows]
        inside = None if self.inside is None else self.inside.part(rows, self.mean.size)
        slope = None if self.slope_per_s is None else self.slope_per_s[rows]
        return Channel(self.mean[rows], self.spread[rows], self.unit_of_measure, phasors, inside, slope)


@dataclass(frozen=True)
class RunBlocks:
    """One run of one unit, reduced to block means; only blocks that have the signal are kept.

    >>> ones = np.ones(3)
    >>> blocks = RunBlocks("FOG-1", "r1", "rate", np.array([0, 1, 5]), 30.0, 0, ones, ones.astype(int), ones, "deg/h")
    >>> len(blocks), blocks.time_s
    (3, array([ 15.,  45., 165.]))
    """

    unit: str
    run: str  # a power-on within a run is a run of its own, ``RUN#2`` and so on
    signal: str
    slot: IntArray  # block b covers [slot*block_s, (slot + 1)*block_s) s from `t0_ns`; increasing, with jumps at gaps
    block_s: float
    t0_ns: int  # start of slot 0, ns UTC
    value: FloatArray  # shape (blocks,); mean of the signal in `unit_of_measure`, finite
    n: IntArray  # samples behind each mean
    # of each mean, from the scatter of the samples inside the block; NaN with too few samples
    white_variance: FloatArray
    unit_of_measure: str  # deg/h for an angular rate
    # by standard name, or their own
    channels: Mapping[str, Channel] = field(default_factory=lambda: MappingProxyType({}))
    hidden_delay_s: float = 0.0  # up to which a delay beside the rate reference may be what joining them left
    is_date_known: bool = True  # whether `t0_ns` is a true date

    def __len__(self) -> int:
        return self.value.size

    @property
    def whole_run(self) -> str:
        """Name of the whole run if this is a power-on within it, else of this run."""
        return self.run.rpartition("#")[0] or self.run

    @property
    def time_s(self) -> FloatArray:
        """Middle of each block, seconds from `t0_ns`."""
        return np.asarray((self.slot + 0.5) * self.block_s, dtype=np.float64)

    @property
    def middle_ns(self) -> IntArray:
        """Middle of each block, ns UTC."""
        block_ns = round(self.block_s * SECOND_NS)
        return self.t0_ns + self.slot * block_ns + block_ns // 2

    @property
    def is_table(self) -> bool:
        """Whether it is a table of means, one sample a block, without scatter and exact times."""
        return not np.isfinite(self.white_variance).any()

    def mean(self, channel: str) -> FloatArray:
        """Block means of a channel of the run."""
        return self.channels[channel].mean

    def part(self, rows: BoolArray | slice) -> "RunBlocks":
        """The run with some of its blocks."""
        return replace(
            self,
            slot=self.slot[rows],
            value=self.value[rows],
            n=self.n[rows],
            white_variance=self.white_variance[rows],
            channels={name: each.part(rows) for name, each in self.channels.items()},
        )


def stands_still(value: FloatArray) -> bool:
    """Whether a signal changes by no more than rounding, as of a sensor that is dead or stuck.

    >>> stands_still(np.array([0.1 + 0.2, 0.3])), stands_still(np.array([0.3, 0.31]))
    (True, False)
    """
    return bool(np.ptp(value) <= _ROUNDING * np.abs(value).max())
