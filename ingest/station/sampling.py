"""Reads an instrument periodically and makes batches of its readings."""

import math
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from uuid import UUID

import numpy as np

from ingest.instruments.base import Instrument, Reading
from ingest.source_fault import Fault
from stream.batch import SampleBatch
from stream.errors import GyrofleetError, InstrumentError

BATCH_S = 1.0

_GRID_TOLERANCE = 0.1
_MOST_IN_BATCH = 1000
_FIRST_PAUSE_S = 0.5
_LONGEST_PAUSE_S = 30.0
_NS = 1e9


class Sampler:
    """Reads one instrument at its `sample_interval_s`, in a thread of its own.

    A failure is reported once; the instrument is reopened after 0.5 s, 1 s, 2 s and so on to 30 s, until it answers,
    which is reported too. The time between is a gap; `missed` readings were due and not made. The name of the opened
    instrument is the unit of its samples, which wait `batch_s` of the computer at most. `deliver` takes each batch in
    this sampler's thread; if it raises, sampling ends and that is reported.

    >>> from ingest.instruments.base import Options
    >>> from ingest.station_clock import StationClock
    >>> class Thermometer(Instrument):
    ...     signals = {"temperature": "degC"}
    ...     def open(self): return "thermometer"
    ...     def close(self): pass
    ...     def sample(self): return [Reading("temperature", self.clock.now_ns(), 21.5)]
    >>> batches = []
    >>> sampler = Sampler(Thermometer("T", Options(), StationClock(100.0)), "r1", UUID(int=1), batches.append, print)
    >>> sampler.start(); time.sleep(0.1); sampler.stop()
    >>> batches[0].unit, batches[0].signal, float(batches[0].value_array[0]), batches[0].dt_ns
    ('T', 'temperature', 21.5, 1000000000)
    """

    def __init__(
        self, instrument: Instrument, run: str, epoch: UUID, deliver: Callable[[SampleBatch], None],
        report: Callable[[str], None], *, lock: AbstractContextManager[object] | None = None, batch_s: float = BATCH_S,
    ) -> None:  # fmt: skip
        self._instrument = instrument
        kind = f"the {instrument.names['en']} " if hasattr(instrument, "names") else ""
        self._who = f"{kind}{instrument.name}"
        self._run, self._epoch = run, epoch
        self._deliver, self._report, self._batch_s = deliver, report, batch_s
        self._lock = instrument.lock if lock is None else lock
        self._interval_s = float(instrument.options.sample_interval_s)
        self._waiting: dict[str, list[Reading]] = {}
        self._next: dict[str, int] = {}
        self._last_ns: dict[str, int] = {}
        self._dt_ns: dict[str, int] = {}  # of traces
        self._lacking: dict[str, int] = {}  # signals without a value while others have theirs: for how many turns
        self._noted: set[str] = set()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self.samples = self.missed = 0
        self.error: Exception | None = None

    def faults(self) -> dict[tuple[str, Fault], str]:
        """None: an instrument is no unit."""
        return {}

    def start(self) -> None:
        """Begin to read."""
        if self._thread is None and self._instrument.signals:
            self._thread = threading.Thread(target=self._sample, name=f"sampler {self._instrument.name}", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """Deliver what has been measured, and end; never raises."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()

    def _sample(self) -> None:
        try:
            try:
                self._poll()
            finally:
                self._flush()
        except Exception as error:  # noqa: BLE001  whatever it is, people are to know that nothing is measured any more
            self.error = error
            self._report(f"{self._who} is not read any more: {error}")

    def _poll(self) -> None:
        clock, interval_s = self._instrument.clock, self._interval_s
        start_ns, turn = clock.now_ns(), 0
        flushed_s = time.monotonic()
        while not self._stop.is_set():
            try:
                with self._lock:
                    readings = self._instrument.sample()
                self._take(readings)
                self._report_faults()
            except InstrumentError as error:
                self._flush()
                self._wait_for_it(error)
            if time.monotonic() - flushed_s + clock.computer_s(interval_s) >= self._batch_s:
                self._flush()
                flushed_s = time.monotonic()
            passed = math.floor((clock.now_ns() - start_ns) / _NS / interval_s)  # of the grid; a late turn is left out
            self.missed += max(0, passed - turn)
            turn = max(passed, turn) + 1
            due_s = turn * interval_s - (clock.now_ns() - start_ns) / _NS
            self._stop.wait(max(0.0, clock.computer_s(due_s)))

    def _wait_for_it(self, error: InstrumentError) -> None:
        self._report(f"{error}; it is tried again until it answers")
        began_s, pause_s, attempts = time.monotonic(), _FIRST_PAUSE_S, 0
        while not self._stop.wait(pause_s):
            pause_s = min(2.0 * pause_s, _LONGEST_PAUSE_S)
            attempts += 1
            try:
                with self._lock:
                    self._instrument.close()
                    self._instrument.open()
                    readings = self._instrument.sample()
            except GyrofleetError:
                continue
            self._report(
                f"{self._who} answers again after {time.monotonic() - began_s:.1f} s and {attempts} attempts; "
                f"what it would have measured meanwhile is missing"
            )
            self._take(readings)
            self._report_faults()
            return

    def _report_faults(self) -> None:
        """Report signals of the last turn that had no value, once until they have one again, and what it notes."""
        faults = self._instrument.faults
        for signal, why in faults.items():
            if signal not in self._lacking:
                self._report(f"{why}; {signal} is left out until it has a value, other signals are kept")
            self._lacking[signal] = self._lacking.get(signal, 0) + 1
        for signal in self._lacking.keys() - faults.keys():
            turns = self._lacking.pop(signal)
            self._report(
                f"{self._who}: {signal} has a value again, {turns} of it {'is' if turns == 1 else 'are'} missing"
            )
        for note in self._instrument.notes:
            if note not in self._noted:
                self._noted.add(note)
                self._report(note)

    def _take(self, readings: list[Reading]) -> None:
        refused = 0
        for reading in readings:
            if reading.t_ns <= self._last_ns.get(reading.signal, reading.t_ns - 1) or not math.isfinite(reading.value):
                refused += 1
                continue
            self._last_ns[reading.signal] = reading.t_ns
            self._waiting.setdefault(reading.signal, []).append(reading)
        if refused:
            left_out = f"{self._who}: {refused} of {len(readings)} readings are left out"
            self._report(f"{left_out}: not finite, or not later than the one before")
        if any(len(waiting) >= _MOST_IN_BATCH for waiting in self._waiting.values()):
            self._flush()

    def _flush(self) -> None:
        waiting, self._waiting = self._waiting, {}
        for signal, readings in waiting.items():
            for start in range(0, len(readings), _MOST_IN_BATCH):
                batch = self._batch(signal, readings[start : start + _MOST_IN_BATCH])
                self._deliver(batch)
                self._next[signal] = batch.next_seq
                self.samples += len(batch)

    def _batch(self, signal: str, readings: list[Reading]) -> SampleBatch:
        times_ns = np.array([reading.t_ns for reading in readings], np.int64)
        gaps = np.diff(times_ns)
        dt_ns = self._dt_ns.get(signal, max(1, round(self._interval_s * _NS)))
        if len(gaps) and (shortest := int(np.median(gaps))) < dt_ns / 2:  # a trace: several values a turn
            dt_ns = self._dt_ns[signal] = shortest
        off = np.abs(gaps - np.maximum(1, np.rint(gaps / dt_ns)) * dt_ns)
        return SampleBatch(
            self._instrument.name, signal, self._run, self._epoch, self._next.get(signal, 0), int(times_ns[0]), dt_ns,
            self._instrument.signals[signal], values=np.array([reading.value for reading in readings]),
            times_ns=times_ns, irregular=bool((off > _GRID_TOLERANCE * dt_ns).any()),
        )  # fmt: skip
