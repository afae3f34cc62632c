"""What all requests of a server share."""

import asyncio
import os
import secrets
import shutil
import time
from collections import Counter
from collections.abc import AsyncIterator, Awaitable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from typing import TypeVar

import anyio

from analytics.serve.answer_cache import AnswerCache
from analytics.serve.doors.doorkeeper import Doorkeeper
from analytics.serve.doors.rate_limit import RateLimit
from analytics.serve.jobs import Jobs
from analytics.serve.live.broadcast import Broadcast, event
from analytics.serve.live.follower import FloorFollower
from analytics.serve.live.fresh_views import FreshViews
from analytics.serve.live.packed import packed
from analytics.serve.memo import Memo
from analytics.serve.problems import Stopping
from analytics.serve.shared_lake import LakeState, SharedCatalogue, SharedLake
from analytics.serve.sql_pool import SqlPool
from analytics.serve.warming import Warming
from storage.recording.status_board import StatusBoard
from storage.store import Store
from stream.errors import GyrofleetError
from stream.status import role_status
from stream.status.reporter import StatusReporter
from stream.status.role_status import RoleStatus, new_status

_METRICS_LOOK_S = 0.05
_MOST_OF_UNITS = 500
_COMMANDS_AT_ONCE, _COMMAND_EVERY_S = 6, 5.0
Result = TypeVar("Result")


def _threads(least: int) -> anyio.CapacityLimiter:
    return anyio.CapacityLimiter(max(least, 2 * (os.cpu_count() or 1)))


@dataclass
class Service:
    """The parts of a server.

    Parameters
    ----------
    fast: Threads for views and rollups.
    slow: Threads for metrics and long computations, so that they hold up nobody else.
    command_tries: How often a person may command stations.
    logins: Threads for passwords and providers, so that a crowd of logins holds up no page.
    memo: What many requests need, kept as long as it is the version's.
    of_units: The same of single units, of which many are looked at.
    nonce: Distinguishes the ETags of this process from those of one before it.
    requests: How many were answered.
    changed: How many changes people have made here; what is shared is not older than the last one.
    listening: Pages of each person that listen to the floor.
    """

    store: Store
    doorkeeper: Doorkeeper
    lake: SharedLake
    sql: SqlPool
    live: FloorFollower
    is_on_loopback: bool
    jobs: Jobs = field(default_factory=Jobs)
    memo: Memo = field(default_factory=Memo)
    of_units: Memo = field(default_factory=lambda: Memo(_MOST_OF_UNITS))
    cache: AnswerCache = field(default_factory=AnswerCache)
    fast: anyio.CapacityLimiter = field(default_factory=lambda: _threads(4))
    slow: anyio.CapacityLimiter = field(default_factory=lambda: _threads(2))
    command_tries: RateLimit = field(default_factory=lambda: RateLimit(_COMMANDS_AT_ONCE, _COMMAND_EVERY_S))
    logins: anyio.CapacityLimiter = field(default_factory=lambda: anyio.CapacityLimiter(4))
    nonce: str = field(default_factory=lambda: secrets.token_hex(4))
    began_ns: int = field(default_factory=time.time_ns)
    requests: int = 0
    changed: int = 0
    listening: Counter[str] = field(default_factory=Counter)
    stopping: asyncio.Event = field(default_factory=asyncio.Event)
    changes: Broadcast = field(init=False)
    fresh: SharedCatalogue[FreshViews] = field(init=False)
    warming: Warming = field(init=False)

    def __post_init__(self) -> None:
        """Connect the parts with each other."""
        self.fresh = SharedCatalogue(lambda state: FreshViews(self.lake, self.live, state), lingers_s=1.5)
        self.changes = Broadcast(self.stopping)
        self.warming = Warming(self.lake, self.live, self.fresh, lambda: self.busy_threads > 0)

    @property
    def busy_threads(self) -> int:
        """Requests that threads are answering."""
        return self.fast.borrowed_tokens + self.slow.borrowed_tokens

    def has_changed(self) -> None:
        """Let nobody who asks from now on see what was before a change that has just been made here."""
        self.changed += 1
        self.warming.changed()

    async def state(self) -> LakeState:
        """The version of lake and log that a request is answered from."""
        opened = self.warming.opened()
        if opened is not None:
            return opened
        return await anyio.to_thread.run_sync(self.warming.newest, limiter=self.fast, abandon_on_cancel=True)

    async def metrics(self) -> None:
        """Wait until metrics are open, in no thread: whoever needs none of them goes on meanwhile."""
        while not self.warming.has_metrics():
            await asyncio.sleep(_METRICS_LOOK_S)

    async def result(self, work: Awaitable[Result]) -> Result:
        """The result of some work; raises Stopping where the server ends before."""
        task, ends = asyncio.ensure_future(work), asyncio.ensure_future(self.stopping.wait())
        try:
            await asyncio.wait({task, ends}, return_when=asyncio.FIRST_COMPLETED)
            if not task.done():
                raise Stopping
            return task.result()
        finally:
            task.cancel()
            ends.cancel()

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Follow the floor beside the requests."""
        loop = asyncio.get_running_loop()

        def tell(version: int, kind: str, data: bytes) -> None:
            with suppress(RuntimeError):  # the server has ended
                change = event(kind, f"{self.nonce}-{version}", data)
                loop.call_soon_threadsafe(self.changes.send, version, change, packed(change))

        self.live.start(self.lake, tell)
        self.warming.start()
        with StatusReporter(self.status, StatusBoard(self.store).put):
            try:
                yield
            finally:
                self.stop()

    def status(self) -> RoleStatus:
        """What the server reports of itself."""
        numbers: dict[str, float] = {
            "requests_total": self.requests,
            "cache_hits_total": self.cache.hits,
            "cache_misses_total": self.cache.misses,
            "cache_bytes": self.cache.bytes,
            "busy_threads": self.busy_threads,
            "sessions": len(self.doorkeeper.sessions),
            "listeners": self.changes.listeners,
            "logins_refused_total": self.doorkeeper.watch.counts["login refused"],
            "requests_refused_total": self.doorkeeper.watch.counts["refused"],
            "lag_seconds": self.live.lag_s,
        }
        trouble, free_bytes = self.live.problem or "", shutil.disk_usage(self.store.folder).free
        try:
            state = self.lake.state()
            numbers |= {"lake_manifest": state.number, "lake_samples": sum(part.samples for part in state.parts)}
        except GyrofleetError as error:
            trouble = str(error)
        whole = {name: float(value) for name, value in numbers.items()} | {"free_bytes": float(free_bytes)}
        return new_status(role_status.Role.SERVE, self.began_ns, trouble=trouble[:4000], numbers=whole)

    def stop(self) -> None:
        """End what would keep the server from ending: event streams, statements."""
        self.stopping.set()
        self.changes.wake()
        self.sql.close()

    def close(self) -> None:
        """Close what is open."""
        self.warming.close()
        self.live.close()
        self.jobs.close()
        self.sql.close()
        self.fresh.close()
        self.lake.close()
