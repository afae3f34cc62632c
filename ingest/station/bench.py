"""The instruments of a station, as a run uses them: by the settings of a procedure, and by what powers the units."""

from collections.abc import Mapping

from ingest.instruments.base import Instrument
from ingest.station.station import Station
from stream.errors import InstrumentError

_UNPOWERED_V = 0.5


class StationBench:
    """Sets, asks and brings to rest what stands at a station.

    Every method but `check` raises InstrumentError where an instrument cannot be reached or refuses.

    Parameters
    ----------
    station: Where.
    instruments: By name.
    """

    def __init__(self, station: Station, instruments: Mapping[str, Instrument]) -> None:
        self._station = station
        self._instruments = instruments

    def rest(self) -> dict[str, str]:
        """Make the instruments safe, what moves before what powers the units; why it failed, by instrument."""
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
        """Whether a supply of the units measures that it gives no voltage."""
        for name in self.supplies():
            instrument = self._instruments[name]
            with instrument.lock:
                readings = instrument.sample()
            if any(each.signal == "supply_voltage" and abs(each.value) < _UNPOWERED_V for each in readings):
                return True
        return False

    def switch(self, on: float) -> bool:
        """Give the units power (1) or take it (0); True, as it is done."""
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
        """Command a setting of a procedure; True, as it is done."""
        instrument = self._instruments[self._station.settings[what]]
        with instrument.lock:
            instrument.set(what, value)
        return True

    def is_settled(self, what: str) -> bool:
        """Whether a setting is reached."""
        instrument = self._instruments[self._station.settings[what]]
        with instrument.lock:
            return instrument.is_settled(what)
