"""Compensation beside a recorder, which reads the log of its store, or in the process of a sender."""

from collections.abc import Callable
from uuid import UUID

import msgspec

from analytics.loop.live.epoch_compensation import SUFFIX
from analytics.loop.live.live_compensator import LiveCompensator, Out, lacking_uid
from analytics.loop.model.model_registry import ModelRegistry
from analytics.loop.model.model_use import logged_documents, uses_of
from storage.log.tail import LogTail
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.batch import SampleBatch
from stream.delivery.publisher import DurablePublisher, Sender
from stream.errors import BadInput, WireError
from stream.events import (
    AnyDocument,
    CompensationStarted,
    ModelActivated,
    NoteAdded,
    RunEnded,
    RunResumed,
    decode_event,
)
from stream.identity import EventKey, SampleKey, event_key, parse_key, sample_key
from stream.wire.acknowledgement import StreamId
from stream.wire.batches import decode_batch


class CompensationWorker:
    """Reads the log of a store and sends the compensated samples of its live error models to the store's recorder.

    It has no state of its own: its output is a function of the log. At the start it reads the running runs again and
    sends what the log lacks; samples sent before it was killed have the same numbers and are dropped. The `publisher`
    is connected to the recorder of the store; `on_document` is called with every document that is sent.
    """

    pause_s = 2.0  # seconds between two reads of the log

    def __init__(
        self, store: Store, publisher: DurablePublisher, *, on_document: Callable[[AnyDocument], None] | None = None
    ) -> None:
        self._publisher = publisher
        self._on_document = on_document
        self._log = LogTail(store)
        documents = logged_documents(store, (ModelActivated, CompensationStarted, NoteAdded))
        begun = {
            (each.run, each.unit, each.signal, each.epoch.replace("-", "")): each.model
            for each in documents
            if isinstance(each, CompensationStarted)
        }
        self._known = {each.uid for each in documents}
        self._compensator = LiveCompensator(ModelRegistry(store), uses_of(documents), begun)
        beginning = self._log.beginning()
        self._positions, self._ended = beginning.positions, beginning.ended
        ended = _ended(store)
        if incomplete := _incomplete(store, documents) & ended:  # a run ended while no worker ran
            self._positions, self._ended = {}, frozenset(ended - incomplete)
        self._sent = {
            message.stream: message.next_seq
            for message in self._log.since(dict(self._positions))
            if message.stream.key.endswith(SUFFIX)
        }
        self.samples = 0

    def look(self, given_up: Callable[[], bool] = lambda: False) -> None:
        """Read the new messages of the log and send their compensated samples, until `given_up` returns true.

        GyrofleetError if the log or a model cannot be read, or the recorder does not acknowledge.
        """
        for message in self._log.since(dict(self._positions)):
            if given_up():
                return
            self._positions[message.stream] = message.next_seq
            try:
                self._take(message.stream.key, message.payload)
            except WireError:
                continue  # the recorder quarantines and reports it

    def _take(self, key: str, payload: bytes) -> None:
        try:
            parsed = parse_key(key)
        except BadInput as error:
            raise WireError(str(error)) from error
        if isinstance(parsed, SampleKey):
            if parsed.signal.endswith(SUFFIX):
                return
            batch = decode_batch(payload)
            if batch.run not in self._ended:
                self._send(self._compensator.take(parsed.place, batch))
        elif isinstance(parsed, EventKey):
            document = decode_event(payload).document
            if isinstance(document, ModelActivated) and document.uid in self._known:
                return  # known since the start
            if document.run not in self._ended:
                self._send(self._compensator.take_document(parsed.place, document))

    def _send(self, out: list[Out]) -> None:
        for place, what in out:
            if isinstance(what, SampleBatch):
                key = sample_key(place, what.unit, what.signal)
                if self._sent.get(StreamId(key, what.epoch.hex), 0) < what.next_seq:
                    self._publisher.send_batch(key, what)
                    self.samples += len(what)
            elif what.uid not in self._known:
                self._known.add(what.uid)
                self._publisher.send_event(event_key(place), what)
                if isinstance(what, CompensationStarted):
                    self._publisher.drain()  # the model is on disk before the first sample
                if self._on_document is not None:
                    self._on_document(what)


def _ended(store: Store) -> set[str]:
    """Runs that ended and were not resumed."""
    last = {each.run: isinstance(each, RunEnded) for each in logged_documents(store, (RunEnded, RunResumed))}
    return {run for run, is_ended in last.items() if is_ended}


def _incomplete(store: Store, documents: list[AnyDocument]) -> set[str]:
    """Runs with fewer compensated than raw samples of a signal in the lake."""
    known = {each.uid for each in documents}
    begun = [
        each
        for each in documents
        if isinstance(each, CompensationStarted) and lacking_uid(UUID(each.compensated_epoch)) not in known
    ]
    if not begun:
        return set()
    with Catalog(store) as catalog:
        rows = catalog.rows(
            "select run, unit, signal, epoch::varchar, max(seq_next) - min(seq_first) "
            "from internal.lake_channels group by all"
        )
    kept = {
        (str(run), str(unit), str(signal), str(epoch).replace("-", "")): int(n) for run, unit, signal, epoch, n in rows
    }
    return {
        each.run
        for each in begun
        if kept.get((each.run, each.unit, each.compensated, each.compensated_epoch.replace("-", "")), -1)
        < kept.get((each.run, each.unit, each.signal, each.epoch.replace("-", "")), 0)
    }


class CompensatingSender:
    """Passes batches and documents to a sender, such as an EmbeddedPipeline, and adds compensated samples.

    The end of a run follows its last compensated sample, and its totals include them.
    """

    def __init__(self, sender: Sender, compensator: LiveCompensator) -> None:
        self._sender = sender
        self._compensator = compensator

    def send_batch(self, key: str, batch: SampleBatch) -> None:
        """Send samples, and the compensated samples that are ready."""
        self._sender.send_batch(key, batch)
        parsed = parse_key(key)
        assert isinstance(parsed, SampleKey)
        self._send(self._compensator.take(parsed.place, batch))

    def send_event(self, key: str, document: AnyDocument) -> None:
        """Send a document."""
        parsed = parse_key(key)
        if not isinstance(parsed, EventKey):
            self._sender.send_event(key, document)
        elif isinstance(document, RunEnded):
            totals = (*document.totals, *self._compensator.totals(document.run))
            self._send(self._compensator.finish(document.run))
            self._sender.send_event(key, msgspec.structs.replace(document, totals=totals))
        else:
            self._sender.send_event(key, document)
            self._send(self._compensator.take_document(parsed.place, document))

    def _send(self, out: list[Out]) -> None:
        for place, what in out:
            if isinstance(what, SampleBatch):
                self._sender.send_batch(sample_key(place, what.unit, what.signal), what)
            else:
                self._sender.send_event(event_key(place), what)
