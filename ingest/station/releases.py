"""Units that a run releases before its end: all their limits are decided, so that their slots are free."""

from collections.abc import Collection, Iterator, Sequence

import msgspec

from ingest.station.bench import StationBench
from ingest.station.run_limits import LimitReport, RunLimits
from ingest.station.station import Station
from ingest.station.units_file import UnitEntry
from stream.duration import duration
from stream.events import Verdict

_NAMED = 4


class Release(msgspec.Struct, frozen=True, kw_only=True):
    """Release of a unit from its run; times are of the station."""

    unit: str
    verdict: Verdict
    t_ns: int
    recorded_s: float
    planned_s: float
    slot: str | None = None

    @property
    def saved_s(self) -> float:
        """How much earlier the unit is done."""
        return self.planned_s - self.recorded_s


class Releases:
    """Decides which units of a run are released, and which supplies then power nobody.

    A unit is released as FAIL once one of its limits has failed early, as PASS once all have passed early and none is
    judged after the run, which would need the rest of its record.
    """

    def __init__(
        self, station: Station, bench: StationBench, entries: Sequence[UnitEntry], limits: RunLimits,
        decisions: LimitReport,
    ) -> None:  # fmt: skip
        self._bench, self._limits, self._decisions = bench, limits, decisions
        self._slots = {entry.serial: entry.slot for entry in entries}
        every = bench.supplies()
        own = {e.serial: station.slots[e.slot].power for e in entries if e.slot in station.slots and e.slot is not None}
        # a unit whose slot names no supply hangs on all of them
        self._supplies = {unit: [power] if (power := own.get(unit)) else every for unit in self._slots}

    def due(self, released: Collection[str], now_ns: int, since_ns: int, planned_s: float) -> Iterator[Release]:
        """Units that can be released now from the record of `planned_s` that began at `since_ns`."""
        for unit, slot in self._slots.items():
            if unit not in released and (verdict := self._verdict(unit)) is not None:
                recorded_s = min(max(0.0, (now_ns - since_ns) / 1e9), planned_s)
                yield Release(
                    unit=unit, verdict=verdict, t_ns=now_ns, recorded_s=recorded_s, planned_s=planned_s, slot=slot
                )

    def idle_supplies(self, released: Collection[str]) -> list[str]:
        """Supplies whose units are all released."""
        used = {name for unit, names in self._supplies.items() if unit not in released for name in names}
        return sorted({name for names in self._supplies.values() for name in names} - used)

    def without_power(self, supplies: Collection[str]) -> list[str]:
        """Units that have no power once these supplies are off."""
        return [unit for unit, names in self._supplies.items() if names and set(names) <= set(supplies)]

    def switch_off(self, supplies: Sequence[str]) -> None:
        """Switch supplies off; raises InstrumentError if one fails."""
        self._bench.switch_supplies(supplies, 0.0)

    def _verdict(self, unit: str) -> Verdict | None:
        of_unit = self._limits.units.get(unit)
        if of_unit is None or not self._limits.is_live:
            return None
        outcomes = self._decisions.early(unit)
        if "FAIL" in outcomes.values():
            return Verdict.FAIL
        is_passed = bool(of_unit.live) and all(outcomes.get(limit) == "PASS" for limit in of_unit.live)
        return Verdict.PASS if is_passed and not of_unit.after else None

    def remarks(self) -> Iterator[str]:
        """Units that are not released, or not as PASS, each as a sentence with its reason."""
        if not self._limits.is_live:
            yield "no unit is released early: without one record at rest nothing is decided while the run goes on"
            return
        if without := [unit for unit in self._slots if unit not in self._limits.units]:
            yield f"recorded to the end, since they have no limits: {_listed(without)}"
        after = {unit: found.after for unit, found in self._limits.units.items() if found.after}
        if after:
            subjects = ", ".join(dict.fromkeys(each for of in after.values() for each in of))
            yield f"released early only as FAIL: {_listed(list(after))}; the whole record is needed for {subjects}"

    def sentence(self, release: Release) -> str:
        """Sentence to the operator about a release."""
        slot = f" (slot {release.slot})" if release.slot else ""
        names = self._supplies[release.unit]
        power = f"it has power until {' and '.join(names)} is off" if names else "switch it off by hand"
        return (
            f"unit {release.unit}{slot}: {release.verdict} is decided after {duration(release.recorded_s)}, "
            f"{duration(release.saved_s)} early; {power}"
        )

    def free_sentence(self, supplies: Sequence[str], units: Sequence[str]) -> str:
        """Sentence to the operator once supplies are off."""
        slots = [slot for unit in units if (slot := self._slots[unit])]
        places = f"slots {', '.join(slots)} are free" if slots else "their places are free"
        return f"{', '.join(supplies)} is switched off; {places} (units {_listed(units)})"


def _listed(units: Sequence[str]) -> str:
    return ", ".join(units[:_NAMED]) + (f" and {len(units) - _NAMED} more" if len(units) > _NAMED else "")
