"""Power supply of the gyros: voltage, limit of the current, and output on or off."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar

from ingest.instruments.base import Options
from ingest.instruments.scpi import ScpiOptions
from ingest.instruments.scpi_instrument import ScpiInstrument
from ingest.instruments.settling import Settling
from stream.errors import BadInput


class PowerSupplyOptions(ScpiOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Table of a power supply.

    Parameters
    ----------
    max_voltage_v, max_current_a: Beyond these nothing is set; they are those of the gyros rather than of the supply.
    band_v: A voltage is reached when it is measured within this of what was set, volts.
    stable_s: And for this long, seconds.
    """

    max_voltage_v: float
    max_current_a: float
    band_v: float = 0.05
    stable_s: float = 0.0


class PowerSupply(ScpiInstrument):
    """Power supply; settings ``voltage``, ``current_limit`` and ``output``, which is 1 for on and 0 for off.

    A voltage settles only while the output is on, since it is measured. Safe is off.

    Examples
    --------
    >>> from ingest.station_clock import StationClock
    >>> options = PowerSupplyOptions(resource="TCPIP::192.168.1.21::5025::SOCKET", max_voltage_v=6, max_current_a=3)
    >>> supply = PowerSupply("PSU-1", options, StationClock())
    >>> supply.set("voltage", 15.0)
    Traceback (most recent call last):
    stream.errors.InstrumentError: power supply PSU-1: voltage of 15 V is not within 0 to 6 V, which the station file \
allows; nothing was sent
    """

    kind: ClassVar[str] = "power_supply"
    names: ClassVar[Mapping[str, str]] = MappingProxyType({"en": "power supply", "zh": "直流稳压电源"})
    options_type: ClassVar[type[Options]] = PowerSupplyOptions
    settings: ClassVar[Mapping[str, str]] = MappingProxyType({"voltage": "V", "current_limit": "A", "output": "1"})
    signals: ClassVar[Mapping[str, str]] = MappingProxyType({"supply_voltage": "V", "supply_current": "A"})
    commands: ClassVar[Mapping[str, str]] = MappingProxyType(
        {
            "set_voltage": "VOLT {value:.6g}",
            "set_current_limit": "CURR {value:.6g}",
            "set_output": "OUTP {value:.0f}",
            "voltage": "MEAS:VOLT?",
            "current": "MEAS:CURR?",
            "output": "OUTP?",
        }
    )
    set_by: ClassVar[Mapping[str, str]] = MappingProxyType(
        {"voltage": "set_voltage", "current_limit": "set_current_limit", "output": "set_output"}
    )
    settled_by: ClassVar[Mapping[str, str]] = MappingProxyType({"voltage": "voltage", "output": "output"})
    measured_by: ClassVar[Mapping[str, str]] = MappingProxyType(
        {"supply_voltage": "voltage", "supply_current": "current"}
    )

    def limits(self, what: str) -> tuple[float, float]:
        """Lowest and highest value of a setting, in its unit."""
        return 0.0, {"voltage": self.options.max_voltage_v, "current_limit": self.options.max_current_a}.get(what, 1.0)

    def settling(self, what: str, value: float) -> Settling:
        """When a setting counts as reached."""
        if what == "voltage":
            return Settling(value, self.options.band_v, self.options.stable_s)
        return Settling(value, 0.0, 0.0)

    def set(self, what: str, value: float) -> None:
        """Command a setting; what is beyond its limits is refused before anything is sent."""
        if what == "output" and value not in (0.0, 1.0):
            raise BadInput(f"{self.who}: output is 1 for on or 0 for off, not {value:g}")
        super().set(what, value)

    def make_safe(self) -> None:
        """Switch its output off."""
        self.set("output", 0.0)
