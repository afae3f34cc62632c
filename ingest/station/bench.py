"""The instruments of a station as a run uses them: by a procedure's settings, and as the supplies of the units."""

from collections.abc import Mapping

from ingest.instruments.base import Instrument
from ingest.station.station import Station
from stream.errors import InstrumentError

_UNPOWERED_V = 0.5


class StationBench:
    """Sets, reads and makes safe the instruments of a station.

    Every method but `rest` and `supplies` raises InstrumentError where an instrument cannot be reached or refuses.
    """

    def __init__(self, station: Station, instruments: Mapping[str, Instrument]) -> None:
        self._station = station
        self._instruments = instruments

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

    def is_dead(self) -> bool:
        """Whether a supply of the units measures no voltage."""
        for name in self.supplies():
            instrument = self._instruments[name]
            with instrument.lock:
                readings = instrument.sample()
            if any(each.signal == "supply_voltage" and abs(each.value) < _UNPOWERED_V for each in readings):
                return True
        return False

    def switch(self, on: float) -> bool:
        """Switch the units on (1) or off (0); True when done."""
        for name in self.supplies():
            with self._instruments[name].lock:
                self._instruments[name].set("output", on)
        return True

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

    def is_settled(self, what: str) -> bool:
        """Whether a setting is reached."""
        instrument = self._instruments[self._station.settings[what]]
        with instrument.lock:
            return instrument.is_settled(what)
