"""Forms of messages that continue their streams: to read one in full takes five times longer than to compare it.

All of a message but its number, its first time and its samples is the same as in the one before it of its stream, which
was read and checked in full: then its bytes are compared, and only what differs is looked at. What does not continue
its stream in the same form is left to be read alone, so that both ways find the same.
"""

from typing import NamedTuple

from storage.log.sequence import LogPlace
from storage.segments.records import SAMPLES, LogRecord
from stream.wire.count_residuals import MEAN_BYTES
from stream.wire.encoder import varint

# fields of the wire form: numbers and kinds
_SEQ, _COUNT, _T0_NS, _DT_NS, _VALUES, _PROOF, _RESIDUALS = 6, 7, 8, 9, 16, 19, 20
_NUMBER, _REAL, _BYTES = 0, 1, 2
_PLAIN = frozenset({1, 2, 3, 4, 5, _SEQ, _COUNT, _T0_NS, _DT_NS, 10, 12, 14, 15, _VALUES, _RESIDUALS})
_LARGEST_SEQ = 1 << 60
_LARGEST_SPAN_NS = 1 << 62
# a time of today has 9 groups of 7 bits, all but the last with a bit that more follow; below 64 in the last group it is
# below 2**62 ns. A time before 1970 has 10
_MOST_TIME_BYTES = 9
# groups of 7, 14 and 28 bits, every second one, in 72 bits
_EVEN_7, _ODD_7 = int.from_bytes(b"\x7f\x00" * 4 + b"\x7f", "little"), int.from_bytes(b"\x00\x7f" * 4, "little")
_EVEN_14, _ODD_14 = 0x3FFF | 0x3FFF << 32 | 0x3FFF << 64, 0x3FFF << 16 | 0x3FFF << 48
_EVEN_28 = 0x0FFFFFFF
# a stream whose messages did not continue so many times is tried again rarely: to learn a form takes time
_TRIED, _RARELY = 4, 64


class _Field(NamedTuple):
    number: int
    begin: int
    value: int  # of a number
    content: int  # where the bytes begin
    end: int


