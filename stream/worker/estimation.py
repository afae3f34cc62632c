"""Estimation of all signals: numbered messages in, documents out; independent of threads and transport."""

import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from stream.errors import BadInput, WireError
from stream.events import AnyDocument, CompensationStarted, EventMessage, LimitsApplied, RunEnded, UnitReleased
from stream.identity import EstimateKey, EventKey, Place, SampleKey, estimate_key, parse_key, sample_key
from stream.wire.acknowledgement import StreamId
from stream.wire.batches import WireBatch, read_wire_batch
from stream.wire.continued_batches import JoinedMessages
from stream.wire.event_validation import decode_received
from stream.worker.continued_streams import ContinuedStreams
from stream.worker.estimated_signals import EstimatedSignals
from stream.worker.limit_checks import VERDICT, unit_verdicts
from stream.worker.pending_ends import PendingEnds, streams_of

if TYPE_CHECKING:
    from stream.estimators.base import Estimator, PointEstimator
    from stream.worker.checkpoint import Checkpoint
    from stream.worker.signal_analysis import Documents, SignalAnalysis

_parse = functools.lru_cache(65_536)(parse_key)


@dataclass
class EstimationCounts:
    """Counts of samples and messages."""

    samples: int = 0
    duplicates: int = 0
    recalled: int = 0
    lost: int = 0
    rejected: int = 0
    estimates: int = 0
    checkpoints: int = 0


