"""Means of consecutive blocks of time: irregular samples put on a grid, or a grid of another interval."""

import math
from typing import Any

import numpy as np

from stream.batch import FloatArray, IntArray, SampleBatch
from stream.errors import BadInput

LEAST_SHARE = 0.9


class BlockMeans:
    """Turns the samples of a signal into means of consecutive blocks of `block_s` seconds.

    A block counts if it holds at least 90 % of the samples that its length and the nominal interval let expect (of
    exact times, of those that fall into it); others are gaps. Values that are not finite are missing.

    Parameters
    ----------
    block_s : float
        Length of a block in seconds, not shorter than the nominal sample interval.

    Raises
    ------
    BadInput
        If the length is no positive number.

    Examples
    --------
    >>> from uuid import UUID
    >>> means = BlockMeans(2.0)
    >>> batch = SampleBatch("FOG-1", "rate", "r1", UUID(int=1), 0, 0, 10**9, "deg/h",
    ...                     values=np.array([1.0, 3.0, 2.0, 6.0, 4.0]))
    >>> means.push(batch).value_array.tolist()
    [2.0, 4.0]
    """

    def __init__(self, block_s: float) -> None:
        if not (math.isfinite(block_s) and block_s > 0):
            raise BadInput(f"blocks of {block_s} s: give a positive number of seconds")
        self._block_ns = max(1, round(block_s * 1e9))
        self._t0_ns: int | None = None
        self._index = 0
        self._sum = 0.0
        self._count = 0
        self._seq = 0

    def export_state(self) -> dict[str, Any]:
        """Everything that is kept, in plain values."""
        return {name: value for name, value in vars(self).items() if name != "_block_ns"}

    def import_state(self, state: dict[str, Any]) -> None:
        """Take over what another one of the same length has exported."""
        vars(self).update(state)

    def _expected(self, batch: SampleBatch, blocks: IntArray) -> FloatArray:
        """Samples that each block lets expect."""
        if batch.times_ns is not None:
            return np.full(len(blocks), self._block_ns / batch.dt_ns)
        first, stop = (-(-(blocks + more) * self._block_ns // batch.dt_ns) for more in (0, 1))
        return np.asarray(stop - first, np.float64)

    def push(self, batch: SampleBatch) -> SampleBatch | None:
        """Take in a batch; the means of the blocks that it completes, if there are any.

        Raises
        ------
        BadInput
            If the blocks are shorter than the nominal sample interval.
        """
        if batch.dt_ns > self._block_ns:
            raise BadInput(
                f"run {batch.run}, unit {batch.unit}, signal {batch.signal}: blocks of {self._block_ns / 1e9:g} s are "
                f"shorter than the sample interval of {batch.dt_ns / 1e9:g} s"
            )
        if self._t0_ns is None:
            self._t0_ns = int(batch.time_array[0])
        indices = (batch.time_array - self._t0_ns) // self._block_ns
        starts = np.flatnonzero(np.diff(indices, prepend=indices[0] - 1))
        is_finite = np.isfinite(batch.value_array)
        sums = np.add.reduceat(np.where(is_finite, batch.value_array, 0.0), starts)
        counts = np.add.reduceat(is_finite, starts, dtype=np.int64)
        blocks = indices[starts]
        if blocks[0] == self._index:
            sums[0] += self._sum
            counts[0] += self._count
        elif self._count > 0:
            blocks = np.concatenate([[self._index], blocks])
            sums = np.concatenate([[self._sum], sums])
            counts = np.concatenate([[self._count], counts])
        self._index, self._sum, self._count = int(blocks[-1]), float(sums[-1]), int(counts[-1])
        whole = np.flatnonzero(counts[:-1] >= LEAST_SHARE * self._expected(batch, blocks[:-1]))
        if len(whole) == 0:
            return None
        times_ns = self._t0_ns + blocks[whole] * self._block_ns
        seq = self._seq
        self._seq += len(whole)
        return SampleBatch(
            unit=batch.unit,
            signal=batch.signal,
            run=batch.run,
            epoch=batch.epoch,
            seq=seq,
            t0_ns=int(times_ns[0]),
            dt_ns=self._block_ns,
            unit_of_measure=batch.unit_of_measure,
            values=sums[whole] / counts[whole],
            times_ns=times_ns,
        )
