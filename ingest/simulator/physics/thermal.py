"""Temperature inside the gyro and the bias it causes: polynomial, rate, hysteresis."""

import math
from typing import Annotated

import msgspec
import numpy as np

from ingest.simulator.physics.draws import NotNegative, Positive
from ingest.simulator.physics.environment import NOMINAL_TEMPERATURE_DEG_C
from stream.batch import FloatArray
from stream.compiled import kernel

_SECONDS_PER_MINUTE = 60.0


class TemperatureRate(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Bias caused by a temperature rate.

    A temperature gradient that moves through the coil changes its two light paths at different times (D. M. Shupe,
    Appl. Opt. 19 (1980) 654, doi:10.1364/AO.19.000654). The gradient is that between the gyro and a mass that follows
    it with a time constant: b = c (T - T_m)/tau, dT_m/dt = (T - T_m)/tau, which is dT/dt behind a first-order lag.
    """

    deg_per_h_per_deg_c_per_min: float
    time_constant_s: Positive = 10.0  # lag of the gradient in the coil: full size on a ramp after a few of these


class Hysteresis(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One loop of thermal hysteresis.

    Glue and fibre coating slip only after a strain has built up, so that the bias depends on the history of the
    temperature: the stop operator (M. Brokate, J. Sprekels, Hysteresis and Phase Transitions, Springer 1996, 2.1),
    z <- min(max(z + dT, -w/2), w/2), b = h z/(w/2). Loops of different widths make a Prandtl-Ishlinskii model.
    """

    half_loop_deg_per_h: float  # bias on the warming branch; the cooling branch has its negative
    width_deg_c: Positive  # temperature reversal after which the other branch is reached
    start: Annotated[float, msgspec.Meta(ge=-1, le=1)] = 0.0  # at power-on: -1 as if cooled before, +1 as if warmed


class Thermal(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Bias caused by temperature.

    The inside follows the housing through a thermal resistance and a heat capacity, in equilibrium at power-on;
    every thermal effect, on the scale factor too, depends on the inside. dT_i/dt = (T - T_i)/lag,
    b = sum_k c_k (T_i - 25)^k + rate + hysteresis.
    """

    lag_s: NotNegative = 0.0  # time constant with which the inside of the gyro follows the housing; 0 for no lag
    bias_polynomial_deg_per_h: tuple[float, ...] = ()  # c_1, c_2...: deg/h/degC, deg/h/degC^2...
    rate: TemperatureRate | None = None
    hysteresis: tuple[Hysteresis, ...] = ()


@kernel
def _follow(
    u: FloatArray, last: float, state: float, decay: float, jump: float, ramp: float, out: FloatArray
) -> tuple[float, float]:
    """First-order lag of an input that is linear between samples; the input and state it ends with."""
    for i in range(u.shape[0]):
        state = decay * state + jump * last + ramp * (u[i] - last)
        last = u[i]
        out[i] = state
    return last, state


@kernel
def _add_stop(u: FloatArray, last: float, z: float, half_width: float, size: float, out: FloatArray) -> float:
    for i in range(u.shape[0]):
        z = min(max(z + (u[i] - last), -half_width), half_width)
        last = u[i]
        out[i] += size * (z / half_width)
    return z


@kernel
def _add_polynomial(u: FloatArray, terms: FloatArray, out: FloatArray) -> None:
    for i in range(u.shape[0]):
        x = u[i] - NOMINAL_TEMPERATURE_DEG_C
        value = 0.0
        for k in range(terms.shape[0] - 1, -1, -1):
            value = (value + terms[k]) * x
        out[i] += value


class Lag:
    """A first-order lag in equilibrium at first: x_1 = e x_0 + (1 - e) u_0 + (u_1 - u_0)(1 - (1 - e) tau/h)."""

    def __init__(self, time_constant_s: float, interval_s: float) -> None:
        h = interval_s / time_constant_s  # e = exp(-h)
        self._decay, self._jump = math.exp(-h), -math.expm1(-h)
        self._ramp = 1.0 + math.expm1(-h) / h
        self._state: tuple[float, float] | None = None

    def follow(self, u: FloatArray) -> FloatArray:
        """The next values, for the next values of the input, shape (n,)."""
        last, state = self._state or (float(u[0]), float(u[0]))
        out = np.empty(len(u))
        self._state = _follow(u, last, state, self._decay, self._jump, self._ramp, out)
        return out


class ThermalEffect:
    """Temperature inside the gyro and thermal bias of one power-on."""

    def __init__(self, thermal: Thermal, interval_s: float) -> None:
        self._inside = Lag(thermal.lag_s, interval_s) if thermal.lag_s > 0.0 else None
        self._terms = np.array(thermal.bias_polynomial_deg_per_h, np.float64)
        self._rate = thermal.rate
        self._mass = Lag(thermal.rate.time_constant_s, interval_s) if thermal.rate else None
        self._loops = thermal.hysteresis
        self._strain_deg_c = [loop.start * loop.width_deg_c / 2 for loop in thermal.hysteresis]
        self._last_deg_c: float | None = None
        self.makes_bias = bool(len(self._terms) or self._rate or self._loops)

    def inside_deg_c(self, housing_deg_c: FloatArray) -> FloatArray:
        """Temperature inside the gyro for the next temperatures of the housing; to be called once per block."""
        return housing_deg_c if self._inside is None else self._inside.follow(housing_deg_c)

    def add(self, inside_deg_c: FloatArray, out: FloatArray) -> None:
        """Add the thermal bias, deg/h, for the next temperatures inside the gyro."""
        if len(self._terms):
            _add_polynomial(inside_deg_c, self._terms, out)
        if self._rate is not None and self._mass is not None:
            per_deg_c = self._rate.deg_per_h_per_deg_c_per_min * _SECONDS_PER_MINUTE / self._rate.time_constant_s
            out += per_deg_c * (inside_deg_c - self._mass.follow(inside_deg_c))
        if not self._loops:
            return
        last = float(inside_deg_c[0]) if self._last_deg_c is None else self._last_deg_c
        for i, loop in enumerate(self._loops):
            self._strain_deg_c[i] = _add_stop(
                inside_deg_c, last, self._strain_deg_c[i], loop.width_deg_c / 2, loop.half_loop_deg_per_h, out
            )
        self._last_deg_c = float(inside_deg_c[-1])
