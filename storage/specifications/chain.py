"""Product specifications in the log of a store: documents, each of which names the one before it by its hash."""

import hashlib
from collections import defaultdict
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import msgspec

from storage.log.store_documents import signed_specification
from storage.log.tail import documents_beyond
from storage.recording.client import record_documents
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.events import SpecificationEntered
from stream.identity import Place

_PLACE = Place("store", "specifications")
_ROLE = "gyrofleet limits"
_SQL = "select document, arrival_ns from internal.lake_documents where kind = $kind"


class Link(NamedTuple):
    """A document of the chain.

    Parameters
    ----------
    document: The document.
    hash: Its SHA-256, which the next one names.
    known_ns: When the recorder had it, ns UTC; later than the document before it.
    """

    document: SpecificationEntered
    hash: str
    known_ns: int

    @property
    def label(self) -> str:
        """Name and revision."""
        return f"{self.document.name}-{self.document.revision}"


class Break(NamedTuple):
    """A place at which the chain does not hold: hash of the document, and what is wrong there."""

    at: str
    what: str


class Chain(NamedTuple):
    """The documents in their order, and where their chain is broken."""

    links: tuple[Link, ...]
    breaks: tuple[Break, ...]

    @property
    def head(self) -> str:
        """Hash that the next document names as the one before it."""
        return self.links[-1].hash if self.links else ""


def read_chain(store: Store, catalog: Catalog | None = None) -> Chain:
    """Specification documents of a store, those not yet in the lake included.

    Parameters
    ----------
    store: Which store.
    catalog: Its catalogue, if one is open.

    Raises
    ------
    StoreError: If the lake or the log is damaged.
    """
    if catalog is None:
        with Catalog(store) as opened:
            return read_chain(store, opened)
    found = {
        document.uid: (document, arrival_ns)
        for text, arrival_ns in catalog.rows(_SQL, {"kind": SpecificationEntered.__name__})
        for document in [msgspec.json.decode(text, type=SpecificationEntered)]
    }
    in_lake = {segment for part in catalog.parts for segment in part.segments}
    for document, arrival_ns in documents_beyond(store, in_lake):
        if isinstance(document, SpecificationEntered):
            found.setdefault(document.uid, (document, arrival_ns))
    return chain_of(found.values())


def chain_of(documents: Iterable[tuple[SpecificationEntered, int]]) -> Chain:
    """Put documents, given with the times of their arrival, in the order of their hashes.

    Examples
    --------
    >>> first = SpecificationEntered(run="", t_ns=0, action="added", name="fog", revision="A", by="Li")
    >>> second = SpecificationEntered(
    ...     run="", t_ns=1, action="withdrawn", name="fog", revision="A", by="Li", previous=hash_of(first)
    ... )
    >>> chain = chain_of([(second, 7), (first, 5)])
    >>> [link.document.action for link in chain.links], chain.head == hash_of(second), chain.breaks
    (['added', 'withdrawn'], True, ())
    >>> chain_of([(second, 7)]).breaks[0].what
    'the document before it is not in the log'
    """
    by_hash = {hash_of(each): (each, arrival) for each, arrival in sorted(documents, key=lambda e: (e[1], e[0].t_ns))}
    followers: defaultdict[str, list[str]] = defaultdict(list)
    for mark, (document, _) in by_hash.items():
        followers[document.previous if document.previous in by_hash else ""].append(mark)
    links: list[Link] = []
    waiting = followers[""][::-1]
    while waiting:
        mark = waiting.pop()
        document, arrival_ns = by_hash[mark]
        links.append(Link(document, mark, max(arrival_ns, links[-1].known_ns + 1) if links else arrival_ns))
        waiting += followers[mark][::-1]
    settled = {mark for document, _ in by_hash.values() for mark in document.settles}
    breaks = [each for each in _breaks(links, followers) if each.at not in settled]
    return Chain(tuple(links), tuple(breaks))


def hash_of(document: SpecificationEntered) -> str:
    """SHA-256 of a document as JSON with sorted keys."""
    return hashlib.sha256(msgspec.json.encode(document, order="sorted")).hexdigest()


def append_document(store: Store, document: SpecificationEntered) -> None:
    """Bring a document into the log, with the store's seal; it is on disk when this returns.

    Raises
    ------
    StoreError, DeliveryError: If it cannot be written.
    """
    record_documents(store, [signed_specification(store, document)], role=_ROLE, place=_PLACE, builds_lake=True)


def _breaks(links: Iterable[Link], followers: dict[str, list[str]]) -> Iterator[Break]:
    has_first = False
    for link in links:
        previous = link.document.previous
        if not previous and has_first:
            yield Break(link.hash, "it begins a second chain")
        elif previous and link.hash in followers[""]:
            yield Break(link.hash, "the document before it is not in the log")
        elif previous and link.hash != followers[previous][0]:
            yield Break(link.hash, "another document follows the same one")
        has_first |= not previous
