"""Simulated devices as CAN frames of 8 bytes: a gyro in one message, an inertial measurement unit in four."""

from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from ingest.simulator.physics.environment import Environment
from ingest.simulator.physics.gyro import SimulatedGyro
from ingest.simulator.physics.imu import SimulatedImu
from ingest.simulator.physics.plan import ImuPlan, Plan
from stream.batch import IntArray

TEMPERATURE_NS = 1_000_000_000  # interval of an inertial measurement unit's temperature
_MOST_24_BITS = 2**23 - 1


class Frames(NamedTuple):
    """Frames with their times, arbitration ids, and bytes of shape (n, 8)."""

    t_ns: IntArray
    ids: npt.NDArray[np.uint32]
    data: npt.NDArray[np.uint8]


class CanDevice(Protocol):
    """One power-on of a device on a CAN bus."""

    @property
    def model(self) -> SimulatedGyro | SimulatedImu:
        """The device itself."""

    def frames(self, end_ns: int) -> Frames:
        """The frames up to a time that have not been returned yet."""


class CanGyro:
    """A gyro: counts of the rate (int32), temperature in 0.01 degC (int16), the sample's number (uint16)."""

    def __init__(self, model: SimulatedGyro, environment: Environment, arbitration_id: int) -> None:
        self.model, self._environment, self._id = model, environment, arbitration_id

    def frames(self, end_ns: int) -> Frames:
        """See `CanDevice`."""
        samples = self.model.samples(self.model.due(end_ns))
        number = samples.first + np.arange(len(samples.counts), dtype=np.int64)
        t_ns = self.model.start_ns + number * self.model.parameters.sample_interval_ns
        rows = np.zeros(len(number), np.dtype([("rate", "<i4"), ("temperature", "<i2"), ("counter", "<u2")]))
        rows["rate"] = samples.counts
        rows["temperature"] = _hundredths(self._environment, t_ns)
        rows["counter"] = number % 65536
        data = rows.view(np.uint8).reshape(len(rows), 8)[samples.present]
        return Frames(t_ns[samples.present], np.full(len(data), self._id, np.uint32), data)


class CanImu:
    """An inertial measurement unit: messages of its X, Y, Z axis, and one a second with its temperature.

    Counts of rate and acceleration (24 bits each), the sample's number (uint16); temperature in 0.01 degC (int16) and
    its number (uint16). The ids follow each other.
    """

    def __init__(self, model: SimulatedImu, environment: Environment, arbitration_id: int) -> None:
        self.model, self._environment, self._id = model, environment, arbitration_id
        self._temperatures = 0

    def frames(self, end_ns: int) -> Frames:
        """See `CanDevice`."""
        samples = self.model.samples(self.model.due(end_ns))
        n = samples.rate_counts.shape[1]
        number = samples.first + np.arange(n, dtype=np.int64)
        parts = [self._temperature(end_ns)]
        for axis in range(3):
            data = np.zeros((n, 8), np.uint8)
            for at, counts in ((0, samples.rate_counts[axis]), (3, samples.acceleration_counts[axis])):
                kept = np.clip(counts, -_MOST_24_BITS, _MOST_24_BITS).astype("<i4")
                data[:, at : at + 3] = kept.view(np.uint8).reshape(n, 4)[:, :3]
            data[:, 6:] = (number % 65536).astype("<u2").view(np.uint8).reshape(n, 2)
            t_ns = self.model.start_ns + number * self.model.parameters.sample_interval_ns
            parts.append(Frames(t_ns, np.full(n, self._id + axis, np.uint32), data))
        return Frames(*(np.concatenate(each) for each in zip(*parts, strict=True)))

    def _temperature(self, end_ns: int) -> Frames:
        due = (end_ns - self.model.start_ns) // TEMPERATURE_NS + 1
        number = np.arange(self._temperatures, max(due, self._temperatures), dtype=np.int64)
        self._temperatures += len(number)
        t_ns = self.model.start_ns + number * TEMPERATURE_NS
        rows = np.zeros(len(number), np.dtype([("temperature", "<i2"), ("counter", "<u2"), ("rest", "<u4")]))
        rows["temperature"], rows["counter"] = _hundredths(self._environment, t_ns), number % 65536
        return Frames(t_ns, np.full(len(rows), self._id + 3, np.uint32), rows.view(np.uint8).reshape(len(rows), 8))


MESSAGES_OF_IMU = 4


def messages_of(plan: Plan | ImuPlan) -> int:
    """Number of arbitration ids of one device of a plan."""
    return 1 if isinstance(plan, Plan) else MESSAGES_OF_IMU


def powered_device(
    plan: Plan | ImuPlan, unit: str, power_on: int, environment: Environment, start_ns: int, arbitration_id: int
) -> CanDevice:
    """One power-on of a device of a plan."""
    if isinstance(plan, Plan):
        gyro = plan.gyro(unit, power_on, environment=environment, start_ns=start_ns)
        return CanGyro(gyro, environment, arbitration_id)
    imu = plan.imu(unit, power_on, environment=environment, start_ns=start_ns)
    return CanImu(imu, environment, arbitration_id)


def _hundredths(environment: Environment, t_ns: IntArray) -> npt.NDArray[np.float64]:
    hundredths = np.rint(environment.temperature_deg_c(t_ns) * 100.0)
    return np.asarray(np.clip(hundredths, -32768, 32767), np.float64)
