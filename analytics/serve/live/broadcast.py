"""Changes for all who listen: each encoded once, the last ones kept for those who come back."""

import asyncio
from collections import deque
from collections.abc import AsyncIterator
from itertools import takewhile

_KEPT = 2400
HEARTBEAT_S = 15.0


class Broadcast:
    """Numbered changes; used from the event loop."""

    def __init__(self, stopping: asyncio.Event) -> None:
        self._kept: deque[tuple[int, bytes, bytes]] = deque(maxlen=_KEPT)
        self._stopping = stopping
        self._news = asyncio.Event()
        self.listeners = 0

    def send(self, version: int, event: bytes, packed: bytes) -> None:
        """Send a change to all, to each as it is or packed."""
        self._kept.append((version, event, packed))
        self.wake()

    def wake(self) -> None:
        """Let all look whether there is something new, or whether the server stops."""
        self._news.set()
        self._news = asyncio.Event()

    def has_after(self, version: int) -> bool:
        """Whether all changes after a version are kept."""
        return bool(self._kept) and self._kept[0][0] <= version + 1 and version <= self._kept[-1][0]

    async def after(self, version: int, *, is_packed: bool = False) -> AsyncIterator[bytes | None]:
        """Changes after a version as they come; None where there was none for a while. Ends when the server stops."""
        self.listeners += 1
        try:
            while not self._stopping.is_set():
                news = self._news
                found = self._after(version)
                for number, event, packed in found:
                    version = number
                    yield packed if is_packed else event
                if found:
                    continue
                try:
                    await asyncio.wait_for(news.wait(), HEARTBEAT_S)
                except TimeoutError:
                    yield None
        finally:
            self.listeners -= 1

    def _after(self, version: int) -> list[tuple[int, bytes, bytes]]:
        """Kept changes after a version; the newest are looked at first, since most listeners miss one or two."""
        return list(takewhile(lambda each: each[0] > version, reversed(self._kept)))[::-1]


def event(kind: str, number: str, data: bytes) -> bytes:
    """A server-sent event."""
    return b"id: %s\nevent: %s\ndata: %s\n\n" % (number.encode(), kind.encode(), data)
