"""Samples of one signal, in pieces of any size, cut into batches of equal size."""

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any
from uuid import UUID

import numpy as np

from ingest.tables.timing.grid import Sampling, is_gap
from stream.batch import CountArray, FloatArray, IntArray, SampleBatch

# A minute of samples a batch: a message costs as much as some thousand samples, and a replay sends whole ones.
_BATCH_NS = 60 * 10**9
_LEAST_SAMPLES, _MOST_SAMPLES = 1000, 8192
# Batches are split at gaps if that leaves at least this many samples per batch on average.
SAMPLES_PER_GAP = 50


@dataclass(frozen=True)
class SignalHead:
    """What all batches of one signal share; the fields are those of SampleBatch."""

    unit: str
    signal: str
    run: str
    epoch: UUID
    dt_ns: int
    unit_of_measure: str
    irregular: bool
    scale: float = 1.0
    offset: float = 0.0

    def batch(
        self, seq: int, times_ns: IntArray, data: FloatArray | CountArray, *, is_even: bool, irregular: bool
    ) -> SampleBatch:
        """A batch; times are left out of it if they are `is_even`."""
        samples: dict[str, Any] = {"counts" if data.dtype == np.int32 else "values": data}
        return SampleBatch(
            self.unit, self.signal, self.run, self.epoch, seq, int(times_ns[0]), self.dt_ns, self.unit_of_measure,
            **samples, times_ns=None if is_even else times_ns, irregular=irregular, scale=self.scale,
            offset=self.offset,
        )  # fmt: skip


def usual_batch_samples(dt_ns: int) -> int:
    """Samples in a batch: about a minute of them, between 1000 and as many as estimators take at once.

    >>> usual_batch_samples(10**6), usual_batch_samples(10**7), usual_batch_samples(10**9)
    (8192, 6000, 1000)
    """
    return min(max(_BATCH_NS // max(dt_ns, 1), _LEAST_SAMPLES), _MOST_SAMPLES)


def splits_at_gaps(sampling: Sampling) -> bool:
    """Whether a signal has few enough gaps to end a batch at each."""
    return sampling.gaps * SAMPLES_PER_GAP <= sampling.samples


def by_time(signals: Sequence[Iterator[SampleBatch]]) -> Iterator[SampleBatch]:
    """Batches of several signals by the time of their first sample, each signal in its own order.

    Who compares signals while they come, as a live compensation, would wait for one that is hours behind another.
    """
    return heapq.merge(*signals, key=lambda batch: batch.t0_ns)


class Batcher:
    """Collects samples of one signal and gives them out in batches, numbered from 0."""

    def __init__(self, head: SignalHead, batch_samples: int, *, splits_at_gaps: bool) -> None:
        self._head, self._batch_samples, self._splits_at_gaps = head, batch_samples, splits_at_gaps
        self._buffer: tuple[IntArray, FloatArray | CountArray] | None = None
        self._seq = 0

    def push(self, times_ns: IntArray, data: FloatArray | CountArray) -> Iterator[SampleBatch]:
        """Add samples; give out the batches that are full."""
        if self._buffer is not None:
            times_ns = np.concatenate([self._buffer[0], times_ns])
            data = np.concatenate([self._buffer[1], data])
        else:
            # the pieces may be views of a reader's buffer, which a batch must not keep alive
            times_ns, data = times_ns.copy(), data.copy()
        intervals_ns = times_ns[1:] - times_ns[:-1]
        uneven = intervals_ns != self._head.dt_ns
        begin = 0
        for end in self._ends(intervals_ns, len(data)):
            yield self._batch(times_ns[begin:end], data[begin:end], is_even=not uneven[begin : end - 1].any())
            begin = end
        self._buffer = (times_ns[begin:].copy(), data[begin:].copy()) if begin < len(data) else None

    def flush(self) -> Iterator[SampleBatch]:
        """Give out the buffered samples."""
        if self._buffer is not None:
            times_ns, data = self._buffer
            self._buffer = None
            yield self._batch(times_ns, data, is_even=bool((np.diff(times_ns) == self._head.dt_ns).all()))

    def _ends(self, intervals_ns: IntArray, samples: int) -> Iterator[int]:
        gaps = np.flatnonzero(is_gap(intervals_ns, self._head.dt_ns)) + 1 if self._splits_at_gaps else np.array([], int)
        begin = 0
        for gap in gaps.tolist():
            yield from range(begin + self._batch_samples, gap, self._batch_samples)
            yield gap
            begin = gap
        yield from range(begin + self._batch_samples, samples + 1, self._batch_samples)

    def _batch(self, times_ns: IntArray, data: FloatArray | CountArray, *, is_even: bool) -> SampleBatch:
        batch = self._head.batch(self._seq, times_ns, data, is_even=is_even, irregular=self._head.irregular)
        self._seq += len(data)
        return batch
