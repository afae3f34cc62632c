"""Answers of a recorder: how far it has each stream on disk, and what it requests again."""

from typing import NamedTuple

import msgspec

from stream.decoding import msgpack_decoder
from stream.errors import WireError
from stream.security.credentials import Credentials
from stream.security.proof import signed_acknowledgement


class StreamId(NamedTuple):
    """Messages numbered without a gap: one key expression within one epoch of its source."""

    key: str
    epoch: str


class StreamPosition(msgspec.Struct, frozen=True, array_like=True):
    """How far a recorder has a stream on disk; with `rewind` it requests the following messages again."""

    key: str
    epoch: str
    next_seq: int
    rewind: bool = False


class Acknowledgement(msgspec.Struct, frozen=True, array_like=True):
    """Streams that moved since the last one, their store, and why its recorder pauses; empty while it records.

    On a secured bus `by` is the recorder's common name, and `signature` its signature of all before.
    """

    schema: int
    store: str
    positions: tuple[StreamPosition, ...]
    paused: str = ""
    by: str = ""
    signature: bytes = b""

    @property
    def content(self) -> bytes:
        """What is signed."""
        return msgspec.msgpack.encode(msgspec.structs.replace(self, signature=b""))


ACKNOWLEDGEMENT_SCHEMA = 1
_decoder = msgpack_decoder(Acknowledgement)


def encode_acknowledgement(
    store: str, positions: tuple[StreamPosition, ...], paused: str = "", signer: Credentials | None = None
) -> bytes:
    """The wire form of positions, signed on a secured bus."""
    plain = Acknowledgement(ACKNOWLEDGEMENT_SCHEMA, store, positions, paused)
    if signer is None:
        return msgspec.msgpack.encode(plain)
    named = msgspec.structs.replace(plain, by=signer.principal.common_name)
    signature = signed_acknowledgement(signer, named.content)
    return msgspec.msgpack.encode(msgspec.structs.replace(named, signature=signature))


def decode_acknowledgement(payload: bytes) -> Acknowledgement:
    """Read positions from their wire form; raises WireError."""
    try:
        return _decoder.decode(payload)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise WireError(f"not an acknowledgement: {error}") from error
