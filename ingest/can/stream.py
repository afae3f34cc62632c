"""From CAN frames to batches of samples while they come in: what live buses and whoever reads once make use of."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from uuid import UUID

import numpy as np

from ingest.can.frames import FrameBlock
from ingest.can.mapping import CanPlan
from ingest.can.samples import CanCounts, CanSamples, MessageCount, SignalPiece
from ingest.tables.grid import GRID_TOLERANCE, SamplingGrid, is_gap
from stream.batch import CountArray, FloatArray, IntArray, SampleBatch

__all__ = ["CanCounts", "CanDecoder", "MessageCount", "nominal_interval_ns"]

# A signal's interval is that of its first samples: so many, or those of so long.
_SETTLE_SAMPLES = 200
_SETTLE_NS = 5_000_000_000
_LEAST_SAMPLES = 3
# A message is sent every 1, 2, 2.5, 4, 5 or 8 times a power of ten, where it is that to half a per cent.
_ROUND = (1.0, 2.0, 2.5, 4.0, 5.0, 8.0, 10.0)
_ROUND_WITHIN = 5e-3
_CYCLE_WITHIN = 0.05
# A batch is cut at a gap where that leaves at least this many samples to a part on average.
_SAMPLES_PER_GAP = 50
_RESTART = 10.5


def nominal_interval_ns(intervals_ns: IntArray, measured_ns: int, cycle_ns: int = 0) -> int:
    """Nominal interval of frames that came `intervals_ns` apart, on the whole every `measured_ns`.

    It is the database's cycle time where that is within 5 %, else a round number within 0.5 %, else as measured.
    Where the intervals lie on no grid of what was measured, their median is compared with round numbers as well.
    So one signal has one interval in all files of a run.

    Examples
    --------
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
    if _off_grid(intervals_ns, measured_ns):
        candidates.append(int(np.median(intervals_ns)))
    for candidate in candidates:
        power: int = 10 ** (len(str(candidate)) - 1)
        nearest = min((round(each * power) for each in _ROUND), key=lambda each: abs(each - candidate))
        if (
            abs(nearest - candidate) <= _ROUND_WITHIN * nearest
            and abs(nearest - measured_ns) <= _CYCLE_WITHIN * nearest
        ):
            return nearest
    return measured_ns


def _off_grid(intervals_ns: IntArray, dt_ns: int) -> bool:
    """Whether an interval is further than a tenth from all multiples of the nominal one."""
    others = intervals_ns[intervals_ns != dt_ns]
    within = others[others <= _RESTART * dt_ns]  # after a longer gap the source may have begun anew
    multiples = np.maximum(np.rint(within / dt_ns), 1.0)
    return bool((np.abs(within - multiples * dt_ns) > GRID_TOLERANCE * dt_ns).any())


class CanDecoder:
    """Takes frames as they come and gives batches per unit and signal, numbered on from block to block.

    Samples of a message with counter and interval lie on an exact grid. Others have the times at which they were
    received; their interval is that of the first 200 samples or 5 s, for which they wait.

    Parameters
    ----------
    plan: From `load_mapping` or `automatic_plan`.
    run: Run that the samples belong to.
    epoch_of: From a unit to the epoch of its samples.

    Examples
    --------
    >>> from ingest.can.decode import BitField, MessageLayout, SignalLayout
    >>> from ingest.can.frames import Frame, frame_block
    >>> from ingest.can.mapping import MessagePlan, Route, SignalPlan
    >>> rate = SignalLayout("Rate", BitField("<", 0, 16, is_signed=True), 0.25)
    >>> message = MessagePlan(MessageLayout("IMU", {"Rate": rate}), (SignalPlan(rate, "rate", "deg/s"),))
    >>> decoder = CanDecoder(CanPlan((Route("G1", 0x101, message),)), run="r1", epoch_of=lambda unit: UUID(int=1))
    >>> decoder.take(frame_block([Frame(i * 10_000_000, 0, 0x101, bytes([i, 0])) for i in range(4)]))
    []
    >>> [(batch.signal, batch.dt_ns, batch.value_array.tolist()) for batch in decoder.finish()]
    [('rate', 10000000, [0.0, 0.25, 0.5, 0.75])]
    """

    def __init__(self, plan: CanPlan, *, run: str, epoch_of: Callable[[str], UUID]) -> None:
        self._samples = CanSamples(plan)
        self._run = run
        self._epoch_of = epoch_of
        self._streams: dict[tuple[str, str], _Stream] = {}

    def take(self, block: FrameBlock) -> list[SampleBatch]:
        """Decode a block; the batches that are complete by then."""
        batches: list[SampleBatch] = []
        for piece in self._samples.take(block):
            name = (piece.route.unit, piece.plan.signal)
            stream = self._streams.get(name)
            if stream is None:
                stream = self._streams[name] = _Stream(piece, self._run, self._epoch_of(piece.route.unit))
            batches += stream.take(piece.times_ns, piece.data)
        return batches

    def finish(self) -> list[SampleBatch]:
        """What still waits for more of its kind."""
        return [batch for stream in self._streams.values() for batch in stream.settle()]

    @property
    def counts(self) -> CanCounts:
        """What became of the frames so far."""
        return self._samples.counts


