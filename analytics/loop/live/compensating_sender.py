"""A sender that adds compensated samples, for sources and pipelines in one process."""

import msgspec

from analytics.loop.live.live_compensator import LiveCompensator, Out
from stream.batch import SampleBatch
from stream.delivery.publisher import Sender
from stream.events import AnyDocument, RunEnded
from stream.identity import EventKey, SampleKey, event_key, parse_key, sample_key


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
