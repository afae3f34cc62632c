"""Bandwidth and output delay from sines of an angular-vibration table.

GJB 2426A-2004 5.13 and 5.14, JJF 2014-2022 7.2.21 and 7.2.22.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from analytics.methods.distributions import f_sf
from analytics.methods.frequency_response import Response
from stream.batch import FloatArray
from stream.errors import BadInput

# below this probability what a model leaves is more than the records' scatter
_MISFIT = 1e-3
# of the gain at the lowest frequency: gains that come down to less at the highest do fall
_FALLEN = 0.9


class DynamicResult(NamedTuple):
    """A value, its standard uncertainty and the degrees of freedom of the uncertainty."""

    value: float
    standard_uncertainty: float
    freedom: float
    misfit: float  # root of the mean square of what the model leaves: relative for a bandwidth, rad for a delay


def first_order_bandwidth(response: Response) -> DynamicResult:
    """Bandwidth in Hz of the first-order lag that fits the gains, GJB 2426A-2004 (36)-(41).

    G^2 = K_D^2 - T^2 (omega^2 G^2), linear least squares for K_D^2 and T^2, Bw = 1/(2 pi T). Where the gains depart
    from a first-order lag by more than their uncertainty, that of the bandwidth grows by as much.

    >>> f = np.geomspace(10, 400, 12)
    >>> zeros = np.zeros(12)
    >>> lag = Response(f, 5 / np.hypot(1, f / 200), zeros, zeros, zeros, zeros + 9, zeros + 10)
    >>> round(first_order_bandwidth(lag).value, 9)
    200.0
    """
    gain = response.gain

    def solved(gains: FloatArray) -> float:
        return 1 / (2 * math.pi * time_constant(response.frequency_hz, gains))

    value, found = solved(gain), _propagated(solved, gain, response.gain_uncertainty, response.freedom)
    model = 1 / np.hypot(1, response.frequency_hz / value)
    model *= float(gain @ model) / float(model @ model)
    return _widened(value, found, 1 - model / gain, response.gain_uncertainty / gain, response, unknowns=2)


def time_constant(frequency_hz: FloatArray, gain: FloatArray) -> float:
    """Time constant T in seconds of a first-order lag, GJB 2426A-2004 (37)-(40)."""
    omega = 2 * math.pi * frequency_hz
    power = gain * gain
    column = omega * omega * power
    design = np.stack([np.ones_like(power), -column / column.max()], axis=1)
    solved, *_ = np.linalg.lstsq(design, power)
    square = float(solved[1]) / float(column.max())
    if not square > 0:
        share = float(gain[-1] / gain[0])
        at = f"at {frequency_hz[-1]:g} Hz the gain is {share:.4g} of that at {frequency_hz[0]:g} Hz"
        if share < _FALLEN:
            raise BadInput(
                f"{at}, but no first-order lag has these gains: they may resonate; see the crossing of 0.707"
            )
        raise BadInput(f"{at}: it does not fall, vibrate up to twice the bandwidth")
    return math.sqrt(square)


def crossing(response: Response, *, zero_gain: float | None = None, of_lowest: bool = False) -> DynamicResult:
    """Frequency in Hz at which the gain has come down to 1/sqrt(2), JJF 2014-2022 (42)(43), GJB 2426A-2004 (35).

    At three frequencies or more. `zero_gain`: gain at zero frequency, of which it is a share, and a further point of
    the curve; where it is not known the curve's own is taken. `of_lowest`: whether it is a share of the gain at the
    lowest frequency, as in GJB.

    The curve is 1/G^2 = c0 + c1 omega^2 + c2 omega^4, least squares with all points of one relative weight: lags of
    the first and of the second order have exactly this form. JJF leaves the curve open; both print 0.707. GJB's F_i/F_L
    takes the vibration to be of one rate amplitude at all frequencies: here each is divided by its own.

    >>> f = np.geomspace(10, 400, 12)
    >>> zeros = np.zeros(12)
    >>> second = Response(f, 1 / np.sqrt(1 + (f / 200) ** 4), zeros, zeros, zeros, zeros + 9, zeros + 10)
    >>> round(crossing(second).value, 9)
    200.0
    """
    f = response.frequency_hz

    def whole(gain: FloatArray, curve: _Curve) -> float:
        return float(gain[0]) if of_lowest else abs(zero_gain or curve.zero)

    def solved(gain: FloatArray) -> float:
        curve = _curve(f, gain, zero_gain)
        return curve.reaches(whole(gain, curve) / math.sqrt(2))

    value, curve = solved(response.gain), _curve(f, response.gain, zero_gain)
    if not value <= f[-1]:
        share = float(response.gain[-1]) / whole(response.gain, curve)
        raise BadInput(
            f"at the highest frequency, {f[-1]:g} Hz, the gain is {share:.4g} of that at the lowest or at zero: it is "
            "to come down to 0.707, vibrate up to twice the bandwidth"
        )
    found = _propagated(solved, response.gain, response.gain_uncertainty, response.freedom)
    residual = 1 - curve.at(f) / response.gain
    return _widened(value, found, residual, response.gain_uncertainty / response.gain, response, unknowns=3)


class _Curve(NamedTuple):
    """1/G^2 as a polynomial of (frequency/highest)^2, from the constant term up."""

    terms: FloatArray
    highest_hz: float

    @property
    def zero(self) -> float:
        return 1 / math.sqrt(float(self.terms[0])) if self.terms[0] > 0 else math.nan

    def at(self, frequency_hz: FloatArray) -> FloatArray:
        square = (frequency_hz / self.highest_hz) ** 2
        return np.asarray(1 / np.sqrt(np.maximum(np.polyval(self.terms[::-1], square), 1e-300)), dtype=np.float64)

    def reaches(self, gain: float) -> float:
        """Lowest frequency of this gain, NaN if it has none."""
        roots = np.roots([*self.terms[:0:-1], float(self.terms[0]) - 1 / gain**2])
        squares = [float(each.real) for each in roots if abs(each.imag) < 1e-12 * abs(each) and each.real > 0]
        return self.highest_hz * math.sqrt(min(squares)) if squares else math.nan


def _curve(frequency_hz: FloatArray, gain: FloatArray, zero_gain: float | None) -> _Curve:
    if zero_gain is not None:
        frequency_hz, gain = np.r_[0.0, frequency_hz], np.r_[abs(zero_gain), gain]
    square = (frequency_hz / frequency_hz[-1]) ** 2
    design = np.stack([np.ones_like(square), square, square * square], axis=1) * (gain * gain)[:, None]
    solved, *_ = np.linalg.lstsq(design, np.ones_like(gain))
    return _Curve(np.asarray(solved, dtype=np.float64), float(frequency_hz[-1]))


def output_delay(response: Response) -> DynamicResult:
    """Delay T_d in seconds of a first-order lag with delay, GJB 2426A-2004 (42)-(46), JJF 2014-2022 (44)-(50).

    -P_i - atan(omega_i T) = omega_i T_d, least squares through 0; T from the gains, as of `first_order_bandwidth`.
    P_i is the output's phase less that of the *rate*, which leads the angle by pi/2. Erratum: GJB (33) prints the rate
    with -pi/2, and with it (43) adds pi/2 where it is to be subtracted. An output of the other sign, and phases of more
    than half a turn at the lowest frequency, are recognised by the extrapolation of the phases to zero frequency.
    """
    if np.isnan(response.phase_rad).any():
        raise BadInput("the phase of the vibration is not known: record the table's angle or rate with the units")
    f, n = response.frequency_hz, len(response.frequency_hz)
    omega = 2 * math.pi * f

    def left(inputs: FloatArray) -> FloatArray:
        return -inputs[n:] - np.arctan(omega * time_constant(f, inputs[:n]))

    def solved(inputs: FloatArray) -> float:
        return float(omega @ left(inputs)) / float(omega @ omega)

    inputs = np.r_[response.gain, response.phase_rad]
    scaled = omega / omega[-1]
    intercept, _ = np.linalg.lstsq(np.stack([np.ones(n), scaled], axis=1), left(inputs))[0]
    inputs[n:] += round(float(intercept) / math.pi) * math.pi
    uncertainties = np.r_[response.gain_uncertainty, response.phase_uncertainty_rad]
    found = _propagated(solved, inputs, uncertainties, np.r_[response.freedom, response.freedom])
    value = solved(inputs)
    residual = left(inputs) - omega * value
    return _widened(value, found, residual, response.phase_uncertainty_rad, response, unknowns=1)


def _propagated(
    function: Callable[[FloatArray], float], inputs: FloatArray, uncertainties: FloatArray, freedoms: FloatArray
) -> tuple[float, float]:
    """Standard uncertainty of a function of independent inputs, and its freedom (JCGM 100:2008 5.1.2, G.4.1)."""
    shares = np.zeros(len(inputs))
    for i, uncertainty in enumerate(uncertainties):
        if uncertainty > 0:
            step = np.zeros(len(inputs))
            step[i] = 1e-3 * uncertainty
            shares[i] = (function(inputs + step) - function(inputs - step)) / 2e-3
    square = float((shares * shares).sum())
    fourth = float((shares**4 / freedoms).sum())
    return math.sqrt(square), square * square / fourth if fourth > 0 else math.inf


def _widened(
    value: float, found: tuple[float, float], residual: FloatArray, uncertainty: FloatArray, response: Response, *,
    unknowns: int,
) -> DynamicResult:  # fmt: skip
    """The value; its uncertainty grown by the Birge ratio where the model leaves more than the scatter explains."""
    misfit = math.sqrt(float((residual**2).mean()))
    own, freedom = found
    degrees = len(residual) - unknowns
    if degrees > 0 and (uncertainty > 0).all():
        ratio = float(((residual / uncertainty) ** 2).sum()) / degrees
        if f_sf(ratio, degrees, min(float(response.freedom.min()), 1e9)) < _MISFIT:
            own, freedom = own * math.sqrt(ratio), min(freedom, float(degrees))
    return DynamicResult(value, own, freedom, misfit)
