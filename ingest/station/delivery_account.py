"""Which samples of the units are missing, and whether that is since nobody took them."""

import datetime as dt
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from uuid import UUID

from ingest.station.run_limits import listed
from ingest.station_clock import StationClock
from stream.batch import SampleBatch

_HELD_S = 1.0  # on the computer; a delivery that takes longer waits for room
_QUIET_S = 3.0  # after which a hold is over: what comes next has shown what was lost


@dataclass
class _Hold:
    units: set[str]
    began_ns: int
    ended_ns: int
    not_read: int = 0


class DeliveryAccount:
    """Counts samples that lack between those that are delivered, and those of them of times when delivery waited.

    A signal on no grid has no count: where that shows late, what was counted before was its wrong interval.
    While the delivery of a unit's samples waits its source is not read, so that what the unit sends is lost. `lost`
    are all that lack, `not_read` those of such times.
    """

    def __init__(self, clock: StationClock) -> None:
        self._clock = clock
        self._began_ns: dict[int, tuple[str, int]] = {}  # of deliveries under way, by thread
        self._last_ns: dict[tuple[str, str, UUID], int] = {}
        self._hold: _Hold | None = None
        self._lock = threading.Lock()
        self._lost: Counter[tuple[str, str, UUID]] = Counter()
        self.not_read = 0
        self.has_waited = False  # so that samples may lack that nothing counts

    @property
    def lost(self) -> int:
        """All samples that lack."""
        return self._lost.total()

    @contextmanager
    def delivering(self, batch: SampleBatch) -> Iterator[None]:
        """Count a batch that is delivered within it."""
        me = threading.get_ident()
        with self._lock:
            self._see(batch)
            self._began_ns[me] = batch.unit, self._clock.now_ns()
        try:
            yield
        finally:
            with self._lock:
                unit, began_ns = self._began_ns.pop(me)
                now_ns = self._clock.now_ns()
                if now_ns - began_ns > self._held_ns:
                    self.has_waited = True
                    hold = self._hold = self._hold or _Hold(set(), began_ns, now_ns)
                    hold.units.add(unit)
                    hold.began_ns, hold.ended_ns = min(hold.began_ns, began_ns), now_ns

    def not_read_now(self) -> set[str]:
        """Units whose delivery waits, or has waited until just now, so that they are not read."""
        now_ns = self._clock.now_ns()
        with self._lock:
            waiting = {unit for unit, began_ns in self._began_ns.values() if now_ns - began_ns > self._held_ns}
            return waiting if self._hold is None else waiting | self._hold.units

    def over(self, *, at_once: bool = False) -> tuple[list[str], str] | None:
        """Units that were not read for a time that is over, and a sentence on it; once."""
        with self._lock:
            hold, now_ns = self._hold, self._clock.now_ns()
            if hold is None or not (at_once or now_ns - hold.ended_ns > _QUIET_S * self._clock.speed * 1e9):
                return None
            if not at_once and any(now_ns - began_ns > self._held_ns for _, began_ns in self._began_ns.values()):
                return None
            self._hold = None
        begin, end = (dt.datetime.fromtimestamp(each / 1e9, dt.UTC) for each in (hold.began_ns, hold.ended_ns))
        units = sorted(hold.units)
        return units, (
            f"{listed(units)} were not read from {begin:%H:%M:%S} to {end:%H:%M:%S} UTC, as what had come waited "
            f"for a recorder and there was no room for more: {hold.not_read:,} samples are lost"
        )

    @property
    def _held_ns(self) -> float:
        return _HELD_S * self._clock.speed * 1e9

    def _see(self, batch: SampleBatch) -> None:
        if not len(batch):
            return
        stream = batch.unit, batch.signal, batch.epoch
        before_ns, self._last_ns[stream] = self._last_ns.get(stream), batch.last_ns
        if batch.irregular:
            self._lost.pop(stream, None)
            return
        if before_ns is None:
            return
        lost = round((batch.last_ns - before_ns) / batch.dt_ns) - len(batch)
        if lost <= 0:
            return
        self._lost[stream] += lost
        hold = self._hold
        if hold is not None and before_ns <= hold.ended_ns and batch.last_ns >= hold.began_ns:
            hold.not_read += lost
            self.not_read += lost
