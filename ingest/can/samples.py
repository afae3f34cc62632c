"""From CAN frames to samples of each unit and signal, with an account of every frame."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ingest.can.checksum import CHECKSUMS
from ingest.can.counters import ForwardTimes, FrameCounter
from ingest.can.decode import FrameBytes
from ingest.can.frames import FrameBlock
from ingest.can.mapping import CanPlan, Route, SignalPlan
from stream.batch import BoolArray, CountArray, FloatArray, IntArray

Rows = npt.NDArray[np.intp]


@dataclass(frozen=True)
class MessageCount:
    """What became of the frames of one message of one unit.

    Parameters
    ----------
    message, unit: Which, as the database and the mapping say.
    arbitration_id: Bit 31 is set where it is of 29 bits.
    frames: Frames that came.
    decoded: Frames whose signals were used.
    lost, repeated, restarts: By its counter: frames that never came, that came again, and silences after which it had
        begun anew.
    checksum_failures: Frames that were left out as their checksum is wrong.
    short: Frames that lack bytes of a signal; that signal was left out.
    not_finite: Values that are no finite number, left out.
    other_channel: Frames on another channel than the first one, where the mapping names none; left out.
    late, retimed: Frames left out as their time lies before that of one before them; frames a little late, set after
        it.
    off_grid_s: Furthest that a frame was received from its place on the grid, seconds (counter with interval only).
    """

    message: str
    unit: str
    arbitration_id: int
    frames: int
    decoded: int
    lost: int
    repeated: int
    restarts: int
    checksum_failures: int
    short: int
    not_finite: int
    other_channel: int
    late: int
    retimed: int
    off_grid_s: float

    @property
    def left_out(self) -> int:
        """Frames that were not used."""
        return self.frames - self.decoded


@dataclass(frozen=True)
class CanCounts:
    """What became of all frames.

    Parameters
    ----------
    frames: Frames that came.
    messages: By message and unit; those that never came are not in it.
    unknown: Frames by arbitration id that no message of the plan has.
    unrouted: Frames by arbitration id whose channel or multiplexer is no unit's.
    """

    frames: int
    messages: tuple[MessageCount, ...]
    unknown: dict[int, int]
    unrouted: dict[int, int]


class SignalPiece(NamedTuple):
    """Consecutive samples of a signal: int32 counts of its scale and offset, or float64 values."""

    route: Route
    plan: SignalPlan
    times_ns: IntArray
    data: CountArray | FloatArray


@dataclass
class _Tally:
    frames: int = 0
    decoded: int = 0
    checksum_failures: int = 0
    short: int = 0
    not_finite: int = 0
    other_channel: int = 0
    off_grid_ns: int = 0


@dataclass
class _Follower:
    """One route on its way through the blocks."""

    route: Route
    tally: _Tally = field(default_factory=_Tally)
    times: ForwardTimes = field(default_factory=ForwardTimes)
    counter: FrameCounter | None = None
    anchor_ns: int | None = None
    channel: int | None = None

    def __post_init__(self) -> None:
        message = self.route.message
        self.channel = self.route.channel
        self.names = [signal.layout.name for signal in message.signals]
        if message.counter is not None:
            self.counter = FrameCounter(message.counter.modulus, message.interval_ns)

    def count(self) -> MessageCount:
        counter, tally = self.counter, self.tally
        return MessageCount(
            self.route.message.layout.name,
            self.route.unit,
            self.route.arbitration_id,
            tally.frames,
            tally.decoded,
            0 if counter is None else counter.lost,
            0 if counter is None else counter.repeated,
            0 if counter is None else counter.restarts,
            tally.checksum_failures,
            tally.short,
            tally.not_finite,
            tally.other_channel,
            self.times.late,
            self.times.retimed,
            tally.off_grid_ns / 1e9,
        )

    def take(self, block: FrameBlock, rows: Rows, frames: FrameBytes) -> Iterator[SignalPiece]:
        """Samples in the rows of a block that have the route's arbitration id; `frames` are their bytes."""
        mine = self._mine(block, rows, frames)
        if mine is not None:
            rows, frames = rows[mine], _part(frames, mine)
        self.tally.frames += len(rows)
        t_ns = block.t_ns[rows]
        for check in (self._on_channel, self._intact):
            good = check(block, rows, frames)
            if not good.all():
                rows, t_ns, frames = rows[good], t_ns[good], _part(frames, good)
        if not len(rows):
            return
        t_ns, keep = self._placed(t_ns, frames)
        if not keep.all():
            frames = _part(frames, keep)
        self.tally.decoded += len(t_ns)
        yield from self._signals(t_ns, frames)

    def _mine(self, block: FrameBlock, rows: Rows, frames: FrameBytes) -> BoolArray | None:
        """Which frames are this unit's; None where all are."""
        mine = None
        if self.route.channel is not None:
            mine = block.channel[rows] == self.route.channel
        if self.route.selector is not None:
            name, value = self.route.selector
            found = self.route.message.layout.decode(frames, [name])[name]
            chosen = np.zeros(len(frames), np.bool_)
            chosen[slice(None) if found.rows is None else found.rows] = found.raw == value
            mine = chosen if mine is None else mine & chosen
        return mine

    def _on_channel(self, block: FrameBlock, rows: Rows, _frames: FrameBytes) -> BoolArray:
        """Two channels are two buses: without a word on it, the first that carries the message is meant."""
        channels = block.channel[rows]
        if self.channel is None and len(channels):
            self.channel = int(channels[0])
        good = np.asarray(channels == self.channel)
        self.tally.other_channel += int(len(good) - good.sum())
        return good

    def _intact(self, _block: FrameBlock, _rows: Rows, frames: FrameBytes) -> BoolArray:
        plan = self.route.message.checksum
        good = np.ones(len(frames), np.bool_)
        if plan is None or not len(frames):
            return good
        found = self.route.message.layout.decode(frames, [plan.signal])[plan.signal]
        good[...] = frames.length > max(plan.octets)
        if found.rows is not None:
            good &= found.rows
        received = np.zeros(len(frames), np.int64)
        received[slice(None) if found.rows is None else found.rows] = found.raw
        prefix = np.tile(np.array(plan.prefix, np.uint8), (len(frames), 1))
        covered = frames.data[:, [octet for octet in plan.octets if octet < frames.width]]
        good &= CHECKSUMS[plan.algorithm](np.hstack([prefix, covered])) == (received & 0xFF)
        self.tally.checksum_failures += int(len(good) - good.sum())
        return good

    def _placed(self, t_ns: IntArray, frames: FrameBytes) -> tuple[IntArray, BoolArray]:
        """Times of the frames that are new, and which those are."""
        message = self.route.message
        if self.counter is None or message.counter is None:
            return self.times.follow(t_ns)
        name = message.counter.signal
        found = message.layout.decode(frames, [name])[name]
        has_counter = np.ones(len(frames), np.bool_) if found.rows is None else found.rows
        numbers, is_new = self.counter.follow(t_ns[has_counter], found.raw.astype(np.int64))
        keep = has_counter.copy()
        keep[has_counter] = is_new
        self.tally.short += found.short
        if message.interval_ns is None:
            times_ns, forward = self.times.follow(t_ns[keep])
            keep[keep] = forward
            return times_ns, keep
        if not keep.any():
            return t_ns[:0], keep
        if self.anchor_ns is None:
            self.anchor_ns = int(t_ns[has_counter][0])
        times_ns = self.anchor_ns + numbers[is_new] * message.interval_ns
        self.tally.off_grid_ns = max(self.tally.off_grid_ns, int(np.abs(t_ns[keep] - times_ns).max()))
        return times_ns, keep

    def _signals(self, t_ns: IntArray, frames: FrameBytes) -> Iterator[SignalPiece]:
        decoded = self.route.message.layout.decode(frames, self.names)
        self.tally.short += max((each.short for each in decoded.values()), default=0)
        for plan in self.route.message.signals:
            found = decoded[plan.layout.name]
            times_ns = t_ns if found.rows is None else t_ns[found.rows]
            data: CountArray | FloatArray
            if plan.is_counts:
                data = found.counts()
            else:
                data = found.values(plan.layout.scale, plan.layout.offset)
                finite = np.isfinite(data)
                if not finite.all():
                    self.tally.not_finite += int(len(finite) - finite.sum())
                    times_ns, data = times_ns[finite], data[finite]
            if len(times_ns):
                yield SignalPiece(self.route, plan, times_ns, data)


