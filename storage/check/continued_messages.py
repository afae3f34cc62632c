"""Messages that continue their streams, followed in the bytes of a chunk: to read one in full takes five times longer.

All of a message but its number, its first time and its samples is the same as in the one before it of its stream, which
was read and checked in full: then it is compared, and only what differs is looked at. What does not continue its stream
in the same form is left to be read alone, so that both ways find the same.
"""

from typing import NamedTuple

from storage.log.sequence import LogPlace, SequenceCheck
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
# below 2**62 ns
_TIME_BYTES = 9
_MORE = int.from_bytes(b"\x80" * 8 + b"\x00", "little")
_MORE_OR_LARGE = int.from_bytes(b"\x80" * 8 + b"\xc0", "little")
# a stream whose messages did not continue so many times is tried again rarely: to learn a form takes time
_TRIED, _RARELY = 4, 64


class _Field(NamedTuple):
    number: int
    begin: int
    value: int  # of a number
    content: int  # where the bytes begin
    end: int


class _Form:
    """What is the same in all messages of a stream, and what the last one has reached."""

    def __init__(self, place: LogPlace, span_ns: int, prefix: bytes, count: bytes) -> None:
        self.stream, self.samples, self.next_seq, self.span_ns = place.stream, place.samples, place.next_seq, span_ns
        self.prefix, self.count = prefix, count
        self.tails: dict[int, bytes] = {}  # from the time to the samples, by the bytes from there to the end
        self.proof, self.proof_bytes = b"", 0  # how the proof after the samples begins, and its length
        self.time = b""  # of the last message that was followed


class ContinuedMessages:
    """Follows messages that continue their streams, for a `SequenceCheck`, which has what they reach after `settle`."""

    def __init__(self, check: SequenceCheck) -> None:
        self._check = check
        self._forms: dict[str, _Form] = {}
        self._tried: dict[str, int] = {}

    def follow(self, topic: str, content: bytes, begin: int, end: int) -> int:
        """Samples of a message that continues its stream; 0 if it is to be read alone."""
        form = self._forms.get(topic)
        if form is None:
            return 0
        head = form.prefix + varint(form.next_seq) + form.count
        at = begin + len(head)
        if not content.startswith(head, begin):
            return 0
        time = content[at : at + _TIME_BYTES]
        at += _TIME_BYTES
        tail = form.tails.get(end - at)
        if tail is None or int.from_bytes(time, "little") & _MORE_OR_LARGE != _MORE or not content.startswith(tail, at):
            return 0
        if form.proof and not content.startswith(form.proof, end - form.proof_bytes):
            return 0
        form.time = time
        form.next_seq += form.samples
        return form.samples

    def settle(self, topic: str) -> None:
        """Let the check have what the stream of a topic has reached, and expect nothing more of it."""
        form = self._forms.pop(topic, None)
        if form is not None and form.time:
            self._settle(topic, form)

    def settle_all(self) -> None:
        """The same of all streams, which are still expected to continue."""
        for topic, form in self._forms.items():
            if form.time:
                self._settle(topic, form)

    def _settle(self, topic: str, form: _Form) -> None:
        self._tried[topic] = 0
        self._check.skip_to(form.stream, form.next_seq, _number(form.time) + form.span_ns)
        form.time = b""

    def drop_stale(self) -> None:
        """Expect nothing of streams of which the check has learnt otherwise what they have reached."""
        reached = self._check.next_seq
        for topic in [each for each, form in self._forms.items() if reached.get(form.stream) != form.next_seq]:
            del self._forms[topic]

    def expect(self, record: LogRecord, place: LogPlace) -> None:
        """Expect messages like this one, which was read alone."""
        tried = self._tried.get(record.topic, 0)
        self._tried[record.topic] = tried + 1
        if tried >= _TRIED and tried % _RARELY:
            return
        if record.schema != SAMPLES or self._check.next_seq[place.stream] != place.next_seq:
            return
        form = _form_of(record.data, place)
        if form is not None:
            self._forms[record.topic] = form


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


def _form_of(data: bytes, place: LogPlace) -> _Form | None:
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
    if not is_small or seq.value != place.seq or samples != place.samples:
        return None
    middle = data[time.end : array.begin]
    sizes = [8 * samples] if array.number == _VALUES else [MEAN_BYTES + planes * samples for planes in range(1, 5)]
    count = data[by_number[_COUNT].begin : time.content]
    form = _Form(place, span_ns, data[: seq.content], count)
    if proof is not None:
        form.proof, form.proof_bytes = data[proof.begin : proof.content], proof.end - proof.begin
    for size in sizes:
        tail = middle + varint(array.number << 3 | _BYTES) + varint(size)
        form.tails[len(tail) + size + form.proof_bytes] = tail
    return form
