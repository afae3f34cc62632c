"""Processes that answer SQL statements: a few at a time, kept while the lake stays as it is."""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from analytics.serve.doors.rate_limit import RateLimit
from analytics.serve.doors.roles import Person
from analytics.serve.problems import TooMany
from analytics.serve.shared_lake import LakeState
from storage.sql.door import QueryLimits, SqlDoor
from storage.store import Store
from stream.closing import Closing

MOST_ROWS = 1_000_000
LIMITS = QueryLimits()._replace(
    time_s=30.0,
    memory_bytes=min(2 << 30, os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 4),
    rows=2 * MOST_ROWS,  # more than are read of any result
)
_AT_ONCE = 2
_PATIENCE_S = 20.0


class SqlPool(Closing):
    """Doors for statements, `_AT_ONCE` at a time; each person may ask 60 at once and one a second more."""

    def __init__(self, store: Store, limits: QueryLimits = LIMITS) -> None:
        self._store, self._limits = store, limits
        self._rate = RateLimit(60, 1.0)
        self._free = threading.BoundedSemaphore(_AT_ONCE)
        self._lock = threading.Lock()
        self._idle: list[tuple[str, SqlDoor]] = []
        self._busy: set[SqlDoor] = set()
        self._is_closed = False

    @contextmanager
    def door(self, state: LakeState, person: Person) -> Iterator[SqlDoor]:
        """A door of the lake as it is now; TooMany if the person asks too often, or all are taken for long."""
        if (wait_s := self._rate.wait_s(person.name)) > 0.0:
            raise TooMany(f"{person.name} asks too many statements", wait_s)
        if not self._free.acquire(timeout=_PATIENCE_S):
            raise TooMany("other statements are still being answered", _PATIENCE_S)
        try:
            door = self._taken(state.tag)
            try:
                yield door
            finally:
                self._put_back(state.tag, door)  # after an error as well: a door starts a new process if it needs one
        finally:
            self._free.release()

    def _taken(self, tag: str) -> SqlDoor:
        with self._lock:
            fresh = [door for of, door in self._idle if of == tag]
            stale = [door for of, door in self._idle if of != tag]
            door = fresh.pop() if fresh else SqlDoor(self._store, self._limits)
            self._idle = [(tag, each) for each in fresh]
            self._busy.add(door)
        for each in stale:
            each.close()
        return door

    def _put_back(self, tag: str, door: SqlDoor) -> None:
        with self._lock:
            self._busy.discard(door)
            if not self._is_closed:
                self._idle.append((tag, door))
                return
        door.close()

    def close(self) -> None:
        """End all processes, those at work as well."""
        with self._lock:
            self._is_closed = True
            doors = [*(door for _, door in self._idle), *self._busy]
            self._idle = []
        for door in doors:
            door.close()
