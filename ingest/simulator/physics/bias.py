"""Bias of a gyro: its output at rest that is neither thermal nor noise, in deg/h."""

import heapq
import math
from collections.abc import Iterator
from itertools import takewhile

import msgspec
import numpy as np

from ingest.simulator.physics.draws import SECONDS_PER_HOUR, Jump, NotNegative, Positive, Seeds, Staircase, random_jumps
from ingest.simulator.physics.environment import NOMINAL_SUPPLY_V, Conditions
from stream.batch import FloatArray
from stream.compiled import compiled

Vector = tuple[float, float, float]
_ZERO: Vector = (0.0, 0.0, 0.0)


class WarmUp(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One exponential of the warm-up: b(t) = A exp(-t/tau), t from power-on.

    Source, electronics and housing heat up after power-on, each with its own heat capacity and thermal resistance.
    """

    amplitude_deg_per_h: float
    time_constant_s: Positive


class BiasStep(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A permanent bias step `at_s` seconds after power-on."""

    at_s: NotNegative
    size_deg_per_h: float


class Jumps(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Permanent bias steps at random times: a Poisson process, with normally distributed sizes of mean 0.

    Mode hops of the source, popcorn noise of a stage or a splice that gives way. b(t) = sum of all sizes up to t.
    """

    rate_per_h: NotNegative
    sd_deg_per_h: NotNegative


class Line(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A sine in the output, from mains hum, a fan or a compressor: b(t) = A sin(2 pi f t + phase), t from power-on.

    It is evaluated at the samples: above half the sample rate it aliases, as in a gyro without an anti-alias filter.
    """

    frequency_hz: NotNegative
    amplitude_deg_per_h: float
    phase_deg: float = 0.0


class Bias(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Bias of a gyro.

    Residual polarisation and offsets (constant, turn-on, day), stress by weight (g, g^2), gains that follow the supply,
    the Faraday effect of twisted fibre, and slow relaxation of glue and mirrors. b = b_0 + b_on + b_day + d . f +
    q . f^2 + s (V - V_0) + m . B + a log10(1 + age/t_0) + warm-up + steps + lines; f along the housing's axes.
    """

    constant_deg_per_h: float = 0.0
    turn_on_deg_per_h: NotNegative = 0.0  # standard deviation of what is drawn at every power-on
    day_deg_per_h: NotNegative = 0.0  # standard deviation of what is drawn on every day
    warm_up: tuple[WarmUp, ...] = ()
    acceleration_deg_per_h_per_g: Vector = _ZERO
    acceleration_squared_deg_per_h_per_g2: Vector = _ZERO
    supply_deg_per_h_per_v: float = 0.0
    supply_nominal_v: float = NOMINAL_SUPPLY_V
    magnetic_deg_per_h_per_gauss: Vector = _ZERO  # sensitivity to the field along x, y, z
    ageing_deg_per_h_per_decade: float = 0.0
    ageing_onset_h: Positive = 1.0
    step: tuple[BiasStep, ...] = ()
    jumps: Jumps | None = None
    line: tuple[Line, ...] = ()


@compiled
def _add_exponential(t_s: FloatArray, amplitude: float, time_constant_s: float, out: FloatArray) -> None:
    for i in range(t_s.shape[0]):
        out[i] += amplitude * math.exp(-t_s[i] / time_constant_s)


@compiled
def _add_sine(t_s: FloatArray, frequency_hz: float, amplitude: float, phase: float, out: FloatArray) -> None:
    for i in range(t_s.shape[0]):
        cycles = frequency_hz * t_s[i]
        out[i] += amplitude * math.sin(2.0 * math.pi * (cycles - math.floor(cycles)) + phase)


@compiled
def _add_logarithm(t_s: FloatArray, age_h: float, onset_h: float, per_decade: float, out: FloatArray) -> None:
    for i in range(t_s.shape[0]):
        out[i] += per_decade * math.log10(1.0 + (age_h + t_s[i] / SECONDS_PER_HOUR) / onset_h)


class BiasEffect:
    """Bias of one power-on after `age_h` hours of operation."""

    def __init__(self, bias: Bias, seeds: Seeds, age_h: float, interval_s: float) -> None:
        self._bias, self._seeds, self._age_h = bias, seeds, age_h
        self.turn_on_deg_per_h = bias.turn_on_deg_per_h * float(seeds.of_power_on("bias turn-on").standard_normal())
        self.day_deg_per_h = bias.day_deg_per_h * float(seeds.of_day("bias day").standard_normal())
        self._steps = Staircase(self.jumps_until(math.inf), interval_s) if bias.step or bias.jumps else None

    def jumps_until(self, until_s: float) -> Iterator[Jump]:
        """All jumps before `until_s` seconds from power-on, planned and drawn, from the first on."""
        planned = [Jump(step.at_s, step.size_deg_per_h) for step in self._bias.step]
        jumps = self._bias.jumps
        drawn: Iterator[Jump] = iter(())
        if jumps is not None:
            generator = self._seeds.of_power_on("bias jumps")
            drawn = random_jumps(jumps.rate_per_h, jumps.sd_deg_per_h, generator)
        return takewhile(lambda jump: jump.at_s < until_s, heapq.merge(sorted(planned), drawn))

    def add(self, first: int, conditions: Conditions, out: FloatArray) -> None:
        """Add the bias, deg/h, to samples `first`, `first` + 1, ..."""
        p = self._bias
        out += p.constant_deg_per_h + self.turn_on_deg_per_h + self.day_deg_per_h
        self._add_sensitivities(conditions, out)
        for warm_up in p.warm_up:
            _add_exponential(conditions.elapsed_s, warm_up.amplitude_deg_per_h, warm_up.time_constant_s, out)
        for line in p.line:
            phase = math.radians(line.phase_deg)
            _add_sine(conditions.elapsed_s, line.frequency_hz, line.amplitude_deg_per_h, phase, out)
        if p.ageing_deg_per_h_per_decade != 0.0:
            _add_logarithm(conditions.elapsed_s, self._age_h, p.ageing_onset_h, p.ageing_deg_per_h_per_decade, out)
        if self._steps is not None:
            self._steps.add(first, out)

    def _add_sensitivities(self, conditions: Conditions, out: FloatArray) -> None:
        p = self._bias
        for axis in range(3):
            if p.acceleration_deg_per_h_per_g[axis] != 0.0:
                out += p.acceleration_deg_per_h_per_g[axis] * conditions["specific_force_g"][axis]
            if p.acceleration_squared_deg_per_h_per_g2[axis] != 0.0:
                squared = np.square(conditions["specific_force_g"][axis])
                out += p.acceleration_squared_deg_per_h_per_g2[axis] * squared
            if p.magnetic_deg_per_h_per_gauss[axis] != 0.0:
                out += p.magnetic_deg_per_h_per_gauss[axis] * conditions["magnetic_field_gauss"][axis]
        if p.supply_deg_per_h_per_v != 0.0:
            out += p.supply_deg_per_h_per_v * (conditions["supply_v"] - p.supply_nominal_v)
