"""Product specifications in the log of a store: a chain of documents, each with the hash of the one before it."""

import hashlib
from collections import defaultdict
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import msgspec

from storage.log.store_documents import sealed
from storage.log.tail import documents_beyond
from storage.recording.client import record_documents
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.decoding import decode_json
from stream.events import SpecificationEntered
from stream.identity import Place

_PLACE = Place("store", "specifications")
_ROLE = "gyrofleet limits"
_SQL = "select document, arrival_ns from internal.lake_documents where kind = $kind"


class Link(NamedTuple):
    """A document of the chain, its SHA-256, and when the recorder had it (ns UTC, later than the one before it)."""

    document: SpecificationEntered
    hash: str
    known_ns: int

    @property
    def label(self) -> str:
        """Name and revision."""
        return f"{self.document.name}-{self.document.revision}"


class Break(NamedTuple):
    """A break of the chain: hash of the document, and what is wrong there."""

    at: str
    what: str


class Chain(NamedTuple):
    """The documents in their order, and the breaks of the chain."""

    links: tuple[Link, ...]
    breaks: tuple[Break, ...]

    @property
    def head(self) -> str:
        """Hash that the next document has as `previous`."""
        return self.links[-1].hash if self.links else ""


def read_chain(store: Store, catalog: Catalog | None = None) -> Chain:
    """Specification documents of a store, also those not yet in the lake; StoreError if lake or log is damaged."""
    if catalog is None:
        with Catalog(store) as opened:
            return read_chain(store, opened)
    found = {
        document.uid: (document, arrival_ns)
        for text, arrival_ns in catalog.rows(_SQL, {"kind": SpecificationEntered.__name__})
        for document in [decode_json(text, SpecificationEntered)]
    }
    in_lake = {segment for part in catalog.parts for segment in part.segments}
    for document, arrival_ns in documents_beyond(store, in_lake):
        if isinstance(document, SpecificationEntered):
            found.setdefault(document.uid, (document, arrival_ns))
    return chain_of(found.values())


def chain_of(documents: Iterable[tuple[SpecificationEntered, int]]) -> Chain:
    """Order documents, given with their times of arrival, by their hashes."""
    by_hash = {hash_of(each): (each, arrival) for each, arrival in sorted(documents, key=lambda e: (e[1], e[0].t_ns))}
    following: defaultdict[str, list[str]] = defaultdict(list)
    for mark, (document, _) in by_hash.items():
        following[document.previous if document.previous in by_hash else ""].append(mark)
    links: list[Link] = []
    waiting = following[""][::-1]
    while waiting:
        mark = waiting.pop()
        document, arrival_ns = by_hash[mark]
        links.append(Link(document, mark, max(arrival_ns, links[-1].known_ns + 1) if links else arrival_ns))
        waiting += following[mark][::-1]
    settled = {mark for document, _ in by_hash.values() for mark in document.settles}
    breaks = [each for each in _breaks(links, following) if each.at not in settled]
    return Chain(tuple(links), tuple(breaks))


def hash_of(document: SpecificationEntered) -> str:
    """SHA-256 of a document as JSON with sorted keys."""
    return hashlib.sha256(msgspec.json.encode(document, order="sorted")).hexdigest()


def append_document(store: Store, document: SpecificationEntered) -> None:
    """Append a document, sealed, to the log, durably; StoreError or DeliveryError if it cannot be written."""
    record_documents(store, [sealed(store, document)], role=_ROLE, place=_PLACE, builds_lake=True)


def _breaks(links: Iterable[Link], following: dict[str, list[str]]) -> Iterator[Break]:
    has_first = False
    for link in links:
        previous = link.document.previous
        if not previous and has_first:
            yield Break(link.hash, "it begins a second chain")
        elif previous and link.hash in following[""]:
            yield Break(link.hash, "the document before it is not in the log")
        elif previous and link.hash != following[previous][0]:
            yield Break(link.hash, "another document follows the same one")
        has_first |= not previous
