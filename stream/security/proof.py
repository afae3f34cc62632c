"""Proofs of origin: of a message by its source, checked by the recorder and kept in its log; of acknowledgements.

A link proves its other end only: a router in between could send in any name. So a source signs documents (ECDSA), and
adds to samples and estimates a MAC for each recorder of the site, under a key that both derive from their certificates'
keys (ECDH, HKDF): a signature takes as long as fifty MACs. Proofs cover the key expression and the whole message. A MAC
has session, number and tag (`message_macs`).

A proof is the last field of a message: field 19 of a batch, `proof` of a document. Readers without it skip it.
"""

import os
import struct
from base64 import b64decode, b64encode
from collections.abc import Callable
from functools import lru_cache
from hmac import compare_digest
from itertools import count
from typing import NamedTuple
from weakref import WeakSet

import msgspec

from stream.decoding import msgpack_decoder
from stream.errors import GyrofleetError, WireError
from stream.security.access import AccessList
from stream.security.credentials import Credentials
from stream.security.message_macs import (
    EARLIER_MAC_BYTES,
    MAC_BYTES,
    NUMBER_BYTES,
    SESSION_BYTES,
    TAG_BYTES,
    MacSession,
    earlier_mac,
    message_context,
)
from stream.security.rights import Principal, Role, principal_of

PROOF_BYTES = 1024  # room for a proof in a message
_TAIL = b"\xc4\x00"  # no signature
_MOST_SESSIONS = 10_000  # of a verifier; one more begins again
_ACKNOWLEDGEMENT = b"gyrofleet acknowledgement\0"
_JSON_FIELD = b',"proof":"'
_FIELD = b"\x9a\x01"  # number 19, bytes
_LENGTH = struct.Struct("<H")
_HEAD_BYTES = len(_FIELD) + 3
_AFTER_BYTES = len(_TAIL) + _LENGTH.size
_NUMBER_AND_TAG = struct.Struct(f"{NUMBER_BYTES}s{TAG_BYTES}s")
_VARIED_BYTES = NUMBER_BYTES + TAG_BYTES + _AFTER_BYTES  # from the number of a MAC to the end of the message


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


class SourceProver:
    """Adds proofs to the messages of a source."""

    def __init__(self, credentials: Credentials) -> None:
        self._contexts: dict[str, bytes] = {}  # of keys under which messages have MACs for one recorder
        self._own, self._by = credentials, credentials.principal.common_name
        recorders = sorted(each for each in credentials.access.admitted if each.role is Role.RECORDER)
        self._secrets = {
            each.common_name: shared_key(credentials, each, credentials.principal, each) for each in recorders
        }
        self.begin_session()
        _provers.add(self)

    def begin_session(self) -> None:
        """Number messages from 0 again, under a key of its own."""
        self._numbers = count()
        self._name = os.urandom(SESSION_BYTES)
        self._sessions = {recorder: MacSession(secret, self._name) for recorder, secret in self._secrets.items()}
        # of a proof for one recorder all is the same but number and tag
        self._frame: tuple[bytes, Callable[[bytes, bytes, bytes], bytes], bytes] | None = None
        if len(self._sessions) == 1:
            ((recorder, session),) = self._sessions.items()
            packed = msgspec.msgpack.encode(Proof(self._by, {recorder: self._name + bytes(NUMBER_BYTES + TAG_BYTES)}))
            size = len(packed) + _LENGTH.size
            before = packed[: -NUMBER_BYTES - TAG_BYTES - len(_TAIL)]
            self._frame = _field_head(size) + before, session.encrypt, _TAIL + _LENGTH.pack(size)

    def prove(self, key: str, body: bytes) -> bytes:
        """The message with its proof."""
        context = self._contexts.get(key)
        if context is not None and body[:1] != b"{":
            assert self._frame is not None
            number = next(self._numbers).to_bytes(NUMBER_BYTES, "big")
            before, encrypt, after = self._frame
            return b"".join((body, before, number, encrypt(number, context, body)[-TAG_BYTES:], after))
        return self._prove(key, body)

    def _prove(self, key: str, body: bytes) -> bytes:
        if key.endswith("/event") or not self._sessions:
            return joined(body, Proof(self._by, signature=_signature(self._own, message_context(key), body)))
        number = next(self._numbers).to_bytes(NUMBER_BYTES, "big")
        if self._frame is not None:
            self._contexts[key] = message_context(key)
        begun = self._name + number
        macs = {recorder: begun + session.tag(number, key, body) for recorder, session in self._sessions.items()}
        return joined(body, Proof(self._by, macs))


