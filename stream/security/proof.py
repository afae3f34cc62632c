"""Proofs of origin: of a message by its source, checked by the recorder and kept in its log; of acknowledgements.

A link proves its other end only: a router in between could send in any name. So a source signs documents (ECDSA), and
adds to samples and estimates a MAC for each recorder of the site, under a key that both derive from their certificates'
keys (ECDH, HKDF): a signature takes as long as a hundred MACs. Proofs cover the key expression and the whole message.

A proof is the last field of a message: field 19 of a batch, `proof` of a document. Readers without it skip it.
"""

import struct
from base64 import b64decode, b64encode
from functools import lru_cache
from hashlib import blake2b
from hmac import compare_digest
from typing import NamedTuple

import msgspec

from stream.decoding import msgpack_decoder
from stream.errors import GyrofleetError, WireError
from stream.security.access import AccessList
from stream.security.credentials import Credentials
from stream.security.rights import Principal, Role, principal_of

PROOF_BYTES = 1024  # room for a proof in a message
_MAC_BYTES = 16
_TAIL = b"\xc4\x00"  # no signature
_AFTER = _MAC_BYTES + len(_TAIL)
_MOST_BEGUN = 50_000  # key expressions, about 500 bytes each
_MESSAGE, _ACKNOWLEDGEMENT = b"gyrofleet message\0", b"gyrofleet acknowledgement\0"
_JSON_FIELD = b',"proof":"'
_FIELD = b"\x9a\x01"  # number 19, bytes
_LENGTH = struct.Struct("<H")


class Forged(WireError):
    """A message without a valid proof of its source."""


class Proof(msgspec.Struct, frozen=True, array_like=True):
    """Who sent a message, and the MAC for each recorder by its name, or a signature."""

    by: str
    macs: dict[str, bytes] = {}
    signature: bytes = b""


_decoder = msgpack_decoder(Proof)


class Proven(NamedTuple):
    """A message without its proof, and the proof as it is in the message; None if it has none."""

    body: bytes
    packed: bytes | None

    @property
    def proof(self) -> Proof | None:
        """The proof; raises Forged if it cannot be read."""
        return None if self.packed is None else _proof(self.packed)

    def check(self) -> None:
        """Raise Forged if there is a proof that cannot be read."""
        if self.packed is not None:
            _proof(self.packed)


def _proof(packed: bytes) -> Proof:
    try:
        return _decoder.decode(packed)
    except (msgspec.MsgspecError, ValueError) as error:
        raise Forged(f"its proof of origin cannot be read: {error}") from error


def credentials_of(bus: object) -> Credentials | None:
    """The credentials that a bus has; None on one without security."""
    found = getattr(bus, "credentials", None)
    return found if isinstance(found, Credentials) else None


def joined(body: bytes, proof: Proof) -> bytes:
    """A message with its proof.

    >>> split(joined(b'{"schema":1}', Proof("station:c1"))).body
    b'{"schema":1}'
    """
    packed = msgspec.msgpack.encode(proof)
    if body.startswith(b"{"):
        return body[:-1] + _JSON_FIELD + b64encode(packed) + b'"}'
    size = len(packed) + _LENGTH.size
    return body + _field_head(size) + packed + _LENGTH.pack(size)


def split(payload: bytes) -> Proven:
    """The parts of a message; raises Forged if its proof cannot be read."""
    try:
        if payload.startswith(b"{"):
            at = payload.rfind(_JSON_FIELD)
            packed = payload[at + len(_JSON_FIELD) : -2]
            if at < 0 or not payload.endswith(b'"}') or b'"' in packed:
                return Proven(payload, None)
            return Proven(payload[:at] + b"}", b64decode(packed, validate=True))
        if len(payload) < _LENGTH.size:
            return Proven(payload, None)
        (size,) = _LENGTH.unpack_from(payload, len(payload) - _LENGTH.size)
        head = _field_head(size)
        at = len(payload) - size - len(head)
        if size < _LENGTH.size or at < 0 or payload[at : at + len(head)] != head:
            return Proven(payload, None)
        return Proven(payload[:at], payload[at + len(head) : -_LENGTH.size])
    except ValueError as error:
        raise Forged(f"its proof of origin cannot be read: {error}") from error


@lru_cache(maxsize=1024)
def _field_head(size: int) -> bytes:
    """Number and length of the field; the length in three bytes, which protobuf allows."""
    return _FIELD + bytes((size & 0x7F | 0x80, size >> 7 & 0x7F | 0x80, size >> 14))


class _Macs:
    """MACs under one secret; what they have in common for a key expression is hashed once."""

    def __init__(self, secret: bytes) -> None:
        self._secret = secret
        self._begun: dict[str, blake2b] = {}

    def of(self, key: str, body: bytes) -> bytes:
        """The MAC of a message."""
        begun = self._begun.get(key)
        if begun is None:
            if len(self._begun) >= _MOST_BEGUN:
                self._begun.clear()
            begun = self._begun[key] = blake2b(_context(key), digest_size=_MAC_BYTES, key=self._secret)
        state = begun.copy()
        state.update(body)
        return state.digest()


