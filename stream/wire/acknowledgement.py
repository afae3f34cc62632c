"""What a recorder answers: how far it has each stream on disk, and what it wants once more."""

from typing import NamedTuple

import msgspec

from stream.errors import WireError


class StreamId(NamedTuple):
    """What is numbered without a gap: one key expression within one epoch of its source."""

    key: str
    epoch: str


class StreamPosition(msgspec.Struct, frozen=True, array_like=True):
    """How far a recorder has a stream on disk; with `rewind` it asks for what comes next once more."""

    key: str
    epoch: str
    next_seq: int
    rewind: bool = False


class Acknowledgement(msgspec.Struct, frozen=True, array_like=True):
    """Positions of the streams that moved since the last acknowledgement, and the store that holds them.

    `paused` says why the recorder takes nothing at the moment; it is empty while it records.
    """

    schema: int
    store: str
    positions: tuple[StreamPosition, ...]
    paused: str = ""


ACKNOWLEDGEMENT_SCHEMA = 1
_decoder = msgspec.msgpack.Decoder(Acknowledgement)


def encode_acknowledgement(store: str, positions: tuple[StreamPosition, ...], paused: str = "") -> bytes:
    """Put positions into their wire form.

    Examples
    --------
    >>> decode_acknowledgement(encode_acknowledgement("s", (StreamPosition("k", "e", 7),))).positions[0].next_seq
    7
    """
    return msgspec.msgpack.encode(Acknowledgement(ACKNOWLEDGEMENT_SCHEMA, store, positions, paused))


def decode_acknowledgement(payload: bytes) -> Acknowledgement:
    """Read positions from their wire form.

    Raises
    ------
    WireError: If it is none.
    """
    try:
        return _decoder.decode(payload)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise WireError(f"not an acknowledgement: {error}") from error
