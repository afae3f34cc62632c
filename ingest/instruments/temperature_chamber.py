"""Temperature chamber."""

from types import MappingProxyType
from typing import Any

from ingest.instruments.scpi import ScpiOptions
from ingest.instruments.scpi_instrument import ScpiInstrument, Settling
from ingest.station_clock import StationClock
from stream.errors import BadInput


class TemperatureChamberOptions(ScpiOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Table of a temperature chamber."""

    lowest_deg_c: float = -40.0  # that is set
    highest_deg_c: float = 85.0  # that is set
    band_deg_c: float = 0.5  # a temperature has settled when it is measured within this of its setting for `stable_s`
    stable_s: float = 600.0  # how long it is within its band, seconds
    room_deg_c: float = 25.0  # temperature of the safe state


class TemperatureChamber(ScpiInstrument):
    """Temperature chamber; setting ``temperature``, signal ``chamber_temperature``, both in degC.

    A manufacturer's own commands in the station file: ``[instruments.chamber.commands]``, ``set =
    "TEMP,S{value:.1f}"``; and where an answer holds more than the number, ``[instruments.chamber.answers]``,
    ``measure = "([^,]+),.*"``.

    >>> options = TemperatureChamberOptions(
    ...     resource="ASRL/dev/ttyUSB0::INSTR", identity="none", check_errors=False,
    ...     commands={"set": "TEMP,S{value:.1f}", "measure": "TEMP?"}, answers={"measure": "([^,]+),.*"},
    ... )
    >>> TemperatureChamber("C1", options, StationClock()).limits("temperature")
    (-40.0, 85.0)
    """

    kind = "temperature_chamber"
    names = MappingProxyType({"en": "temperature chamber", "zh": "高低温试验箱"})
    options_type = TemperatureChamberOptions
    settings = MappingProxyType({"temperature": "degC"})
    signals = MappingProxyType({"chamber_temperature": "degC"})
    commands = MappingProxyType({"set": "TEMP:SETP {value:.6g}", "measure": "TEMP:ACT?"})
    set_by = MappingProxyType({"temperature": "set"})
    settled_by = MappingProxyType({"temperature": "measure"})
    measured_by = MappingProxyType({"chamber_temperature": "measure"})

    def __init__(self, name: str, options: Any, clock: StationClock) -> None:
        super().__init__(name, options, clock)
        low, high = self.limits("temperature")
        if not low <= options.room_deg_c <= high:
            raise BadInput(f"{self.who}: room_deg_c of {options.room_deg_c:g} is not within {low:g} to {high:g} degC")

    def limits(self, what: str) -> tuple[float, float]:  # noqa: ARG002
        """Lowest and highest temperature."""
        return self.options.lowest_deg_c, self.options.highest_deg_c

    def settling(self, what: str, value: float) -> Settling:  # noqa: ARG002
        """Criterion by which a temperature has settled."""
        return Settling(value, self.options.band_deg_c, self.options.stable_s)

    def make_safe(self) -> None:
        """Bring it to room temperature."""
        self.set("temperature", self.options.room_deg_c)
