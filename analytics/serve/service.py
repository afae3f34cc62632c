"""What all requests of a server share."""

import asyncio
import os
import secrets
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field

import anyio

from analytics.serve.answer_cache import AnswerCache
from analytics.serve.doors.doorkeeper import Doorkeeper
from analytics.serve.jobs import Jobs
from analytics.serve.live.broadcast import Broadcast, event
from analytics.serve.live.follower import FloorFollower
from analytics.serve.shared_lake import SharedLake
from analytics.serve.sql_pool import SqlPool
from storage.store import Store


def _threads(least: int) -> anyio.CapacityLimiter:
    return anyio.CapacityLimiter(max(least, 2 * (os.cpu_count() or 1)))


@dataclass
class Service:
    """The parts of a server.

    Parameters
    ----------
    fast: Threads for views and rollups.
    slow: Threads for metrics and long computations, so that they hold up nobody else.
    nonce: Distinguishes the ETags of this process from those of one before it.
    requests: How many were answered.
    """

    store: Store
    doorkeeper: Doorkeeper
    lake: SharedLake
    sql: SqlPool
    live: FloorFollower
    is_on_loopback: bool
    jobs: Jobs = field(default_factory=Jobs)
    cache: AnswerCache = field(default_factory=AnswerCache)
    fast: anyio.CapacityLimiter = field(default_factory=lambda: _threads(4))
    slow: anyio.CapacityLimiter = field(default_factory=lambda: _threads(2))
    nonce: str = field(default_factory=lambda: secrets.token_hex(4))
    began_s: float = field(default_factory=time.time)
    requests: int = 0
    stopping: asyncio.Event = field(default_factory=asyncio.Event)
    changes: Broadcast = field(init=False)

    def __post_init__(self) -> None:
        """Connect the floor's changes with the end of the server."""
        self.changes = Broadcast(self.stopping)

    @property
    def busy_threads(self) -> int:
        """Requests that threads are answering."""
        return self.fast.borrowed_tokens + self.slow.borrowed_tokens

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Follow the floor beside the requests."""
        loop = asyncio.get_running_loop()

        def tell(version: int, kind: str, data: bytes) -> None:
            with suppress(RuntimeError):  # the server has ended
                loop.call_soon_threadsafe(self.changes.send, version, event(kind, f"{self.nonce}-{version}", data))

        self.live.start(self.lake, tell)
        try:
            yield
        finally:
            self.stop()

    def stop(self) -> None:
        """End what would keep the server from ending: event streams, statements."""
        self.stopping.set()
        self.changes.wake()
        self.sql.close()

    def close(self) -> None:
        """Close what is open."""
        self.live.close()
        self.jobs.close()
        self.sql.close()
        self.lake.close()
