"""The frequency response of a gyro: means over the records of each frequency, and unwrapped phases."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from stream.batch import FloatArray


class SineRatio(NamedTuple):
    """A gyro's sine over the sine of the input rate, in one record; uncertainties are standard uncertainties.

    Parameters
    ----------
    frequency_hz: Of the vibration.
    gain: Amplitude of the output over amplitude of the rate.
    phase_rad: Of the output less that of the rate, at any multiple of 2 pi; NaN where the rate's phase is unknown.
    """

    frequency_hz: float
    gain: float
    gain_uncertainty: float
    phase_rad: float
    phase_uncertainty_rad: float


class Response(NamedTuple):
    """A frequency response; arrays over the frequencies, which increase.

    Parameters
    ----------
    frequency_hz, gain, gain_uncertainty, phase_rad, phase_uncertainty_rad: Means of the records; phases are unwrapped
        over the frequency.
    freedom: Degrees of freedom of the uncertainties.
    records: How many records there are.
    """

    frequency_hz: FloatArray
    gain: FloatArray
    gain_uncertainty: FloatArray
    phase_rad: FloatArray
    phase_uncertainty_rad: FloatArray
    freedom: FloatArray
    records: FloatArray


def response_of(records: Sequence[SineRatio]) -> Response:
    """Means over the records of each frequency, JJF 2014-2022 (41) and (44).

    Notes
    -----
    The uncertainty of a mean is the scatter of its records over sqrt(n); of fewer than three it is that of their fits.
    A gain is taken record by record, so that the table's amplitude may change from one to the next.

    Examples
    --------
    >>> two = response_of([SineRatio(10.0, 1.0, 0.01, 3.1, 0.01), SineRatio(10.0, 1.2, 0.01, -3.1, 0.01)])
    >>> two.gain.round(6).tolist(), (two.phase_rad % (2 * np.pi)).round(6).tolist()
    ([1.1], [3.141593])
    """
    frequencies = sorted({each.frequency_hz for each in records})
    rows = [_mean([each for each in records if each.frequency_hz == frequency]) for frequency in frequencies]
    columns = [np.array(column, dtype=np.float64) for column in zip(*rows, strict=True)]
    gain, gain_u, phase, phase_u, freedom, count = columns
    return Response(
        np.array(frequencies), gain, gain_u, unwrapped(np.array(frequencies), phase), phase_u, freedom, count
    )


def unwrapped(frequency_hz: FloatArray, phase_rad: FloatArray) -> FloatArray:
    """Unwrapped phases: each lies nearest to the line through the first and the last before it.

    So a delay may turn the phase by more than half a turn from one frequency to the next, as long as it does not do so
    from the first to the second.

    Examples
    --------
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
