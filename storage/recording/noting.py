"""Documents of a store brought into its own log, by the recorder at work there or by one made for it."""

from collections.abc import Sequence

from storage.log.store_documents import LAKE
from storage.store import Store, WriterLock, writer_endpoint
from stream.delivery.publisher import DurablePublisher
from stream.events import AnyDocument
from stream.identity import Place, event_key
from stream.transport.bus import Bus


def note(
    store: Store, documents: Sequence[AnyDocument], *, role: str, place: Place = LAKE, builds_lake: bool = False
) -> None:
    """Bring documents into the log of a store; they are durable when this returns.

    A recorder that writes the store gets them over its bus. Where none is at work they are written here.

    Parameters
    ----------
    store: Whose log.
    documents: What there is to say.
    role: Who writes, for the message that another writer gets.
    place: Where the documents are from.
    builds_lake: Whether they are also brought to the lake where no recorder is at work; a recorder does so in its own
        time.
    """
    endpoint = writer_endpoint(store.folder)
    if endpoint is not None:
        from stream.transport.zenoh_bus import ZenohBus

        with ZenohBus(connect=[endpoint]) as far:
            _send(far, documents, place, store)
        return
    from storage.log.event_log import EventLog
    from storage.recording.recorder import Recorder
    from stream.transport.bus import LocalBus

    with (
        WriterLock(store, role),
        LocalBus() as bus,
        Recorder(store, bus, EventLog(store), sync_interval_s=0.01, builds_lake=builds_lake),
    ):
        _send(bus, documents, place, store)


def _send(bus: Bus, documents: Sequence[AnyDocument], place: Place, store: Store) -> None:
    with DurablePublisher(bus, timeout_s=20.0, only_store=store.identity) as publisher:
        for document in documents:
            publisher.send_event(event_key(place), document)
        publisher.drain()
