"""Angular-vibration table: a sine of the rate about one axis, for bandwidth and delay."""

from types import MappingProxyType
from typing import Any

from ingest.instruments.base import Reading
from ingest.instruments.scpi import ScpiOptions
from ingest.instruments.scpi_instrument import ScpiInstrument, Settling
from ingest.station_clock import StationClock
from stream.errors import InstrumentError


class VibrationTableOptions(ScpiOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Table of an angular-vibration table."""

    max_amplitude_deg_per_s: float  # largest amplitude of the rate
    lowest_frequency_hz: float = 0.1  # that is set
    highest_frequency_hz: float = 500.0  # that is set
    frequency_band_fraction: float = 1e-3  # settings have settled when they are measured within these fractions of
    amplitude_band_fraction: float = 0.01  # their values for `stable_s`
    amplitude_band_deg_per_s: float = 0.01  # smallest band of the amplitude
    stable_s: float = 1.0  # how long it is within its band, seconds


class VibrationTable(ScpiInstrument):
    """Angular-vibration table; settings ``frequency`` and ``amplitude`` (of the rate), signal ``table_rate``.

    A sine of 100 Hz cannot be read one value at a time: ``trace`` fetches the controller's record since the last query,
    as ``t0_ns,dt_ns,rate,rate,...`` with times in nanoseconds UTC of a controller whose clock is the station's (PTP).
    Where the controller has no record, ``trace = ""`` reads single values. The safe state is an amplitude of 0.
    """

    kind = "vibration_table"
    names = MappingProxyType({"en": "angular-vibration table", "zh": "角振动台"})
    options_type = VibrationTableOptions
    settings = MappingProxyType({"frequency": "Hz", "amplitude": "deg/s"})
    signals = MappingProxyType({"table_rate": "deg/s"})
    commands = MappingProxyType(
        {
            "set_frequency": "FREQ:SETP {value:.9g}",
            "set_amplitude": "AMPL:SETP {value:.9g}",
            "frequency": "FREQ:ACT?",
            "amplitude": "AMPL:ACT?",
            "rate": "RATE:ACT?",
            "trace": "RATE:TRAC?",
        }
    )
    measured_by = MappingProxyType({"table_rate": "rate"})

    def __init__(self, name: str, options: Any, clock: StationClock) -> None:
        super().__init__(name, options, clock)
        self._is_vibrating = False

    def limits(self, what: str) -> tuple[float, float]:
        """Lowest and highest value of a setting."""
        if what == "frequency":
            return self.options.lowest_frequency_hz, self.options.highest_frequency_hz
        return 0.0, self.options.max_amplitude_deg_per_s

    def set(self, what: str, value: float) -> None:
        """Command a setting; while the amplitude is not 0 the rate is recorded as a trace."""
        super().set(what, value)
        if what == "amplitude":
            self._is_vibrating = value > 0.0

    def settling(self, what: str, value: float) -> Settling:
        """Criterion by which a setting has settled."""
        options, band = self.options, self.options.frequency_band_fraction * value
        if what == "amplitude":
            band = max(options.amplitude_band_deg_per_s, options.amplitude_band_fraction * value)
        return Settling(value, band, options.stable_s)

    def sample(self) -> list[Reading]:
        """The trace since the last time; one value at rest, or where there is no trace."""
        # a trace at rest would fill the store with thousands of zeros per second
        if not (self._is_vibrating and (query := self._text("trace"))):
            return super().sample()
        answer = self.connection.ask(query)
        try:
            t0, dt, *rates = answer.text.split(",")
            t0_ns, dt_ns = int(t0), int(dt)
            return [Reading("table_rate", t0_ns + i * dt_ns, float(rate)) for i, rate in enumerate(rates)]
        except ValueError:
            raise InstrumentError(
                f"{self.connection.who}: asked for its trace it answered {answer.text[:80]!r}, not "
                f't0_ns,dt_ns,rate,rate,...; if it records none, say trace = "" in the station file'
            ) from None

    def make_safe(self) -> None:
        """Bring it to rest."""
        self.set("amplitude", 0.0)