class SourceProver:
    """Adds proofs to the messages of a source."""

    def __init__(self, credentials: Credentials) -> None:
        self._own, self._by = credentials, credentials.principal.common_name
        recorders = [each for each in credentials.access.admitted if each.role is Role.RECORDER]
        self._macs = [(each.common_name, _Macs(shared_key(credentials, each, credentials.principal, each)))
                      for each in sorted(recorders)]  # fmt: skip
        # of a proof for one recorder all is the same but the MAC
        self._frame: tuple[bytes, bytes] | None = None
        if len(self._macs) == 1:
            packed = msgspec.msgpack.encode(Proof(self._by, {self._macs[0][0]: bytes(_MAC_BYTES)}))
            size = len(packed) + _LENGTH.size
            self._frame = _field_head(size) + packed[:-_AFTER], packed[-len(_TAIL) :] + _LENGTH.pack(size)

    def prove(self, key: str, body: bytes) -> bytes:
        """The message with its proof."""
        if key.endswith("/event") or not self._macs:
            return joined(body, Proof(self._by, signature=_signature(self._own, _context(key), body)))
        if self._frame is not None and not body.startswith(b"{"):
            before, after = self._frame
            return b"".join((body, before, self._macs[0][1].of(key, body), after))
        return joined(body, Proof(self._by, {name: macs.of(key, body) for name, macs in self._macs}))


class SourceVerifier:
    """Checks the proofs of messages for a recorder."""

    def __init__(self, credentials: Credentials) -> None:
        self._own = credentials
        self._name = credentials.principal.common_name
        self._known: dict[str, tuple[Principal, _Macs]] = {}
        # by what is the same in every proof of a source for this recorder alone
        self._frames: dict[bytes, tuple[Principal, _Macs]] = {}

    @property
    def access(self) -> AccessList:
        """Who is admitted, and the site's rules."""
        return self._own.access

    def source_of(self, key: str, message: Proven) -> Principal:
        """Who sent a message; raises Forged if its proof is not that of an admitted principal."""
        body, packed = message
        if packed is None:
            raise Forged("it has no proof of its source")
        frame = packed[:-_AFTER]
        found = self._frames.get(frame)
        if found is not None and packed.endswith(_TAIL):
            principal, macs = found
            if not compare_digest(packed[-_AFTER : -len(_TAIL)], macs.of(key, body)):
                raise Forged(f"its proof is not that of {principal}")
            return principal
        proof = message.proof
        assert proof is not None
        found = self._known.get(proof.by)
        if found is None:
            found = self._known[proof.by] = self._admitted(proof.by)
        principal, macs = found
        if proof.signature:
            is_valid = _is_signed(self._own, principal, proof.signature, _context(key), body)
        else:
            mac = proof.macs.get(self._name, b"")
            if not mac:
                raise Forged(f"{principal} does not know {self._own.principal}: copy the newest access.json there")
            is_valid = compare_digest(mac, macs.of(key, body))
            if is_valid and len(proof.macs) == 1 and packed == frame + mac + _TAIL:
                self._frames[frame] = principal, macs
        if not is_valid:
            raise Forged(f"its proof is not that of {principal}")
        return principal

    def _admitted(self, common_name: str) -> tuple[Principal, _Macs]:
        try:
            principal = principal_of(common_name)
        except GyrofleetError as error:
            raise Forged(str(error)) from error
        if (reason := self._own.access.reason_against(principal)) is not None:
            raise Forged(reason)
        return principal, _Macs(shared_key(self._own, principal, principal, self._own.principal))


def signed_acknowledgement(credentials: Credentials, content: bytes) -> bytes:
    """The signature of an acknowledgement by a recorder."""
    return _signature(credentials, _ACKNOWLEDGEMENT, content)


def check_acknowledgement(credentials: Credentials, by: str, signature: bytes, content: bytes) -> None:
    """Raise Forged unless a recorder of the site signed the content."""
    try:
        principal = principal_of(by)
    except GyrofleetError as error:
        raise Forged(str(error)) from error
    if principal.role is not Role.RECORDER:
        raise Forged(f"{principal} is no recorder")
    if (reason := credentials.access.reason_against(principal)) is not None:
        raise Forged(reason)
    if not _is_signed(credentials, principal, signature, _ACKNOWLEDGEMENT, content):
        raise Forged(f"it is not signed by {principal}")


def shared_key(own: Credentials, other: Principal, source: Principal, recorder: Principal) -> bytes:
    """The secret of a source and a recorder, one of which is this side."""
    from cryptography.hazmat.primitives.asymmetric.ec import ECDH
    from cryptography.hazmat.primitives.hashes import SHA256
    from cryptography.hazmat.primitives.kdf.hkdf import HKDF

    public = own.access.key_of(other)
    assert public is not None
    about = f"gyrofleet mac\0{source.common_name}\0{recorder.common_name}".encode()
    return HKDF(SHA256(), 32, None, about).derive(own.key.exchange(ECDH(), public))


def _context(key: str) -> bytes:
    return _MESSAGE + key.encode() + b"\0"


def _signature(own: Credentials, context: bytes, body: bytes) -> bytes:
    from cryptography.hazmat.primitives.asymmetric.ec import ECDSA
    from cryptography.hazmat.primitives.hashes import SHA256

    return own.key.sign(context + body, ECDSA(SHA256()))


def _is_signed(own: Credentials, by: Principal, signature: bytes, context: bytes, body: bytes) -> bool:
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives.asymmetric.ec import ECDSA
    from cryptography.hazmat.primitives.hashes import SHA256

    public = own.access.key_of(by)
    if public is None:
        return False
    try:
        public.verify(signature, context + body, ECDSA(SHA256()))
    except InvalidSignature:
        return False
    return True
