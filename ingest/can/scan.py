"""Survey of a CAN log: its messages, their rates, signals that vary, and a first mapping."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ingest.can.database import MessageIndex, is_j1939, load_database, own_names
from ingest.can.decode import FrameBytes, MessageLayout, why_unusable
from ingest.can.frames import EXTENDED, FrameBlock
from ingest.can.logs.can_log import CanLog
from ingest.tables.units import database_unit
from stream.batch import IntArray

if TYPE_CHECKING:
    from cantools.database.can import Message

# A field that increases by one from frame to frame at least this often, and wraps around, counts frames.
_COUNTER_SHARE = 0.9
_COUNTER_FRAMES = 20
_COUNTER_BITS = 16
_OF_COUNTERS = frozenset({"1", "count", "LSB"})
_AS_A_COUNTER = "it rises by one from frame to frame and starts again, as a counter of frames does"


@dataclass(frozen=True)
class SignalScan:
    """One signal of the database in the frames of the log."""

    name: str
    unit_of_measure: str
    is_known: bool  # whether the unit of measure is known
    least: float | None  # range of its values; None if it never came
    most: float | None
    varies: bool
    looks_like_counter: bool  # whether it is a plain number that increases by one from frame to frame
    selects_page: bool = False  # whether it says which signals a frame has: pages in turn look like a counter


@dataclass(frozen=True)
class IdScan:
    """One arbitration id on one channel."""

    arbitration_id: int  # without bit 31
    is_extended: bool  # whether it is of 29 bits
    channel: int
    frames: int
    rate_hz: float | None  # frames a second, by the median interval; None for a lone frame
    longest_s: float | None  # longest interval, seconds
    lengths: tuple[int, ...]
    message: str | None  # name in the database; None if it is not there
    signals: tuple[SignalScan, ...]
    source: int | None = None  # J1939 source address; None for other messages

    @property
    def wanted(self) -> list[SignalScan]:
        """Signals that a mapping takes: those that vary, without counters of frames and selectors of pages."""
        return [each for each in self.signals if each.varies and not (each.looks_like_counter or each.selects_page)]

    @property
    def counter(self) -> SignalScan | None:
        """The signal that is taken as the counter of the frames."""
        counters = [each for each in self.signals if each.looks_like_counter]
        return min(counters, key=lambda each: each.most or 0.0, default=None)

    def why_left_out(self, signal: SignalScan) -> str:
        """Why a mapping leaves a signal out; empty for one that it takes."""
        if signal.selects_page:
            return "it says which signals a frame has"
        if signal.looks_like_counter:
            return _AS_A_COUNTER
        return "" if signal.varies else "it never changes here" if signal.least is not None else "it never comes here"


@dataclass(frozen=True)
class LogScan:
    """A log as a whole."""

    file: str
    frames: int
    error_frames: int
    remote_frames: int
    echoes: int  # left out, as they repeat a frame of the other direction
    seconds: float
    date_known: bool
    damage: str
    ids: tuple[IdScan, ...]

    @property
    def unknown(self) -> tuple[IdScan, ...]:
        """Ids that are not in the database."""
        return tuple(each for each in self.ids if each.message is None)

    @property
    def by_message(self) -> dict[str, tuple[IdScan, list[IdScan]]]:
        """Of each message of the database the id with most frames, and its other ids and channels."""
        found: dict[str, list[IdScan]] = {}
        for each in self.ids:
            if each.message is not None:
                found.setdefault(each.message, []).append(each)
        busiest = {message: max(ids, key=lambda each: each.frames) for message, ids in found.items()}
        return {
            message: (most, [each for each in found[message] if each is not most]) for message, most in busiest.items()
        }


@dataclass
class _Range:
    least: float = np.inf
    most: float = -np.inf
    last: int | None = None
    steps: int = 0
    ups: int = 0
    turns: int = 0

    def add(self, raw: Any, bits: int) -> None:
        finite = raw[np.isfinite(raw)]
        if not len(finite):
            return
        self.least, self.most = min(self.least, float(finite.min())), max(self.most, float(finite.max()))
        if raw.dtype.kind == "f" or bits > _COUNTER_BITS:
            return
        steps = np.diff(raw, prepend=raw[0] - 1 if self.last is None else self.last)
        self.last = int(raw[-1])
        self.steps += len(steps)
        self.ups += int((steps == 1).sum())
        self.turns += int((steps < 0).sum())

    def is_counter(self) -> bool:
        """Whether it increases by one nearly always, and decreases only where it wraps around."""
        if self.steps < _COUNTER_FRAMES or self.most - self.least < 2 or not self.turns:
            return False
        return self.ups + self.turns >= _COUNTER_SHARE * self.steps and self.ups > 2 * self.turns - 1


@dataclass
class _IdFrames:
    times_ns: list[IntArray] = field(default_factory=list)
    lengths: set[int] = field(default_factory=set)
    ranges: dict[str, _Range] = field(default_factory=dict)


def scan_log(path: Path, databases: Sequence[Path], progress: Callable[[float], None] | None = None) -> LogScan:
    """Survey a log by its CAN databases; raises BadInput if a file cannot be read."""
    messages = MessageIndex(message for path in databases for message in load_database(path))
    layouts: dict[int, MessageLayout | None] = {}
    log = CanLog(path)
    seen: dict[tuple[int, int], _IdFrames] = {}
    for block in log.blocks(progress):
        _add_block(block, messages, layouts, seen)
    times_ns = [int(each.times_ns[i][j]) for each in seen.values() for i, j in ((0, 0), (-1, -1))]
    return LogScan(
        file=str(path), frames=log.counts.data, error_frames=log.counts.errors, remote_frames=log.counts.remote,
        echoes=log.counts.echoes,
        seconds=(max(times_ns) - min(times_ns)) / 1e9 if times_ns else 0.0,
        date_known=bool(times_ns) and min(times_ns) >= 10**17, damage=log.damage,
        ids=tuple(_id_scan(key, each, messages.find(key[0])) for key, each in sorted(seen.items())),
    )  # fmt: skip


def mapping_text(scan: LogScan, databases: Sequence[Path], unit: str | None) -> str:
    """A mapping file (TOML) of the signals that vary in the log, for the user to edit."""
    names = own_names([message for path in databases for message in load_database(path)])
    lines = [f"# proposed from {Path(scan.file).name}: rename signals, strike out what is not wanted"]
    for message, (busiest, others) in scan.by_message.items():
        if not busiest.wanted:
            lines += [
                "",
                f"# message {_quoted(message)} is left out: no signal of it varies, but counters and selectors",
            ]
            continue
        lines += ["", "[[message]]", f"message = {_quoted(message)}"]
        lines += [f"unit = {_quoted(unit)}"] if unit else []
        if channels := sorted({each.channel for each in others} - {busiest.channel}):
            lines.append(f"channel = {busiest.channel}  # it comes on {', '.join(map(str, channels))} as well")
        if sources := sorted({each.source for each in others if each.source is not None} - {busiest.source}):
            listed = ", ".join(f"0x{source:02x}" for source in sources)
            lines.append(f"source = 0x{busiest.source:02x}  # it comes from {listed} as well")
        counter = busiest.counter
        if counter is not None and counter.most is not None:
            lines.append(f"counter = {{ signal = {_quoted(counter.name)}, modulus = {int(counter.most) + 1} }}")
        if busiest.rate_hz is not None and counter is not None:
            lines.append(f"# interval_s = {1 / busiest.rate_hz:.6g}  # median; with the counter it makes an exact grid")
        lines.append("[message.signals]")
        for signal in busiest.wanted:
            remark = "" if signal.is_known else f"  # unit of measure {signal.unit_of_measure!r} is not known"
            lines.append(f"{_quoted(signal.name)} = {_quoted(names[message, signal.name])}{remark}")
        for signal in busiest.signals:
            if why := busiest.why_left_out(signal):
                lines.append(f"# {_quoted(signal.name)} = {_quoted(names[message, signal.name])}  # left out: {why}")
    return "\n".join(lines) + "\n"


def counter_remarks(scan: LogScan) -> list[str]:
    """What a reader must know of signals that a mapping leaves out because they look like counters of frames."""
    remarks = []
    for message, (busiest, _) in scan.by_message.items():
        for signal in busiest.signals:
            if not signal.looks_like_counter:
                continue
            is_taken = signal is busiest.counter and busiest.wanted
            what = "is taken as the counter of the frames and is no signal" if is_taken else "is left out"
            how = "remove the # before its line in the mapping" if busiest.wanted else "write a mapping that names it"
            also = ", and the line counter = ... if it counts no frames" if is_taken else ""
            remarks.append(
                f"message {message}, signal {signal.name}: {what}, as {_AS_A_COUNTER}; to import it, {how}{also}"
            )
    return remarks


def _add_block(
    block: FrameBlock, messages: MessageIndex, layouts: dict[int, MessageLayout | None],
    seen: dict[tuple[int, int], _IdFrames],
) -> None:  # fmt: skip
    keys = block.arbitration_id.astype(np.int64) << 16 | (block.channel.astype(np.int64) & 0xFFFF)
    distinct, inverse = np.unique(keys, return_inverse=True)
    for number, key in enumerate(distinct.tolist()):
        rows = np.flatnonzero(inverse == number)
        found = seen.setdefault((key >> 16, int(block.channel[rows[0]])), _IdFrames())
        found.times_ns.append(block.t_ns[rows])
        found.lengths.update(np.unique(block.length[rows]).tolist())
        if key >> 16 not in layouts:
            message = messages.find(key >> 16)
            layouts[key >> 16] = None if message is None else MessageLayout.of(message)
        layout = layouts[key >> 16]
        if layout is None:
            continue
        decoded = layout.decode(FrameBytes(block.data[rows], block.length[rows]), list(layout.signals))
        for name, each in decoded.items():
            if len(each.raw):
                found.ranges.setdefault(name, _Range()).add(each.raw, layout.signals[name].field.bits)


def _id_scan(key: tuple[int, int], seen: _IdFrames, message: "Message | None") -> IdScan:
    times_ns = np.concatenate(seen.times_ns)
    intervals_ns = np.diff(times_ns)
    median_ns = float(np.median(intervals_ns)) if len(intervals_ns) else 0.0
    signals = []
    for signal in [] if message is None else message.signals:
        if why_unusable(signal) is not None:
            continue
        measure, is_known = database_unit(signal.unit, signal.name)
        found = seen.ranges.get(signal.name, _Range())
        scale, offset = float(signal.conversion.scale), float(signal.conversion.offset)
        came = found.least <= found.most
        least, most = sorted(end * scale + offset for end in (found.least, found.most)) if came else (None, None)
        varies = came and found.least < found.most
        is_selector = bool(signal.is_multiplexer)
        is_number = measure in _OF_COUNTERS or not is_known
        is_counter = is_number and scale == 1.0 and offset == 0.0 and not is_selector and found.is_counter()
        signals.append(SignalScan(signal.name, measure, is_known, least, most, varies, is_counter, is_selector))
    return IdScan(
        key[0] & ~EXTENDED, bool(key[0] & EXTENDED), key[1], len(times_ns), 1e9 / median_ns if median_ns > 0 else None,
        float(intervals_ns.max()) / 1e9 if len(intervals_ns) else None, tuple(sorted(seen.lengths)),
        None if message is None else message.name, tuple(signals),
        key[0] & 0xFF if message is not None and is_j1939(message) else None,
    )  # fmt: skip


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)  # JSON's escapes are TOML's
