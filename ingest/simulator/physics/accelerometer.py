"""The simulated accelerometer with planted effects: from the specific force on its housing to counts, at any length."""

import math
from typing import Annotated

import msgspec
import numpy as np

from ingest.simulator.physics.draws import NotNegative, Positive, Seeds, checked
from ingest.simulator.physics.environment import NOMINAL_TEMPERATURE_DEG_C, Conditions, Environment
from stream.batch import CountArray, FloatArray
from stream.compiled import kernel

_MICRO = 1e-6
_ARCSEC = math.pi / (180 * 3600)
_EIGHTH_TURN_ARCSEC = 45 * 3600
_INT32 = np.iinfo(np.int32)

_Lean = Annotated[float, msgspec.Meta(ge=-_EIGHTH_TURN_ARCSEC, le=_EIGHTH_TURN_ARCSEC)]


class AccelerometerParameters(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Effects planted in an accelerometer; x is its input axis, y and z follow it by the right-hand rule.

    A pendulum held by a servo: offset and gain of the servo, a pivot that is not square to the housing, rectification
    (f^2), and white noise. f_out = (1 + e) f + b + q f^2 + noise, with f = f_x sqrt(1 - s_y^2 - s_z^2) + f_y s_y +
    f_z s_z and s the sines of the two angles.
    """

    counts_per_g: Positive = 1_000_000.0  # nominal scale factor, which the samples carry with them
    scale_error_ppm: float = 0.0
    bias_ug: float = 0.0
    bias_turn_on_ug: NotNegative = 0.0  # standard deviation of what is drawn at every power-on
    bias_ug_per_deg_c: float = 0.0  # from 25 degC
    second_order_ug_per_g2: float = 0.0
    y_arcsec: _Lean = 0.0  # angle of the input axis towards y, at most 45 deg
    z_arcsec: _Lean = 0.0
    noise_ug_per_sqrt_hz: NotNegative = 0.0  # white noise, the root of its one-sided power density
    saturation_g: Positive | None = None  # largest specific force in both directions; without it that of int32
    carries_rest: bool = True  # whether the rounding error is added to the next sample, as in a velocity counter


@kernel
def _to_counts(values: FloatArray, limit: float, carries: bool, rest: float, out: CountArray) -> float:
    for i in range(values.shape[0]):
        value = min(max(values[i], -limit), limit) + rest
        count = np.rint(value)
        if carries:
            rest = value - count
        out[i] = np.int32(count)
    return rest


class SimulatedAccelerometer:
    """One power-on of a simulated accelerometer in an environment whose x is its input axis.

    The same seeds, parameters and environment give the same samples, in blocks of whatever size.
    """

    def __init__(
        self, parameters: AccelerometerParameters, seeds: Seeds, environment: Environment, who: str,
        start_ns: int, interval_ns: int,
    ) -> None:  # fmt: skip
        self.parameters = checked(parameters, who)
        self._environment, self._who = environment, who
        self._start_ns, self._interval_ns = start_ns, interval_ns
        self.bias_turn_on_ug = parameters.bias_turn_on_ug * float(seeds.of_power_on("bias turn-on").standard_normal())
        self._white = seeds.of_power_on("white")
        self._white_g = _MICRO * parameters.noise_ug_per_sqrt_hz / math.sqrt(2.0 * interval_ns * 1e-9)
        most = min(-float(_INT32.min), float(_INT32.max)) - 1.0
        self._limit = min(most, (parameters.saturation_g or math.inf) * parameters.counts_per_g)
        self._rest = 0.0
        self._next = 0

    def samples(self, n: int) -> CountArray:
        """Return the next `n` samples, in counts."""
        p = self.parameters
        since_ns = (self._next + np.arange(n, dtype=np.int64)) * self._interval_ns
        self._next += n
        elapsed_s = np.asarray(since_ns * 1e-9, np.float64)
        conditions = Conditions(self._environment, self._start_ns + since_ns, elapsed_s, self._who)
        x, y, z = conditions["specific_force_g"]
        lean_y, lean_z = math.sin(p.y_arcsec * _ARCSEC), math.sin(p.z_arcsec * _ARCSEC)
        force_g = math.sqrt(1.0 - lean_y**2 - lean_z**2) * x + lean_y * y + lean_z * z
        bias_ug: float | FloatArray = p.bias_ug + self.bias_turn_on_ug
        if p.bias_ug_per_deg_c != 0.0:
            warmer_deg_c = conditions["temperature_deg_c"] - NOMINAL_TEMPERATURE_DEG_C
            bias_ug = bias_ug + p.bias_ug_per_deg_c * warmer_deg_c
        out_g = force_g * (1.0 + _MICRO * p.scale_error_ppm) + _MICRO * bias_ug
        out_g += _MICRO * p.second_order_ug_per_g2 * np.square(force_g)
        if self._white_g > 0.0:
            out_g += self._white_g * self._white.standard_normal(n)
        counts = np.empty(n, np.int32)
        self._rest = _to_counts(out_g * p.counts_per_g, self._limit, p.carries_rest, self._rest, counts)
        return counts
