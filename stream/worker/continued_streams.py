"""Streams whose messages continue them: their samples go straight to the buffers of their signals."""

from collections.abc import Iterable
from itertools import islice
from typing import TYPE_CHECKING, NamedTuple

from stream.wire.acknowledgement import StreamId
from stream.wire.batches import WireBatch
from stream.wire.continued_batches import JoinedMessages, StreamStates

if TYPE_CHECKING:
    from stream.worker.signal_analysis import SignalAnalysis

_BYTES_A_COUNT = 4


class Taken(NamedTuple):
    """Messages and samples that were read; the last of them with its analysis where it completes a piece."""

    messages: int
    samples: int
    completing: "tuple[SignalAnalysis, WireBatch] | None" = None


class ContinuedStreams:
    """Appends messages that continue their streams exactly to the buffers; all others are left to be read alone.

    A signal is continued by one stream at a time, by the last of which a message was read alone.
    """

    def __init__(self) -> None:
        self._states = StreamStates()
        self._numbers: dict[str, int] = {}  # by key expression
        self._targets: dict[int, tuple[StreamId, SignalAnalysis]] = {}  # by number
        self._of_signal: dict[tuple[str, str, str], int] = {}
        self._unused: list[int] = []
        self._released: list[int] = []  # messages that were joined before may still have them

    def numbers(self, keys: Iterable[str]) -> list[int]:
        """Numbers of the streams of key expressions; -1 where a message must be read alone."""
        self._unused += self._released
        self._released = []
        known = self._numbers
        return [known.get(key, -1) for key in keys]

    def expect(self, stream: StreamId, analysis: "SignalAnalysis", payload: bytes) -> None:
        """Expect messages that continue a signal, which has just taken in `payload`."""
        number = self._numbers.get(stream.key)
        if self._of_signal.get(analysis.name) != number:
            self.forget(analysis)
        pieces = analysis.pieces
        if not pieces.is_plain:
            self.forget(analysis)
            return
        if number is None:
            number = self._unused.pop() if self._unused else self._states.add()
        elif number in self._targets:
            self._of_signal.pop(self._targets[number][1].name, None)
        self._numbers[stream.key], self._of_signal[analysis.name] = number, number
        self._targets[number] = stream, analysis
        self._states.expect(
            number, payload, pieces.next_seq, pieces.next_ns, pieces.interval_ns, pieces.border, pieces.due_ns
        )

    def forget(self, analysis: "SignalAnalysis") -> None:
        """Expect nothing more for a signal."""
        number = self._of_signal.pop(analysis.name, None)
        if number is not None:
            self._states.forget(number)
            stream, _ = self._targets.pop(number)
            del self._numbers[stream.key]
            self._released.append(number)

    def take(self, messages: JoinedMessages, first: int, positions: dict[StreamId, int]) -> Taken:
        """Append messages from the first on, up to one that must be read alone or completes a piece."""
        if messages.streams[first] < 0:
            return Taken(0, 0)
        read = self._states.read(messages, first)
        counts, targets = read.counts, self._targets
        appended = len(read.streams) - read.is_crossing
        begin = 0
        rows = zip(read.streams, read.samples, read.next_seqs, read.next_times_ns, strict=True)
        for number, samples, seq, t_ns in islice(rows, appended):
            stream, analysis = targets[number]
            end = begin + _BYTES_A_COUNT * samples
            analysis.pieces.append(counts[begin:end], seq, t_ns)
            positions[stream] = seq
            begin = end
        samples = len(counts) // _BYTES_A_COUNT
        if not read.is_crossing:
            return Taken(appended, samples)
        stream, analysis = targets[read.streams[-1]]
        positions[stream] = read.next_seqs[-1]
        return Taken(appended + 1, samples, (analysis, analysis.pieces.continuation(bytes(counts[begin:]))))

    def resume(self, analysis: "SignalAnalysis") -> None:
        """Expect messages of the same form after a piece was completed."""
        number, pieces = self._of_signal[analysis.name], analysis.pieces
        self._states.continues(number, pieces.next_seq, pieces.next_ns, pieces.border, pieces.due_ns)
