"""Frames of a gyro on a serial line (RS-422): found in the bytes, checked, decoded and placed in time."""

from collections.abc import Iterator
from dataclasses import dataclass
from uuid import UUID

import numpy as np

from ingest.checksums import SERIAL_CHECKSUM_BYTES, ByteArray, checksums
from ingest.serial.frame_layout import SIZES, FrameField, FrameLayout, floats, integers
from ingest.serial.frame_times import FrameTimes
from stream.batch import BoolArray, IntArray, SampleBatch

_REGULAR = 0.05  # of an interval: largest distance of times from an exact grid to be stored as one
_FIT_INT32 = {"u8", "i8", "u16", "i16", "u24", "i24", "i32"}


@dataclass
class SerialCounts:
    """Account of the bytes of a line; bad checksums and lengths are sync bytes that began no frame."""

    frames: int = 0
    bad_checksums: int = 0
    bad_lengths: int = 0
    dropped_bytes: int = 0  # bytes that belong to no frame
    lost: int = 0
    repeated: int = 0
    restarts: int = 0


class SerialFrames:
    """Decodes the bytes of one gyro.

    Bytes are read from left to right. Sync bytes followed by a legal length and the right checksum are a frame, and
    reading continues behind it; otherwise one byte is dropped. So every whole frame is found, unless bytes before it
    look like a frame themselves (sync, length and checksum) and reach into it; garbage without sync bytes cannot. The
    result does not depend on how the bytes are cut into pieces.

    >>> from ingest.serial.frame_layout import decode_layout
    >>> layout = decode_layout(b'''
    ... sync = "AA 55"
    ... length = 5
    ... interval_s = 0.01
    ... counter = {at = 2, type = "u8"}
    ... fields = [{signal = "rate", at = 3, type = "i16", scale = 0.01, unit = "deg/s"}]
    ... ''', "layout.toml")
    >>> frames = SerialFrames(layout, "FOG-1", "r1", UUID(int=1))
    >>> [batch] = frames.feed(bytes.fromhex("00 AA55 07 0064 AA55 08 FFFF AA"), 1_010_000_000)
    >>> batch.value_array.tolist(), batch.time_array.tolist(), frames.counts.dropped_bytes
    ([1.0, -0.01], [1000000000, 1010000000], 1)
    """

    def __init__(self, layout: FrameLayout, unit: str, run: str, epoch: UUID, *, is_live: bool = True) -> None:
        layout.check(f"unit {unit}: layout of its frames")
        self.layout = layout
        self.counts = SerialCounts()
        self._unit, self._run, self._epoch = unit, run, epoch
        self._sync = np.frombuffer(layout.sync_bytes, np.uint8)
        self._shortest = layout.shortest
        self._longest = layout.longest if layout.length is None else layout.length
        counter = layout.counter
        modulus = None if counter is None else counter.modulus or 256 ** SIZES[counter.type]
        self.times = FrameTimes(layout.interval_s, modulus, is_live=is_live)
        self._dt_ns = max(1, round(layout.interval_s * 1e9))
        self._kept = b""
        self._seq = 0

    def feed(self, data: bytes, t_ns: int) -> list[SampleBatch]:
        """Decode bytes, the last of which arrived at `t_ns`: a batch of each signal, none if no frame is complete."""
        return self._decode(self._kept + data, t_ns, is_last=False)

    def finish(self, t_ns: int) -> list[SampleBatch]:
        """No more bytes come: bytes that waited for the rest of a frame are searched for shorter ones."""
        return self._decode(self._kept, t_ns, is_last=True)

    def _decode(self, data: bytes, t_ns: int, *, is_last: bool) -> list[SampleBatch]:
        array = np.frombuffer(data, np.uint8)
        starts, consumed = self._find(array, is_last=is_last)
        self._kept = data[consumed:]
        if not starts:
            return []
        head = array[np.array(starts)[:, None] + np.arange(self._shortest)]
        counter = self.layout.counter
        numbers = None
        if counter is not None:
            numbers = integers(head, counter.at, counter.type, self.layout.order(counter))
            numbers %= counter.modulus or 256 ** SIZES[counter.type]
        placed = self.times.place(numbers, len(head), t_ns)
        self.counts.lost, self.counts.repeated = self.times.lost, self.times.repeated
        self.counts.restarts = self.times.restarts
        if not len(placed.times_ns):
            return []
        head = head[placed.is_new]
        batches = [self._batch(each, head, placed.times_ns) for each in self.layout.fields]
        self._seq += len(head)
        return batches

    def _batch(self, part: FrameField, head: ByteArray, times_ns: IntArray) -> SampleBatch:
        order = self.layout.order(part)
        counts = values = None
        scale, offset = part.scale, part.offset
        if part.type in _FIT_INT32:
            counts = integers(head, part.at, part.type, order).astype(np.int32)
        else:
            read = floats if part.type.startswith("float") else integers
            with np.errstate(over="ignore", invalid="ignore"):
                values = np.asarray(read(head, part.at, part.type, order) * scale + offset, np.float64)
            scale, offset = 1.0, 0.0
        grid = times_ns[0] + self._dt_ns * np.arange(len(times_ns), dtype=np.int64)
        is_wrong = self.times.is_wrong
        is_regular = not is_wrong and bool((np.abs(times_ns - grid) <= _REGULAR * self._dt_ns).all())
        return SampleBatch(
            self._unit, part.signal, self._run, self._epoch, self._seq, int(times_ns[0]), self._dt_ns, part.unit,
            counts=counts, values=values, times_ns=None if is_regular else times_ns, irregular=is_wrong, scale=scale,
            offset=offset,
        )  # fmt: skip

    def _find(self, data: ByteArray, *, is_last: bool) -> tuple[list[int], int]:
        """Check the candidates from left to right: where frames begin, and how many bytes are done with."""
        starts: list[int] = []
        end = 0  # of the last frame
        counts = self.counts
        for start, length, is_legal, is_whole, is_right in self._candidates(data):
            if start < end:
                continue
            if not is_legal:
                counts.bad_lengths += 1
            elif not is_whole and not is_last:
                consumed = start
                break
            elif is_whole and is_right:
                starts.append(start)
                counts.frames += 1
                counts.dropped_bytes -= length
                end = start + length
            elif is_whole:
                counts.bad_checksums += 1
        else:
            consumed = len(data) if is_last else self._rest(data, end)
        counts.dropped_bytes += consumed
        return starts, consumed

    def _rest(self, data: ByteArray, end: int) -> int:
        """Place where sync bytes may have begun at the end; the number of bytes if nowhere."""
        text = data[max(end, len(data) - len(self._sync) + 1) :].tobytes()
        sync = self.layout.sync_bytes
        for n in range(len(text), 0, -1):
            if text.endswith(sync[:n]):
                return len(data) - n
        return len(data)

    def _candidates(self, data: ByteArray) -> Iterator[tuple[int, int, bool, bool, bool]]:
        """Start and length (-1 where it is not known yet), and whether a frame there is legal, whole and right."""
        places = max(0, len(data) - len(self._sync) + 1)
        begins = np.ones(places, np.bool_)
        for i, byte in enumerate(self._sync):
            begins &= data[i : i + places] == byte
        starts = np.flatnonzero(begins)
        lengths = self._lengths(data, starts)
        is_legal = (lengths == -1) | ((lengths >= self._shortest) & (lengths <= self._longest))
        is_whole = is_legal & (lengths != -1) & (starts + lengths <= len(data))
        is_right = is_whole.copy()
        if self.layout.checksum is not None:
            for length in np.unique(lengths[is_whole]):
                these = np.flatnonzero(is_whole & (lengths == length))
                is_right[these] = self._is_right(data[starts[these][:, None] + np.arange(length)])
        return zip(*(each.tolist() for each in (starts, lengths, is_legal, is_whole, is_right)), strict=True)

    def _lengths(self, data: ByteArray, starts: IntArray) -> IntArray:
        number = self.layout.length_field
        if number is None:
            return np.full(len(starts), self._longest, np.int64)
        lengths = np.full(len(starts), -1, np.int64)
        known = starts + number.at + SIZES[number.type] <= len(data)
        head = data[starts[known][:, None] + np.arange(number.at + SIZES[number.type])]
        # -1 means not known yet: a negative length becomes 0, which is illegal too
        lengths[known] = np.maximum(0, integers(head, number.at, number.type, self.layout.order(number)) + number.add)
        return lengths

    def _is_right(self, frames: ByteArray) -> BoolArray:
        part = self.layout.checksum
        assert part is not None
        length = frames.shape[1]
        at = part.at % length if part.at < 0 else part.at
        kind = "u8" if SERIAL_CHECKSUM_BYTES[part.kind] == 1 else "u16"
        covered = frames[:, part.start : at if part.stop is None else part.stop]
        received = integers(frames, at, kind, self.layout.order(part))
        return np.asarray(checksums(part.kind, covered, part.initial) == received)
