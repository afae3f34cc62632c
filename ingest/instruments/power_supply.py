"""Power supply of the gyros: voltage, current limit, and output on or off."""

from types import MappingProxyType

from ingest.instruments.base import Moving
from ingest.instruments.scpi import ScpiOptions
from ingest.instruments.scpi_instrument import ScpiInstrument, Settling
from stream.errors import BadInput

UNPOWERED_V = 0.5  # below it nothing has power


class PowerSupplyOptions(ScpiOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Table of a power supply."""

    max_voltage_v: float  # that of the gyros rather than of the supply
    max_current_a: float  # limit of the current, that of the gyros
    band_v: float = 0.05  # a voltage has settled when it is measured within this of its setting for `stable_s`
    stable_s: float = 0.0  # how long it is within its band, seconds


class PowerSupply(ScpiInstrument):
    """Power supply; settings ``voltage``, ``current_limit`` and ``output``, which is 1 for on and 0 for off.

    A voltage settles only while the output is on, since it is measured. The safe state is off.
    """

    kind = "power_supply"
    names = MappingProxyType({"en": "power supply", "zh": "直流稳压电源"})
    options_type = PowerSupplyOptions
    settings = MappingProxyType({"voltage": "V", "current_limit": "A", "output": "1"})
    signals = MappingProxyType({"supply_voltage": "V", "supply_current": "A"})
    commands = MappingProxyType(
        {
            "set_voltage": "VOLT {value:.6g}",
            "set_current_limit": "CURR {value:.6g}",
            "set_output": "OUTP {value:.0f}",
            "voltage": "MEAS:VOLT?",
            "current": "MEAS:CURR?",
            "output": "OUTP?",
        }
    )
    measured_by = MappingProxyType({"supply_voltage": "voltage", "supply_current": "current"})

    def limits(self, what: str) -> tuple[float, float]:
        """Lowest and highest value of a setting."""
        return 0.0, {"voltage": self.options.max_voltage_v, "current_limit": self.options.max_current_a}.get(what, 1.0)

    def settling(self, what: str, value: float) -> Settling:
        """Criterion by which a setting has settled."""
        is_voltage = what == "voltage"
        return Settling(value, self.options.band_v * is_voltage, self.options.stable_s * is_voltage)

    def set(self, what: str, value: float) -> None:
        """Command a setting; a value beyond its limits is not sent."""
        if what == "output" and value not in (0.0, 1.0):
            raise BadInput(f"{self.who}: output is 1 for on or 0 for off, not {value:g}")
        super().set(what, value)

    def make_safe(self) -> None:
        """Switch its output off."""
        self.set("output", 0.0)

    def moving(self) -> Moving | None:
        """A voltage that is still measured."""
        voltage_v = self._read("voltage").value if self._text("voltage") else 0.0
        if abs(voltage_v) < UNPOWERED_V:
            return None
        return Moving(abs(voltage_v), f"output is commanded off, {voltage_v:.4g} V measured")
