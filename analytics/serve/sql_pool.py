"""Processes that answer SQL statements: a few at a time, kept while the lake stays as it is."""

import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

from analytics.serve.doors.rate_limit import RateLimit
from analytics.serve.doors.roles import Person
from analytics.serve.problems import TooMany
from analytics.serve.shared_lake import LakeState
from storage.sql.door import QueryLimits, SqlDoor
from storage.store import Store, writer_is_active
from stream.closing import Closing

MOST_ROWS = 1_000_000
LIMITS = QueryLimits()._replace(
    time_s=30.0,
    memory_bytes=min(2 << 30, os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 4),
    rows=2 * MOST_ROWS,  # more than are read of any result
)
_AT_ONCE = 2
_PATIENCE_S = 20.0
_FRESH_S = 1.0


class _Idle(NamedTuple):
    """A door, the version of the lake that it is of, and when it was opened."""

    tag: str
    began_s: float
    door: SqlDoor


class SqlPool(Closing):
    """Doors for statements, `_AT_ONCE` at a time; each person may ask 60 at once and one a second more."""

    def __init__(self, store: Store, limits: QueryLimits = LIMITS) -> None:
        self._store, self._limits = store, limits
        self._rate = RateLimit(60, 1.0)
        self._free = threading.BoundedSemaphore(_AT_ONCE)
        self._lock = threading.Lock()
        self._idle: list[_Idle] = []
        self._busy: dict[SqlDoor, _Idle] = {}
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
                self._put_back(door)  # after an error as well: a door starts a new process if it needs one
        finally:
            self._free.release()

    def _taken(self, tag: str) -> SqlDoor:
        with self._lock:
            fresh = [each for each in self._idle if each.tag == tag and not self._is_old(each)]
            stale = [each for each in self._idle if each not in fresh]
            taken = fresh.pop() if fresh else _Idle(tag, time.monotonic(), SqlDoor(self._store, self._limits))
            self._idle = fresh
            self._busy[taken.door] = taken
        for each in stale:
            each.door.close()
        return taken.door

    def _is_old(self, idle: _Idle) -> bool:
        """Whether a recorder may have written what the door does not see."""
        return time.monotonic() - idle.began_s > _FRESH_S and writer_is_active(self._store.folder)

    def _put_back(self, door: SqlDoor) -> None:
        with self._lock:
            idle = self._busy.pop(door)
            if not self._is_closed:
                self._idle.append(idle)
                return
        door.close()

    def close(self) -> None:
        """End all processes, those at work as well."""
        with self._lock:
            self._is_closed = True
            doors = [*(each.door for each in self._idle), *self._busy]
            self._idle = []
        for door in doors:
            door.close()
