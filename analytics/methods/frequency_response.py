"""Sines in records by least squares (IEEE 1057-2017 annexes A, B), and the frequency response of a gyro from them."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from stream.batch import FloatArray
from stream.errors import BadInput

LEAST_PER_PERIOD = 2.5
_LEAST_SAMPLES = 8
_MOST_TURNS = 20


class SineFit(NamedTuple):
    """A fitted sine, ``amplitude * sin(2 pi frequency t + phase) + offset``."""

    frequency_hz: float  # as it was given, or as it was refined
    amplitude: float  # in the unit of the values, as the offset
    phase_rad: float  # at t = 0, within -pi to pi
    offset: float
    amplitude_uncertainty: float  # standard uncertainties, of white noise as large as the residual
    phase_uncertainty_rad: float
    residual_sd: float  # standard deviation of what is left, in the unit of the values
    n: int  # samples


def fit_sine(t_s: FloatArray, values: FloatArray, frequency_hz: float, *, refine: bool = False) -> SineFit:
    """Fit a sine of a known frequency.

    `t_s`: moments in any spacing; where 0 is the middle of the record, phase and frequency do not correlate. `refine`:
    whether the frequency is fitted as well, from there; it stays as given where the record holds less than two periods,
    and where the fit would leave it by more than half a period in the record.

    JJF 2014-2022 (40) fits amplitude and phase only, about zero; here the offset is fitted too, since a bias would
    enter both where the record does not hold whole periods.

    >>> t_s = np.arange(-500, 500) / 1000
    >>> found = fit_sine(t_s, 3 * np.sin(2 * np.pi * 50 * t_s + 0.5) + 7, 50.0)
    >>> round(found.amplitude, 9), round(found.phase_rad, 9), round(found.offset, 9)
    (3.0, 0.5, 7.0)
    """
    _check(t_s, frequency_hz)
    design, solved = _solved(t_s, values, 2 * math.pi * frequency_hz)
    if refine and (found := _refined(t_s, values, frequency_hz, solved)) is not None:
        frequency_hz = found
        design, solved = _solved(t_s, values, 2 * math.pi * frequency_hz)
    sine, cosine, offset = (float(each) for each in solved)
    amplitude = math.hypot(sine, cosine)
    residual = values - design @ solved
    variance = float(residual @ residual) / (len(values) - 3)
    covariance = np.linalg.inv(design.T @ design)[:2, :2] * variance
    along = np.array([sine, cosine]) / amplitude if amplitude > 0 else np.array([1.0, 0.0])
    across = np.array([-along[1], along[0]])
    amplitude_u = math.sqrt(float(along @ covariance @ along))
    phase_u = math.sqrt(float(across @ covariance @ across)) / amplitude if amplitude > 0 else math.inf
    phase = math.atan2(cosine, sine)
    return SineFit(frequency_hz, amplitude, phase, offset, amplitude_u, phase_u, math.sqrt(variance), len(values))


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
        span, period = f"{span_s:.3g} s long", f"{1 / frequency_hz:.3g} s"
        raise BadInput(f"a record at {frequency_hz:g} Hz is {span}; one period of {period} is needed")


def _solved(t_s: FloatArray, values: FloatArray, omega: float) -> tuple[FloatArray, FloatArray]:
    design = np.stack([np.sin(omega * t_s), np.cos(omega * t_s), np.ones_like(t_s)], axis=1)
    solved, *_ = np.linalg.lstsq(design, values)
    return design, np.asarray(solved, dtype=np.float64)


def _refined(t_s: FloatArray, values: FloatArray, frequency_hz: float, solved: FloatArray) -> float | None:
    """The frequency by Gauss and Newton; None where there are too few periods, or it runs away from where it began."""
    if (t_s[-1] - t_s[0]) * frequency_hz < 2:
        return None
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


class SineRatio(NamedTuple):
    """A gyro's sine over the sine of the input rate, in one record; uncertainties are standard uncertainties."""

    frequency_hz: float  # of the vibration
    gain: float  # amplitude of the output over amplitude of the rate
    gain_uncertainty: float
    # of the output less that of the rate, at any multiple of 2 pi; NaN where the rate's phase is unknown
    phase_rad: float
    phase_uncertainty_rad: float


class Response(NamedTuple):
    """A frequency response; arrays over the frequencies, which increase."""

    # means of the records; phases are unwrapped over the frequency
    frequency_hz: FloatArray
    gain: FloatArray
    gain_uncertainty: FloatArray
    phase_rad: FloatArray
    phase_uncertainty_rad: FloatArray
    freedom: FloatArray  # degrees of freedom of the uncertainties
    records: FloatArray  # how many records there are


def response_of(records: Sequence[SineRatio]) -> Response:
    """Means over the records of each frequency, JJF 2014-2022 (41) and (44).

    The uncertainty of a mean is the scatter of its records over sqrt(n); of fewer than three it is that of their fits.
    A gain is taken record by record, so that the table's amplitude may change from one to the next.

    >>> two = response_of([SineRatio(10.0, 1.0, 0.01, 3.1, 0.01), SineRatio(10.0, 1.2, 0.01, -3.1, 0.01)])
    >>> two.gain.round(6).tolist(), (two.phase_rad % (2 * np.pi)).round(6).tolist()
    ([1.1], [3.141593])
    """
    frequencies = np.array(sorted({each.frequency_hz for each in records}))
    rows = [_mean([each for each in records if each.frequency_hz == frequency]) for frequency in frequencies]
    columns = [np.array(column, dtype=np.float64) for column in zip(*rows, strict=True)]
    gain, gain_u, phase, phase_u, freedom, count = columns
    return Response(frequencies, gain, gain_u, unwrapped(frequencies, phase), phase_u, freedom, count)


def unwrapped(frequency_hz: FloatArray, phase_rad: FloatArray) -> FloatArray:
    """Unwrapped phases: each lies nearest to the line through the first and the last before it.

    So a delay may turn the phase by more than half a turn from one frequency to the next, as long as it does not do so
    from the first to the second.

    >>> f = np.geomspace(10, 400, 12)
    >>> turned = -2 * np.pi * f * 0.080
    >>> bool(np.allclose(np.diff(unwrapped(f, np.angle(np.exp(1j * turned)))), np.diff(turned)))
    True
    """
    phases = phase_rad.copy()
    for i in range(1, len(phases)):
        slope = (phases[i - 1] - phases[0]) / (frequency_hz[i - 1] - frequency_hz[0]) if i > 1 else 0.0
        expected = phases[i - 1] + slope * (frequency_hz[i] - frequency_hz[i - 1])
        phases[i] = expected + math.remainder(phases[i] - expected, 2 * math.pi)
    return phases


def _mean(records: Sequence[SineRatio]) -> tuple[float, float, float, float, float, int]:
    _, gain, gain_u, phase, phase_u = (np.array(column) for column in zip(*records, strict=True))
    count = len(records)
    centre = math.atan2(float(np.sin(phase).sum()), float(np.cos(phase).sum()))
    apart = np.remainder(phase - centre + math.pi, 2 * math.pi) - math.pi
    if count >= 3:
        uncertainties = [float(each.std(ddof=1)) / math.sqrt(count) for each in (gain, apart)]
        freedom = count - 1.0
    else:
        uncertainties = [math.sqrt(float((each**2).sum())) / count for each in (gain_u, phase_u)]
        freedom = math.inf
    return float(gain.mean()), uncertainties[0], centre + float(apart.mean()), uncertainties[1], freedom, count
