"""What a store has to say of itself: the documents, and whose they are."""

import time
from typing import Any

from stream.events import StoreNoted
from stream.identity import Place

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
