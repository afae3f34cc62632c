"""Interfaces of a recorder for a worker: a log to read missed messages from, and a sender of documents."""

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple, Protocol

import numpy as np

from stream.events import AnyDocument
from stream.wire.acknowledgement import StreamId


class LoggedMessage(NamedTuple):
    """A numbered message of a log, and the number that follows it."""

    stream: StreamId
    next_seq: int
    payload: bytes


class LogBeginning(NamedTuple):
    """Positions from which unfinished runs are complete, and the runs that have ended, which are left out."""

    positions: dict[StreamId, int]
    ended: frozenset[str]


class RecordedLog(Protocol):
    """The log from which a worker reads missed messages."""

    @property
    def identity(self) -> str:
        """Identity of the store."""

    def beginning(self, *, thorough: bool = False) -> LogBeginning:
        """Where to begin without a checkpoint: with runs in progress; if `thorough`, also those not fully estimated."""

    def since(self, positions: Mapping[StreamId, int]) -> Iterator[LoggedMessage]:
        """Messages beyond those positions, in order."""

    def published(self, positions: Mapping[StreamId, int]) -> Iterator[str]:
        """Identities of the estimates and decisions beyond those positions."""


class DocumentSender(Protocol):
    """Sender of estimates."""

    @property
    def outstanding(self) -> int:
        """Documents that are not in the log yet."""

    def send_event(self, key: str, document: AnyDocument) -> None:
        """Send a document under `key`."""

    def drain(self) -> None:
        """Wait until nothing is outstanding."""


class Identities:
    """A set of document identities in 8 bytes each: after weeks there are millions.

    >>> "b" in Identities(["a", "b"]), "c" in Identities(["a", "b"])
    (True, False)
    """

    def __init__(self, uids: Iterable[str]) -> None:
        self._digests = np.sort(np.fromiter((_digest(uid) for uid in uids), np.uint64))

    def __contains__(self, uid: str) -> bool:
        if len(self._digests) == 0:
            return False
        digest = np.uint64(_digest(uid))
        at = int(np.searchsorted(self._digests, digest))
        return at < len(self._digests) and bool(self._digests[at] == digest)


def _digest(uid: str) -> int:
    return int.from_bytes(hashlib.blake2b(uid.encode(), digest_size=8).digest())
