"""The instruments of a simulated station, and what they make of the gyros that stand there."""

from typing import NamedTuple

from ingest.simulator.physics.mounting import TableEnvironment
from ingest.simulator.scpi.chamber import SimulatedChamber
from ingest.simulator.scpi.device import SimulatedDevice
from ingest.simulator.scpi.rate_table import SimulatedRateTable
from ingest.simulator.scpi.supply import SimulatedSupply
from ingest.simulator.scpi.vibration_table import SimulatedVibrationTable
from ingest.station_clock import StationClock


class SimulatedBench(NamedTuple):
    """Chamber, rate table with an angular-vibration table on top, and supply."""

    chamber: SimulatedChamber
    table: SimulatedRateTable
    vibration: SimulatedVibrationTable
    supply: SimulatedSupply

    @classmethod
    def at(cls, clock: StationClock) -> "SimulatedBench":
        """Fresh instruments on a clock.

        Examples
        --------
        >>> sorted(SimulatedBench.at(StationClock()).named)
        ['chamber', 'supply', 'table', 'vibration']
        """
        return cls(
            SimulatedChamber(clock), SimulatedRateTable(clock), SimulatedVibrationTable(clock), SimulatedSupply(clock)
        )

    @property
    def named(self) -> dict[str, SimulatedDevice]:
        """The instruments by their names in the station's file."""
        return {name: getattr(self, name) for name in self._fields}

    def environment(self, latitude_deg: float, position: str) -> TableEnvironment:
        """What acts on the gyros: both tables turn about the same axis, and the chamber is around them."""
        return TableEnvironment(
            latitude_deg,
            position,
            rate_deg_per_s=lambda t_ns: self.table.rate_deg_per_s(t_ns) + self.vibration.rate_deg_per_s(t_ns),
            angle_deg=lambda t_ns: self.table.angle_deg(t_ns) + self.vibration.angle_deg(t_ns),
            temperature_deg_c=self.chamber.temperature_deg_c,
        )
