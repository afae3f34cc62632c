"""From CAN frames to samples of each unit and signal, with an account of every frame."""

from collections import Counter
from dataclasses import replace
from typing import Any, NamedTuple
from uuid import UUID

import numpy as np
import numpy.typing as npt

from ingest.can.counters import FrameCounter
from ingest.can.decode import Decoded, FrameBytes, RawArray, SignalLayout, scaled
from ingest.can.forward_times import ForwardTimes
from ingest.can.frames import EXTENDED, FrameBlock, IdArray, pgn_keys
from ingest.can.grid_times import GridTimes
from ingest.can.pairs import PairFinder
from ingest.can.plan import OF_PGN, CanPlan, MessagePlan, Route, SignalPlan
from ingest.can.summary import CanCounts, MessageCount
from ingest.checksums import checksums
from ingest.tables.batches import SignalHead
from stream.batch import BoolArray, CountArray, FloatArray, IntArray


class SignalPiece(NamedTuple):
    """Consecutive samples of a signal: int32 counts of its scale and offset, or float64 values."""

    route: Route
    plan: SignalPlan
    times_ns: IntArray
    data: CountArray | FloatArray
    is_irregular: bool = False  # of a message with another interval than its mapping states

    def head(self, run: str, epoch: UUID, dt_ns: int, *, irregular: bool = False) -> SignalHead:
        """What all batches of the signal have in common."""
        plan, layout = self.plan, self.plan.layout
        scale, offset = (layout.scale, layout.offset) if plan.is_counts else (1.0, 0.0)
        unit, measure = self.route.unit, plan.unit_of_measure
        return SignalHead(unit, plan.signal, run, epoch, dt_ns, measure, irregular, scale, offset)


class _Frames(NamedTuple):
    t_ns: IntArray
    channel: npt.NDArray[np.int16]
    source: IdArray
    octets: FrameBytes
    decoded: dict[str, Decoded]


# greatest raw values that are measured ones, by bits (SAE J1939-71 5.1.4)
_J1939_MOST = {8: 0xFA, 16: 0xFAFF, 32: 0xFAFFFFFF}


