"""A thread that keeps the floor: reads the log many times a second, and tells at once what has changed."""

import itertools
import threading
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from typing import Any

from analytics.first_floor import fill_floor
from analytics.floor import Floor, UnitNow, parsed_key
from analytics.serve.live.course import LiveCourse
from analytics.serve.live.floor_rows import FloorRows
from analytics.serve.live.rows import LiveRows, RowTables
from analytics.serve.live.tail import LiveTail
from analytics.serve.shared_lake import SharedLake
from storage.log.follower import ContinuedBatch, FollowedMessage, LogFollower
from storage.store import Store
from stream.closing import Closing
from stream.errors import GyrofleetError
from stream.events import EstimatePublished
from stream.terminal.console import json_text
from stream.wire.batches import RawBatch

_LOOK_S = 0.05
_AT_ONCE = 200  # messages
_RUNS_S = 1.0  # between two rows of the same run
_ROWS_S = 0.5  # between two versions of the rows that only the log has
_TRY_AGAIN_S = 5.0
_FILLED_WITHIN_S = 10.0
_ENTERED = ("SpecificationEntered", "CheckEntered", "ExclusionEntered", "ModelActivated")
Tell = Callable[[int, str, bytes], None]
"""Takes a version of the floor, whether it is the whole ``floor`` or a ``change``, and its JSON."""


class FloorFollower(Closing):
    """Follows a store's log; `lag_s` is how long the last look took, `problem` why it does not work, if so."""

    def __init__(self, store: Store) -> None:
        self.floor, self.rows, self.tail, self.course = Floor(), FloorRows(), LiveTail(), LiveCourse()
        self.fresh = LiveRows()
        self._document: tuple[Floor | None, float, dict[str, Any]] = (None, 0.0, {})  # the last one, and since when
        self.lag_s = 0.0
        self.problem: str | None = None
        self._store = store
        self._lock = threading.Lock()
        self._ends = threading.Event()
        self._is_filled = threading.Event()
        self._is_read = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self, lake: SharedLake, tell: Tell) -> None:
        """Begin; `tell` gets each version with its changes."""
        self._thread = threading.Thread(target=self._follow, args=(lake, tell), daemon=True, name="floor")
        self._thread.start()

    def document(self, most_s: float = 0.0) -> dict[str, Any]:
        """The floor now, or as it was at most so many seconds ago; waits for the first one.

        It is shared by those who ask: nobody changes it.
        """
        self._is_filled.wait(_FILLED_WITHIN_S)
        with self._lock:
            now_s = time.monotonic()
            floor, made_s, document = self._document
            if floor is not self.floor or now_s - made_s > most_s:
                document = self.rows.document(self.floor)
                self._document = self.floor, now_s, document
            return document | {"problem": self.problem, "lag_s": round(self.lag_s, 3)}

    @contextmanager
    def unit(self, name: str) -> Iterator[UnitNow | None]:
        """A unit on the floor, which stays as it is within."""
        self._is_filled.wait(_FILLED_WITHIN_S)
        with self._lock:
            yield self.floor.units.get(name)

    def verdicts_so_far(self, run: str) -> dict[str, int] | None:
        """Units of a run on the floor by their verdict so far, early decisions included; None if it is not there."""
        self._is_filled.wait(_FILLED_WITHIN_S)
        with self._lock:
            units = [unit for unit in self.floor.units.values() if unit.run.run == run and not unit.is_instrument]
            return dict(sorted(Counter(unit.so_far or "OPEN" for unit in units).items())) if units else None

    @property
    def log_versions(self) -> tuple[int, int]:
        """Numbers that grow as documents come that the lake does not have, and as channels or documents do."""
        with self._lock:
            return self.fresh.documents, self.fresh.version

    def beyond(self, in_lake: Collection[str]) -> RowTables:
        """Rows of what a version of the lake does not have; waits until the log has been read once."""
        self.wait()
        with self._lock:
            return self.fresh.beyond(in_lake)

    def wait(self) -> None:
        """Wait until the log has been read once, for some seconds."""
        self._is_read.wait(_FILLED_WITHIN_S)

    def entered(self) -> str:
        """Changes with each document that changes limits, checks or models."""
        return str(sum(self.floor.entered[name] for name in _ENTERED))

    def close(self) -> None:
        """End the thread."""
        self._ends.set()
        if self._thread is not None:
            self._thread.join(timeout=2.0)

    def _follow(self, lake: SharedLake, tell: Tell) -> None:
        while not self._ends.is_set():
            try:
                self._follow_store(lake, tell)
            except (GyrofleetError, OSError) as error:
                self.problem = str(error)
                self._is_read.set()  # requests get what there is
                self._ends.wait(_TRY_AGAIN_S)

    def _follow_store(self, lake: SharedLake, tell: Tell) -> None:
        state = lake.state()
        fresh = Floor()
        with lake.views.lease(state) as catalog:
            fill_floor(fresh, catalog)
        with self._lock:
            self.floor, self.tail, self.course = fresh, LiveTail(), LiveCourse()
            self.rows.begin()
            document = self.rows.document(fresh)
        tell(document["version"], "floor", json_text(document).encode())
        self._is_filled.set()
        sent_s = published_s = 0.0
        rows = LiveRows(self.fresh.version + 1, self.fresh.documents + 1)
        with LogFollower(self._store, state.segments, unread=True) as messages:
            while not self._ends.is_set():
                began_s = time.monotonic()
                new = messages.poll()
                # read without the lock, so that requests have the floor meanwhile
                while some := list(itertools.islice(new, _AT_ONCE)):
                    with self._lock:
                        for message in some:
                            self._take(message, rows)
                self.lag_s, self.problem = time.monotonic() - began_s, None
                if began_s - published_s >= _ROWS_S:
                    published_s = began_s
                    in_lake = lake.state().segments
                    self.tail.forget(in_lake)
                    self.course.forget(in_lake)
                    with self._lock:
                        rows.forget(in_lake)
                        rows.publish()
                        self.fresh = rows
                    self._is_read.set()
                is_due = began_s - sent_s >= _RUNS_S
                if is_due:
                    sent_s = began_s
                self._tell(tell, with_runs=is_due)
                # as long again as the look took, so that requests have their turn
                self._ends.wait(max(_LOOK_S, time.monotonic() - began_s))

    def _take(self, message: FollowedMessage, rows: LiveRows) -> None:
        entered = self.floor.take_message(message)
        if entered is not None and message.place is not None:
            place = parsed_key(message.place.stream.key).place
            self.course.take(message.segment, place, entered, message.record.arrival_ns)
        rows.take(message)
        if isinstance(message.content, RawBatch | ContinuedBatch):
            self.tail.take(message.segment, message.content, len(message.record.data))
        elif isinstance(message.content, EstimatePublished):
            self.tail.take_estimate(message.content)

    def _tell(self, tell: Tell, *, with_runs: bool) -> None:
        with self._lock:
            if with_runs:
                self.floor.listen(time.time_ns())
            changes = self.rows.changes(self.floor, with_runs=with_runs)
            self.floor.forget_changes()
        if changes is not None:
            tell(changes["version"], "change", json_text(changes).encode())
