"""Humps of spectra: noise of the model shows one no more often than promised, band noise is found with its power."""

import numpy as np
import pytest
from scipy import signal, stats

from analytics.curves.humps import find_humps
from stream.batch import FloatArray

RATE_HZ, SEGMENT = 50.0, 2048
ALARM = 0.01
ASKED = {"sample_interval_s": 1.0 / RATE_HZ, "false_alarm_probability": ALARM, "confidence": 0.95}


def spectrum(values: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Bins, density and degrees of freedom of a Welch average under the Hann window, half overlapping."""
    frequency_hz, density = signal.welch(values, RATE_HZ, "hann", SEGMENT, detrend=False)
    k = 2 * len(values) // SEGMENT - 1
    return frequency_hz[2:-1], density[2:-1], 2 * k**2 / (k + 2 * (k - 1) / 36)


def humps(values: FloatArray) -> list[tuple[float, float, float, float]]:
    frequency_hz, density, edf = spectrum(values)
    found = find_humps(frequency_hz, density, edf, **ASKED)
    return [(each.frequency_lo_hz, each.frequency_hi_hz, each.rms_lo, each.rms_hi) for each in found]


@pytest.mark.in_gate("white-100")
@pytest.mark.parametrize("series", [100, 300])
@pytest.mark.parametrize("kind", ["white", "walk", "quantization"])
def test_noise_of_the_model_shows_a_hump_no_more_often_than_promised(kind: str, series: int) -> None:
    rng = np.random.default_rng(20260901)
    alarms = 0
    for _ in range(series):
        noise = rng.standard_normal(16 * SEGMENT)
        if kind == "walk":
            noise = noise + 0.02 * np.cumsum(rng.standard_normal(noise.size))
        if kind == "quantization":
            noise = noise + np.diff(3.0 * rng.standard_normal(noise.size + 1))
        alarms += bool(humps(noise))
    # at most 1 % of them; the binomial quantile is passed by chance once in 1000
    assert alarms <= stats.binom.ppf(0.999, series, ALARM)


@pytest.mark.long
@pytest.mark.parametrize("sigma", [0.35, 0.6])
def test_band_noise_is_found_where_it_is_with_its_power(sigma: float) -> None:
    rng = np.random.default_rng(7)
    held = 0
    for _ in range(20):
        coloured = signal.sosfiltfilt(
            signal.butter(4, (8.0, 11.0), "bandpass", fs=RATE_HZ, output="sos"), rng.standard_normal(64 * SEGMENT)
        )
        coloured *= sigma / coloured.std()
        white = rng.standard_normal(coloured.size) + 0.01 * np.cumsum(rng.standard_normal(coloured.size))
        (hump,) = humps(white + coloured)
        lo_hz, hi_hz, rms_lo, rms_hi = hump
        assert 7.0 < lo_hz < 9.0
        assert 10.0 < hi_hz < 12.5
        held += rms_lo * 0.95 <= sigma <= rms_hi * 1.05
    assert held >= 15


def test_two_humps_are_apart() -> None:
    rng = np.random.default_rng(8)
    values = rng.standard_normal(64 * SEGMENT)
    for band in ((2.0, 3.0), (12.0, 15.0)):
        sos = signal.butter(4, band, "bandpass", fs=RATE_HZ, output="sos")
        coloured = signal.sosfiltfilt(sos, rng.standard_normal(values.size))
        values = values + 0.5 * coloured / coloured.std()
    found = humps(values)
    assert len(found) == 2
    assert found[0][1] < 5.0 < 10.0 < found[1][0]


def test_a_short_or_constant_spectrum_has_none() -> None:
    frequency_hz, density, edf = spectrum(np.random.default_rng(1).standard_normal(16 * SEGMENT))
    assert find_humps(frequency_hz[:60], density[:60], edf, **ASKED) == ()
    assert find_humps(frequency_hz, 0.0 * density, edf, **ASKED) == ()
