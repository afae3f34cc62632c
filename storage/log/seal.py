"""A seal on what a store says of itself: only who can read the store's folder can make it.

Documents of a store come over the bus too, as those of retention do while a recorder is at work. Its identity is in
every acknowledgement, so that anybody could write in its name; the secret is in no message and in no segment.
"""

import hmac
import os
from hashlib import sha256
from secrets import token_bytes

import msgspec

from storage.log.notes import is_foreign
from storage.store import Store
from stream.errors import StoreError
from stream.events import AnyDocument, SpecificationEntered, StoreNoted

_SECRET = "seal.key"  # noqa: S105  a file name
_SEAL = "seal"
_BYTES = 32


def sealed(store: Store, document: StoreNoted) -> StoreNoted:
    """The document with the seal of the store that it is of.

    Raises
    ------
    StoreError: If the secret cannot be read or written.
    """
    details = {name: value for name, value in document.details.items() if name != _SEAL}
    plain = msgspec.structs.replace(document, details=details)
    return msgspec.structs.replace(document, details={**details, _SEAL: _digest(_secret(store), plain)})


def is_sealed(store: Store, document: StoreNoted) -> bool:
    """Whether a document has the store's own seal."""
    seal = document.details.get(_SEAL)
    if not isinstance(seal, str):
        return False
    wanted = sealed(store, document).details[_SEAL]
    return hmac.compare_digest(seal.encode(), str(wanted).encode())


def sealed_specification(store: Store, document: SpecificationEntered) -> SpecificationEntered:
    """The document with the identity and the seal of a store.

    Raises
    ------
    StoreError: If the secret cannot be read or written.
    """
    plain = msgspec.structs.replace(document, store=store.identity, seal="")
    return msgspec.structs.replace(plain, seal=_digest(_secret(store), plain))


def forged(store: Store, document: AnyDocument) -> str | None:
    """Why a document that came over the bus is not to be believed; None where it may be.

    What a store says of itself, and its specifications, count with its seal only. Specifications of another store are
    not recorded; what another store says of itself is.
    """
    if isinstance(document, SpecificationEntered):
        if document.store != store.identity:
            return "it is a specification of another store"
        is_own = hmac.compare_digest(document.seal.encode(), sealed_specification(store, document).seal.encode())
    elif isinstance(document, StoreNoted):
        is_own = is_foreign(document, store.identity) or is_sealed(store, document)
    else:
        is_own = True
    return None if is_own else "it says that it is of the store that is recorded to, and has not its seal"


def _digest(secret: bytes, document: StoreNoted | SpecificationEntered) -> str:
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
        secret = path.read_bytes()
    except OSError as error:
        raise StoreError(f"{path} cannot be read or written: {error}; free space or mend the disk") from error
    if len(secret) != _BYTES:
        raise StoreError(f"{path} is damaged; remove it, it is written anew")
    return secret
