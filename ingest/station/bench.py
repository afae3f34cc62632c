"""The instruments of a station as a run uses them, and whether they can do its procedure."""

from collections.abc import Collection, Mapping, Sequence

from ingest.instruments.base import Instrument
from ingest.instruments.power_supply import UNPOWERED_V
from ingest.instruments.scpi_instrument import ScpiInstrument, Settling
from ingest.procedures.procedure import Procedure
from ingest.station.checks.rest import has_safe_state, still_moving
from ingest.station.station import Station
from stream.errors import BadInput, InstrumentError


class StationBench:
    """Uses a station's instruments.

    Its methods but `rest`, `not_at_rest` and `supplies` raise InstrumentError where one fails.
    """

    def __init__(self, station: Station, instruments: Mapping[str, Instrument]) -> None:
        self._station, self._instruments = station, instruments

    def rest(self) -> dict[str, str]:
        """Make the instruments safe, supplies of the units last; failures by instrument."""
        troubles: dict[str, str] = {}
        supplies = self.supplies()
        for name in sorted(self._instruments, key=lambda name: name in supplies):
            instrument = self._instruments[name]
            try:
                with instrument.lock:
                    instrument.make_safe()
            except InstrumentError as error:
                troubles[name] = str(error)
        return troubles

    def not_at_rest(self, but: Collection[str]) -> dict[str, str]:
        """Wait until what was made safe is measured at rest; what is not, by instrument, but for those named."""
        safe = {name: each for name, each in self._instruments.items() if name not in but and has_safe_state(each)}
        return {name: trouble for name, each in safe.items() if (trouble := still_moving(each))}

    def is_dead(self, but: Collection[str] = ()) -> bool:
        """Whether a supply of the units measures no voltage; not asked of some supplies."""
        for name in (each for each in self.supplies() if each not in but):
            with self._instruments[name].lock:
                readings = self._instruments[name].sample()
            if any(each.signal == "supply_voltage" and abs(each.value) < UNPOWERED_V for each in readings):
                return True
        return False

    def switch(self, on: float, but: Collection[str] = ()) -> bool:
        """Switch the units on (1) or off (0), not those of some supplies; True when done."""
        self.switch_supplies([name for name in self.supplies() if name not in but], on)
        return True

    def switch_supplies(self, names: Sequence[str], on: float) -> None:
        """Switch supplies on (1) or off (0)."""
        for name in names:
            with self._instruments[name].lock:
                self._instruments[name].set("output", on)

    def supplies(self) -> list[str]:
        """What powers the slots, else every supply that the station has."""
        named = {slot.power for slot in self._station.slots.values() if slot.power is not None}
        able = [name for name, instrument in self._instruments.items() if "output" in instrument.settings]
        return sorted(named) or able

    def set(self, what: str, value: float) -> bool:
        """Command a setting of a procedure; True when done."""
        instrument = self._instruments[self._station.settings[what]]
        with instrument.lock:
            instrument.set(what, value)
        return True

    def carries_to(self, position: str) -> bool:
        """Whether an instrument carries the units to a position, so that no operator is needed."""
        return any(position in each.positions for each in self._instruments.values())

    def carry(self, position: str) -> bool:
        """Carry the units to a position; True when done."""
        for instrument in self._instruments.values():
            if position in instrument.positions:
                with instrument.lock:
                    instrument.carry(position)
        return True

    def settling(self, what: str) -> str:
        """What is measured and set of a setting; empty where its instrument does not say."""
        found, unit = self._settling_of(what)
        return "" if found is None else found.text(unit)

    def departures(self, but: Collection[str] = ()) -> dict[str, tuple[float, str]]:
        """Settings that had settled and are off now: how far, and what is measured; not those of some supplies."""
        found = {what: self._settling_of(what) for what, name in self._station.settings.items() if name not in but}
        return {
            what: (settling.departure, settling.text(unit))
            for what, (settling, unit) in found.items()
            if settling is not None and settling.departure
        }

    def left_as_they_are(self) -> list[str]:
        """Instruments with settings that nothing brings to a safe state."""
        return [name for name, each in self._instruments.items() if each.settings and not has_safe_state(each)]

    def _settling_of(self, what: str) -> tuple[Settling | None, str]:
        instrument = self._instruments[self._station.settings[what]]
        if not isinstance(instrument, ScpiInstrument):
            return None, ""
        return instrument.settling_of(what), instrument.settings[what]

    def is_settled(self, what: str) -> bool:
        """Whether a setting is reached."""
        instrument = self._instruments[self._station.settings[what]]
        with instrument.lock:
            return instrument.is_settled(what)


def check_station(station: Station, procedure: Procedure, parameters: Mapping[str, str]) -> None:
    """Raise BadInput where a station lacks what a procedure sets or switches."""
    lacking = [each for each in procedure.requirements(parameters) if each.setting not in station.settings]
    if lacking:
        wants = "; ".join(f"{each.setting} from {each.least:g} to {each.most:g} {each.unit}" for each in lacking)
        raise BadInput(
            f"station {station.table.name} ({station.path}) cannot do procedure {procedure.name}: it has no instrument "
            f"for {wants}; it can set {', '.join(sorted(station.settings)) or 'nothing'}"
        )


def check_limits(
    station: Station, instruments: Mapping[str, Instrument], procedure: Procedure, parameters: Mapping[str, str]
) -> None:
    """Raise BadInput where a procedure exceeds an instrument's range, or switches power without a supply."""
    for each in procedure.requirements(parameters):
        name = station.settings[each.setting]
        if not isinstance(instrument := instruments[name], ScpiInstrument):
            continue
        low, high = instrument.limits(each.setting)
        if not low <= each.least <= each.most <= high:
            raise BadInput(
                f"procedure {procedure.name} sets a {each.setting} of {each.least:g} to {each.most:g} {each.unit}, and "
                f"instruments.{name} of {station.path} may be set to {low:g} to {high:g} {each.unit}: choose other "
                f"values with --set, or another station"
            )
    switches = any(step.power is not None for step in procedure.steps(parameters))
    if switches and not StationBench(station, instruments).supplies():
        raise BadInput(
            f"procedure {procedure.name} switches the units off and on, and station {station.table.name} "
            f"({station.path}) has no instrument that does: add its supply"
        )
