"""Scale factor: from the sensed rate to the output rate, with nonlinearities."""

import math
from typing import Annotated

import msgspec
import numpy as np

from ingest.simulator.physics.draws import SECONDS_PER_HOUR, NotNegative, Positive, Seeds
from ingest.simulator.physics.environment import NOMINAL_TEMPERATURE_DEG_C, Conditions
from stream.batch import FloatArray
from stream.compiled import kernel

_PPM = 1e-6
_HOURS_PER_KILOHOUR = 1000.0


class Ripple(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A sinusoidal deviation from the straight line, periodic in the rate; its amplitude is in ppm of full range.

    The feedback ramp of a closed-loop FOG resets by 2 pi; an error of its height, or a stray interference, repeats
    with every reset and so with equal steps of rate. dOmega = a Omega_max sin(2 pi Omega/P + phase).
    """

    amplitude_ppm: float
    period_deg_per_s: Positive
    phase_deg: float = 0.0


class Scale(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Scale factor of a gyro.

    The Sagnac phase is 2 pi L D Omega/(lambda c): the scale factor follows the coil's length and diameter and the
    source's wavelength, hence temperature and ageing; detector and feedback electronics bend the line.
    Omega_out = Omega (1 + e + s_1 dT + s_2 dT^2 + d f_x + w t) + (A/2) abs(Omega) +
    Omega_max sum_m c_m (Omega/Omega_max)^m + ripple.
    """

    counts_per_deg_per_s: Positive = 20_000.0  # nominal scale factor, which the samples carry with them
    full_range_deg_per_s: Positive = 300.0  # reference rate of the nonlinearities
    error_ppm: float = 0.0  # deviation from the nominal scale factor at 25 degC
    turn_on_ppm: NotNegative = 0.0  # standard deviation of what is drawn at every power-on
    day_ppm: NotNegative = 0.0  # standard deviation of what is drawn on every day
    nonlinearity_ppm: Annotated[tuple[float, ...], msgspec.Meta(max_length=4)] = ()  # c_2 to c_5, ppm of full range
    ripple: Ripple | None = None
    asymmetry_ppm: float = 0.0  # (K+ - K-)/K
    temperature_ppm_per_deg_c: float = 0.0
    temperature_ppm_per_deg_c2: float = 0.0
    acceleration_ppm_per_g: float = 0.0  # change with the specific force along the input axis
    ageing_ppm_per_1000_h: float = 0.0  # change with the hours of operation


@kernel
def _bend(rate: FloatArray, full: float, terms: FloatArray, asymmetry: float, out: FloatArray) -> None:
    for i in range(rate.shape[0]):
        x = rate[i] / full
        value = 0.0
        for m in range(terms.shape[0] - 1, -1, -1):
            value = value * x + terms[m]
        out[i] += full * value * x * x + asymmetry * abs(rate[i])


@kernel
def _add_ripple(rate: FloatArray, amplitude: float, period: float, phase: float, out: FloatArray) -> None:
    for i in range(rate.shape[0]):
        out[i] += amplitude * math.sin(2.0 * math.pi * rate[i] / period + phase)


class ScaleEffect:
    """Scale factor of one power-on after `age_h` hours of operation."""

    def __init__(self, scale: Scale, seeds: Seeds, age_h: float) -> None:
        self._scale, self._age_h = scale, age_h
        self.turn_on_ppm = scale.turn_on_ppm * float(seeds.of_power_on("scale turn-on").standard_normal())
        self.day_ppm = scale.day_ppm * float(seeds.of_day("scale day").standard_normal())
        self._terms = _PPM * np.array(scale.nonlinearity_ppm, np.float64)
        self.needs_temperature = scale.temperature_ppm_per_deg_c != 0.0 or scale.temperature_ppm_per_deg_c2 != 0.0

    def apply(self, rate: FloatArray, conditions: Conditions, temperature: FloatArray | None) -> FloatArray:
        """Output rate for a sensed `rate`, both deg/s; `temperature` is that inside the gyro, degC."""
        p = self._scale
        ppm: float | FloatArray = p.error_ppm + self.turn_on_ppm + self.day_ppm
        if temperature is not None and self.needs_temperature:
            above = temperature - NOMINAL_TEMPERATURE_DEG_C
            ppm = ppm + above * (p.temperature_ppm_per_deg_c + above * p.temperature_ppm_per_deg_c2)
        if p.acceleration_ppm_per_g != 0.0:
            ppm = ppm + p.acceleration_ppm_per_g * conditions["specific_force_g"][0]
        if p.ageing_ppm_per_1000_h != 0.0:
            age_h = self._age_h + conditions.elapsed_s / SECONDS_PER_HOUR
            ppm = ppm + p.ageing_ppm_per_1000_h * (age_h / _HOURS_PER_KILOHOUR)
        out = np.asarray(rate + rate * (_PPM * ppm), np.float64)
        if len(self._terms) or p.asymmetry_ppm != 0.0:
            _bend(rate, p.full_range_deg_per_s, self._terms, 0.5 * _PPM * p.asymmetry_ppm, out)
        if p.ripple is not None:
            amplitude = _PPM * p.ripple.amplitude_ppm * p.full_range_deg_per_s
            _add_ripple(rate, amplitude, p.ripple.period_deg_per_s, math.radians(p.ripple.phase_deg), out)
        return out