_provers: WeakSet[SourceProver] = WeakSet()


def _begin_sessions() -> None:
    """In a forked process: it and its parent must not count under one key."""
    for each in list(_provers):
        each.begin_session()


os.register_at_fork(after_in_child=_begin_sessions)


class SourceVerifier:
    """Checks the proofs of messages for a recorder."""

    def __init__(self, credentials: Credentials) -> None:
        self._own = credentials
        self._name = credentials.principal.common_name
        self._known: dict[str, tuple[Principal, bytes]] = {}
        self._sessions: dict[tuple[str, bytes], MacSession] = {}
        # by what is the same in every message of a session for this recorder alone, and after it its end
        self._frames: dict[bytes, tuple[Principal, Callable[[bytes, bytes, bytes], bytes], bytes]] = {}

    @property
    def access(self) -> AccessList:
        """Who is admitted, and the site's rules."""
        return self._own.access

    def opened(self, key: str, payload: bytes) -> tuple[Principal, bytes]:
        """Who sent a message, and the message without its proof; raises Forged as `source_of`."""
        size = _HEAD_BYTES + (payload[-2] | payload[-1] << 8) if len(payload) > _VARIED_BYTES else 0
        found = self._frames.get(payload[-size:-_VARIED_BYTES])
        if found is not None:
            principal, encrypt, after = found
            if payload.endswith(after):
                body = payload[:-size]
                number, tag = _NUMBER_AND_TAG.unpack_from(payload, len(payload) - _VARIED_BYTES)
                if not compare_digest(tag, encrypt(number, message_context(key), body)[-TAG_BYTES:]):
                    raise Forged(f"its proof is not that of {principal}")
                return principal, body
        message = split(payload)
        principal = self.source_of(key, message)
        if not payload.startswith(b"{"):
            self._learn(principal, message, payload)
        return principal, message.body

    def _learn(self, principal: Principal, message: Proven, payload: bytes) -> None:
        """Expect more messages of a session, of which one has just been checked."""
        proof = message.proof
        if proof is None or proof.signature or len(proof.macs) != 1 or payload != joined(message.body, proof):
            return
        session = self._sessions.get((proof.by, proof.macs[self._name][:SESSION_BYTES]))
        if session is not None:
            if len(self._frames) >= _MOST_SESSIONS:
                self._frames.clear()
            frame = payload[len(message.body) : -_VARIED_BYTES]
            self._frames[frame] = principal, session.encrypt, payload[-_AFTER_BYTES:]

    def source_of(self, key: str, message: Proven) -> Principal:
        """Who sent a message; raises Forged if its proof is not that of an admitted principal."""
        body, proof = message.body, message.proof
        if proof is None:
            raise Forged("it has no proof of its source")
        found = self._known.get(proof.by)
        if found is None:
            found = self._known[proof.by] = self._admitted(proof.by)
        principal, secret = found
        if proof.signature:
            is_valid = _is_signed(self._own, principal, proof.signature, message_context(key), body)
        else:
            mac = proof.macs.get(self._name, b"")
            if not mac:
                raise Forged(f"{principal} does not know {self._own.principal}: copy the newest access.json there")
            is_valid = self._is_mac(principal, secret, mac, key, body)
        if not is_valid:
            raise Forged(f"its proof is not that of {principal}")
        return principal

    def _is_mac(self, principal: Principal, secret: bytes, mac: bytes, key: str, body: bytes) -> bool:
        if len(mac) == EARLIER_MAC_BYTES:
            return compare_digest(mac, earlier_mac(secret, key, body))
        if len(mac) != MAC_BYTES:
            return False
        name, number, tag = mac[:SESSION_BYTES], mac[SESSION_BYTES:-TAG_BYTES], mac[-TAG_BYTES:]
        of_session = principal.common_name, name
        session = self._sessions.get(of_session) or MacSession(secret, name)
        if not compare_digest(tag, session.tag(number, key, body)):
            return False
        if len(self._sessions) >= _MOST_SESSIONS:
            self._sessions.clear()
        self._sessions[of_session] = session
        return True

    def _admitted(self, common_name: str) -> tuple[Principal, bytes]:
        try:
            principal = principal_of(common_name)
        except GyrofleetError as error:
            raise Forged(str(error)) from error
        if (reason := self._own.access.reason_against(principal)) is not None:
            raise Forged(reason)
        return principal, shared_key(self._own, principal, principal, self._own.principal)


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
