"""Temperature chamber."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar

from ingest.instruments.base import Options
from ingest.instruments.scpi import ScpiOptions
from ingest.instruments.scpi_instrument import ScpiInstrument
from ingest.instruments.settling import Settling
from ingest.station_clock import StationClock
from stream.errors import BadInput


class TemperatureChamberOptions(ScpiOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Table of a temperature chamber.

    Parameters
    ----------
    lowest_deg_c, highest_deg_c: Beyond these nothing is set.
    band_deg_c: A temperature is reached when what is measured stays within this of it, degC.
    stable_s: For this long, seconds at the station.
    room_deg_c: Where it is left alone, degC.
    """

    lowest_deg_c: float = -40.0
    highest_deg_c: float = 85.0
    band_deg_c: float = 0.5
    stable_s: float = 600.0
    room_deg_c: float = 25.0


class TemperatureChamber(ScpiInstrument):
    """Temperature chamber; setting ``temperature``, signal ``chamber_temperature``, both in degC.

    Examples
    --------
    A maker's own words in the station file: ``[instruments.chamber.commands]``, ``set = "TEMP,S{value:.1f}"``; and
    where an answer holds more than the number, ``[instruments.chamber.answers]``, ``measure = "([^,]+),.*"``.

    >>> options = TemperatureChamberOptions(
    ...     resource="ASRL/dev/ttyUSB0::INSTR", identity="none", check_errors=False,
    ...     commands={"set": "TEMP,S{value:.1f}", "measure": "TEMP?"}, answers={"measure": "([^,]+),.*"},
    ... )
    >>> TemperatureChamber("C1", options, StationClock()).limits("temperature")
    (-40.0, 85.0)
    """

    kind: ClassVar[str] = "temperature_chamber"
    names: ClassVar[Mapping[str, str]] = MappingProxyType({"en": "temperature chamber", "zh": "高低温试验箱"})
    options_type: ClassVar[type[Options]] = TemperatureChamberOptions
    settings: ClassVar[Mapping[str, str]] = MappingProxyType({"temperature": "degC"})
    signals: ClassVar[Mapping[str, str]] = MappingProxyType({"chamber_temperature": "degC"})
    commands: ClassVar[Mapping[str, str]] = MappingProxyType({"set": "TEMP:SETP {value:.6g}", "measure": "TEMP:ACT?"})
    set_by: ClassVar[Mapping[str, str]] = MappingProxyType({"temperature": "set"})
    settled_by: ClassVar[Mapping[str, str]] = MappingProxyType({"temperature": "measure"})
    measured_by: ClassVar[Mapping[str, str]] = MappingProxyType({"chamber_temperature": "measure"})

    def __init__(self, name: str, options: Any, clock: StationClock) -> None:
        super().__init__(name, options, clock)
        low, high = self.limits("temperature")
        if not low <= options.room_deg_c <= high:
            raise BadInput(f"{self.who}: room_deg_c of {options.room_deg_c:g} is not within {low:g} to {high:g} degC")
        self.settling("temperature", options.room_deg_c)

    def limits(self, what: str) -> tuple[float, float]:  # noqa: ARG002
        """Lowest and highest temperature, degC."""
        return self.options.lowest_deg_c, self.options.highest_deg_c

    def settling(self, what: str, value: float) -> Settling:  # noqa: ARG002
        """When a temperature counts as reached."""
        return Settling(value, self.options.band_deg_c, self.options.stable_s)

    def make_safe(self) -> None:
        """Bring it to room temperature."""
        self.set("temperature", self.options.room_deg_c)
