"""Time and gaps: the place of the samples of one signal on a grid of its nominal interval."""

from typing import NamedTuple

import numpy as np

from stream.batch import FloatArray, IntArray, SampleBatch, count_finite
from stream.errors import EstimatorError

INTERVAL_TOLERANCE = 1e-3
MAX_SPAN_NS = 2**62
_JOINED_SPAN = 8


class Piece(NamedTuple):
    """Samples ``start:stop`` of a batch lie on the slots from `first_slot` on, without a hole."""

    first_slot: int
    start: int
    stop: int


class GridTracker:
    """Places the samples of successive batches of one signal on the slots of a grid.

    The first sample has slot 0. Each further one advances by ``max(1, round((t - t_previous) / dt))`` slots: a clock
    that is slightly slow or fast never causes holes, and a gap takes its true place in time.
    A sample whose time is not after that of the last one placed is left out.

    `samples` were placed and hold a finite value; `missing` slots up to the last one hold none: never sent, or NaN;
    `late` samples were left out. Of a continuation, `start_slot` and `start_ns` are the next slot and the last time of
    the tracker before it, else 0. `irregular` is True once a batch on no grid has come: from then on every sample takes
    one slot, slots are unrelated to time, and samples that were not sent are not detected.

    >>> from uuid import UUID
    >>> def batch(t0_ns, n):
    ...     return SampleBatch("FOG-1", "rate", "r1", UUID(int=1), 0, t0_ns, 10, "deg/s", values=np.zeros(n))
    >>> tracker = GridTracker()
    >>> tracker.place(batch(0, 4))
    [Piece(first_slot=0, start=0, stop=4)]
    >>> tracker.place(batch(62, 4)), tracker.missing
    ([Piece(first_slot=6, start=0, stop=4)], 2)
    >>> tracker.place(batch(82, 4)), tracker.late
    ([Piece(first_slot=10, start=2, stop=4)], 2)
    """

    def __init__(self) -> None:
        self.samples = self.missing = self.late = 0
        self.irregular = False
        self.dt_ns = self.first_ns = self.last_ns = self.next_slot = 0
        self.start_ns = self.start_slot = 0

    @property
    def sample_interval_s(self) -> float:
        """Nominal interval of the samples in seconds, 0 before the first batch."""
        return self.dt_ns / 1e9

    def export_state(self) -> dict[str, int]:
        """The state by name."""
        return {name: int(value) for name, value in vars(self).items()}

    def import_state(self, state: dict[str, int]) -> None:
        """Take over the state of another tracker."""
        for name, value in state.items():
            setattr(self, name, bool(value) if name == "irregular" else value)

    def continuation(self) -> "GridTracker":
        """A tracker for the samples that follow, with counts of its own."""
        later = GridTracker()
        later.import_state(self.export_state() | {"samples": 0, "missing": 0, "late": 0})
        later.start_ns, later.start_slot = self.last_ns, self.next_slot
        return later

    def merge(self, later: "GridTracker") -> None:
        """Become the tracker of both parts; `later` must be a `continuation` of this one as it is now."""
        if (later.start_slot, later.start_ns) != (self.next_slot, self.last_ns):
            raise EstimatorError(
                f"the later part begins at slot {later.start_slot}, the earlier one ends at slot {self.next_slot}: "
                "only neighbours can be merged; begin the later part with continuation() of the earlier one"
            )
        counts = {name: getattr(self, name) + getattr(later, name) for name in ("samples", "missing", "late")}
        start = {"start_ns": self.start_ns, "start_slot": self.start_slot}
        self.import_state(later.export_state() | counts | start)

    def place_next(self, batch: SampleBatch, n: int) -> int:
        """Place n samples that continue exactly, as nearly all do: their first slot, or -1 and nothing is placed."""
        dt_ns, first_slot = self.dt_ns, self.next_slot
        last_ns = self.last_ns + n * dt_ns
        if (
            batch.t0_ns != self.last_ns + dt_ns
            or batch.dt_ns != dt_ns
            or batch.times_ns is not None
            or self.irregular
            or batch.irregular
            or first_slot == 0
            or last_ns - self.first_ns > MAX_SPAN_NS
        ):
            return -1
        self.last_ns = last_ns
        self.next_slot = next_slot = first_slot + n
        self.samples = samples = self.samples + batch.finite
        self.missing = next_slot - self.start_slot - samples
        return first_slot

    def place(self, batch: SampleBatch) -> list[Piece]:
        """Pieces of the samples that are not late; EstimatorError if the interval changes by 0.1 %, or times leap."""
        n, t0_ns = len(batch), batch.t0_ns
        if batch.dt_ns != self.dt_ns:
            self._check_interval(batch)
        if batch.irregular:
            self.irregular = True
        if batch.times_ns is not None:
            return self._place_timed(batch, batch.times_ns)
        late = 0
        if t0_ns <= self.last_ns and self.next_slot:
            late = min(n, (self.last_ns - t0_ns) // batch.dt_ns + 1)
            self.late += late
            if late == n:
                return []
        last_ns = t0_ns + (n - 1) * batch.dt_ns
        self._check_span(batch, last_ns)
        first_slot = self._slot_of(t0_ns + late * batch.dt_ns)
        self.next_slot, self.last_ns = first_slot + n - late, last_ns
        self._count(n - late, None if batch.values is None else batch.values[late:])
        return [Piece(first_slot, late, n)]

    def _check_interval(self, batch: SampleBatch) -> None:
        if self.dt_ns == 0:
            self.dt_ns = batch.dt_ns
            self.first_ns = batch.t0_ns if batch.times_ns is None else int(batch.times_ns[0])
        elif abs(batch.dt_ns - self.dt_ns) > INTERVAL_TOLERANCE * self.dt_ns:
            raise EstimatorError(
                f"{batch.label}: the nominal sample interval changes from {self.dt_ns / 1e9:g} s to "
                f"{batch.dt_ns / 1e9:g} s in mid-stream; begin a new run or a new signal for the new interval"
            )

    def _place_timed(self, batch: SampleBatch, times_ns: IntArray) -> list[Piece]:
        highest = np.maximum.accumulate(times_ns)
        self._check_span(batch, int(highest[-1]))
        after = np.ones(len(times_ns), np.bool_)
        after[1:] = times_ns[1:] > highest[:-1]
        if self.next_slot:
            after &= times_ns > self.last_ns
        kept = np.flatnonzero(after)
        self.late += len(times_ns) - len(kept)
        if len(kept) == 0:
            return []
        steps = np.diff(times_ns[kept])
        is_break = np.diff(kept) != 1
        if not self.irregular:
            is_break |= steps >= -(-3 * self.dt_ns // 2)
        pieces = []
        begin = 0
        for end in [*(np.flatnonzero(is_break) + 1).tolist(), len(kept)]:
            start, stop = int(kept[begin]), int(kept[end - 1]) + 1
            first = self._slot_of(int(times_ns[start]))
            pieces.append(Piece(first, start, stop))
            self.next_slot, self.last_ns = first + stop - start, int(times_ns[stop - 1])
            begin = end
        self._count(len(kept), None if batch.values is None else batch.values[kept])
        return pieces

    def _slot_of(self, t_ns: int) -> int:
        if self.next_slot == 0:
            return 0
        advance = 1 if self.irregular else max(1, (2 * (t_ns - self.last_ns) + self.dt_ns) // (2 * self.dt_ns))
        return self.next_slot - 1 + advance

    def _check_span(self, batch: SampleBatch, last_ns: int) -> None:
        if last_ns - self.first_ns > MAX_SPAN_NS:
            raise EstimatorError(
                f"{batch.label}: a sample at {last_ns} ns lies more than 146 years after the first; check the clock"
            )

    def _count(self, n: int, values: FloatArray | None) -> None:
        self.samples += n if values is None else count_finite(values)
        self.missing = self.next_slot - self.start_slot - self.samples


def contiguous_runs(batch: SampleBatch, pieces: list[Piece]) -> list[tuple[int, FloatArray]]:
    """Values of the pieces with their first slots; close ones joined by NaN, which cost less than a call for each."""
    values = batch.own_values
    if len(pieces) == 1:
        first_slot, start, stop = pieces[0]
        return [(first_slot, values if stop - start == len(values) else values[start:stop])]
    origin, last = pieces[0].first_slot, pieces[-1]
    span = last.first_slot + last.stop - last.start - origin
    if span > _JOINED_SPAN * len(values):
        return [(slot, values[start:stop]) for slot, start, stop in pieces]
    joined = np.full(span, np.nan)
    for slot, start, stop in pieces:
        joined[slot - origin : slot - origin + stop - start] = values[start:stop]
    return [(origin, joined)]