class MessageForm:
    """What is the same in all messages of a stream, and what the last one has reached.

    `stream`, `samples` of each message, `next_seq`, and `span_ns` from its first sample to its last one. `has_followed`
    tells whether a message has continued it; then `t0_ns` is the time of its first sample, and `data` is where the
    bytes of its samples begin and end.
    """

    __slots__ = (
        "_count", "_mask", "_more", "_prefix", "_proof", "_proof_bytes", "_tails", "_time", "_time_bytes", "data",
        "next_seq", "samples", "span_ns", "stream",
    )  # fmt: skip

    def __init__(self, place: LogPlace, span_ns: int, prefix: bytes, count: bytes, time_bytes: int) -> None:
        self.stream, self.samples, self.next_seq, self.span_ns = place.stream, place.samples, place.next_seq, span_ns
        self._prefix, self._count = prefix, count
        self._tails: dict[int, bytes] = {}  # from the time to the samples, by the bytes from there to the end
        self._proof, self._proof_bytes = b"", 0  # how the proof after the samples begins, and its length
        self._time = b""  # of the last message that was followed
        self.data = (0, 0)
        self._time_bytes = time_bytes
        self._more = int.from_bytes(b"\x80" * (time_bytes - 1), "little")
        last = b"\xc0" if time_bytes == _MOST_TIME_BYTES else b"\x80"
        self._mask = int.from_bytes(b"\x80" * (time_bytes - 1) + last, "little")

    def follow(self, content: bytes, begin: int, end: int) -> bool:
        """Whether a message continues the stream in this form; then it is the last one."""
        head = self._prefix + varint(self.next_seq) + self._count
        at = begin + len(head)
        if not content.startswith(head, begin):
            return False
        time = content[at : at + self._time_bytes]
        at += self._time_bytes
        tail = self._tails.get(end - at)
        if tail is None or int.from_bytes(time, "little") & self._mask != self._more:
            return False
        if not content.startswith(tail, at):
            return False
        if self._proof and not content.startswith(self._proof, end - self._proof_bytes):
            return False
        self._time = time
        self.data = at + len(tail), end - self._proof_bytes
        self.next_seq += self.samples
        return True

    @property
    def has_followed(self) -> bool:
        """Whether a message has continued it since it was learnt, or since `settle`."""
        return bool(self._time)

    @property
    def t0_ns(self) -> int:
        """Time of the first sample of the last message."""
        groups = int.from_bytes(self._time, "little")
        groups = (groups & _EVEN_7) | (groups & _ODD_7) >> 1
        groups = (groups & _EVEN_14) | (groups & _ODD_14) >> 2
        return (groups & _EVEN_28) | (groups >> 32 & _EVEN_28) << 28 | groups >> 64 << 56

    def settle(self) -> None:
        """What it has reached is known."""
        self._time = b""

    @classmethod
    def of(cls, data: bytes, place: LogPlace) -> "MessageForm | None":
        """The form of a stream's messages; None if they have other fields, in another order, or numbers too large."""
        fields = _fields(data)
        proof = fields.pop() if fields[-1].number == _PROOF else None
        by_number = {each.number: each for each in fields}
        numbers = list(by_number)
        is_plain = len(by_number) == len(fields) and numbers == sorted(numbers) and _PLAIN.issuperset(numbers)
        if not is_plain or not {_SEQ, _COUNT, _T0_NS, _DT_NS} <= by_number.keys():
            return None
        array, seq, time = fields[-1], by_number[_SEQ], by_number[_T0_NS]
        samples, dt_ns = by_number[_COUNT].value, by_number[_DT_NS].value
        span_ns = (samples - 1) * dt_ns
        if numbers[-1] not in {_VALUES, _RESIDUALS} or (numbers[-1] == _RESIDUALS and _VALUES in by_number):
            return None
        is_small = place.next_seq <= _LARGEST_SEQ and span_ns <= _LARGEST_SPAN_NS
        is_small &= time.end - time.content <= _MOST_TIME_BYTES
        if not is_small or seq.value != place.seq or samples != place.samples:
            return None
        middle = data[time.end : array.begin]
        sizes = [8 * samples] if array.number == _VALUES else [MEAN_BYTES + planes * samples for planes in range(1, 5)]
        count = data[by_number[_COUNT].begin : time.content]
        form = cls(place, span_ns, data[: seq.content], count, time.end - time.content)
        if proof is not None:
            form._proof, form._proof_bytes = data[proof.begin : proof.content], proof.end - proof.begin
        for size in sizes:
            tail = middle + varint(array.number << 3 | _BYTES) + varint(size)
            form._tails[len(tail) + size + form._proof_bytes] = tail
        return form


class MessageForms:
    """Forms of the streams of many topics, the last stream of each."""

    def __init__(self) -> None:
        self.by_topic: dict[str, MessageForm] = {}
        self._tried: dict[str, int] = {}

    def forget(self, topic: str) -> MessageForm | None:
        """Expect nothing more of a topic; its form, if there was one."""
        form = self.by_topic.pop(topic, None)
        if form is not None and form.has_followed:
            self.succeeded(topic)
        return form

    def succeeded(self, topic: str) -> None:
        """The form of a topic was followed: the next one is learnt at once."""
        self._tried[topic] = 0

    def learn(self, record: LogRecord, place: LogPlace) -> None:
        """Expect messages like this one, which was read alone."""
        tried = self._tried.get(record.topic, 0)
        self._tried[record.topic] = tried + 1
        if record.schema != SAMPLES or (tried >= _TRIED and tried % _RARELY):
            return
        form = MessageForm.of(record.data, place)
        if form is not None:
            self.by_topic[record.topic] = form


def _number(data: bytes) -> int:
    return sum((each & 127) << 7 * place for place, each in enumerate(data))


def _fields(data: bytes) -> list[_Field]:
    """Fields of a message that was read before, in their order; ValueError if one has another kind."""
    found, at = [], 0
    while at < len(data):
        begin = at
        tag, at = _varint_at(data, at)
        number, kind = tag >> 3, tag & 7
        if kind == _NUMBER:
            value, end = _varint_at(data, at)
        elif kind == _REAL:
            value, end = 0, at + 8
        elif kind == _BYTES:
            value, at = _varint_at(data, at)
            end = at + value
        else:
            raise ValueError(f"field {number} has the kind {kind}")
        found.append(_Field(number, begin, value, at, end))
        at = end
    return found


def _varint_at(data: bytes, at: int) -> tuple[int, int]:
    end = at
    if data[at] < 128:
        return data[at], at + 1
    while data[end] > 127:
        end += 1
    return _number(data[at : end + 1]), end + 1