class CanSamples:
    """Takes frames as they come and gives the samples in them; it keeps counters and grids from block to block.

    Parameters
    ----------
    plan: From `load_mapping` or `automatic_plan`.
    """

    def __init__(self, plan: CanPlan) -> None:
        self._followers = [_Follower(route) for route in plan.routes]
        self._known = np.array(sorted({route.arbitration_id for route in plan.routes}), np.uint32)
        self._by_id: list[list[_Follower]] = [
            [each for each in self._followers if each.route.arbitration_id == identifier] for identifier in self._known
        ]
        self._frames = 0
        self._unknown: Counter[int] = Counter()
        self._unrouted: Counter[int] = Counter()

    @property
    def counts(self) -> CanCounts:
        """What became of the frames so far."""
        met = tuple(count for count in (each.count() for each in self._followers) if count.frames)
        return CanCounts(self._frames, met, dict(sorted(self._unknown.items())), dict(self._unrouted))

    def take(self, block: FrameBlock) -> Iterator[SignalPiece]:
        """Samples of a block, signal by signal; each signal's in order of time."""
        self._frames += len(block)
        index = np.minimum(np.searchsorted(self._known, block.arbitration_id), len(self._known) - 1)
        is_known = self._known[index] == block.arbitration_id
        if not is_known.all():
            identifiers, counts = np.unique(block.arbitration_id[~is_known], return_counts=True)
            self._unknown.update(dict(zip(identifiers.tolist(), counts.tolist(), strict=True)))
        # numbers of 16 bits are sorted by their digits, ten times faster than by comparison
        slots = np.where(is_known, index, len(self._known)).astype(np.uint16)
        order = np.argsort(slots, kind="stable")
        ends = np.cumsum(np.bincount(slots, minlength=len(self._known) + 1))
        begin = 0
        for followers, end in zip(self._by_id, ends.tolist(), strict=False):
            if end > begin:
                rows = order[begin:end]
                frames = FrameBytes(block.data[rows], block.length[rows])
                unrouted = len(rows)
                for follower in followers:
                    before = follower.tally.frames
                    yield from follower.take(block, rows, frames)
                    unrouted -= follower.tally.frames - before
                if unrouted > 0:
                    self._unrouted[followers[0].route.arbitration_id] += unrouted
            begin = end


def _part(frames: FrameBytes, rows: BoolArray) -> FrameBytes:
    return FrameBytes(frames.data[rows], frames.length[rows])