class _RouteState:
    def __init__(self, route: Route, *, finds_pairs: bool, is_live: bool) -> None:
        message = route.message
        self.route, self.channel, self.source = route, route.channel, route.source
        self.tally = MessageCount(message.layout.name, route.unit, route.arbitration_id)
        self.times = ForwardTimes()
        self.pairs = PairFinder() if finds_pairs else None
        self.counter = None if message.counter is None else FrameCounter(message.counter.modulus, message.interval_ns)
        self.grid: GridTimes | None = None
        if message.counter is not None and message.interval_ns is not None:
            is_watched = finds_pairs or is_live
            self.grid = GridTimes(message.interval_ns, message.counter.modulus, is_live, is_watched)

    def count(self) -> MessageCount:
        of_counter = ("lost", "repeated", "restarts", "strays")
        numbers: dict[str, Any] = {name: getattr(self.counter, name, 0) for name in of_counter}
        late, retimed = self.times.late, self.times.retimed
        pairs = None if self.pairs is None else self.pairs.found()
        if self.grid is not None:
            numbers |= {name: getattr(self.grid, name) for name in ("off_grid_s", "set_back", "set_back_s", "seen")}
        return replace(self.tally, **numbers, late=late, retimed=retimed, pairs=pairs)

    def take(self, frames: _Frames) -> list[SignalPiece]:
        """Samples of those frames that are of the route."""
        keep = self._mine(frames)
        self.tally.frames += int(np.count_nonzero(keep))
        self._select_line(frames, keep)
        self._select_intact(frames, keep)
        if not keep.any():
            return []
        times_ns = self._place(frames, keep)
        self.tally.decoded += len(times_ns)
        return self._pieces(frames, keep, times_ns)

    def _mine(self, frames: _Frames) -> BoolArray:
        mine = np.ones(len(frames.t_ns), np.bool_)
        if self.route.channel is not None:
            mine &= frames.channel == self.route.channel
        if self.route.source is not None:
            mine &= frames.source == self.route.source
        if self.route.selector is not None:
            name, value = self.route.selector
            found = frames.decoded[name]
            mine &= found.all_raw == value
            if found.rows is not None:
                mine &= found.rows
        return mine

    def _select_line(self, frames: _Frames, keep: BoolArray) -> None:
        """Keep the frames of one channel, and of one J1939 source: the first ones, if the mapping names none."""
        if self.channel is None and keep.any():
            self.channel = int(frames.channel[keep][0])
        self.tally.other_channel += _drop(keep, frames.channel != self.channel)
        if self.route.is_j1939:
            if self.source is None and keep.any():
                self.source = int(frames.source[keep][0])
            self.tally.other_source += _drop(keep, frames.source != self.source)

    def _select_intact(self, frames: _Frames, keep: BoolArray) -> None:
        if (plan := self.route.message.checksum) is None:
            return
        found, octets = frames.decoded[plan.signal], frames.octets
        prefix = np.tile(np.array(plan.prefix, np.uint8), (len(keep), 1))
        covered = octets.data[:, [octet for octet in plan.octets if octet < octets.width]]
        good = checksums(plan.algorithm, np.hstack([prefix, covered])) == (found.all_raw & 0xFF)
        good &= octets.length > max(plan.octets)
        if found.rows is not None:
            good &= found.rows
        self.tally.checksum_failures += _drop(keep, ~good)

    def _place(self, frames: _Frames, keep: BoolArray) -> IntArray:
        """Keep the frames that are new; returns their times."""
        message = self.route.message
        if self.counter is None or message.counter is None:
            if self.pairs is not None:
                self.pairs.follow(frames.t_ns, frames.octets, keep)
            times_ns, is_forward = self.times.follow(frames.t_ns if keep.all() else frames.t_ns[keep])
            keep[keep] = is_forward
            return times_ns
        found = frames.decoded[message.counter.signal]
        if found.short_rows is not None:
            self.tally.short += int((found.short_rows & keep).sum())
        if found.rows is not None:
            keep &= found.rows
        counters = found.all_raw[keep].astype(np.int64)
        restarts = self.counter.restarts
        numbers, is_new = self.counter.follow(frames.t_ns[keep], counters)
        if self.grid is None:
            keep[keep] = is_new
            times_ns, is_forward = self.times.follow(frames.t_ns[keep])
            keep[keep] = is_forward
            return times_ns
        if len(numbers):
            self.grid.begin(int(frames.t_ns[keep][0]))
        if self.counter.restarts > restarts:
            self.grid.restart()
        keep[keep] = is_new
        return self.grid.place(frames.t_ns[keep], numbers[is_new], counters[is_new])

    def _pieces(self, frames: _Frames, keep: BoolArray, times_ns: IntArray) -> list[SignalPiece]:
        has_all = bool(keep.all())
        pieces, short = [], 0
        is_irregular = self.grid is not None and self.grid.is_wrong
        for plan in self.route.message.signals:
            found = frames.decoded[plan.layout.name]
            if found.short_rows is not None:
                short = max(short, int((found.short_rows & keep).sum()))
            if found.rows is None:
                mine_ns, raw = times_ns, found.all_raw if has_all else found.all_raw[keep]
            else:
                mine_ns, raw = times_ns[found.rows[keep]], found.all_raw[found.rows & keep]
            if self.route.is_j1939 and (meaning := _j1939_values(raw, plan.layout)) is not None:
                self.tally.not_available += int(len(meaning) - meaning.sum())
                mine_ns, raw = mine_ns[meaning], raw[meaning]
            self.tally.outside += _outside(raw, plan.layout)
            data: CountArray | FloatArray
            if plan.is_counts:
                data = raw.astype(np.int32)
            else:
                data = scaled(raw, plan.layout.scale, plan.layout.offset)
                finite = np.isfinite(data)
                if not finite.all():
                    self.tally.not_finite += int(len(finite) - finite.sum())
                    mine_ns, data = mine_ns[finite], data[finite]
            if len(mine_ns):
                pieces.append(SignalPiece(self.route, plan, mine_ns, data, is_irregular))
        self.tally.short += short
        return pieces


def _j1939_values(raw: RawArray, layout: SignalLayout) -> BoolArray | None:
    """Which raw values are measured ones; None if all are.

    Above 0xFA, 0xFAFF and 0xFAFFFFFF are errors, what is not available, and reserved ones (SAE J1939-71 5.1.4).
    """
    most = _J1939_MOST.get(layout.field.bits)
    if most is None or layout.field.is_signed or layout.field.is_float:
        return None
    is_value = raw <= most
    return None if is_value.all() else np.asarray(is_value, np.bool_)


