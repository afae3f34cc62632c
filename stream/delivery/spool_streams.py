"""The streams of a spool, its frames between the messages, and its folder as an earlier process left it."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import msgspec

from stream.decoding import msgpack_decoder
from stream.delivery.spool_frames import ACKNOWLEDGED, FIRST_STREAM, TABLE, SpoolFrame, encode_frame, parse_frames
from stream.errors import DeliveryError
from stream.wire.acknowledgement import StreamId

SUFFIX = ".spool"
_FRAME_BYTES = (64 << 10, 4 << 20)  # more than asked for is read, to have the last frame whole


@dataclass
class StreamState:
    """State of one stream, whose frames carry `number`.

    `appended` and `acknowledged` are the numbers after its last message and after the last one that a recorder has.
    From number `base`, if not 0, it is sent under another epoch, because the messages before are lost. `lost` are the
    spans of numbers that cannot be read any more.
    """

    id: StreamId
    number: int
    appended: int = 0
    acknowledged: int = 0
    base: int = 0
    lost: list[tuple[int, int]] = field(default_factory=list)


class _Row(msgspec.Struct, array_like=True):
    number: int
    key: str
    epoch: str
    appended: int
    acknowledged: int
    base: int


class _Table(msgspec.Struct, array_like=True):
    store: str
    rows: list[_Row]


class _Acknowledged(msgspec.Struct, array_like=True):
    store: str
    positions: list[tuple[int, int]]


_table_decoder = msgpack_decoder(_Table)
_acknowledged_decoder = msgpack_decoder(_Acknowledged)


class StreamTable:
    """All streams of a spool, by name and by number."""

    def __init__(self) -> None:
        self.store = ""
        self.streams: dict[StreamId, StreamState] = {}
        self.by_number: dict[int, StreamState] = {}

    def add(self, stream: StreamId) -> StreamState:
        """Assign a number to a stream."""
        state = StreamState(stream, max(self.by_number, default=FIRST_STREAM - 1) + 1)
        self._put(state)
        return state

    def rows(self, states: Iterable[StreamState] | None = None) -> bytes:
        """A frame with the rows of these streams, by default of all."""
        chosen = self.streams.values() if states is None else states
        rows = [_Row(s.number, s.id.key, s.id.epoch, s.appended, s.acknowledged, s.base) for s in chosen]
        return encode_frame(TABLE, 0, 0, msgspec.msgpack.encode(_Table(self.store, rows)))

    def acknowledged(self, numbers: Iterable[int]) -> bytes:
        """A frame with the acknowledged positions of these streams."""
        positions = [(number, self.by_number[number].acknowledged) for number in numbers]
        return encode_frame(ACKNOWLEDGED, 0, 0, msgspec.msgpack.encode(_Acknowledged(self.store, positions)))

    def apply(self, frame: SpoolFrame) -> None:
        """Update the state of the streams from a frame."""
        if frame.number == TABLE:
            table = _table_decoder.decode(frame.payload)
            self.store = table.store or self.store
            for row in table.rows:
                self._apply_row(row)
        elif frame.number == ACKNOWLEDGED:
            acknowledged = _acknowledged_decoder.decode(frame.payload)
            self.store = acknowledged.store or self.store
            for number, next_seq in acknowledged.positions:
                if (state := self.by_number.get(number)) is not None:
                    state.acknowledged = max(state.acknowledged, next_seq)
        elif (state := self.by_number.get(frame.number)) is not None:
            if frame.seq > state.appended:
                state.lost.append((state.appended, frame.seq))
            state.appended = max(state.appended, frame.next_seq)

    def _put(self, state: StreamState) -> None:
        self.streams[state.id] = self.by_number[state.number] = state

    def _apply_row(self, row: _Row) -> None:
        state = self.by_number.get(row.number)
        if state is None:
            state = StreamState(StreamId(row.key, row.epoch), row.number, row.appended)
            self._put(state)
        if row.appended > state.appended:
            state.lost.append((state.appended, row.appended))
            state.appended = row.appended
        state.acknowledged = max(state.acknowledged, row.acknowledged)
        state.base = max(state.base, row.base)


class SpoolError(DeliveryError):
    """A spool that cannot be opened, written or read at the moment."""


class SpoolFull(SpoolError):
    """A spool that has reached its size."""


class SpooledMessage(NamedTuple):
    """A message read back."""

    stream: StreamId
    seq: int
    next_seq: int
    payload: bytes


@dataclass
class SpoolFile:
    """A file of a spool: `unread` messages after `read_to`, and the next number of each stream in it."""

    path: Path
    size: int = 0
    read_to: int = 0
    unread: int = 0
    last: dict[int, int] = field(default_factory=dict)

    def read(self, most_bytes: int) -> list[SpoolFrame]:
        """The next frames, about so many bytes, at least one if there is any."""
        left = self.size - self.read_to
        for length in (*(min(left, most_bytes + each) for each in _FRAME_BYTES), left):
            with self.path.open("rb") as opened:
                opened.seek(self.read_to)
                data = opened.read(length)
            parsed = parse_frames(data, is_end=length == left, most_bytes=most_bytes)
            if parsed.frames or length == left:
                break
        self.read_to += parsed.used
        return parsed.frames


@dataclass
class Scanned:
    """All files of a spool in order, the state of its streams, and its damages."""

    table: StreamTable = field(default_factory=StreamTable)
    files: list[SpoolFile] = field(default_factory=list)
    damages: list[str] = field(default_factory=list)


def scan(folder: Path) -> Scanned:
    """Read every file of a spool."""
    found = Scanned()
    for path in sorted(folder.glob(f"*{SUFFIX}")):
        data = path.read_bytes()
        file = SpoolFile(path, len(data))
        parsed = parse_frames(data, is_end=True)
        found.damages += [f"{path}: bytes {first} to {after} are damaged" for first, after in parsed.damaged]
        for frame in parsed.frames:
            try:
                found.table.apply(frame)
            except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:  # its checksum is right
                found.damages.append(f"{path}: a frame of the table of streams cannot be read: {error}")
            if frame.number >= FIRST_STREAM:
                file.unread += 1
                file.last[frame.number] = max(frame.next_seq, file.last.get(frame.number, 0))
        found.files.append(file)
    nameless = sum(number not in found.table.by_number for file in found.files for number in file.last)
    if nameless:
        found.damages.append(f"{folder}: the names of {nameless} streams are lost, their messages are kept")
    for state in found.table.streams.values():
        # what a recorder has is not lost
        state.lost = [span for span in state.lost if span[1] > max(state.acknowledged, state.base)]
        found.damages += [f"{state.id.key}: numbers {first} to {after - 1} are lost" for first, after in state.lost]
    return found


def held_messages(folder: Path) -> int:
    """Messages in a spool that no recorder has as far as known; SpoolError if it cannot be read. It may be in use."""
    try:
        found = scan(folder)
        known = found.table.by_number
        return sum(
            frame.number >= FIRST_STREAM
            and (frame.number not in known or frame.next_seq > known[frame.number].acknowledged)
            for file in found.files
            if any(n not in known or last > known[n].acknowledged for n, last in file.last.items())
            for frame in parse_frames(file.path.read_bytes(), is_end=True).frames
        )
    except FileNotFoundError:
        return 0  # the rest has just been acknowledged
    except OSError as error:
        raise SpoolError(f"the spool {folder} cannot be read: {error}") from error