class Estimation:
    """Takes the messages of all streams, keeps an analysis of every signal, and publishes the documents that are due.

    Estimators, and what they need, are loaded for the first signal that is estimated. `factories` are those of a
    signal, by default `default_estimators`.

    Estimates are due after every `every_ns` of a signal's time; a signal keeps its first interval. `publish` gets the
    key expression and the document. `fill` gets a stream and a number, and reads the missing messages before that
    number from a log, if it has them soon. A message after a gap that remains is left out (`left_out` is then set), and
    comes again from the log; and the end of a run waits for all its samples. Without `fill`, gaps are skipped, and a
    stream may be joined in its middle. `estimated` are the signals that are estimated beside those that a run has
    limits on.

    `positions` are the next numbers of the streams; `catching_up` is set while messages come from the log, which has no
    gaps; runs that have `ended` are left out.
    """

    def __init__(
        self, every_ns: int, factories: "Mapping[str, Callable[[], PointEstimator]] | None",
        publish: Callable[[str, AnyDocument], None], fill: Callable[[StreamId, int], None] | None = None, *,
        spectrum: bool = True, estimated: EstimatedSignals = EstimatedSignals(),
    ) -> None:  # fmt: skip
        self._every_ns, self._estimated = every_ns, estimated
        self._not_estimated: set[tuple[str, str, str]] = set()
        self._factories, self._spectrum = factories, spectrum
        self._publish, self._fill = publish, fill
        self._signals: dict[tuple[str, str, str], SignalAnalysis] = {}
        self._limits: dict[tuple[str, str | None], LimitsApplied] = {}
        self._compensated: dict[str, list[CompensationStarted]] = {}
        self._released: dict[str, dict[str, UnitReleased]] = {}  # by run and unit
        self._pending = PendingEnds()
        self._continued = ContinuedStreams()
        self.positions: dict[StreamId, int] = {}
        self.catching_up = self.left_out = False
        self.ended: frozenset[str] = frozenset()
        self.counts = EstimationCounts()

    def take_all(self, messages: Sequence[tuple[str, bytes]]) -> None:
        """Process messages in their order, as `take` does; those that continue their streams many at a time."""
        continued = self._continued
        joined = JoinedMessages([payload for _, payload in messages], continued.numbers(key for key, _ in messages))
        at = 0
        while at < len(messages):
            taken = continued.take(joined, at, self.positions)
            self.counts.samples += taken.samples
            at += taken.messages
            if taken.completing is not None:
                analysis, batch = taken.completing
                self._publish_all(analysis, analysis.take(batch))
                continued.resume(analysis)
            elif at < len(messages):
                self.take(*messages[at])
                at += 1

    def take(self, key: str, payload: bytes) -> None:
        """Process a message if it is the next of its stream; invalid ones are counted, and left to the recorder."""
        try:
            parsed = _parse(key)
            if isinstance(parsed, SampleKey):
                self._take_samples(key, parsed, read_wire_batch(payload), payload)
            else:
                self._take_document(key, parsed, decode_received(payload))
        except (BadInput, WireError):
            self.counts.rejected += 1  # the recorder quarantines and reports it

    def checkpoint(self, store: str) -> "Checkpoint":
        """The state, with the identity of its store."""
        from stream.worker.checkpoint import Checkpoint

        return Checkpoint(
            store=store,
            positions=[(stream.key, stream.epoch, next_seq) for stream, next_seq in self.positions.items()],
            ended=sorted(self.ended),
            limits=list(self._limits.values()),
            compensated=[each for begun in self._compensated.values() for each in begun],
            signals=[analysis.export_state() for analysis in self._signals.values()],
            released=[each for of_run in self._released.values() for each in of_run.values()],
        )

    def resume(self, checkpoint: "Checkpoint") -> None:
        """Resume from a checkpoint; an EstimatorError, and no change, if a snapshot in it is damaged."""
        from stream.worker.signal_analysis import SignalAnalysis

        analyses = [SignalAnalysis.from_state(state) for state in checkpoint.signals]
        self._continued = ContinuedStreams()
        self._signals = {(each.run, each.unit, each.signal): each for each in analyses}
        self._limits = {(limits.run, limits.unit): limits for limits in checkpoint.limits}
        self._compensated = {}
        for begun in checkpoint.compensated:
            self._compensated.setdefault(begun.run, []).append(begun)
        self._released = {}
        for each in checkpoint.released:
            self._released.setdefault(each.run, {})[each.unit] = each
        self.positions = {StreamId(key, epoch): next_seq for key, epoch, next_seq in checkpoint.positions}
        self.ended = frozenset(checkpoint.ended)

    def release(self, *, is_last: bool = False) -> None:
        """Process the ends of runs whose samples have come or are lost; if `is_last`, of all."""
        for stream in self._pending.streams:
            while (waiting := self._pending.first(stream)) is not None:
                place, message = waiting
                must_wait = self._must_wait(place, message) and not is_last
                if must_wait and not self._pending.is_lost(stream, self.positions):
                    self.left_out = True
                    break
                self._pending.pop(stream)
                self.positions[stream] = message.seq + 1
                if message.document.run not in self.ended:
                    self._process(place, message.document)

    def _take_samples(self, key: str, parsed: SampleKey, batch: WireBatch, payload: bytes) -> None:
        if batch.unit != parsed.unit or batch.signal != parsed.signal:
            raise WireError("it holds samples of another unit or signal")
        stream = StreamId(key, batch.meaning[0].hex())
        first, after, counts = batch.seq, batch.next_seq, self.counts
        expected = self._filled_to(stream, first)
        if expected is None:
            return
        if first < expected:
            # partial overlaps are quarantined by the recorder too
            counts.duplicates += after <= expected
            counts.rejected += after > expected
            return
        self.positions[stream] = after
        if batch.run in self.ended:
            return
        counts.lost += first - expected
        counts.samples += after - first
        name = (batch.run, batch.unit, batch.signal)
        if name in self._not_estimated:
            return
        analysis = self._signals.get(name) or self._begin(parsed.place, name, batch.unit_of_measure)
        if analysis is None:
            self._not_estimated.add(name)
            return
        documents = analysis.take(batch)
        self._continued.expect(stream, analysis, payload)
        if documents:
            self._publish_all(analysis, documents)

    def _take_document(self, key: str, parsed: EventKey | EstimateKey, message: EventMessage) -> None:
        stream = StreamId(key, message.epoch)
        expected = self._filled_to(stream, message.seq)
        if expected is None:
            return
        if message.seq < expected:
            self._pending.mark_seen(stream, message.seq, is_recorded=self.catching_up)
            return
        if isinstance(parsed, EventKey) and (self._pending.next_seq(stream) or self._must_wait(parsed.place, message)):
            self._pending.hold(stream, parsed.place, message, is_recorded=self.catching_up)
            self.left_out = True
            return
        self.positions[stream] = message.seq + 1
        if isinstance(parsed, EventKey) and message.document.run not in self.ended:
            self._process(parsed.place, message.document)

    def _must_wait(self, place: Place, message: EventMessage) -> bool:
        """Whether it is the end of a run whose last samples have not come yet."""
        document = message.document
        if self._fill is None or not isinstance(document, RunEnded) or document.run in self.ended:
            return False
        positions = self.positions
        expected = (*streams_of(place, document), *self._compensated_streams(place, document))
        return any(positions.get(stream, 0) < total for stream, total in expected)

    def _compensated_streams(self, place: Place, ended: RunEnded) -> Iterator[tuple[StreamId, int]]:
        """Compensated signals of a run, which come after the raw ones: each has as many samples."""
        totals = {(each.unit, each.signal, each.epoch.replace("-", "")): each.samples for each in ended.totals}
        for each in self._compensated.get(ended.run, ()):
            total = totals.get((each.unit, each.signal, each.epoch.replace("-", "")))
            if total is not None:
                key = sample_key(place, each.unit, each.compensated)
                yield StreamId(key, each.compensated_epoch.replace("-", "")), total - each.first_seq

    def _filled_to(self, stream: StreamId, first: int) -> int | None:
        """Number that a stream expects, once missing messages are filled in; None if a message is to be left out."""
        expected = self._expected(stream, first)
        if first > expected and not self.catching_up and self._fill is not None:
            self._fill(stream, first)
            expected = self._expected(stream, first)
            if first > expected:
                self.left_out = True
                return None
        return expected

    def _expected(self, stream: StreamId, first: int) -> int:
        # with a log a stream begins at 0; without, it may be joined in its middle
        return self._pending.next_seq(stream) or self.positions.get(stream, first if self._fill is None else 0)

    def _process(self, place: Place, document: AnyDocument) -> None:
        if isinstance(document, LimitsApplied):
            self._limits[document.run, document.unit] = document
            self._forget_not_estimated(document.run)  # the limits may be on one of them
            for analysis in self._signals.values():
                if analysis.run == document.run and document.unit in {None, analysis.unit}:
                    analysis.apply_limits(document)
        elif isinstance(document, CompensationStarted):
            self._compensated.setdefault(document.run, []).append(document)
        elif isinstance(document, UnitReleased):
            self._released.setdefault(document.run, {})[document.unit] = document
        elif isinstance(document, RunEnded):
            self._compensated.pop(document.run, None)
            finished = [self._signals.pop(name) for name in [each for each in self._signals if each[0] == document.run]]
            for analysis in finished:
                self._continued.forget(analysis)
                self._publish_all(analysis, analysis.finish())
            applied = [self._limits.pop(each) for each in [each for each in self._limits if each[0] == document.run]]
            final = [estimate for analysis in finished for estimate in analysis.judged]
            early = [decision for analysis in finished for decision in analysis.decided]
            released = self._released.pop(document.run, {})
            unseen = {(analysis.unit, analysis.signal): analysis.unseen_s for analysis in finished}
            for verdict in unit_verdicts(document, applied, final, early, released, unseen):
                signal = verdict.checks[0].limit.signal
                self._publish(estimate_key(place, verdict.unit, signal, VERDICT), verdict)
            self._forget_not_estimated(document.run)

    def _forget_not_estimated(self, run: str) -> None:
        self._not_estimated = {each for each in self._not_estimated if each[0] != run}

    def _begin(self, place: Place, name: tuple[str, str, str], unit_of_measure: str) -> "SignalAnalysis | None":
        """Start the analysis of a signal; None where it is not estimated."""
        run, unit, signal = name
        limits = self._limits.get((run, unit)) or self._limits.get((run, None))
        is_limited = limits is not None and any(limit.signal == signal for limit in limits.limits)
        if not is_limited and not self._estimated.includes(signal, unit_of_measure):
            return None
        from stream.worker.signal_analysis import SignalAnalysis

        analysis = SignalAnalysis(place, (unit, signal, run), self._every_ns, self._new_estimators())
        self._signals[name] = analysis
        if limits is not None:
            analysis.apply_limits(limits)
        return analysis

    def _new_estimators(self) -> "list[Estimator[Any]]":
        from stream.estimators.base import default_estimators
        from stream.worker.signal_analysis import new_estimators

        if self._factories is None:
            self._factories = default_estimators()
        return new_estimators(self._factories, spectrum=self._spectrum)

    def _publish_all(self, analysis: "SignalAnalysis", documents: "Documents") -> None:
        for what, document in documents:
            self._publish(estimate_key(analysis.place, analysis.unit, analysis.signal, what), document)
