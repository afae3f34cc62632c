"""Digital voltmeter: DC volts to 6.5 digits, as JJF 2014-2022 requires for a gyro with an analogue output."""

from types import MappingProxyType
from typing import Any

from ingest.instruments.scpi import ScpiOptions
from ingest.instruments.scpi_instrument import ScpiInstrument
from ingest.station_clock import StationClock
from stream.errors import BadInput


class VoltmeterOptions(ScpiOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Table of a digital voltmeter."""

    range_v: float = 10.0  # of the measurement
    nplc: float = 1.0  # averaging time in mains cycles: 1 or more rejects the mains
    mains_hz: float = 50.0  # frequency of the mains, 50 or 60


class Voltmeter(ScpiInstrument):
    """Digital voltmeter; its signal is ``voltage`` in V, at the middle of its averaging time."""

    kind = "voltmeter"
    names = MappingProxyType({"en": "digital voltmeter", "zh": "数字电压表"})
    options_type = VoltmeterOptions
    signals = MappingProxyType({"voltage": "V"})
    commands = MappingProxyType(
        {"configure": "CONF:VOLT:DC {range_v:g}", "average": "VOLT:DC:NPLC {nplc:g}", "measure": "READ?"}
    )
    measured_by = MappingProxyType({"voltage": "measure"})

    def __init__(self, name: str, options: Any, clock: StationClock) -> None:
        super().__init__(name, options, clock)
        for what in ("range_v", "nplc", "mains_hz"):
            if not getattr(options, what) > 0.0:
                raise BadInput(f"{self.who}: {what} is {getattr(options, what)}, more than 0 is needed")
        average_s = options.nplc / options.mains_hz
        if average_s >= options.timeout_s:
            raise BadInput(
                f"{self.who}: {options.nplc:g} cycles of {options.mains_hz:g} Hz take {average_s:g} s, "
                f"but the answer is due within timeout_s = {options.timeout_s:g} s: increase it, or average less"
            )

    def prepare(self) -> None:
        """Set its range and averaging time."""
        self.give("configure")
        self.give("average")
