"""Certificates in the log of a store: issued ones, each sealed, and which of them supersedes which."""

import hashlib
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any, Protocol

from storage.log.store_documents import is_sealed, sealed
from storage.log.tail import documents_beyond
from storage.recording.acts.two_persons import read_proposals
from storage.recording.client import record_documents
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.decoding import decode_json
from stream.events import CertificateIssued
from stream.identity import Place

FOLDER = "certificates"  # within the store: the issued files

_PLACE = Place("store", FOLDER)
_ROLE = "gyrofleet certificate"
_SQL = "select document, arrival_ns from internal.lake_documents where kind = $kind"


class Certificates:
    """The issued certificates of a store, in the order of their arrival; documents without its seal do not count."""

    def __init__(self, issued: Sequence[CertificateIssued]) -> None:
        self.issued = tuple(issued)

    def by_hash(self, sha256: str) -> CertificateIssued | None:
        """The certificate whose PDF or digital form has that SHA-256."""
        return next((each for each in self.issued if sha256 in (each.sha256, each.digital_sha256)), None)

    def by_number(self, number: str) -> CertificateIssued | None:
        """The certificate of a number."""
        return next((each for each in self.issued if each.number == number), None)

    def successor(self, number: str) -> CertificateIssued | None:
        """The certificate that supersedes that of a number."""
        return next((each for each in self.issued if each.supersedes == number), None)

    def in_force(self, unit: str, standard: str) -> list[CertificateIssued]:
        """Certificates of a unit by a standard that no other one supersedes."""
        of_unit = (each for each in self.issued if each.unit == unit and each.standard == standard)
        return [each for each in of_unit if self.successor(each.number) is None]

    def next_number(self, prefix: str, year: int, taken: Collection[str] = ()) -> str:
        """The next free number of a year; numbers that are `taken` are not free either.

        >>> Certificates([]).next_number("GYL", 2026)
        'GYL-2026-0001'
        """
        stem = f"{prefix}-{year}-" if prefix else f"{year}-"
        numbers = (*(each.number for each in self.issued), *taken)
        used = [each.removeprefix(stem) for each in numbers if each.startswith(stem)]
        return f"{stem}{max((int(each) for each in used if each.isdecimal()), default=0) + 1:04d}"


class _Views(Protocol):
    """Views that answer a statement."""

    def rows(self, sql: str, parameters: object = None) -> list[tuple[Any, ...]]:
        """All rows."""


def logged_certificates(store: Store, views: _Views) -> Certificates:
    """The certificates whose documents some views of a store have."""
    return _sealed(store, _documents(views).values())


def read_certificates(store: Store, catalog: Catalog) -> Certificates:
    """The certificates of a store, also those not yet in the lake."""
    found = _documents(catalog)
    for document, arrival_ns in documents_beyond(store, {each for part in catalog.parts for each in part.segments}):
        if isinstance(document, CertificateIssued):
            found.setdefault(document.uid, (arrival_ns, document))
    return _sealed(store, found.values())


def _documents(views: _Views) -> dict[str, tuple[int, CertificateIssued]]:
    return {
        document.uid: (arrival_ns, document)
        for text, arrival_ns in views.rows(_SQL, {"kind": CertificateIssued.__name__})
        for document in [decode_json(text, CertificateIssued)]
    }


def _sealed(store: Store, found: Iterable[tuple[int, CertificateIssued]]) -> Certificates:
    ordered = sorted(found, key=lambda each: (each[0], each[1].t_ns))
    return Certificates([document for _, document in ordered if is_sealed(store, document)])


def file_of(store: Store, number: str, suffix: str = ".pdf") -> Path:
    """Where a store keeps a file of a certificate; a number may have slashes, and no two numbers have one file.

    >>> store = Store(Path("lab"), "1f")
    >>> file_of(store, "GYL-2026-0001").as_posix(), file_of(store, "GYL/2026 0001").as_posix()
    ('lab/certificates/GYL-2026-0001.pdf', 'lab/certificates/GYL_2026_0001-bbac2b75.pdf')
    """
    name = _plain(number)
    mark = "" if name == number else f"-{sha256_of(number.encode())[:8]}"
    return store.folder / FOLDER / f"{name}{mark}{suffix}"


def kept_file(store: Store, number: str, suffix: str = ".pdf") -> Path:
    """The file of an issued certificate, also as earlier releases named it."""
    path = file_of(store, number, suffix)
    return path if path.is_file() else store.folder / FOLDER / f"{_plain(number)}{suffix}"


def _plain(number: str) -> str:
    return "".join(each if each.isalnum() or each in "-." else "_" for each in number)


def proposed_file(store: Store, proposal: str, suffix: str = ".pdf") -> Path:
    """Where a store keeps a file of a certificate that waits for another person to approve it."""
    return store.folder / FOLDER / "proposed" / f"{proposal}{suffix}"


def waiting_certificates(store: Store) -> list[CertificateIssued]:
    """Certificates that are proposed, and neither issued nor rejected."""
    return [act for act, is_open in _proposed(store) if is_open]


def proposed_numbers(store: Store) -> set[str]:
    """Numbers of all certificates that were ever proposed: a rejected one is not given again."""
    return {act.number for act, _ in _proposed(store)}


def _proposed(store: Store) -> list[tuple[CertificateIssued, bool]]:
    found = [(each.act, each.state == "open") for each in read_proposals(store).values()]
    return [(act, is_open) for act, is_open in found if isinstance(act, CertificateIssued)]


def append_certificate(store: Store, document: CertificateIssued) -> None:
    """Append the document of a certificate, sealed, to the log, durably."""
    record_documents(store, [sealed(store, document)], role=_ROLE, place=_PLACE, builds_lake=True)


def sha256_of(content: bytes) -> str:
    """SHA-256 in hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()
