"""A recorder as a worker sees it: a log to read again what it has missed, and a way to send documents there."""

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from typing import Protocol

import numpy as np

from stream.delivery.publisher import StreamId
from stream.events import AnyDocument


class LoggedMessage(Protocol):
    """A message of a numbered stream that was recorded."""

    @property
    def stream(self) -> StreamId:
        """Which stream."""

    @property
    def payload(self) -> bytes:
        """What was sent."""


class LogBeginning(Protocol):
    """Where to begin in a log."""

    @property
    def positions(self) -> dict[StreamId, int]:
        """Numbers to begin with."""

    @property
    def ended(self) -> frozenset[str]:
        """Runs that are left out of what comes behind them."""


class RecordedLog(Protocol):
    """Where a worker reads again what it has missed."""

    @property
    def identity(self) -> str:
        """Identity of the store."""

    def beginning(self, *, thorough: bool = False) -> LogBeginning:
        """Where one begins who knows nothing: with runs that go on; if `thorough`, also those not estimated whole."""

    def since(self, positions: Mapping[StreamId, int]) -> Iterator[LoggedMessage]:
        """Messages beyond those positions, in their order."""

    def published(self, positions: Mapping[StreamId, int]) -> Iterator[str]:
        """Identities of the estimates and decisions beyond those positions."""


class DocumentSender(Protocol):
    """What estimates are sent with."""

    @property
    def outstanding(self) -> int:
        """Documents that are not in the log yet."""

    def send_event(self, key: str, document: AnyDocument) -> None:
        """Send a document under `key`."""

    def drain(self) -> None:
        """Wait until nothing is outstanding."""


class Identities:
    """Which documents there are already, in 8 bytes each: after weeks there are millions.

    Parameters
    ----------
    uids: Those that there are.

    Examples
    --------
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
