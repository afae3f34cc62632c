"""Angular-vibration table: a sine of the rate about one axis, for bandwidth and delay."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar

from ingest.instruments.base import Options, Reading
from ingest.instruments.scpi import ScpiOptions
from ingest.instruments.scpi_instrument import ScpiInstrument
from ingest.instruments.settling import Settling
from ingest.station_clock import StationClock
from stream.errors import InstrumentError

_LEAST_FIELDS = 2  # time and interval, and then no sample


class VibrationTableOptions(ScpiOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Table of an angular-vibration table.

    Parameters
    ----------
    lowest_frequency_hz, highest_frequency_hz: Beyond these no frequency is set.
    max_amplitude_deg_per_s: Beyond this no amplitude of the rate is set.
    frequency_band_fraction, amplitude_band_fraction: They are reached when what is measured stays within these shares
        of them.
    amplitude_band_deg_per_s: Least band of the amplitude, deg/s, since a share of 0 is nothing.
    stable_s: For this long, seconds at the station.
    """

    max_amplitude_deg_per_s: float
    lowest_frequency_hz: float = 0.1
    highest_frequency_hz: float = 500.0
    frequency_band_fraction: float = 1e-3
    amplitude_band_fraction: float = 0.01
    amplitude_band_deg_per_s: float = 0.01
    stable_s: float = 1.0


class VibrationTable(ScpiInstrument):
    """Angular-vibration table; settings ``frequency`` and ``amplitude`` (of the rate), signal ``table_rate``.

    A sine of 100 Hz cannot be read a value at a time: ``trace`` fetches what the controller has recorded since it was
    last asked, as ``t0_ns,dt_ns,rate,rate,...`` with times in nanoseconds UTC of a controller whose clock is the
    station's (PTP). Where the controller records nothing, say ``trace = ""``: single values are then read. Safe is an
    amplitude of 0.

    Examples
    --------
    >>> options = VibrationTableOptions(resource="TCPIP::192.168.1.23::5025::SOCKET", max_amplitude_deg_per_s=100)
    >>> VibrationTable("V1", options, StationClock()).limits("amplitude")
    (0.0, 100)
    """

    kind: ClassVar[str] = "vibration_table"
    names: ClassVar[Mapping[str, str]] = MappingProxyType({"en": "angular-vibration table", "zh": "角振动台"})
    options_type: ClassVar[type[Options]] = VibrationTableOptions
    settings: ClassVar[Mapping[str, str]] = MappingProxyType({"frequency": "Hz", "amplitude": "deg/s"})
    signals: ClassVar[Mapping[str, str]] = MappingProxyType({"table_rate": "deg/s"})
    commands: ClassVar[Mapping[str, str]] = MappingProxyType(
        {
            "set_frequency": "FREQ:SETP {value:.9g}",
            "set_amplitude": "AMPL:SETP {value:.9g}",
            "frequency": "FREQ:ACT?",
            "amplitude": "AMPL:ACT?",
            "rate": "RATE:ACT?",
            "trace": "RATE:TRAC?",
        }
    )
    set_by: ClassVar[Mapping[str, str]] = MappingProxyType({"frequency": "set_frequency", "amplitude": "set_amplitude"})
    settled_by: ClassVar[Mapping[str, str]] = MappingProxyType({"frequency": "frequency", "amplitude": "amplitude"})
    measured_by: ClassVar[Mapping[str, str]] = MappingProxyType({"table_rate": "rate"})

    def __init__(self, name: str, options: Any, clock: StationClock) -> None:
        super().__init__(name, options, clock)
        self._shakes = False
        for what in self.settings:
            self.settling(what, 1.0)

    def limits(self, what: str) -> tuple[float, float]:
        """Lowest and highest value of a setting, in its unit."""
        if what == "frequency":
            return self.options.lowest_frequency_hz, self.options.highest_frequency_hz
        return 0.0, self.options.max_amplitude_deg_per_s

    def set(self, what: str, value: float) -> None:
        """Command a setting; from the first amplitude on its rate is recorded as a trace, until it is 0 again."""
        super().set(what, value)
        if what == "amplitude":
            self._shakes = value > 0.0

    def settling(self, what: str, value: float) -> Settling:
        """When a setting counts as reached."""
        options = self.options
        if what == "frequency":
            band = options.frequency_band_fraction * value
        else:
            band = max(options.amplitude_band_deg_per_s, options.amplitude_band_fraction * value)
        return Settling(value, band, options.stable_s)

    def sample(self) -> list[Reading]:
        """Everything recorded since the last time; one value at rest, or where nothing is recorded."""
        # a table that nobody shakes would fill the store with thousands of zeros a second
        if not (self.has("trace") and self._shakes):
            return super().sample()
        answer = self.connection.ask(self._text("trace", None))
        fields = answer.text.split(",")
        try:
            t0_ns, dt_ns = int(fields[0]), int(fields[1])
            rates = [float(field) for field in fields[_LEAST_FIELDS:]]
        except (ValueError, IndexError):
            raise InstrumentError(
                f"{self.connection.who}: asked for its trace it answered {answer.text[:80]!r}, not "
                f't0_ns,dt_ns,rate,rate,...; if it records none, say trace = "" in the station file'
            ) from None
        return [Reading("table_rate", t0_ns + i * dt_ns, rate) for i, rate in enumerate(rates)]

    def make_safe(self) -> None:
        """Bring it to rest."""
        self.set("amplitude", 0.0)
