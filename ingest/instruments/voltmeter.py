"""Digital voltmeter: DC volts to 6.5 digits, as JJF 2014-2022 asks for a gyro with an analogue output."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar

from ingest.instruments.base import Options
from ingest.instruments.scpi import ScpiOptions
from ingest.instruments.scpi_instrument import ScpiInstrument
from ingest.station_clock import StationClock
from stream.errors import BadInput


class VoltmeterOptions(ScpiOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Table of a digital voltmeter.

    Parameters
    ----------
    range_v: Measuring range, volts.
    nplc: Time over which it averages, cycles of the mains: 1 or more rejects the mains.
    mains_hz: Frequency of the mains.
    """

    range_v: float = 10.0
    nplc: float = 1.0
    mains_hz: float = 50.0


class Voltmeter(ScpiInstrument):
    """Digital voltmeter; its signal is ``voltage`` in V, at the middle of its averaging time.

    Examples
    --------
    >>> options = VoltmeterOptions(resource="TCPIP::192.168.1.20::5025::SOCKET", identity="344[67]1A", nplc=10)
    >>> voltmeter = Voltmeter("DVM-1", options, StationClock())
    >>> voltmeter.signals["voltage"]
    'V'
    """

    kind: ClassVar[str] = "voltmeter"
    names: ClassVar[Mapping[str, str]] = MappingProxyType({"en": "digital voltmeter", "zh": "数字电压表"})
    options_type: ClassVar[type[Options]] = VoltmeterOptions
    signals: ClassVar[Mapping[str, str]] = MappingProxyType({"voltage": "V"})
    commands: ClassVar[Mapping[str, str]] = MappingProxyType(
        {"configure": "CONF:VOLT:DC {range_v:g}", "average": "VOLT:DC:NPLC {nplc:g}", "measure": "READ?"}
    )
    measured_by: ClassVar[Mapping[str, str]] = MappingProxyType({"voltage": "measure"})

    def __init__(self, name: str, options: Any, clock: StationClock) -> None:
        super().__init__(name, options, clock)
        for what in ("range_v", "nplc", "mains_hz"):
            if not getattr(options, what) > 0.0:
                raise BadInput(f"{self.who}: {what} is {getattr(options, what)}, more than 0 is needed")
        average_s = options.nplc / options.mains_hz
        if average_s >= options.timeout_s:
            raise BadInput(
                f"{self.who}: {options.nplc:g} cycles of {options.mains_hz:g} Hz take {average_s:g} s, "
                f"but it is to answer within timeout_s = {options.timeout_s:g} s: allow more, or average less"
            )

    def prepare(self) -> None:
        """Set its range and averaging time."""
        self.give("configure")
        self.give("average")
