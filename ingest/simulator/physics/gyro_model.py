"""A simulated gyro with planted effects: from motion and environment to counts, at any length."""

from typing import Annotated

import msgspec
import numpy as np

from ingest.simulator.physics.bias import SECONDS_PER_HOUR, Bias, BiasEffect
from ingest.simulator.physics.dynamics import Dynamics, LowPass, outside_dead_zone
from ingest.simulator.physics.environment import Conditions, Environment, StaticEnvironment
from ingest.simulator.physics.misalignment import Misalignment, sensed_rate
from ingest.simulator.physics.noise import Noise, NoiseEffect
from ingest.simulator.physics.readout import Readout, ReadoutEffect, Samples, StartUp
from ingest.simulator.physics.scale import Scale, ScaleEffect
from ingest.simulator.physics.seeds import Seeds
from ingest.simulator.physics.thermal import Thermal, ThermalEffect
from stream.batch import FloatArray, IntArray
from stream.errors import BadInput
from stream.identity import check_name

_AT_ONCE = 8192


class GyroModelParameters(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is planted in a gyro; what is left out is off.

    Parameters
    ----------
    sample_interval_ns: Interval of the samples; 5,000,000 is 200 Hz.
    scale, bias, thermal, misalignment, noise, dynamics, readout, start_up: The groups of effects. Without `scale` a
        count is 5e-5 deg/s.
    """

    sample_interval_ns: Annotated[int, msgspec.Meta(ge=1)] = 5_000_000
    scale: Scale = Scale()
    bias: Bias | None = None
    thermal: Thermal | None = None
    misalignment: Misalignment | None = None
    noise: Noise | None = None
    dynamics: Dynamics | None = None
    readout: Readout | None = None
    start_up: StartUp | None = None


class SimulatedGyroModel:
    """One power-on of a simulated gyro, from its first sample on.

    Parameters
    ----------
    parameters: What is planted.
    seed: Of the fleet, not negative. The same seed, unit, power-on, day, age, parameters and environment give the same
        samples, in blocks of whatever size.
    unit: Serial number.
    power_on, day: Number of the power-on, and of the day on which it is, not negative: power-ons of one day share what
        is drawn by day. The day is the power-on's number by default.
    age_h: Hours of operation before this power-on.
    environment: What acts on it; by default no rate, no force, 25 degC.
    start_ns: Time of power-on and of the first sample.

    Raises
    ------
    BadInput: If the seed, a number or the age is negative, or the unit cannot be a name.

    Notes
    -----
    sensed = misalignment(rates), then bandwidth and delay, then dead zone; out = scale(sensed) + (bias + thermal bias
    + noise)/3600 + transient; counts = readout(out). A delay is exact: the environment is asked for the time before,
    though never for one before power-on. Nothing later than the samples asked for is looked at, so that the
    environment may still be in the making.

    Memory: the block asked for, and less than 3 MB at any length.

    Examples
    --------
    >>> parameters = GyroModelParameters(bias=Bias(constant_deg_per_h=36.0))
    >>> gyro = SimulatedGyroModel(parameters, seed=1, unit="FOG-1")
    >>> gyro.samples(3).counts.tolist(), round(gyro.scale_deg_per_s_per_count, 9)
    ([200, 200, 200], 5e-05)
    """

    def __init__(
        self,
        parameters: GyroModelParameters,
        *,
        seed: int,
        unit: str,
        power_on: int = 1,
        day: int | None = None,
        age_h: float = 0.0,
        environment: Environment | None = None,
        start_ns: int = 0,
    ) -> None:
        day = power_on if day is None else day
        check_name("unit", unit)
        for name, value in (("seed", seed), ("power_on", power_on), ("day", day), ("age_h", age_h)):
            if not value >= 0:
                raise BadInput(f"simulated gyro {unit}: {name} is {value}, at least 0 is needed")
        self.parameters, self.unit, self.seed = parameters, unit, seed
        self.power_on, self.day, self.age_h, self.start_ns = power_on, day, age_h, start_ns
        self._environment = environment or StaticEnvironment()
        p = parameters
        seeds = Seeds(seed, unit, power_on, day)
        interval_s = p.sample_interval_ns * 1e-9
        self.scale_effect = ScaleEffect(p.scale, seeds, age_h)
        self.bias_effect = BiasEffect(p.bias, seeds, age_h, interval_s) if p.bias else None
        self._thermal = ThermalEffect(p.thermal or Thermal(), interval_s)
        self._noise = NoiseEffect(p.noise, seeds, interval_s) if p.noise else None
        self.readout_effect = ReadoutEffect(p.readout or Readout(), p.start_up, p.scale.counts_per_deg_per_s, seeds)
        dynamics = p.dynamics or Dynamics()
        self._delay_ns = round(dynamics.delay_s * 1e9)
        self._dead_zone = dynamics.dead_zone
        self._low_pass: LowPass | None = None
        if dynamics.bandwidth_hz is not None:
            self._low_pass = LowPass(dynamics.bandwidth_hz, dynamics.damping, interval_s)
        self._next = 0

    @property
    def scale_deg_per_s_per_count(self) -> float:
        """Nominal scale of the counts."""
        return 1.0 / self.parameters.scale.counts_per_deg_per_s

    @property
    def next_sample(self) -> int:
        """Number of the sample that comes next; the first after power-on is number 0."""
        return self._next

    def time_ns(self, sample: int) -> int:
        """Time of a sample."""
        return self.start_ns + sample * self.parameters.sample_interval_ns

    def due(self, t_ns: int) -> int:
        """How many samples are there up to and including the time `t_ns` that have not been asked for.

        Examples
        --------
        >>> gyro = SimulatedGyroModel(GyroModelParameters(), seed=1, unit="FOG-1", start_ns=100)
        >>> gyro.due(99), gyro.due(100), gyro.due(10_000_100)
        (0, 1, 3)
        """
        return max(0, (t_ns - self.start_ns) // self.parameters.sample_interval_ns + 1 - self._next)

    def samples(self, n: int) -> Samples:
        """Return the next `n` samples.

        Raises
        ------
        BadInput: If `n` is negative, or the environment gives what is no finite number.
        """
        if n < 0:
            raise BadInput(f"simulated gyro {self.unit}: {n} samples are asked for, at least 0 is needed")
        first = self._next
        counts, present, ready = np.empty(n, np.int32), np.empty(n, np.bool_), np.empty(n, np.bool_)
        for done in range(0, n, _AT_ONCE):
            part = self._part(min(_AT_ONCE, n - done))
            stop = done + len(part.counts)
            counts[done:stop], present[done:stop], ready[done:stop] = part.counts, part.present, part.ready
        return Samples(first, counts, present, ready)

    def _part(self, n: int) -> Samples:
        first = self._next
        since_ns = (first + np.arange(n, dtype=np.int64)) * self.parameters.sample_interval_ns
        acting_ns = self._acting(self.start_ns + since_ns)
        elapsed_s = np.asarray(since_ns * 1e-9, np.float64)
        conditions = Conditions(self._environment, acting_ns, elapsed_s, f"simulated gyro {self.unit}")
        out = self._motion(conditions, acting_ns)

        inside: FloatArray | None = None
        if self._thermal.makes_bias or self.scale_effect.needs_temperature:
            inside = self._thermal.inside_deg_c(conditions.temperature_deg_c)
        out = self.scale_effect.apply(out, conditions, inside)
        out += self._output_referred(first, conditions, inside) / SECONDS_PER_HOUR
        self._next += n
        return self.readout_effect.read(first, out, conditions.elapsed_s)

    def _acting(self, t_ns: IntArray) -> IntArray:
        """When what is put out at `t_ns` acted on the gyro."""
        return np.maximum(t_ns - self._delay_ns, self.start_ns) if self._delay_ns else t_ns

    def _motion(self, conditions: Conditions, acting_ns: IntArray) -> FloatArray:
        """Rate that is sensed, behind bandwidth, delay and dead zone, deg/s."""
        misalignment = self.parameters.misalignment
        if self._low_pass is None:
            rate = sensed_rate(misalignment, conditions.rates_deg_per_s)
        else:
            half_ns = self.parameters.sample_interval_ns // 2
            t_ns = np.empty(2 * len(acting_ns), np.int64)
            t_ns[0::2] = np.maximum(acting_ns - half_ns, self.start_ns)
            t_ns[1::2] = acting_ns
            rate = self._low_pass.follow(sensed_rate(misalignment, conditions.rates_at(t_ns)))
        return rate if self._dead_zone is None else outside_dead_zone(self._dead_zone, rate)

    def _output_referred(self, first: int, conditions: Conditions, inside: FloatArray | None) -> FloatArray:
        """Bias, thermal bias and noise, deg/h."""
        out = np.zeros(len(conditions.elapsed_s))
        if self.bias_effect is not None:
            self.bias_effect.add(first, conditions, out)
        if inside is not None and self._thermal.makes_bias:
            self._thermal.add(inside, out)
        if self._noise is not None:
            self._noise.add(conditions.elapsed_s, out)
        return out
