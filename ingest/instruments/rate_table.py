"""Single-axis rate table."""

from collections.abc import Collection
from types import MappingProxyType

import msgspec

from ingest.instruments.scpi import ScpiOptions
from ingest.instruments.scpi_instrument import ScpiInstrument, Settling


class RateTableOptions(ScpiOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Table of a rate table."""

    max_rate_deg_per_s: float  # largest rate in both directions
    lowest_angle_deg: float = -360.0  # end of its travel
    highest_angle_deg: float = 360.0  # end of its travel
    rate_band_deg_per_s: float = 0.005  # a rate has settled when it is measured within the larger of this and of
    rate_band_fraction: float = 1e-3  # this fraction of it for `stable_s`
    angle_band_deg: float = 0.01  # a position has settled when it is measured within this of its setting for `stable_s`
    stable_s: float = 2.0  # how long it is within its band, seconds
    # commands by which it carries the units to positions, by the names of procedures; no operator is asked there
    positions: dict[str, str] = msgspec.field(default_factory=dict)  # by name of the position


class RateTable(ScpiInstrument):
    """Single-axis rate table; settings ``rate`` and ``angle``, signals ``table_rate`` and ``table_angle``.

    Positive is anticlockwise seen from above: the rate vector points upwards. The safe state is at rest. A table with
    more axes, or a robot beside it, carries the units to the `positions` of its options.

    >>> from ingest.station_clock import StationClock
    >>> options = RateTableOptions(resource="TCPIP::192.168.1.22::5025::SOCKET", max_rate_deg_per_s=200)
    >>> table = RateTable("T1", options, StationClock())
    >>> table.set("rate", -250.0)
    Traceback (most recent call last):
    stream.errors.InstrumentError: rate table T1: rate of -250 deg/s is not within -200 to 200 deg/s, which the \
station file allows; nothing was sent
    """

    kind = "rate_table"
    names = MappingProxyType({"en": "rate table", "zh": "单轴速率转台"})
    options_type = RateTableOptions
    settings = MappingProxyType({"rate": "deg/s", "angle": "deg"})
    signals = MappingProxyType({"table_rate": "deg/s", "table_angle": "deg"})
    commands = MappingProxyType(
        {
            "set_rate": "RATE:SETP {value:.9g}",
            "set_angle": "ANGL:SETP {value:.9g}",
            "rate": "RATE:ACT?",
            "angle": "ANGL:ACT?",
        }
    )
    measured_by = MappingProxyType({"table_rate": "rate", "table_angle": "angle"})

    def limits(self, what: str) -> tuple[float, float]:
        """Lowest and highest value of a setting."""
        if what == "rate":
            return -self.options.max_rate_deg_per_s, self.options.max_rate_deg_per_s
        return self.options.lowest_angle_deg, self.options.highest_angle_deg

    def settling(self, what: str, value: float) -> Settling:
        """Criterion by which a setting has settled."""
        options, band = self.options, self.options.angle_band_deg
        if what == "rate":
            band = max(options.rate_band_deg_per_s, options.rate_band_fraction * abs(value))
        return Settling(value, band, options.stable_s)

    def set(self, what: str, value: float) -> None:
        """Command a setting; a value beyond its limits is not sent."""
        super().set(what, value)
        # the table either turns or stands at an angle
        self._settling = {what: self._settling[what]}

    @property
    def positions(self) -> Collection[str]:
        """Positions to which it carries the units without an operator."""
        return tuple(self.options.positions)

    def carry(self, position: str) -> None:
        """Carry the units to a position, and wait until it has answered."""
        self.connection.command(self.options.positions[position])

    def make_safe(self) -> None:
        """Bring it to rest."""
        self.set("rate", 0.0)
