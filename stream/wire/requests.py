"""Requests of a source to a recorder, and the replies: who sends what, and what the store has of it.

Requests have one key, replies a key for each request. A chunk of a key that starts with ``@`` is matched by no
wildcard, so that neither is recorded.
"""

import re
from typing import Any, TypeVar

import msgspec

from stream.bounds import MAX_MESSAGE_BYTES
from stream.decoding import decode_msgpack
from stream.errors import WireError
from stream.identity import ROOT

REQUEST_KEY = f"{ROOT}/@request"
LEASE_S = 3.0  # duration of a claim that is not renewed
RENEW_S = 0.7
_ID = re.compile(r"[0-9A-Za-z_-]{1,64}")
MOST_ROWS = 1_000_000  # samples in one answer
FORM = 2  # of answers about signals and runs: another number where their fields change


class Hello(msgspec.Struct, frozen=True, tag=True):
    """Which recorders are there?"""


class Claim(msgspec.Struct, frozen=True, tag=True):
    """Let `holder` alone send samples of these units and runs, until it releases them or is silent for a lease.

    `station` sends them.
    """

    holder: str
    text: str
    owners: tuple[tuple[str, str], ...]
    station: str = ""


class Release(msgspec.Struct, frozen=True, tag=True):
    """The holder has ended."""

    holder: str


class Settle(msgspec.Struct, frozen=True, tag=True):
    """Move everything that has come to the lake, from which later requests are answered."""


class AskSignals(msgspec.Struct, frozen=True, tag=True):
    """Which signals of these runs are there, in which unit, from when to when, and how many samples?"""

    runs: tuple[str, ...]


class AskRuns(msgspec.Struct, frozen=True, tag=True):
    """Date, end and documents of these runs?"""

    runs: tuple[str, ...]


class AskSamples(msgspec.Struct, frozen=True, tag=True):
    """Times and values of a signal between two moments, both inclusive; null for more than `MOST_ROWS`."""

    unit: str
    signal: str
    run: str
    first_ns: int
    last_ns: int


Question = Hello | Claim | Release | Settle | AskSignals | AskRuns | AskSamples


class Request(msgspec.Struct, frozen=True):
    """A question to the recorder of a store; to every recorder if `store` is empty."""

    id: str
    store: str
    question: Question


class Reply(msgspec.Struct, frozen=True):
    """The answer of the recorder of a store, or its error; `form` is its `FORM`, 0 of recorders before it had one."""

    id: str
    store: str
    answer: Any = None
    error: str = ""
    form: int = 0


Message = TypeVar("Message", Request, Reply)


def is_id(request_id: str) -> bool:
    """Whether a request can be answered: its id is a chunk of a key.

    >>> is_id("0f3a"), is_id(""), is_id("a/**")
    (True, False, False)
    """
    return _ID.fullmatch(request_id) is not None


def reply_key(request_id: str) -> str:
    """Key expression of the replies to a request."""
    return f"{ROOT}/@reply/{request_id}"


def encode(message: Request | Reply) -> bytes:
    """The wire form of a request or a reply."""
    return msgspec.msgpack.encode(message)


def decode(payload: bytes, kind: type[Message]) -> Message:
    """Read a request or a reply; raises WireError."""
    if len(payload) > MAX_MESSAGE_BYTES:
        raise WireError(f"{len(payload)} bytes are more than a message may have")
    try:
        return decode_msgpack(payload, kind)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise WireError(f"neither a request nor an answer: {error}") from error
