"""Processes that answer SQL statements: a few at a time, kept while the lake stays as it is.

A door sees the log as it was at its first statement. So that nobody waits for the start of a process, one that has not
been asked anything stands by once somebody has asked.
"""

import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import NamedTuple

from analytics.serve.doors.rate_limit import RateLimit
from analytics.serve.doors.roles import Person
from analytics.serve.problems import TooMany
from analytics.serve.shared_lake import LakeState
from storage.sql.door import Advice, QueryLimits, SqlDoor
from storage.store import Store, writer_is_active
from stream.closing import Closing
from stream.errors import GyrofleetError

MOST_ROWS = 1_000_000
LIMITS = QueryLimits()._replace(
    time_s=30.0,
    memory_bytes=min(2 << 30, os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 4),
    rows=2 * MOST_ROWS,  # more than are read of any result
)
_ADVICE = Advice(
    kept="to keep a result ask for it as a file: `format` csv or parquet at /api/sql, a button on the page SQL",
    rows="ask for less: aggregate, or write `limit`",
    time="ask for less: one run, one signal or a shorter time, or `rollup_10s` in place of `samples`",
    memory="ask for less: fewer rows and columns at once, or aggregate them",
)
_AT_ONCE = 2
_PATIENCE_S = 20.0
_FRESH_S = 0.5


class _Idle(NamedTuple):
    """A door, the version of the lake that it is of, and when it was first asked; None if it has not been.

    `log_version` is that of the log beside the lake when it was first asked: the door sees those rows, perhaps more.
    """

    tag: str
    began_s: float | None
    door: SqlDoor
    log_version: int = 0


class SqlPool(Closing):
    """Doors for statements, `_AT_ONCE` at a time; each person may ask 60 at once and one a second more."""

    def __init__(self, store: Store, limits: QueryLimits = LIMITS) -> None:
        self._store, self._limits = store, limits
        self._rate = RateLimit(60, 1.0)
        self._free = threading.BoundedSemaphore(_AT_ONCE)
        self._lock = threading.Lock()
        self._idle: list[_Idle] = []
        self._busy: dict[SqlDoor, _Idle] = {}
        self._is_closed = self._starts = False

    @contextmanager
    def door(self, state: LakeState, person: Person) -> Iterator[SqlDoor]:
        """A door of the lake as it is now; TooMany if the person asks too often, or all are taken for long."""
        if (wait_s := self._rate.wait_s(person.name)) > 0.0:
            raise TooMany(f"{person.name} asks too many statements", wait_s)
        if not self._free.acquire(timeout=_PATIENCE_S):
            raise TooMany("other statements are still being answered", _PATIENCE_S)
        try:
            door = self._taken(state)
            try:
                yield door
            finally:
                self._put_back(door)  # after an error as well: a door starts a new process if it needs one
                self._stand_by(state.tag)
        finally:
            self._free.release()

    def _taken(self, state: LakeState) -> SqlDoor:
        with self._lock:
            fresh = [each for each in self._idle if each.tag == state.tag and not self._is_old(each, state)]
            stale = [each for each in self._idle if each not in fresh]
            fresh.sort(key=lambda each: each.began_s is not None)  # the one that stands by is taken last
            taken = fresh.pop() if fresh else _Idle(state.tag, None, self._new())
            if taken.began_s is None:
                taken = taken._replace(began_s=time.monotonic(), log_version=state.log_version)
            self._idle = fresh
            self._busy[taken.door] = taken
        for each in stale:
            each.door.close()
        return taken.door

    def _new(self) -> SqlDoor:
        return SqlDoor(self._store, self._limits, advice=_ADVICE)

    def _is_old(self, idle: _Idle, state: LakeState) -> bool:
        """Whether a recorder may have written, or one that has ended since did write, what the door does not see."""
        if idle.began_s is None or time.monotonic() - idle.began_s <= _FRESH_S:
            return False
        return idle.log_version != state.log_version or writer_is_active(self._store.folder)

    def _stand_by(self, tag: str) -> None:
        """Start a process for the next statement, beside the answer of this one."""
        with self._lock:
            is_needed = not self._is_closed and not self._starts and all(each.began_s for each in self._idle)
            self._starts |= is_needed
        if is_needed and writer_is_active(self._store.folder):
            threading.Thread(target=self._start_one, args=(tag,), daemon=True, name="sql").start()
        elif is_needed:
            self._starts = False

    def _start_one(self, tag: str) -> None:
        try:
            door = self._new()
            with suppress(GyrofleetError):  # the next statement reports it
                door.start()
            with self._lock:
                is_wanted = not self._is_closed
                if is_wanted:
                    self._idle.append(_Idle(tag, None, door))
            if not is_wanted:
                door.close()
        except GyrofleetError:
            pass  # the manifest is damaged: as above
        finally:
            self._starts = False

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
