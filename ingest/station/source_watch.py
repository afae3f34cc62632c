"""What a run looks for in its sources: units that fall silent, and why their samples lack."""

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Protocol

from ingest.source_fault import Fault
from ingest.station.run_limits import listed
from ingest.station.run_log import RunLog
from ingest.station_clock import StationClock

_LOOK_EVERY_S = 1.0
_UNKNOWN = "check its wiring and power"


class RunSource(Protocol):
    """Where samples come from: a bus, a serial line, the sampler of an instrument."""

    def start(self) -> None:
        """Begin to deliver."""

    def stop(self) -> None:
        """Deliver what has come, and end; never raises."""

    def faults(self) -> Mapping[tuple[str, Fault], str]:
        """What keeps samples of units from being used now, a sentence each."""


class SourceWatch:
    """Reports to the operator and notes in the run what its `sources` and the deliveries show."""

    def __init__(
        self, log: RunLog, clock: StationClock, sources: Sequence[RunSource], report: Callable[[str], None]
    ) -> None:
        self._log, self._clock, self._sources, self._report = log, clock, sources, report
        self._reported: set[tuple[str, Fault]] = set()
        self._causes: dict[str, Fault] = {}  # of samples that lack in the step that is recorded
        self._silent: dict[str, float] = {}
        self._looked_s = 0.0

    def begin_step(self) -> None:
        """A step is recorded from now on."""
        self._causes.clear()

    def end_record(self) -> None:
        """Nothing is recorded any more: nobody is silent."""
        self._silent.clear()

    def cause(self, unit: str) -> str:
        """Why samples of a unit lack in this step, as far as is known."""
        return self._causes[unit].value if unit in self._causes else _UNKNOWN

    def look(self, step: str) -> None:
        """Look at the sources once a second; `step` names the one that is worked on."""
        if time.monotonic() < self._looked_s + _LOOK_EVERY_S:
            return
        self._looked_s = time.monotonic()
        faults = {key: text for each in self._sources for key, text in each.faults().items()}
        for (unit, fault), text in faults.items():
            self._causes[unit] = fault
            if (unit, fault) not in self._reported:
                self._reported.add((unit, fault))
                self._say(f"warning: {text}", unit)
        self._log.faults = tuple(faults.values())
        not_read = self._log.account.not_read_now()
        self._causes.update(dict.fromkeys(not_read, Fault.NOT_READ))
        self._look_back(self._log.account.over())
        self._look_for_silence(step, {*not_read, *(unit for unit, fault in faults if fault is not Fault.INTERVAL)})

    def end(self) -> None:
        """Note what is not noted yet."""
        self._look_back(self._log.account.over(at_once=True))

    def _look_back(self, over: tuple[list[str], str] | None) -> None:
        if over is not None:
            self._causes.update(dict.fromkeys(over[0], Fault.NOT_READ))
            self._say(f"warning: {over[1]}")

    def _look_for_silence(self, step: str, known: Collection[str]) -> None:
        """Report units that fall silent while a step records, but for `known` ones, and those that deliver again."""
        silent = self._log.coverage.silent(self._clock.speed)
        if new := [unit for unit in silent if unit not in self._silent and unit not in known]:
            longest_s = max(silent[unit] for unit in new)
            self._say(
                f"warning: {step}: nothing has come for {longest_s:.0f} s from {listed(new)}: check wiring and power"
            )
        left = set(self._log.units_left)
        if back := [unit for unit in self._silent if unit not in silent and unit in left]:
            self._say(f"{step}: samples come again from {listed(back)}")
        self._silent = silent

    def _say(self, text: str, unit: str | None = None) -> None:
        self._report(text)
        self._log.note(text, unit)
