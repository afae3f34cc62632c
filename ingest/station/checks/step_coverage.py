"""Whether the units deliver as many samples in a step as their sample intervals imply."""

import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from stream.batch import IntArray, SampleBatch

_KEPT_BATCHES = 8  # of each signal: what comes just before a step begins can be labelled with a time just behind it
_MAY_LACK_FRACTION = 0.02
_MAY_LACK_SAMPLES = 1  # where a step begins between two samples
_SILENT_S, _SILENT_INTERVALS = 10.0, 5.0  # on the computer, and of its samples, after which a unit is silent


@dataclass
class _Seen:
    dt_ns: int = 1
    last_ns: int = 0
    inside: int = 0
    recent: deque[IntArray] = field(default_factory=lambda: deque(maxlen=_KEPT_BATCHES))


class StepCoverage:
    """Counts the samples of `units` in the evaluated part of a step; batches come from any thread.

    >>> from uuid import UUID
    >>> import numpy as np
    >>> coverage = StepCoverage(["FOG-1", "FOG-2"])
    >>> coverage.begin(0, 1000)
    >>> coverage.see(SampleBatch("FOG-1", "rate", "r1", UUID(int=1), 0, 0, 10, "deg/s", values=np.zeros(90)))
    >>> coverage.is_whole
    False
    >>> coverage.lacking()
    [('FOG-1', 'signal rate has 90 of 100 samples'), ('FOG-2', 'no sample came')]
    """

    def __init__(self, units: Sequence[str]) -> None:
        self._units, self._known = tuple(units), frozenset(units)
        self._seen: dict[tuple[str, str], _Seen] = {}
        self._begin_ns = self._end_ns = 0
        self._arrived_s: dict[str, float] = {}
        self._longest_ns: dict[str, int] = {}  # sample interval of the slowest signal of each unit
        self._watched_s: float | None = None
        self._lock = threading.Lock()

    def begin(self, begin_ns: int, end_ns: int) -> None:
        """Count samples from `begin_ns` to before `end_ns` from now on."""
        with self._lock:
            self._begin_ns, self._end_ns = begin_ns, end_ns
            for seen in self._seen.values():
                seen.inside = sum(self._inside(times_ns) for times_ns in seen.recent)

    def see(self, batch: SampleBatch) -> None:
        """Count a batch."""
        if batch.unit not in self._known or not len(batch):
            return
        times_ns = batch.time_array
        with self._lock:
            seen = self._seen.setdefault((batch.unit, batch.signal), _Seen())
            seen.dt_ns, seen.last_ns = batch.dt_ns, int(times_ns[-1])
            seen.inside += self._inside(times_ns)
            seen.recent.append(times_ns)
            self._arrived_s[batch.unit] = time.monotonic()
            self._longest_ns[batch.unit] = max(self._longest_ns.get(batch.unit, 0), batch.dt_ns)

    def watch(self, *, is_recording: bool) -> None:
        """Count silence from now on, or no more."""
        with self._lock:
            self._watched_s = time.monotonic() if is_recording else None

    def silent(self, speed: float = 1.0) -> dict[str, float]:
        """Units of which nothing comes while a step records, and for how long, seconds on the computer.

        `speed`: of a simulated station's clock, in which the sample intervals are.
        """
        now_s = time.monotonic()
        found = {}
        with self._lock:
            if self._watched_s is None:
                return {}
            for unit in self._units:
                dt_ns = self._longest_ns.get(unit, 0)
                since_s = now_s - max(self._arrived_s.get(unit, 0.0), self._watched_s)
                if since_s > max(_SILENT_S, _SILENT_INTERVALS * dt_ns / 1e9 / speed):
                    found[unit] = since_s
        return found

    def release(self, unit: str) -> None:
        """Expect nothing of a unit any more."""
        with self._lock:
            self._units = tuple(each for each in self._units if each != unit)
            self._known = frozenset(self._units)
            self._seen = {key: seen for key, seen in self._seen.items() if key[0] != unit}

    @property
    def is_whole(self) -> bool:
        """Whether every signal that has ever come has come up to the end of the step, and each unit has one."""
        with self._lock:
            come = {unit for unit, _ in self._seen}
            return come == self._known and all(s.last_ns + s.dt_ns >= self._end_ns for s in self._seen.values())

    @property
    def longest_interval_s(self) -> float:
        """Longest sample interval that has come, seconds."""
        with self._lock:
            return max((seen.dt_ns for seen in self._seen.values()), default=0) / 1e9

    def lacking(self) -> list[tuple[str, str]]:
        """Units that delivered nothing or clearly fewer samples than they should, and what they lack."""
        found = []
        with self._lock:
            for unit in self._units:
                signals = {signal: seen for (of, signal), seen in sorted(self._seen.items()) if of == unit}
                if not any(seen.inside for seen in signals.values()):
                    found.append((unit, "no sample came"))
                    continue
                for signal, seen in signals.items():
                    expected = (self._end_ns - self._begin_ns) // seen.dt_ns
                    if expected - seen.inside > max(_MAY_LACK_SAMPLES, _MAY_LACK_FRACTION * expected):
                        found.append((unit, f"signal {signal} has {seen.inside} of {expected} samples"))
        return found

    def _inside(self, times_ns: IntArray) -> int:
        return int(times_ns.searchsorted(self._end_ns) - times_ns.searchsorted(self._begin_ns))
