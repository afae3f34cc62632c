"""Documents of a store about itself, and their signature (the stored field `seal`).

They may come over the bus, where anybody can read the store's identity and write in its name. The signature needs a
secret that is in the store's folder only, in no message and no segment.
"""

import hmac
import os
import time
from hashlib import sha256
from secrets import token_bytes
from typing import Any, TypeVar

import msgspec

from storage.log.event_log import EventLog
from storage.log.sequence import LogPlace
from storage.segments.records import EVENTS, LogRecord
from storage.store import Store
from storage.store_marker import is_replica
from stream.errors import StoreError
from stream.events import (
    ActProposed,
    AnyDocument,
    CertificateIssued,
    ModelActivated,
    ProposalRejected,
    SpecificationEntered,
    StoreNoted,
    encode_event,
)
from stream.identity import Place
from stream.security.file_modes import fault_of_secret
from stream.wire.acknowledgement import StreamId

LAKE = Place("store", "lake")
_SECRET = "seal.key"  # noqa: S105  a file name
_SEAL = "seal"
_BYTES = 32
# documents that only the store itself enters
SEALED = (SpecificationEntered, CertificateIssued, ActProposed, ProposalRejected)
_WHAT = {
    SpecificationEntered: "specification", CertificateIssued: "certificate", ActProposed: "proposal",
    ProposalRejected: "decision on a proposal",
}  # fmt: skip
CanBeSealed = ModelActivated | SpecificationEntered | CertificateIssued | ActProposed | ProposalRejected
Sealed = TypeVar("Sealed", bound=CanBeSealed)


def store_document(store: str, what: str, text: str, details: dict[str, Any]) -> StoreNoted:
    """A document of the store with that identity, dated now.

    >>> document = store_document("5e", "disk_low", "", {})
    >>> is_own(document, "5e"), is_own(document, "6f")
    (True, False)
    """
    return StoreNoted(run="", t_ns=time.time_ns(), what=what, text=text, details={**details, "store": store})


def append_document(log: EventLog, stream: StreamId, document: StoreNoted) -> None:
    """Append a document to the log as the next message of a stream; durable after its next `sync`."""
    seq, t_ns = log.marks.get(stream, 0), document.t_ns
    record = LogRecord(stream.key, EVENTS, t_ns, t_ns, encode_event(document, stream.epoch, seq))
    log.append(LogPlace(stream, seq, seq + 1, t_ns, t_ns, ""), record)


def is_own(document: StoreNoted, store: str) -> bool:
    """Whether a document names that store; recorders on one bus receive the documents of all of them."""
    named: object = document.details.get("store")
    return named == store


def is_foreign(document: StoreNoted, store: str) -> bool:
    """Whether a document names another store; one that names none belongs to the store whose log holds it."""
    named: object = document.details.get("store", store)
    return named != store


def signed(store: Store, document: StoreNoted) -> StoreNoted:
    """The document with the store's signature."""
    details = {name: value for name, value in document.details.items() if name != _SEAL}
    plain = msgspec.structs.replace(document, details=details)
    return msgspec.structs.replace(document, details={**details, _SEAL: _digest(_secret(store), plain)})


def sealed(store: Store, document: Sealed) -> Sealed:
    """The document with the identity and the signature of a store."""
    plain = msgspec.structs.replace(document, store=store.identity, seal="")
    return msgspec.structs.replace(plain, seal=_digest(_secret(store), plain))


def is_sealed(store: Store, document: CanBeSealed) -> bool:
    """Whether a document has the signature of a store.

    The secret stays at the plant: a fleet store's copy relies on the plant's recorder, which accepts no other.
    """
    if is_replica(store.folder):
        return document.store == store.identity
    return hmac.compare_digest(document.seal.encode(), sealed(store, document).seal.encode())


def forgery(store: Store, document: AnyDocument) -> str | None:
    """Why a document that came over the bus must not be recorded; None if it may be.

    Documents of this store, its specifications, certificates and proposals need its signature. Documents of other
    stores are recorded, their specifications, certificates and proposals are not.
    """
    if isinstance(document, SEALED):
        if document.store != store.identity:
            return f"it is a {_WHAT[type(document)]} of another store"
        seal: object = document.seal
        wanted = sealed(store, document).seal
    elif isinstance(document, StoreNoted) and not is_foreign(document, store.identity):
        seal, wanted = document.details.get(_SEAL), signed(store, document).details[_SEAL]
    else:
        return None
    is_valid = isinstance(seal, str) and hmac.compare_digest(seal.encode(), wanted.encode())
    return None if is_valid else "it claims to be of the store that is recorded to, and lacks its seal"


def _digest(secret: bytes, document: StoreNoted | CanBeSealed) -> str:
    return hmac.new(secret, msgspec.json.encode(document, order="deterministic"), sha256).hexdigest()


def _secret(store: Store) -> bytes:
    path = store.folder / _SECRET
    try:
        try:
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
        except FileExistsError:
            pass
        else:
            with os.fdopen(descriptor, "wb") as file:
                file.write(token_bytes(_BYTES))
                file.flush()
                os.fsync(file.fileno())
        if fault_of_secret(path):
            path.chmod(0o600)
        secret = path.read_bytes()
    except OSError as error:
        raise StoreError(f"{path} cannot be read or written: {error}; free space or repair the disk") from error
    if len(secret) != _BYTES:
        raise StoreError(f"{path} is damaged; remove it, a new one is then created")
    return secret