def _outside(raw: RawArray, layout: SignalLayout) -> int:
    """How many values lie outside what the database states, by more than half a step."""
    if layout.span is None or not len(raw):
        return 0
    ends = scaled(np.array([raw.min(), raw.max()]), layout.scale, layout.offset)
    room = 0.5 * abs(layout.scale)
    least, most = layout.span[0] - room, layout.span[1] + room
    if least <= ends.min() and ends.max() <= most:
        return 0
    values = scaled(raw, layout.scale, layout.offset)
    return int(np.count_nonzero((values < least) | (values > most)))


class CanSamples:
    """Turns frames into samples; counters and grids continue from block to block.

    With `finds_pairs` the account says which messages without a counter have every frame twice, and which have another
    interval than the plan states. `is_live` is a bus: no frame there was sampled after it was received.
    """

    def __init__(self, plan: CanPlan, *, finds_pairs: bool = False, is_live: bool = False) -> None:
        self._states = [_RouteState(route, finds_pairs=finds_pairs, is_live=is_live) for route in plan.routes]
        keys = sorted({route.key for route in plan.routes})
        self._known = np.array(keys, np.uint32)
        self._pgns = np.array([key & ~OF_PGN for key in keys if key & OF_PGN], np.uint32)
        self._by_key = [[each for each in self._states if each.route.key == key] for key in keys]
        self._names = {id(route.message): _names(plan, route.message) for route in plan.routes}
        self._frames = 0
        self._unknown: Counter[int] = Counter()
        self._unrouted: Counter[int] = Counter()

    @property
    def counts(self) -> CanCounts:
        """Account of the frames so far."""
        met = tuple(each.count() for each in self._states if each.tally.frames)
        return CanCounts(self._frames, met, dict(sorted(self._unknown.items())), dict(self._unrouted))

    def take(self, block: FrameBlock) -> list[SignalPiece]:
        """Samples of a block, signal by signal; each signal's in order of time."""
        self._frames += len(block.t_ns)
        keys = block.arbitration_id if not len(self._pgns) else self._keys(block.arbitration_id)
        index = np.minimum(np.searchsorted(self._known, keys), len(self._known) - 1)
        is_known = self._known[index] == keys
        if not is_known.all():
            distinct, counts = np.unique(block.arbitration_id[~is_known], return_counts=True)
            self._unknown.update(dict(zip(distinct.tolist(), counts.tolist(), strict=True)))
        # numbers of 16 bits are sorted by their digits, ten times faster than by comparison
        slots = np.where(is_known, index, len(self._known)).astype(np.uint16)
        order = np.argsort(slots, kind="stable")
        ends = np.cumsum(np.bincount(slots, minlength=len(self._known) + 1))
        pieces: list[SignalPiece] = []
        begin = 0
        for states, end in zip(self._by_key, ends.tolist(), strict=False):
            if end > begin:
                rows = order[begin:end]
                octets = FrameBytes(block.data[rows], block.length[rows])
                source = block.arbitration_id[rows] & np.uint32(0xFF)
                decoded: dict[int, dict[str, Decoded]] = {}
                used = 0
                for state in states:
                    message = state.route.message
                    if id(message) not in decoded:
                        decoded[id(message)] = message.layout.decode(octets, self._names[id(message)])
                    used -= state.tally.frames
                    frames = _Frames(block.t_ns[rows], block.channel[rows], source, octets, decoded[id(message)])
                    pieces += state.take(frames)
                    used += state.tally.frames
                if used < len(rows):
                    self._unrouted[states[0].route.arbitration_id] += len(rows) - used
            begin = end
        return pieces

    def _keys(self, identifiers: IdArray) -> IdArray:
        """Keys of frames: the PGN's for J1939 messages of the plan, unless the identifier itself is planned."""
        pgns = pgn_keys(identifiers)
        is_j1939 = (identifiers & np.uint32(EXTENDED) != 0) & np.isin(pgns, self._pgns)
        is_j1939 &= ~np.isin(identifiers, self._known)
        return np.where(is_j1939, pgns | np.uint32(OF_PGN), identifiers)


def _names(plan: CanPlan, message: MessagePlan) -> list[str]:
    names = [signal.layout.name for signal in message.signals]
    names += [part.signal for part in (message.counter, message.checksum) if part is not None]
    names += [route.selector[0] for route in plan.routes if route.message is message and route.selector]
    return list(dict.fromkeys(names))


def _drop(keep: BoolArray, bad: BoolArray) -> int:
    """Drop the bad ones of what is kept; returns how many they are."""
    before = np.count_nonzero(keep)
    keep &= ~bad
    return int(before - np.count_nonzero(keep))
