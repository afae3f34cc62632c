"""Means of consecutive blocks of time: irregular samples resampled to a grid, or a grid of another interval."""

import math
from typing import Any

import numpy as np

from stream.batch import FloatArray, IntArray, SampleBatch, checked_batch
from stream.compiled import compiled
from stream.errors import BadInput
from stream.estimators.base import LEAST_SHARE

_ESTIMATED = 1e-3  # of the samples of a block: the interval of uneven times is an estimate
_NO_TIMES = np.empty(0, np.int64)


class BlockMeans:
    """Means of the samples of a signal over consecutive blocks of `block_s` seconds.

    A block counts if it holds at least 90 % of the samples expected from its length and the nominal interval (with
    exact times, of those that fall into it); others are gaps. Values that are not finite are missing.

    Blocks are not shorter than the nominal sample interval.

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
        self._count = self._seq = 0

    def export_state(self) -> dict[str, Any]:
        """The state, in plain values."""
        return {name: value for name, value in vars(self).items() if name != "_block_ns"}

    def import_state(self, state: dict[str, Any]) -> None:
        """Take over the state of another one of the same block length."""
        vars(self).update(state)

    def push(self, batch: SampleBatch) -> SampleBatch | None:
        """Take in a batch; the means of the blocks that it completes, if there are any."""
        if batch.dt_ns > self._block_ns:
            raise BadInput(
                f"{batch.label}: blocks of {self._block_ns / 1e9:g} s are "
                f"shorter than the sample interval of {batch.dt_ns / 1e9:g} s"
            )
        if self._t0_ns is None:
            self._t0_ns = batch.t0_ns if batch.times_ns is None else int(batch.times_ns[0])
        n = len(batch)
        blocks, means = np.empty(n, np.int64), np.empty(n)
        self._index, self._sum, self._count, found, is_even = _close_blocks(
            self._block_ns, batch.t0_ns - self._t0_ns, batch.dt_ns,
            _NO_TIMES if batch.times_ns is None else batch.times_ns - self._t0_ns, batch.own_values, self._index,
            self._sum, self._count, blocks, means,
        )  # fmt: skip
        if found == 0:
            return None
        seq = self._seq
        self._seq += found
        return checked_batch(
            unit=batch.unit, signal=batch.signal, run=batch.run, epoch=batch.epoch, seq=seq,
            t0_ns=self._t0_ns + int(blocks[0]) * self._block_ns, dt_ns=self._block_ns,
            unit_of_measure=batch.unit_of_measure, values=means[:found],
            times_ns=None if is_even else self._t0_ns + blocks[:found] * self._block_ns,
        )  # fmt: skip


@compiled
def _close_blocks(
    block_ns: int, first_ns: int, dt_ns: int, times_ns: IntArray, values: FloatArray, index: int, total: float,
    count: int, blocks: IntArray, means: FloatArray,
) -> tuple[int, float, int, int, bool]:  # fmt: skip
    """Take in values; the block being filled, its sum and count, how many means were written, and if without a gap.

    Times are relative to the beginning of block 0; empty where they are exactly on the grid.
    """
    is_timed = times_ns.shape[0] > 0
    begin, end = index * block_ns, (index + 1) * block_ns
    found = 0
    is_even = True
    for i in range(values.shape[0]):
        t_ns = times_ns[i] if is_timed else first_ns + i * dt_ns
        if t_ns < begin or t_ns >= end:
            expected = block_ns / dt_ns if is_timed else float((-begin // dt_ns) - (-end // dt_ns))
            if count > 0 and count >= (LEAST_SHARE - _ESTIMATED) * expected:
                is_even = is_even and (found == 0 or blocks[found - 1] == index - 1)
                blocks[found] = index
                means[found] = total / count
                found += 1
            index = t_ns // block_ns
            begin, end = index * block_ns, (index + 1) * block_ns
            total = 0.0
            count = 0
        if values[i] - values[i] == 0.0:
            total += values[i]
            count += 1
    return index, total, count, found, is_even
