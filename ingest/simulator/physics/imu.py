"""The simulated inertial measurement unit: three gyros and three accelerometers in one housing."""

from typing import Annotated, NamedTuple

import msgspec
import numpy as np

from ingest.simulator.physics.accelerometer import AccelerometerParameters, SimulatedAccelerometer
from ingest.simulator.physics.draws import Seeds
from ingest.simulator.physics.environment import Environment, StaticEnvironment
from ingest.simulator.physics.gyro import GyroParameters, SimulatedGyro
from stream.batch import CountArray, FloatArray, IntArray
from stream.identity import check_name

AXES = ("x", "y", "z")


class ImuParameters(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Effects planted in an inertial measurement unit, by sensor.

    The axes of a sensor's own parameters (misalignment, sensitivities) begin with its input axis: y, z, x for the
    sensors of the Y axis. The sample interval is that of the unit; those of the gyros are not used.
    """

    sample_interval_ns: Annotated[int, msgspec.Meta(ge=1)] = 10_000_000
    gyro_x: GyroParameters = GyroParameters()
    gyro_y: GyroParameters = GyroParameters()
    gyro_z: GyroParameters = GyroParameters()
    accelerometer_x: AccelerometerParameters = AccelerometerParameters()
    accelerometer_y: AccelerometerParameters = AccelerometerParameters()
    accelerometer_z: AccelerometerParameters = AccelerometerParameters()


class ImuSamples(NamedTuple):
    """Consecutive samples of all six sensors: number of the first, and counts of shape (3, n)."""

    first: int
    rate_counts: CountArray
    acceleration_counts: CountArray


class SensorEnvironment:
    """An environment as the sensors of one axis feel it: that axis is x, the next ones are y and z."""

    def __init__(self, environment: Environment, axis: int) -> None:
        self._environment, self._order = environment, [(axis + i) % 3 for i in range(3)]

    def rates_deg_per_s(self, t_ns: IntArray) -> FloatArray:
        """See `Environment`."""
        return self._environment.rates_deg_per_s(t_ns)[self._order]

    def specific_force_g(self, t_ns: IntArray) -> FloatArray:
        """See `Environment`."""
        return self._environment.specific_force_g(t_ns)[self._order]

    def magnetic_field_gauss(self, t_ns: IntArray) -> FloatArray:
        """See `Environment`."""
        return self._environment.magnetic_field_gauss(t_ns)[self._order]

    def temperature_deg_c(self, t_ns: IntArray) -> FloatArray:
        """See `Environment`."""
        return self._environment.temperature_deg_c(t_ns)

    def supply_v(self, t_ns: IntArray) -> FloatArray:
        """See `Environment`."""
        return self._environment.supply_v(t_ns)


class SimulatedImu:
    """One power-on of a simulated inertial measurement unit, from its first sample on, which is at `start_ns`.

    The sensors sit in one point, so that turning exerts no centripetal force. A sensor is a `SimulatedGyro` or a
    `SimulatedAccelerometer` with a seed of its own. Where a sample is a mean over its interval, as of sensors that
    integrate, the environment says so.

    >>> from ingest.simulator.physics.mounting import TableEnvironment
    >>> imu = SimulatedImu(ImuParameters(), seed=1, unit="IMU-1", environment=TableEnvironment(30.0, "input_east"))
    >>> samples = imu.samples(1)
    >>> (samples.rate_counts[:, 0] * imu.rate_scale_deg_per_s * 3600).round(1).tolist()
    [0.0, 13.0, 7.6]
    >>> (samples.acceleration_counts[:, 0] * imu.acceleration_scale_g).tolist()
    [0.0, 0.0, 1.0]
    """

    def __init__(
        self, parameters: ImuParameters, *, seed: int, unit: str, power_on: int = 1,
        environment: Environment | None = None, start_ns: int = 0,
    ) -> None:  # fmt: skip
        check_name("unit", unit)
        self.parameters, self.unit, self.seed = parameters, unit, seed
        self.power_on, self.start_ns = power_on, start_ns
        environment = environment or StaticEnvironment()
        interval_ns = parameters.sample_interval_ns
        self.gyros: list[SimulatedGyro] = []
        self.accelerometers: list[SimulatedAccelerometer] = []
        for axis, name in enumerate(AXES):
            felt = SensorEnvironment(environment, axis)
            own: GyroParameters = getattr(parameters, f"gyro_{name}")
            own = msgspec.structs.replace(own, sample_interval_ns=interval_ns)
            self.gyros.append(
                SimulatedGyro(
                    own, seed=seed, unit=f"{unit}:gyro_{name}", power_on=power_on, environment=felt, start_ns=start_ns
                )
            )
            seeds = Seeds(seed, f"{unit}:accelerometer_{name}", power_on, power_on)
            who = f"simulated accelerometer {name} of {unit}"
            servo: AccelerometerParameters = getattr(parameters, f"accelerometer_{name}")
            self.accelerometers.append(SimulatedAccelerometer(servo, seeds, felt, who, start_ns, interval_ns))
        self._next = 0

    @property
    def rate_scale_deg_per_s(self) -> float:
        """Nominal scale of the rates' counts, those of X."""
        return self.gyros[0].scale_deg_per_s_per_count

    @property
    def acceleration_scale_g(self) -> float:
        """Nominal scale of the accelerations' counts, those of X."""
        return 1.0 / self.parameters.accelerometer_x.counts_per_g

    def due(self, t_ns: int) -> int:
        """Number of samples up to and including the time `t_ns` that `samples` has not returned yet."""
        return self.gyros[0].due(t_ns)

    def samples(self, n: int) -> ImuSamples:
        """Return the next `n` samples."""
        rates = np.stack([gyro.samples(n).counts for gyro in self.gyros])
        forces = np.stack([each.samples(n) for each in self.accelerometers])
        first, self._next = self._next, self._next + n
        return ImuSamples(first, rates, forces)
