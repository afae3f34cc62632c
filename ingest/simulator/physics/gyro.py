"""The simulated gyro with planted effects: from motion and environment to counts, at any length."""

from typing import Annotated

import msgspec
import numpy as np

from ingest.simulator.physics.bias import Bias, BiasEffect
from ingest.simulator.physics.draws import SECONDS_PER_HOUR, NotNegative, Seeds, checked
from ingest.simulator.physics.environment import Conditions, Environment, StaticEnvironment
from ingest.simulator.physics.noise import HeldNoise, Noise, NoiseEffect
from ingest.simulator.physics.readout import Readout, ReadoutEffect, Samples, StartUp
from ingest.simulator.physics.scale import Scale, ScaleEffect
from ingest.simulator.physics.sensing import Dynamics, LowPass, Misalignment, outside_dead_zone, sensed_rate
from ingest.simulator.physics.thermal import Thermal, ThermalEffect
from stream.batch import FloatArray, IntArray
from stream.errors import BadInput
from stream.identity import check_name

_AT_ONCE = 8192
_AHEAD = 15 * _AT_ONCE


class GyroParameters(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Effects planted in a gyro, by group; a group that is left out has no effect.

    `hold_s`: everything but white and quantisation noise and the read-out is evaluated once per interval of this
    length, rounded to whole samples, and held within it: slow noise as its mean over the interval, all else at its
    middle. 0 evaluates every sample. At 200 Hz a hold of 0.1 s is about four times as fast.
    """

    sample_interval_ns: Annotated[int, msgspec.Meta(ge=1)] = 5_000_000  # interval of the samples; 5,000,000 is 200 Hz
    hold_s: NotNegative = 0.0
    scale: Scale = Scale()
    bias: Bias | None = None
    thermal: Thermal | None = None
    misalignment: Misalignment | None = None
    noise: Noise | None = None
    dynamics: Dynamics | None = None
    readout: Readout | None = None
    start_up: StartUp | None = None


class SimulatedGyro:
    """One power-on of a simulated gyro, from its first sample on, which is at `start_ns`.

    The same seed, unit, power-on, day, age, parameters and environment give the same samples, in blocks of whatever
    size. Power-ons of one day share what is drawn by day; by default every power-on has its own. `age_h` are the hours
    of operation before. By default the environment has no rate, no force, 25 degC. Raises BadInput if a number is
    negative or out of bounds, or the unit cannot be a name.

    sensed = misalignment(rates), then bandwidth and delay, then dead zone; out = scale(sensed) + (bias + thermal bias
    + noise)/3600 + transient; counts = readout(out). A delay is exact: the environment is evaluated at the time before,
    though never before power-on. It is never evaluated later than the samples of a call, or, with a hold, than the
    middle of their last interval.

    Memory: the block of a call, and less than 3 MB at any length.

    >>> parameters = GyroParameters(bias=Bias(constant_deg_per_h=36.0))
    >>> gyro = SimulatedGyro(parameters, seed=1, unit="FOG-1")
    >>> gyro.samples(3).counts.tolist(), round(gyro.scale_deg_per_s_per_count, 9)
    ([200, 200, 200], 5e-05)
    """

    def __init__(
        self, parameters: GyroParameters, *, seed: int, unit: str, power_on: int = 1, day: int | None = None,
        age_h: float = 0.0, environment: Environment | None = None, start_ns: int = 0,
    ) -> None:  # fmt: skip
        day = power_on if day is None else day
        check_name("unit", unit)
        self._who = f"simulated gyro {unit}"
        for name, value in (("seed", seed), ("power_on", power_on), ("day", day), ("age_h", age_h)):
            if not value >= 0:
                raise BadInput(f"{self._who}: {name} is {value}, at least 0 is needed")
        self.parameters, self.unit, self.seed = checked(parameters, self._who), unit, seed
        self.power_on, self.day, self.age_h, self.start_ns = power_on, day, age_h, start_ns
        self._environment = environment or StaticEnvironment()
        p = parameters
        hold = max(1, round(p.hold_s * 1e9 / p.sample_interval_ns))
        self._hold_ns = hold * p.sample_interval_ns
        self._middle_ns = (hold - 1) * p.sample_interval_ns // 2
        interval_s, hold_s = p.sample_interval_ns * 1e-9, self._hold_ns * 1e-9
        seeds = Seeds(seed, unit, power_on, day)
        self.scale_effect = ScaleEffect(p.scale, seeds, age_h)
        self.bias_effect = BiasEffect(p.bias, seeds, age_h, hold_s) if p.bias else None
        self._thermal = ThermalEffect(p.thermal or Thermal(), hold_s)
        self._noise = NoiseEffect(p.noise, seeds, interval_s, hold_s) if p.noise else None
        self.readout_effect = ReadoutEffect(
            p.readout or Readout(), p.start_up, p.scale.counts_per_deg_per_s, p.sample_interval_ns, seeds
        )
        dynamics = p.dynamics or Dynamics()
        self._delay_ns = round(dynamics.delay_s * 1e9)
        self._dead_zone = dynamics.dead_zone
        self._low_pass: LowPass | None = None
        if dynamics.bandwidth_hz is not None:
            self._low_pass = LowPass(dynamics.bandwidth_hz, dynamics.damping, hold_s)
        self._held = HeldNoise(self._evaluate, hold)
        self._evaluated = 0
        self._next = 0

    @property
    def scale_deg_per_s_per_count(self) -> float:
        """Nominal scale of the counts."""
        return 1.0 / self.parameters.scale.counts_per_deg_per_s

    def time_ns(self, sample: int) -> int:
        """Time of a sample; the first after power-on is number 0."""
        return self.start_ns + sample * self.parameters.sample_interval_ns

    def due(self, t_ns: int) -> int:
        """Number of samples up to and including the time `t_ns` that `samples` has not returned yet."""
        return max(0, (t_ns - self.start_ns) // self.parameters.sample_interval_ns + 1 - self._next)

    def samples(self, n: int) -> Samples:
        """Return the next `n` samples."""
        if n < 0:
            raise BadInput(f"{self._who}: {n} samples are requested, at least 0 is needed")
        first = self._next
        counts, present, ready = np.empty(n, np.int32), np.empty(n, np.bool_), np.empty(n, np.bool_)
        for done in range(0, n, _AT_ONCE):
            stop = min(done + _AT_ONCE, n)
            rate = self._held.take(stop - done, min(n - stop, _AHEAD))
            if self._noise is not None:
                self._noise.add_fast(rate)
            part = self.readout_effect.read(self._next, rate)
            counts[done:stop], present[done:stop], ready[done:stop] = part.counts, part.present, part.ready
            self._next += stop - done
        return Samples(first, counts, present, ready)

    def _evaluate(self, n: int) -> FloatArray:
        """Output rate of the next `n` hold intervals without white and quantisation noise, deg/s."""
        first = self._evaluated
        self._evaluated += n
        since_ns = (first + np.arange(n, dtype=np.int64)) * self._hold_ns + self._middle_ns
        acting_ns = self.start_ns + since_ns
        if self._delay_ns:
            acting_ns = np.maximum(acting_ns - self._delay_ns, self.start_ns)
        conditions = Conditions(self._environment, acting_ns, np.asarray(since_ns * 1e-9, np.float64), self._who)
        inside: FloatArray | None = None
        if self._thermal.makes_bias or self.scale_effect.needs_temperature:
            inside = self._thermal.inside_deg_c(conditions["temperature_deg_c"])
        out = self.scale_effect.apply(self._sensed(conditions, acting_ns), conditions, inside)
        out += self._output_referred(first, conditions, inside) / SECONDS_PER_HOUR
        return out

    def _sensed(self, conditions: Conditions, acting_ns: IntArray) -> FloatArray:
        """Rate behind misalignment, bandwidth, delay and dead zone, deg/s."""
        misalignment = self.parameters.misalignment
        if self._low_pass is None:
            rate = sensed_rate(misalignment, conditions["rates_deg_per_s"])
        else:
            t_ns = np.empty(2 * len(acting_ns), np.int64)
            t_ns[0::2] = np.maximum(acting_ns - self._hold_ns // 2, self.start_ns)
            t_ns[1::2] = acting_ns
            rate = self._low_pass.follow(sensed_rate(misalignment, conditions.at("rates_deg_per_s", t_ns)))
        return rate if self._dead_zone is None else outside_dead_zone(self._dead_zone, rate)

    def _output_referred(self, first: int, conditions: Conditions, inside: FloatArray | None) -> FloatArray:
        out = np.zeros(len(conditions.elapsed_s))
        if self.bias_effect is not None:
            self.bias_effect.add(first, conditions, out)
        if inside is not None and self._thermal.makes_bias:
            self._thermal.add(inside, out)
        if self._noise is not None:
            self._noise.add_slow(conditions.elapsed_s, out)
        return out