@dataclass
class _Stream:
    """One signal of one unit: numbers its samples, and finds out how they lie in time."""

    of: SignalPiece
    run: str
    epoch: UUID
    seq: int = 0
    dt_ns: int | None = None
    last_ns: int | None = None
    waiting: list[tuple[IntArray, CountArray | FloatArray]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.dt_ns = self.of.route.message.interval_ns

    def take(self, times_ns: IntArray, data: CountArray | FloatArray) -> list[SampleBatch]:
        if self.dt_ns is not None:
            return self._batches(times_ns, data)
        self.waiting.append((times_ns, data))
        samples = sum(len(each) for each, _ in self.waiting)
        waited_ns = int(times_ns[-1] - self.waiting[0][0][0])
        is_enough = samples >= _SETTLE_SAMPLES or (samples >= _LEAST_SAMPLES and waited_ns >= _SETTLE_NS)
        return self.settle() if is_enough else []

    def settle(self) -> list[SampleBatch]:
        """Fix the interval by what has come, and give it out."""
        if not self.waiting:
            return []
        times_ns = np.concatenate([times_ns for times_ns, _ in self.waiting])
        data = np.concatenate([data for _, data in self.waiting])
        self.waiting.clear()
        grid = SamplingGrid(partial(nominal_interval_ns, cycle_ns=self.of.route.message.cycle_ns))
        grid.add(times_ns)
        self.dt_ns = grid.finish().dt_ns
        return self._batches(times_ns, data)

    def _batches(self, times_ns: IntArray, data: CountArray | FloatArray) -> list[SampleBatch]:
        assert self.dt_ns is not None
        intervals_ns = np.diff(times_ns)
        gaps = np.flatnonzero(is_gap(intervals_ns, self.dt_ns)) + 1
        cuts = gaps.tolist() if len(gaps) * _SAMPLES_PER_GAP <= len(times_ns) else []
        if self.of.route.message.is_on_grid:  # every part is exact then, and a time array says nothing
            cuts = gaps.tolist()
        return [
            self._batch(times_ns[begin:end], data[begin:end])
            for begin, end in zip([0, *cuts], [*cuts, len(times_ns)], strict=True)
        ]

    def _batch(self, times_ns: IntArray, data: CountArray | FloatArray) -> SampleBatch:
        assert self.dt_ns is not None
        plan = self.of.plan
        is_even = bool((np.diff(times_ns) == self.dt_ns).all())
        batch = SampleBatch(
            unit=self.of.route.unit,
            signal=plan.signal,
            run=self.run,
            epoch=self.epoch,
            seq=self.seq,
            t0_ns=int(times_ns[0]),
            dt_ns=self.dt_ns,
            unit_of_measure=plan.unit_of_measure,
            counts=data if plan.is_counts else None,  # type: ignore[arg-type]
            values=None if plan.is_counts else data,  # type: ignore[arg-type]
            times_ns=None if is_even else times_ns,
            irregular=self._is_off_grid(times_ns),
            scale=plan.layout.scale if plan.is_counts else 1.0,
            offset=plan.layout.offset if plan.is_counts else 0.0,
        )
        self.seq += len(data)
        self.last_ns = int(times_ns[-1])
        return batch

    def _is_off_grid(self, times_ns: IntArray) -> bool:
        """Whether an interval, that to the batch before among them, is further than a tenth from all multiples."""
        assert self.dt_ns is not None
        last_ns = int(times_ns[0]) - self.dt_ns if self.last_ns is None else self.last_ns
        return _off_grid(np.diff(times_ns, prepend=np.int64(last_ns)), self.dt_ns)
