"""The plan of a simulated fleet, from TOML: the effects planted in each unit."""

from collections.abc import Mapping
from pathlib import Path

import msgspec

from ingest.simulator.physics.environment import Environment
from ingest.simulator.physics.fleet_file import Fleet, parse_fleet, read_fleet
from ingest.simulator.physics.gyro import GyroParameters, SimulatedGyro
from ingest.simulator.physics.imu import ImuParameters, SimulatedImu
from stream.errors import BadInput


class Plan(msgspec.Struct, frozen=True):
    """A simulated fleet."""

    seed: int
    parameters: Mapping[str, GyroParameters]  # by serial number, with everything drawn that is constant over a life
    power_ons_per_day: int = 1  # number of power-ons of a unit on one day
    hours_per_power_on: float = 0.0  # hours of operation from one power-on of a unit to the next

    @property
    def units(self) -> tuple[str, ...]:
        """Serial numbers, in order of the file."""
        return tuple(self.parameters)

    def gyro(
        self, unit: str, power_on: int = 1, *, day: int | None = None, age_h: float | None = None,
        environment: Environment | None = None, start_ns: int = 0,
    ) -> SimulatedGyro:  # fmt: skip
        """One power-on of a unit, numbered from 1, see `SimulatedGyro`; day and age follow from it by default."""
        if unit not in self.parameters:
            raise BadInput(f"simulated fleet: no unit {unit!r} in the plan; it has {', '.join(self.units) or 'none'}")
        if power_on < 1:
            raise BadInput(f"simulated fleet: power-on {power_on} of unit {unit}; they are numbered from 1 on")
        day = (power_on - 1) // self.power_ons_per_day + 1 if day is None else day
        age_h = (power_on - 1) * self.hours_per_power_on if age_h is None else age_h
        return SimulatedGyro(
            self.parameters[unit], seed=self.seed, unit=unit, power_on=power_on, day=day, age_h=age_h,
            environment=environment, start_ns=start_ns,
        )  # fmt: skip


class ImuPlan(msgspec.Struct, frozen=True):
    """A simulated fleet of inertial measurement units."""

    seed: int
    parameters: Mapping[str, ImuParameters]  # by serial number, with everything drawn that is constant over a life

    @property
    def units(self) -> tuple[str, ...]:
        """Serial numbers, in order of the file."""
        return tuple(self.parameters)

    def imu(
        self, unit: str, power_on: int = 1, *, environment: Environment | None = None, start_ns: int = 0
    ) -> SimulatedImu:
        """One power-on of a unit, numbered from 1, see `SimulatedImu`."""
        return SimulatedImu(
            self.parameters[unit], seed=self.seed, unit=unit, power_on=power_on, environment=environment,
            start_ns=start_ns,
        )  # fmt: skip


def load_plan(path: Path) -> Plan:
    """Read a plan from a file; see `parse_plan`. Raises BadInput if the file cannot be read or is not such a plan."""
    return _plan(read_fleet(path, GyroParameters))


def parse_plan(text: str, source: str) -> Plan:
    """Read a plan of gyros from TOML: see `parse_fleet`, and `GyroParameters` for the effects.

    >>> plan = parse_plan('''
    ... [fleet]
    ... seed = 7
    ... units = ["FOG-0230"]
    ... [fleet.bias]
    ... constant_deg_per_h = {mean = 0.0, sd = 0.5}
    ... jumps = {rate_per_h = 0.1, sd_deg_per_h = 0.2}
    ... [unit."FOG-0231"]
    ... off = ["bias.jumps"]
    ... thermal.bias_polynomial_deg_per_h = [0.4]
    ... ''', "fleet.toml")
    >>> plan.units, plan.parameters["FOG-0231"].bias.jumps
    (('FOG-0230', 'FOG-0231'), None)
    >>> plan.gyro("FOG-0231", power_on=2).samples(2).counts.dtype
    dtype('int32')
    """
    return _plan(parse_fleet(text, source, GyroParameters))


def load_imu_plan(path: Path) -> ImuPlan:
    """Read a plan of inertial measurement units from a file: see `parse_fleet`, and `ImuParameters` for the effects."""
    fleet = read_fleet(path, ImuParameters)
    return ImuPlan(fleet.settings.seed, fleet.parameters)


def _plan(fleet: Fleet[GyroParameters]) -> Plan:
    settings = fleet.settings
    return Plan(settings.seed, fleet.parameters, settings.power_ons_per_day, settings.hours_per_power_on)
