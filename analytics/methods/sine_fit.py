"""A sine in a record: least squares for amplitude, phase and offset (IEEE 1057-2017 annexes A and B)."""

import math
from typing import NamedTuple

import numpy as np

from stream.batch import FloatArray
from stream.errors import BadInput

LEAST_PER_PERIOD = 2.5
_LEAST_SAMPLES = 8
_MOST_TURNS = 20


class SineFit(NamedTuple):
    """A fitted sine, ``amplitude * sin(2 pi frequency t + phase) + offset``.

    Parameters
    ----------
    frequency_hz: As it was given, or as it was refined.
    amplitude, offset: In the unit of the values.
    phase_rad: At t = 0, within -pi to pi.
    amplitude_uncertainty, phase_uncertainty_rad: Standard uncertainties, of white noise as large as the residual.
    residual_sd: Standard deviation of what is left, in the unit of the values.
    n: Samples.
    """

    frequency_hz: float
    amplitude: float
    phase_rad: float
    offset: float
    amplitude_uncertainty: float
    phase_uncertainty_rad: float
    residual_sd: float
    n: int


def fit_sine(t_s: FloatArray, values: FloatArray, frequency_hz: float, *, refine: bool = False) -> SineFit:
    """Fit a sine of a known frequency.

    Parameters
    ----------
    t_s: shape (n,); moments, seconds, in any spacing; where 0 is the middle of the record, phase and frequency do not
        correlate.
    values: shape (n,); the record.
    frequency_hz: Of the sine.
    refine: Whether the frequency is fitted as well, from there; it stays as given where the record holds less than two
        periods, and where the fit would leave it by more than half a period in the record.

    Notes
    -----
    JJF 2014-2022 (40) fits amplitude and phase only, about zero; here the offset is fitted too, since a bias would
    enter both where the record does not hold whole periods.

    Examples
    --------
    >>> t_s = np.arange(-500, 500) / 1000
    >>> found = fit_sine(t_s, 3 * np.sin(2 * np.pi * 50 * t_s + 0.5) + 7, 50.0)
    >>> round(found.amplitude, 9), round(found.phase_rad, 9), round(found.offset, 9)
    (3.0, 0.5, 7.0)
    """
    _check(t_s, frequency_hz)
    design, solved = _solved(t_s, values, 2 * math.pi * frequency_hz)
    if refine and (t_s[-1] - t_s[0]) * frequency_hz >= 2:
        found = _refined(t_s, values, frequency_hz, solved)
        if found is not None:
            frequency_hz = found
            design, solved = _solved(t_s, values, 2 * math.pi * frequency_hz)
    sine, cosine, offset = (float(each) for each in solved)
    amplitude = math.hypot(sine, cosine)
    residual = values - design @ solved
    variance = float(residual @ residual) / (len(values) - 3)
    covariance = np.linalg.inv(design.T @ design)[:2, :2] * variance
    along = np.array([sine, cosine]) / amplitude if amplitude > 0 else np.array([1.0, 0.0])
    across = np.array([-along[1], along[0]])
    return SineFit(
        frequency_hz=frequency_hz,
        amplitude=amplitude,
        phase_rad=math.atan2(cosine, sine),
        offset=offset,
        amplitude_uncertainty=math.sqrt(float(along @ covariance @ along)),
        phase_uncertainty_rad=math.sqrt(float(across @ covariance @ across)) / amplitude if amplitude > 0 else math.inf,
        residual_sd=math.sqrt(variance),
        n=len(values),
    )


def _check(t_s: FloatArray, frequency_hz: float) -> None:
    if len(t_s) < _LEAST_SAMPLES:
        raise BadInput(f"a record at {frequency_hz:g} Hz has {len(t_s)} samples; a sine fit needs {_LEAST_SAMPLES}")
    span_s = float(t_s[-1] - t_s[0])
    per_period = (len(t_s) - 1) / (span_s * frequency_hz) if span_s > 0 else 0.0
    if per_period < LEAST_PER_PERIOD:
        raise BadInput(
            f"a record at {frequency_hz:g} Hz has {per_period:.2g} samples a period; at least {LEAST_PER_PERIOD} are "
            "needed to tell a sine from its alias: sample faster"
        )
    if (span_s + span_s / (len(t_s) - 1)) * frequency_hz < 1:
        raise BadInput(
            f"a record at {frequency_hz:g} Hz is {span_s:.3g} s long; one period of {1 / frequency_hz:.3g} s is needed"
        )


def _solved(t_s: FloatArray, values: FloatArray, omega: float) -> tuple[FloatArray, FloatArray]:
    design = np.stack([np.sin(omega * t_s), np.cos(omega * t_s), np.ones_like(t_s)], axis=1)
    solved, *_ = np.linalg.lstsq(design, values)
    return design, np.asarray(solved, dtype=np.float64)


def _refined(t_s: FloatArray, values: FloatArray, frequency_hz: float, solved: FloatArray) -> float | None:
    """The frequency by Gauss and Newton; None where it runs away from where it began."""
    omega = start = 2 * math.pi * frequency_hz
    farthest = math.pi / float(t_s[-1] - t_s[0])
    for _ in range(_MOST_TURNS):
        sine, cosine, offset = solved
        wave, quarter = np.sin(omega * t_s), np.cos(omega * t_s)
        design = np.stack([wave, quarter, np.ones_like(t_s), t_s * (sine * quarter - cosine * wave)], axis=1)
        change, *_ = np.linalg.lstsq(design, values - (sine * wave + cosine * quarter + offset))
        omega += float(change[3])
        if not abs(omega - start) <= farthest:
            return None
        solved = solved + change[:3]
        if abs(change[3]) <= 1e-12 * omega:
            break
    return omega / (2 * math.pi)
