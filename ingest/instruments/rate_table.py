"""Single-axis rate table."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar

from ingest.instruments.base import Options
from ingest.instruments.scpi import ScpiOptions
from ingest.instruments.scpi_instrument import ScpiInstrument
from ingest.instruments.settling import Settling
from ingest.station_clock import StationClock


class RateTableOptions(ScpiOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Table of a rate table.

    Parameters
    ----------
    max_rate_deg_per_s: In either direction nothing faster is set.
    lowest_angle_deg, highest_angle_deg: Beyond these no position is set.
    rate_band_deg_per_s, rate_band_fraction: A rate is reached when what is measured stays within the larger of the two
        of it; the second is a share of the rate.
    angle_band_deg: A position is reached when what is measured stays within this of it.
    stable_s: For this long, seconds at the station.
    """

    max_rate_deg_per_s: float
    lowest_angle_deg: float = -360.0
    highest_angle_deg: float = 360.0
    rate_band_deg_per_s: float = 0.005
    rate_band_fraction: float = 1e-3
    angle_band_deg: float = 0.01
    stable_s: float = 2.0


class RateTable(ScpiInstrument):
    """Single-axis rate table; settings ``rate`` and ``angle``, signals ``table_rate`` and ``table_angle``.

    Positive is anticlockwise seen from above: the rate vector points upwards. Safe is at rest.

    Examples
    --------
    >>> options = RateTableOptions(resource="TCPIP::192.168.1.22::5025::SOCKET", max_rate_deg_per_s=200)
    >>> table = RateTable("T1", options, StationClock())
    >>> table.set("rate", -250.0)
    Traceback (most recent call last):
    stream.errors.InstrumentError: rate table T1: rate of -250 deg/s is not within -200 to 200 deg/s, which the \
station file allows; nothing was sent
    """

    kind: ClassVar[str] = "rate_table"
    names: ClassVar[Mapping[str, str]] = MappingProxyType({"en": "rate table", "zh": "单轴速率转台"})
    options_type: ClassVar[type[Options]] = RateTableOptions
    settings: ClassVar[Mapping[str, str]] = MappingProxyType({"rate": "deg/s", "angle": "deg"})
    signals: ClassVar[Mapping[str, str]] = MappingProxyType({"table_rate": "deg/s", "table_angle": "deg"})
    commands: ClassVar[Mapping[str, str]] = MappingProxyType(
        {
            "set_rate": "RATE:SETP {value:.9g}",
            "set_angle": "ANGL:SETP {value:.9g}",
            "rate": "RATE:ACT?",
            "angle": "ANGL:ACT?",
        }
    )
    set_by: ClassVar[Mapping[str, str]] = MappingProxyType({"rate": "set_rate", "angle": "set_angle"})
    settled_by: ClassVar[Mapping[str, str]] = MappingProxyType({"rate": "rate", "angle": "angle"})
    measured_by: ClassVar[Mapping[str, str]] = MappingProxyType({"table_rate": "rate", "table_angle": "angle"})

    def __init__(self, name: str, options: Any, clock: StationClock) -> None:
        super().__init__(name, options, clock)
        for what in self.settings:
            self.settling(what, 0.0)

    def limits(self, what: str) -> tuple[float, float]:
        """Lowest and highest value of a setting, in its unit."""
        if what == "rate":
            return -self.options.max_rate_deg_per_s, self.options.max_rate_deg_per_s
        return self.options.lowest_angle_deg, self.options.highest_angle_deg

    def settling(self, what: str, value: float) -> Settling:
        """When a setting counts as reached."""
        options = self.options
        if what == "rate":
            band = max(options.rate_band_deg_per_s, options.rate_band_fraction * abs(value))
        else:
            band = options.angle_band_deg
        return Settling(value, band, options.stable_s)

    def set(self, what: str, value: float) -> None:
        """Command a setting; what is beyond its limits is refused before anything is sent."""
        super().set(what, value)
        for other in self.settings:  # it turns, or it stands somewhere: one takes the place of the other
            if other != what:
                self._settling.pop(other, None)

    def make_safe(self) -> None:
        """Bring it to rest."""
        self.set("rate", 0.0)
