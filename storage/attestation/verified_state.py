"""What an attestation says was verified: segments that are sound as long as they have the SHA-256 that was signed."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from storage.attestation.attestation import AttestedSegment, entry_digest, kept_attestations, read_attestation
from storage.attestation.signing_key import fingerprint
from storage.manifests.entries import SegmentEntry
from storage.store import Store
from stream.errors import StoreError

_MAKE_ONE = "`gyrofleet attest --verify` makes one"


class VerifiedState(NamedTuple):
    """The segments that were read whole and found sound before an attestation, by name.

    `where` is the attestation's file, `at_ns` its time, `signed_by` the fingerprint of its key.
    """

    where: str
    at_ns: int
    signed_by: str
    segments: Mapping[str, AttestedSegment]

    def has(self, entry: SegmentEntry) -> bool:
        """Whether a segment was verified with this very entry of the log's manifest."""
        known = self.segments.get(entry.segment)
        if known is None or (entry.size, entry.sha256) != (known.size, known.sha256):
            return False
        return entry_digest(entry) == known.entry


def verified_state(store: Store, path: Path, signer: str = "") -> VerifiedState:
    """The state that an attestation of a store says was verified; StoreError if it does not, or cannot be trusted.

    `signer` is the fingerprint of the key that must have signed it.
    """
    found = read_attestation(path)
    if not found.is_genuine:
        raise StoreError(f"{path}: its signature is not that of its key and text; use the attestation that was kept")
    by, stated = fingerprint(found.public), found.stated
    if signer and by != signer:
        raise StoreError(f"{path} is signed by the key {by}, not by {signer}; ask whose key this is")
    if stated.store != store.identity:
        raise StoreError(f"{path} is of the store {stated.store}, {store.folder} is {store.identity}")
    if stated.unverified is None:
        raise StoreError(f"{path} does not say that the store was verified before it was signed; {_MAKE_ONE} that does")
    left_out = set(stated.unverified)
    segments = {each.name: each for each in stated.segments if each.name not in left_out}
    return VerifiedState(str(path), stated.at_ns, by, segments)


def newest_verified_state(store: Store, signer: str = "") -> VerifiedState | None:
    """The newest of the store's own attestations that says what was verified; None if there is none.

    With `signer`, the newest that this key has signed.
    """
    for path in reversed(kept_attestations(store)):
        try:
            return verified_state(store, path, signer)
        except StoreError:
            continue
    return None


def last_verified_state(store: Store, signer: str = "") -> VerifiedState:
    """As `newest_verified_state`; StoreError if there is none."""
    found = newest_verified_state(store, signer)
    if found is None:
        by = f" signed by {signer}" if signer else ""
        raise StoreError(f"no attestation in {store.folder}{by} says that the store was verified; {_MAKE_ONE}")
    return found
