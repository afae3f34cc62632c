"""From CAN frames to batches of samples while they come in."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise
from uuid import UUID

import numpy as np

from ingest.can.frames import FrameBlock
from ingest.can.plan import CanPlan
from ingest.can.samples import CanSamples, SignalPiece
from ingest.can.summary import CanCounts
from ingest.tables.batches import SAMPLES_PER_GAP
from ingest.tables.timing.grid import SamplingGrid, is_gap, off_grid_intervals
from stream.batch import CountArray, FloatArray, IntArray, SampleBatch

# A signal's interval is measured over its first samples.
_SETTLE_SAMPLES = 200
_SETTLE_NS = 5_000_000_000
_LEAST_SAMPLES = 3
# A message is sent every 1, 2, 2.5, 4, 5 or 8 times a power of ten if it is that to half a per cent.
_ROUND = (1.0, 2.0, 2.5, 4.0, 5.0, 8.0, 10.0)
_ROUND_WITHIN = 5e-3
_CYCLE_WITHIN = 0.05


def nominal_interval_ns(intervals_ns: IntArray, measured_ns: int, cycle_ns: int = 0) -> int:
    """Nominal interval of frames received `intervals_ns` apart, on average every `measured_ns`.

    It is the database's cycle time if that is within 5 %, else a round number within 0.5 %, else as measured. If the
    intervals lie on no grid of the measured one, their median is compared with round numbers as well. So one signal
    has one interval in all files of a run.

    >>> nominal_interval_ns(np.array([9_998_000, 9_999_024]), 9_998_512)
    10000000
    >>> nominal_interval_ns(np.array([9_000_000, 10_000_000, 10_000_000]), 9_765_625)
    9765625
    >>> nominal_interval_ns(np.array([9_900_000]), 9_900_000, cycle_ns=10_000_000)
    10000000
    """
    if cycle_ns and abs(measured_ns - cycle_ns) <= _CYCLE_WITHIN * cycle_ns:
        return cycle_ns
    candidates = [measured_ns]
    if off_grid_intervals(intervals_ns, measured_ns)[0]:
        candidates.append(int(np.median(intervals_ns)))
    for candidate in candidates:
        power: int = 10 ** (len(str(candidate)) - 1)
        nearest = min((round(each * power) for each in _ROUND), key=lambda each: abs(each - candidate))
        is_round = abs(nearest - candidate) <= _ROUND_WITHIN * nearest
        if is_round and abs(nearest - measured_ns) <= _CYCLE_WITHIN * nearest:
            return nearest
    return measured_ns


class CanDecoder:
    """Turns frames as they come into batches per unit and signal, numbered on from block to block.

    Samples of a message with counter and interval lie on an exact grid, as long as its frames come so. Others have
    their times of reception; their interval is that of the first 200 samples or 5 s, which are buffered until then.
    `is_live`: no frame was sampled after its time of reception.

    >>> from ingest.can.decode import BitField, MessageLayout, SignalLayout
    >>> from ingest.can.frames import CanFrame, frame_block
    >>> from ingest.can.plan import MessagePlan, Route, SignalPlan
    >>> rate = SignalLayout("Rate", BitField("<", 0, 16, is_signed=True), 0.25)
    >>> message = MessagePlan(MessageLayout("IMU", {"Rate": rate}), (SignalPlan(rate, "rate", "deg/s"),))
    >>> decoder = CanDecoder(CanPlan((Route("G1", 0x101, message),)), run="r1", epoch_of=lambda unit: UUID(int=1))
    >>> decoder.take(frame_block([CanFrame(i * 10_000_000, 0, 0x101, bytes([i, 0])) for i in range(4)]))
    []
    >>> [(batch.signal, batch.dt_ns, batch.value_array.tolist()) for batch in decoder.finish()]
    [('rate', 10000000, [0.0, 0.25, 0.5, 0.75])]
    """

    def __init__(self, plan: CanPlan, *, run: str, epoch_of: Callable[[str], UUID], is_live: bool = False) -> None:
        self._samples = CanSamples(plan, is_live=is_live)
        self._run, self._epoch_of = run, epoch_of
        self._streams: dict[tuple[str, str], _Stream] = {}

    def take(self, block: FrameBlock) -> list[SampleBatch]:
        """Decode a block; the batches that are complete by then."""
        batches: list[SampleBatch] = []
        for piece in self._samples.take(block):
            name = (piece.route.unit, piece.plan.signal)
            if name not in self._streams:
                self._streams[name] = _Stream(piece, self._run, self._epoch_of(piece.route.unit))
            batches += self._streams[name].take(piece)
        return batches

    def finish(self) -> list[SampleBatch]:
        """The batches of all buffered samples."""
        return [batch for stream in self._streams.values() for batch in stream.settle()]

    @property
    def counts(self) -> CanCounts:
        """Account of the frames so far."""
        return self._samples.counts


class _Stream:
    def __init__(self, first: SignalPiece, run: str, epoch: UUID) -> None:
        message = first.route.message
        self._head = first.head(run, epoch, message.interval_ns or 0)
        self._cycle_ns = message.cycle_ns
        self._is_on_grid = message.counter is not None and message.interval_ns is not None
        self._is_wrong = False
        self._seq = 0
        self._last_ns: int | None = None
        self._buffer: list[tuple[IntArray, CountArray | FloatArray]] = []

    def take(self, piece: SignalPiece) -> list[SampleBatch]:
        times_ns, data = piece.times_ns, piece.data
        self._is_wrong = piece.is_irregular
        if self._head.dt_ns:
            return self._batches(times_ns, data)
        self._buffer.append((times_ns, data))
        samples = sum(len(each) for each, _ in self._buffer)
        waited_ns = int(times_ns[-1] - self._buffer[0][0][0])
        is_enough = samples >= _SETTLE_SAMPLES or (samples >= _LEAST_SAMPLES and waited_ns >= _SETTLE_NS)
        return self.settle() if is_enough else []

    def settle(self) -> list[SampleBatch]:
        """Fix the interval by the buffered samples, and give them out."""
        if not self._buffer:
            return []
        times_ns, data = (np.concatenate(parts) for parts in zip(*self._buffer, strict=True))
        self._buffer.clear()
        grid = SamplingGrid(partial(nominal_interval_ns, cycle_ns=self._cycle_ns))
        grid.add(times_ns)
        self._head = replace(self._head, dt_ns=grid.finish().dt_ns)
        return self._batches(times_ns, data)

    def _batches(self, times_ns: IntArray, data: CountArray | FloatArray) -> list[SampleBatch]:
        dt_ns = self._head.dt_ns
        last_ns = int(times_ns[0]) - dt_ns if self._last_ns is None else self._last_ns
        intervals_ns = np.diff(times_ns, prepend=np.int64(last_ns))
        uneven = intervals_ns != dt_ns
        self._last_ns = int(times_ns[-1])
        gaps = np.flatnonzero(is_gap(intervals_ns[1:], dt_ns)) + 1 if uneven.any() else np.empty(0, np.int64)
        # on a grid every part is exact, and needs no array of times
        cuts = gaps.tolist() if self._is_on_grid or len(gaps) * SAMPLES_PER_GAP <= len(times_ns) else []
        batches = []
        for begin, end in pairwise([0, *cuts, len(times_ns)]):
            is_even = not uneven[begin + 1 : end].any()
            irregular = self._is_wrong
            if not self._is_on_grid:
                irregular = bool(uneven[begin:end].any()) and off_grid_intervals(intervals_ns[begin:end], dt_ns)[0] > 0
            part = self._seq + begin, times_ns[begin:end], data[begin:end]
            batches.append(self._head.batch(*part, is_even=is_even, irregular=irregular))
        self._seq += len(data)
        return batches
