"""What a store has to say of itself, brought into its own log."""

from storage.store import Store, WriterLock, writer_endpoint
from stream.bus import Bus
from stream.delivery import DurablePublisher
from stream.events import StoreNoted
from stream.identity import Place, event_key

LAKE = Place("store", "lake")


def note(store: Store, documents: list[StoreNoted], *, role: str, place: Place = LAKE) -> None:
    """Bring documents into the log of a store; they are durable when this returns.

    A recorder that writes the store gets them over its bus. Where none is at work they are written here.

    Parameters
    ----------
    store : Store
        Whose log.
    documents : list of StoreNoted
        What there is to say.
    role : str
        Who writes, for the message that another writer gets.
    place : Place
        Where the documents are from.

    Raises
    ------
    DeliveryError
        If the recorder does not acknowledge them.
    StoreError
        If a process writes the store that takes no messages, or the log cannot be written.
    """
    endpoint = writer_endpoint(store.folder)
    if endpoint is not None:
        from stream.zenoh_bus import ZenohBus

        with ZenohBus(connect=[endpoint]) as far:
            _send(far, documents, place)
        return
    from storage.event_log import EventLog
    from storage.recorder import Recorder
    from stream.bus import LocalBus

    with (
        WriterLock(store, role),
        LocalBus() as bus,
        Recorder(store, bus, EventLog(store), sync_interval_s=0.01, builds_lake=False),
    ):
        _send(bus, documents, place)


def _send(bus: Bus, documents: list[StoreNoted], place: Place) -> None:
    with DurablePublisher(bus, timeout_s=20.0) as publisher:
        for document in documents:
            publisher.send_event(event_key(place), document)
        publisher.drain()
