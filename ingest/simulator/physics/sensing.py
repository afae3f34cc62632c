"""The rate a gyro senses: misalignment, cross-axis sensitivity, bandwidth, delay, dead zone."""

import math
from typing import Annotated, Literal

import msgspec
import numpy as np

from ingest.simulator.physics.draws import SECONDS_PER_HOUR, NotNegative, Positive
from stream.batch import FloatArray
from stream.compiled import compiled

_ARCSEC = math.pi / (180 * 3600)
_PPM = 1e-6
_EIGHTH_TURN_ARCSEC = 45 * 3600

_Lean = Annotated[float, msgspec.Meta(ge=-_EIGHTH_TURN_ARCSEC, le=_EIGHTH_TURN_ARCSEC)]


class Misalignment(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Direction of the true input axis in the housing, and cross-axis sensitivity.

    The normal of the coil is not exactly perpendicular to the housing's reference face; electronics and housing may
    couple further. Omega = Omega_x sqrt(1 - s_y^2 - s_z^2) + Omega_y (s_y + c_y) + Omega_z (s_z + c_z), with s the
    sines of the two angles.
    """

    y_arcsec: _Lean = 0.0  # angle of the input axis towards y, at most 45 deg
    z_arcsec: _Lean = 0.0
    cross_y_ppm: float = 0.0  # response to rates about y that does not come from the angle
    cross_z_ppm: float = 0.0


class DeadZone(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Rates below the threshold.

    `beyond`: ``full``: the whole rate from the threshold on; ``offset``: continuous, short by (1 - slope) threshold
    everywhere; ``lock_in``: sign(Omega) sqrt(Omega^2 - (1 - slope^2) threshold^2), continuous, full at high rates.

    Crosstalk in a closed loop holds the feedback at zero, and backscatter locks the beams of a laser gyro together,
    until the rate is large enough. Omega_out = slope Omega for abs(Omega) < threshold. It acts on the sensed rate,
    Earth's included, and not on the bias.
    """

    threshold_deg_per_h: Positive  # half width of the zone
    slope: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.0  # remaining fraction of the scale factor within it, 0 to 1
    beyond: Literal["full", "offset", "lock_in"] = "full"


class Dynamics(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Bandwidth, delay and dead zone.

    The loop's integrator and the filter behind it act as a low-pass, computation and transfer as a delay.
    H(s) = w^2 exp(-s delay)/(s^2 + 2 zeta w s + w^2), w = 2 pi bandwidth/sqrt(1 - 2 zeta^2 +
    sqrt((1 - 2 zeta^2)^2 + 1)). They act on rates, not on biases, which are defined at the output.
    """

    bandwidth_hz: Positive | None = None  # frequency at which the gain is 1/sqrt(2)
    damping: Positive = math.sqrt(0.5)  # damping ratio of the second-order low-pass
    delay_s: NotNegative = 0.0  # pure delay, not necessarily a whole number of samples
    dead_zone: DeadZone | None = None


@compiled
def _low_pass(u: FloatArray, last: float, state: FloatArray, a: FloatArray, b: FloatArray, out: FloatArray) -> float:
    """Advance by one sample per two inputs, at the middle and the end of the interval."""
    for i in range(out.shape[0]):
        middle, end = u[2 * i], u[2 * i + 1]
        x = a[0, 0] * state[0] + a[0, 1] * state[1] + b[0, 0] * last + b[0, 1] * middle + b[0, 2] * end
        y = a[1, 0] * state[0] + a[1, 1] * state[1] + b[1, 0] * last + b[1, 1] * middle + b[1, 2] * end
        state[0], state[1] = x, y
        last = end
        out[i] = x
    return last


@compiled
def _dead_zone(rate: FloatArray, threshold: float, slope: float, beyond: int, out: FloatArray) -> None:
    for i in range(rate.shape[0]):
        size = abs(rate[i])
        if size < threshold:
            value = slope * size
        elif beyond == 0:
            value = size
        elif beyond == 1:
            value = size - (1.0 - slope) * threshold
        else:
            value = math.sqrt(size * size - (1.0 - slope * slope) * threshold * threshold)
        out[i] = math.copysign(value, rate[i])


def sensed_rate(misalignment: Misalignment | None, rates_deg_per_s: FloatArray) -> FloatArray:
    """Rate about the true input axis, deg/s, of rates about x, y, z."""
    x, across_y, across_z = rates_deg_per_s
    if misalignment is None:
        return np.asarray(x, np.float64)
    y, z = math.sin(misalignment.y_arcsec * _ARCSEC), math.sin(misalignment.z_arcsec * _ARCSEC)
    along = math.sqrt(1.0 - y * y - z * z)
    cross_y, cross_z = y + _PPM * misalignment.cross_y_ppm, z + _PPM * misalignment.cross_z_ppm
    return np.asarray(along * x + cross_y * across_y + cross_z * across_z, np.float64)


class LowPass:
    """Second-order low-pass (see `Dynamics`) in steady state at its first input, by exact discretisation.

    Between samples the input is the parabola through its values at both ends and in the middle; for it, the state
    x_1 = exp(A h) x_0 + integral of exp(A (h - s)) B u(s) is exact, from the exponential of the augmented matrix
    (C. F. Van Loan, IEEE Trans. Autom. Control 23 (1978) 395, doi:10.1109/TAC.1978.1101743). Of a sine the gain is
    wrong by (2 pi f h)^4/960 (Simpson's 1/2880 less the first moment of the parabola's error, 1/720): 1.6e-4 at a
    tenth of the sample rate.
    """

    def __init__(self, bandwidth_hz: float, damping: float, interval_s: float) -> None:
        from scipy.linalg import expm

        bend = 1.0 - 2.0 * damping**2
        w = 2.0 * math.pi * bandwidth_hz / math.sqrt(bend + math.hypot(bend, 1.0))
        # states: the output, and its derivative over w; then the input and its derivatives over the interval
        augmented = np.zeros((5, 5))
        augmented[0, 1], augmented[1, 0], augmented[1, 1], augmented[1, 2] = w, -w, -2.0 * damping * w, w
        augmented *= interval_s
        augmented[2, 3] = augmented[3, 4] = 1.0
        advance = expm(augmented)
        self._a = np.ascontiguousarray(advance[:2, :2])
        # of u, h u', h^2 u'' at the start: from the values at the start, in the middle and at the end
        derivatives = np.array([[1.0, 0.0, 0.0], [-3.0, 4.0, -1.0], [4.0, -8.0, 4.0]])
        self._b = np.ascontiguousarray(advance[:2, 2:] @ derivatives)
        self._state: FloatArray | None = None
        self._last = 0.0

    def follow(self, u: FloatArray) -> FloatArray:
        """The next outputs, shape (n,), of inputs half an interval apart, shape (2 n,): middle, end, middle, end..."""
        if self._state is None:
            self._state, self._last = np.array([u[0], 0.0]), float(u[0])
        out = np.empty(len(u) // 2)
        self._last = _low_pass(u, self._last, self._state, self._a, self._b, out)
        return out


def outside_dead_zone(dead_zone: DeadZone, rate_deg_per_s: FloatArray) -> FloatArray:
    """Rates behind a dead zone, deg/s."""
    out = np.empty(len(rate_deg_per_s))
    code = ("full", "offset", "lock_in").index(dead_zone.beyond)
    _dead_zone(rate_deg_per_s, dead_zone.threshold_deg_per_h / SECONDS_PER_HOUR, dead_zone.slope, code, out)
    return out
