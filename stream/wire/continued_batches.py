"""Batches that continue their streams exactly, as nearly all do, read many at a time.

To read a message alone takes longer than to estimate from a hundred samples. A stream's messages differ in their
number, time and counts only: everything before the number and between time and counts is compared with the bytes of
the message before, which was read and checked in full. Whatever differs is left to be read alone.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from stream.batch import CountArray, IntArray
from stream.bounds import MAX_MOMENT_NS, MAX_SEQ, MIN_MOMENT_NS
from stream.compiled import kernel
from stream.wire.count_residuals import MEAN_BYTES, expand

Bytes = npt.NDArray[np.uint8]

# tags of the wire form: field number << 3 | wire type
_SEQ, _SAMPLES, _T0_NS = 6 << 3, 7 << 3, 8 << 3
_RESIDUALS, _PROOF = 20 << 3 | 2, 19 << 3 | 2
_LARGEST_HEAD = 1024
# columns of the state of a stream
_NEXT_SEQ, _NEXT_NS, _DT_NS, _BORDER, _DUE_NS, _PREFIX, _MIDDLE = range(7)


class Continued(NamedTuple):
    """Messages that continue their streams: stream and samples of each, and number and time that follow it.

    `counts` are the bytes of all samples, 32 bits each, one message after another. If `is_crossing`, the last message
    reaches the border or the due time of its stream.
    """

    streams: list[int]
    samples: list[int]
    next_seqs: list[int]
    next_times_ns: list[int]
    counts: memoryview
    is_crossing: bool


class JoinedMessages:
    """Messages one after another, with the numbers of their streams; -1 for one that is to be read alone."""

    def __init__(self, payloads: Sequence[bytes], streams: Sequence[int]) -> None:
        self.data: Bytes = np.frombuffer(b"".join(payloads), np.uint8)
        self.ends: IntArray = np.cumsum(np.fromiter(map(len, payloads), np.int64, len(payloads)))
        self.streams: IntArray = np.array(streams, np.int64)


class StreamStates:
    """What is expected next of each stream that was read in full before, by the number that it was given."""

    def __init__(self) -> None:
        self._states = np.zeros((64, 7), np.int64)
        self._heads = np.zeros((64, _LARGEST_HEAD), np.uint8)
        self._known = 0

    def add(self) -> int:
        """Make room for a stream; its number."""
        number = self._known
        if number == len(self._states):
            self._states = np.concatenate([self._states, np.zeros_like(self._states)])
            self._heads = np.concatenate([self._heads, np.zeros_like(self._heads)])
        self._known += 1
        return number

    def expect(self, stream: int, payload: bytes, seq: int, t_ns: int, dt_ns: int, border: int, due_ns: int) -> None:
        """Expect messages like `payload` that continue with that number and time, and end before a border and time."""
        array = np.frombuffer(payload, np.uint8)
        prefix, middle, end = _layout(array)
        if prefix + end - middle > _LARGEST_HEAD:
            prefix = 0
        head = self._heads[stream]
        head[:prefix] = array[:prefix]
        head[prefix : prefix + end - middle] = array[middle:end] if prefix else 0
        self._states[stream] = (seq, t_ns, dt_ns, border, due_ns, prefix, end - middle)

    def continues(self, stream: int, seq: int, t_ns: int, border: int, due_ns: int) -> None:
        """Expect another number, time, border and due time of a stream whose messages keep their form."""
        self._states[stream, _NEXT_SEQ] = seq
        self._states[stream, _NEXT_NS] = t_ns
        self._states[stream, _BORDER] = border
        self._states[stream, _DUE_NS] = due_ns

    def forget(self, stream: int) -> None:
        """Expect nothing of a stream."""
        self._states[stream, _PREFIX] = 0

    def read(self, messages: JoinedMessages, first: int) -> Continued:
        """Read messages from the first on, up to one that does not continue its stream, or crosses its border."""
        data, ends, streams = messages.data, messages.ends, messages.streams
        left = len(ends) - first
        found = np.empty((3, left), np.int64)
        counts = np.empty(len(data) - (int(ends[first - 1]) if first else 0), np.int32)
        read, samples, is_crossing = _read(data, ends, streams, first, self._states, self._heads, found, counts)
        sizes, seqs, times = found[:, :read].tolist()
        whole = counts[:samples].data.cast("B")
        return Continued(streams[first : first + read].tolist(), sizes, seqs, times, whole, is_crossing)


@kernel
def _varint(data: Bytes, at: int, end: int) -> tuple[int, int]:
    """A number and the place after it; -1 as the place where there is none."""
    value = np.uint64(0)
    shift = np.uint64(0)
    for _ in range(10):
        if at >= end:
            return 0, -1
        byte = np.uint64(data[at])
        value |= (byte & np.uint64(127)) << shift
        at += 1
        if byte < np.uint64(128):
            return int(np.int64(value)), at
        shift += np.uint64(7)
    return 0, -1


@kernel
def _layout(data: Bytes) -> tuple[int, int, int]:
    """Where the number of a message begins, and where what lies between time and counts begins and ends.

    0, 0, 0 where the message has other fields than those, or not in their order.
    """
    end = data.shape[0]
    at = prefix = middle = before = 0
    while at < end:
        start = at
        tag, at = _varint(data, at, end)
        field, kind = tag >> 3, tag & 7
        if at < 0 or field <= before or 10 <= field <= 11 or field == 13 or 16 <= field <= 19:
            return 0, 0, 0
        before = field
        if field == 6:
            prefix = start
        if field == 20:
            return (prefix, middle, start) if prefix and middle else (0, 0, 0)
        value = 0
        if kind == 0:
            _, at = _varint(data, at, end)
        elif kind == 2:
            value, at = _varint(data, at, end)
        elif kind == 1:
            value = 8
        if at < 0 or kind > 2 or not 0 <= value <= end - at:
            return 0, 0, 0
        at += value
        if field == 8:
            middle = at
    return 0, 0, 0


@kernel
def _numbers(data: Bytes, at: int, end: int) -> tuple[int, int, int, int]:
    """Number, samples and time of a message, and the place after them; -1 as the place where it has others."""
    if at >= end or data[at] != _SEQ:
        return 0, 0, 0, -1
    seq, at = _varint(data, at + 1, end)
    if at < 0 or at >= end or data[at] != _SAMPLES:
        return 0, 0, 0, -1
    n, at = _varint(data, at + 1, end)
    if at < 0 or at >= end or data[at] != _T0_NS:
        return 0, 0, 0, -1
    t0_ns, at = _varint(data, at + 1, end)
    return seq, n, t0_ns, at


@kernel
def _residuals(data: Bytes, at: int, end: int, n: int) -> tuple[int, int]:
    """Where the residuals of a message begin, and their planes, 0 unless they are whole and nothing follows.

    A proof may follow: the recorder checks it.
    """
    tag, at = _varint(data, at, end)
    if at < 0 or tag != _RESIDUALS:
        return 0, 0
    length, at = _varint(data, at, end)
    planes = 0 if n < 1 else (length - MEAN_BYTES) // n
    if at < 0 or not 1 <= planes <= 4 or length != MEAN_BYTES + planes * n or length > end - at:
        return 0, 0
    rest = at + length
    if rest < end:
        tag, rest = _varint(data, rest, end)
        if rest < 0 or tag != _PROOF:
            return 0, 0
        proof, rest = _varint(data, rest, end)
        if rest < 0 or proof != end - rest:
            return 0, 0
    return at, planes


@kernel
def _same(data: Bytes, at: int, head: Bytes) -> bool:
    differs = np.uint8(0)
    for i in range(head.shape[0]):
        differs |= data[at + i] ^ head[i]
    return bool(differs == 0)


@kernel
def _read(
    data: Bytes, ends: IntArray, streams: IntArray, first: int, states: IntArray, heads: Bytes, found: IntArray,
    counts: CountArray,
) -> tuple[int, int, bool]:  # fmt: skip
    """Read messages one after another; how many, their samples, and whether the last crosses a border."""
    begin = 0 if first == 0 else ends[first - 1]
    written = 0
    for message in range(ends.shape[0] - first):
        end, stream = ends[first + message], streams[first + message]
        if stream < 0:
            return message, written, False
        state = states[stream]
        prefix, middle = state[_PREFIX], state[_MIDDLE]
        if prefix == 0 or begin + prefix + middle >= end or not _same(data, begin, heads[stream, :prefix]):
            return message, written, False
        seq, n, t0_ns, at = _numbers(data, begin + prefix, end)
        if at < 0 or at + middle >= end or not _same(data, at, heads[stream, prefix : prefix + middle]):
            return message, written, False
        residuals, planes = _residuals(data, at + middle, end, n)
        last_ns = t0_ns + (n - 1) * state[_DT_NS]
        is_next = seq == state[_NEXT_SEQ] and t0_ns == state[_NEXT_NS]
        is_within = seq + n < state[_BORDER] and last_ns < state[_DUE_NS]
        is_bounded = seq <= MAX_SEQ - n and t0_ns >= MIN_MOMENT_NS and last_ns <= MAX_MOMENT_NS
        if planes == 0 or not (is_next and is_bounded):
            return message, written, False
        expand(data, residuals, counts[written : written + n], planes)
        written += n
        state[_NEXT_SEQ] = found[1, message] = seq + n
        state[_NEXT_NS] = found[2, message] = last_ns + state[_DT_NS]
        found[0, message] = n
        if not is_within:
            return message + 1, written, True
        begin = end
    return ends.shape[0] - first, written, False
