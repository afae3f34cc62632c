"""An attestation: what a store's log and issued files were at a moment, signed; kept in the store and elsewhere.

The signed text lists every sealed segment with its SHA-256, in the order of the log's manifest, the head of the
manifest's chain, the files that are never changed once written, and the SHA-256 of the attestation before it.
"""

import base64
import hashlib
import re
import time
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import msgspec

from storage.attestation.signing_key import SigningKey, is_signed
from storage.attestation.time_stamp import request_stamp
from storage.carried_names import is_carried
from storage.manifests.entries import SegmentEntry
from storage.manifests.log import read_log_manifest
from storage.segments.disk import sha256_of
from storage.specifications.copies import FOLDER as SPECIFICATIONS
from storage.store import Store, only_one
from storage.store_marker import is_replica
from stream.decoding import decode_json
from stream.errors import StoreError
from stream.files.atomic_file import write_durably

FOLDER = "attestations"
_FORMAT = 1
_NAME = re.compile(r"\d{8}\.json")


class AttestedSegment(msgspec.Struct, frozen=True, array_like=True):
    """A sealed segment: name, bytes, SHA-256 of its file and of its entry in the manifest."""

    name: str
    size: int
    sha256: str
    entry: str


class AttestedFile(msgspec.Struct, frozen=True, array_like=True):
    """A file: its path in the store and SHA-256."""

    path: str
    sha256: str


class Statement(msgspec.Struct, frozen=True, kw_only=True):
    """What is signed.

    `unverified` are the segments that were sealed after the store was verified and found sound; None if it was not
    verified for this attestation.
    """

    format: int = _FORMAT
    store: str
    at_ns: int
    version: str
    head: str
    segments: tuple[AttestedSegment, ...]
    files: tuple[AttestedFile, ...]
    previous: str = ""
    unverified: tuple[str, ...] | None = None


class Attestation(msgspec.Struct, frozen=True, kw_only=True):
    """A signed statement, as text so that its bytes are those that were signed."""

    statement: str
    public_key: str
    signature: str
    algorithm: str = "Ed25519"
    time_stamp: str = ""  # of the signature, by an authority (RFC 3161); base64

    @property
    def stated(self) -> Statement:
        """What it states; StoreError if it cannot be read."""
        try:
            found = decode_json(self.statement, Statement)
        except msgspec.MsgspecError as error:
            raise StoreError(f"the attestation's statement cannot be read: {error}") from error
        if found.format > _FORMAT:
            raise StoreError("the attestation has a newer format than this gyrofleet reads: upgrade gyrofleet")
        return found

    @property
    def public(self) -> bytes:
        """The public key in it; empty if that cannot be read."""
        try:
            return bytes.fromhex(self.public_key)
        except ValueError:
            return b""

    @property
    def signature_bytes(self) -> bytes:
        """The signature; empty if it cannot be read."""
        try:
            return base64.b64decode(self.signature, validate=True)
        except ValueError:  # binascii.Error, and text that is not ASCII
            return b""

    @property
    def is_genuine(self) -> bool:
        """Whether its signature is that of its key."""
        return self.algorithm == "Ed25519" and is_signed(self.public, self.signature_bytes, self.statement.encode())


def entry_digest(entry: SegmentEntry) -> str:
    """SHA-256 of an entry of the log's manifest."""
    return hashlib.sha256(msgspec.json.encode(entry)).hexdigest()


def lasting_files(store: Store) -> Iterator[Path]:
    """Issued certificates, error models and copies of specifications."""
    for folder in ("certificates", "models", SPECIFICATIONS):
        for path in sorted((store.folder / folder).rglob("*")):
            is_copy = folder == SPECIFICATIONS and path.suffix == ".toml"
            is_lasting = is_copy or is_carried(path.relative_to(store.folder).as_posix())
            if is_lasting and path.is_file() and not path.is_symlink():
                yield path


def kept_attestations(store: Store) -> list[Path]:
    """The store's own attestations, oldest first."""
    return sorted(path for path in (store.folder / FOLDER).glob("*.json") if _NAME.fullmatch(path.name))


def read_attestation(path: Path) -> Attestation:
    """Read an attestation; StoreError if the file is none."""
    if path.exists() and not path.is_file():
        raise StoreError(f"{path} is no file; give the one that `gyrofleet attest --out FILE` has written")
    try:
        return decode_json(path.read_bytes(), Attestation)
    except (OSError, msgspec.MsgspecError) as error:
        raise StoreError(f"{path} is no attestation: {error}; `gyrofleet attest --out FILE` writes one") from error


class Attested(NamedTuple):
    """An attestation, where it is kept, and why it has no time stamp though one was asked for."""

    path: Path
    attestation: Attestation
    unstamped: str = ""


def attest(
    store: Store, key: SigningKey, *, timestamp_url: str = "", verified: Mapping[str, SegmentEntry] | None = None
) -> Attested:
    """Sign what the store is now, have it stamped by an authority if one is given, and keep it there.

    `verified` are the segments of a store that was just verified and is sound, which is signed too. Without an answer
    of the authority it is kept without a stamp. StoreError if the log's manifest is damaged, or the store is a fleet
    store's copy of a plant.
    """
    if is_replica(store.folder):
        raise StoreError(
            f"{store.folder} is a fleet store's copy of a plant, nothing is signed: attest at the plant; its "
            "attestations arrive with its segments"
        )
    with only_one(store.folder / FOLDER / ".lock", "gyrofleet attest"):
        found = read_log_manifest(store, whole=True)
        if found.damage:
            line, why = found.damage[0]
            raise StoreError(
                f"the log's manifest of {store.folder} is damaged in line {line}: {why}; nothing is signed. "
                "`gyrofleet verify` says more"
            )
        before = kept_attestations(store)
        statement = Statement(
            store=store.identity, at_ns=time.time_ns(), version=version("gyrofleet"), head=found.last,
            segments=tuple(
                AttestedSegment(entry.segment, entry.size, entry.sha256, entry_digest(entry))
                for entry in found.entries.values()
            ),
            files=tuple(
                AttestedFile(path.relative_to(store.folder).as_posix(), sha256_of(path))
                for path in lasting_files(store)
            ),
            previous=sha256_of(before[-1]) if before else "",
            unverified=None if verified is None else tuple(
                name for name, entry in found.entries.items() if verified.get(name) != entry
            ),
        )  # fmt: skip
        text = msgspec.json.encode(statement).decode()
        signature, stamp, unstamped = key.sign(text.encode()), "", ""
        if timestamp_url:
            try:
                stamp = request_stamp(timestamp_url, signature)
            except StoreError as error:  # the anchor counts more than the proof of its time
                unstamped = str(error)
        signed = Attestation(
            statement=text, public_key=key.public.hex(), signature=base64.b64encode(signature).decode(),
            time_stamp=stamp,
        )  # fmt: skip
        number = int(before[-1].stem) + 1 if before else 1
        path = store.folder / FOLDER / f"{number:08d}.json"
        try:
            write_durably(path, msgspec.json.encode(signed), overwrite=False)
        except OSError as error:
            raise StoreError(f"{path} cannot be written: {error}; free or repair the disk") from error
    return Attested(path, signed, unstamped)
