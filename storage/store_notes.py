"""What a store has to say of itself, brought into its own log."""

import time
from collections.abc import Sequence
from typing import Any

from storage.store import Store, WriterLock, writer_endpoint
from stream.bus import Bus
from stream.delivery import DurablePublisher
from stream.events import AnyDocument, StoreNoted
from stream.identity import Place, event_key

LAKE = Place("store", "lake")


def noted(store: str, what: str, text: str, details: dict[str, Any]) -> StoreNoted:
    """A document of the store with that identity, of now.

    Examples
    --------
    >>> is_own(noted("5e", "disk_low", "", {}), "5e"), is_own(noted("5e", "disk_low", "", {}), "6f")
    (True, False)
    """
    return StoreNoted(run="", t_ns=time.time_ns(), what=what, text=text, details={**details, "store": store})


def is_own(document: StoreNoted, store: str) -> bool:
    """Whether a document is of the store with that identity: where recorders share a bus, each has those of all."""
    named: object = document.details.get("store")
    return named == store


def is_foreign(document: StoreNoted, store: str) -> bool:
    """Whether a document names another store than that; one that names none is of the store in whose log it is."""
    named: object = document.details.get("store", store)
    return named != store


def note(
    store: Store, documents: Sequence[AnyDocument], *, role: str, place: Place = LAKE, builds_lake: bool = False
) -> None:
    """Bring documents into the log of a store; they are durable when this returns.

    A recorder that writes the store gets them over its bus. Where none is at work they are written here.

    Parameters
    ----------
    store : Store
        Whose log.
    documents : sequence of Document
        What there is to say.
    role : str
        Who writes, for the message that another writer gets.
    place : Place
        Where the documents are from.
    builds_lake : bool
        Whether they are also brought to the lake where no recorder is at work; a recorder does so in its own time.

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
            _send(far, documents, place, store)
        return
    from storage.event_log import EventLog
    from storage.recorder import Recorder
    from stream.bus import LocalBus

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
