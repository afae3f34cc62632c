"""The state of a run and the documents that it sends: what a station's run and a run of simulated units share."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar
from uuid import NAMESPACE_URL, UUID, uuid5

import msgspec
from msgspec.structs import replace

from ingest.state_file import write_state
from stream.delivery.publisher import Sender
from stream.delivery.spool import Spool
from stream.events import AnyDocument, StreamTotal
from stream.identity import Place, SampleKey, event_key, parse_key

State = TypeVar("State", bound=msgspec.Struct)

Outcome = Literal["completed", "stopped", "aborted"]
Phase = Literal["starting", "running", "ending", "ended"]
"""`starting` until the first documents are kept, `running`, `ending` when nothing more is measured, `ended` when a
recorder has everything."""


class RunRecord(Generic[State]):
    """Owner of a run's state: only its methods change it, and every change is on disk when they return.

    Parameters
    ----------
    state: How far the run is.
    file: Where that is kept.
    spool: Keeps what is sent until it is recorded.
    place: Site and station.

    Raises
    ------
    StoreError: From every method that changes the state, if it cannot be written.
    """

    def __init__(self, state: State, file: Path, spool: Spool, place: Place) -> None:
        self.state = state
        self.place = place
        self._file = file
        self._spool = spool
        self._sender: Sender | None = None

    @property
    def samples(self) -> int:
        """Samples of the run so far, whichever process has sent them."""
        return sum(total.samples for total in self._totals())

    def _totals(self) -> tuple[StreamTotal, ...]:
        """Samples of every stream of the run."""
        return tuple(sorted(self._stream_totals(), key=lambda total: (total.unit, total.signal, total.epoch)))

    def _stream_totals(self) -> Iterator[StreamTotal]:
        for stream, known in self._spool.streams.items():
            key = parse_key(stream.key)
            if isinstance(key, SampleKey) and known.appended:
                epoch = str(UUID(stream.epoch))
                yield StreamTotal(unit=key.unit, signal=key.signal, epoch=epoch, samples=known.appended)

    def _save(self, **changes: Any) -> None:
        self.state = write_state(self._file, replace(self.state, **changes))

    def _send(self, document: AnyDocument) -> None:
        assert self._sender is not None
        self._sender.send_event(event_key(self.place), document)


def document_uid(name: str) -> str:
    """Identity of a document: the same document has the same identity however often it is sent."""
    return uuid5(NAMESPACE_URL, name).hex
