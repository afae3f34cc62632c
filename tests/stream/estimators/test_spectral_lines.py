"""Lines in a spectrum: frequency and amplitude within their intervals, and false alarms no more than promised."""

import math
from uuid import UUID

import numpy as np
import pytest
import scipy.fft
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from stream.batch import FloatArray, SampleBatch
from stream.estimators.base import NoEstimate
from stream.estimators.spectral_density import SpectralDensity
from stream.estimators.spectrum.spectral_lines import SpectralLine, WelchAverage, find_lines, hann_window

RATE_HZ = 100.0


def lines_in(values: FloatArray, segment_samples: int) -> tuple[SpectralLine, ...]:
    spectral = SpectralDensity(segment_samples)
    spectral.update(SampleBatch("FOG-1", "rate", "r1", UUID(int=1), 0, 0, 10_000_000, "deg/h", values=values))
    lines = spectral.lines()
    assert not isinstance(lines, NoEstimate), lines
    return lines


def shaped(rng: np.random.Generator, n: int, exponent: float) -> FloatArray:
    """Noise with a density as f**-exponent: 1 is flicker, 2 random walk."""
    transform = scipy.fft.rfft(rng.standard_normal(n))
    bins = np.arange(len(transform), dtype=np.float64)
    bins[0] = np.inf
    return np.asarray(scipy.fft.irfft(transform * bins ** (-exponent / 2.0), n), np.float64)


def assert_at_least(hits: int, trials: int, share: float) -> None:
    assert scipy.stats.binom.cdf(hits, trials, share) > 1e-4, f"{hits} of {trials}, at least {share:.0%} expected"


@pytest.mark.in_gate("0.0-3.0-4-30.0", "0.25-30.0-1-90.0", "0.25-1.0-1-90.0", "0.5-100000.0-40-6.0")
@pytest.mark.parametrize(("segments", "weakest"), [(1, 90.0), (4, 30.0), (40, 6.0), (200, 2.0)])
@pytest.mark.parametrize("times_stronger", [1.0, 3.0, 30.0, 1e5])
@pytest.mark.parametrize("off_bin", [0.0, 0.25, 0.5])
def test_a_sine_comes_back_within_its_intervals(
    segments: int, weakest: float, times_stronger: float, off_bin: float
) -> None:
    """`weakest` is the power over the background, at its bin, of a line that is found always or nearly so."""
    strength = weakest * times_stronger
    size, trials = 512, 60
    n = size + (segments - 1) * size // 2
    rng = np.random.default_rng([segments, int(times_stronger), int(4 * off_bin)])
    amplitude = math.sqrt(strength * 6.0 / size)
    frequency = (77.0 + off_bin) / size
    frequency_hits = amplitude_hits = 0
    for _ in range(trials):
        sine = amplitude * np.sin(2.0 * np.pi * (frequency * np.arange(n) + rng.random()))
        found = lines_in(rng.standard_normal(n) + sine, size)
        assert found
        line = max(found, key=lambda line: line.amplitude)
        assert line.frequency_hz == pytest.approx(frequency * RATE_HZ, abs=0.6 * RATE_HZ / size)
        frequency_hits += line.frequency_lo_hz <= frequency * RATE_HZ <= line.frequency_hi_hz
        amplitude_hits += line.amplitude_lo <= amplitude <= line.amplitude_hi
        assert line.false_alarm_probability <= 0.01
    assert_at_least(frequency_hits, trials, 0.95)
    assert_at_least(amplitude_hits, trials, 0.95)


def test_a_sine_without_noise_is_exact() -> None:
    sine = 2.0 * np.sin(2.0 * np.pi * 0.1234 * np.arange(20_000) + 0.3)
    (line,) = lines_in(sine + 1e-6 * np.random.default_rng(1).standard_normal(20_000), 1024)
    assert line.frequency_lo_hz <= 12.34 <= line.frequency_hi_hz
    assert line.amplitude_lo <= 2.0 <= line.amplitude_hi
    assert line.amplitude == pytest.approx(2.0, rel=1e-5)
    assert line.frequency_hz == pytest.approx(12.34, abs=1e-5)


def assert_legal(line: SpectralLine) -> None:
    assert 0.0 <= line.amplitude_lo <= line.amplitude <= line.amplitude_hi < math.inf
    assert line.frequency_lo_hz <= line.frequency_hz <= line.frequency_hi_hz
    assert 0.0 <= line.false_alarm_probability <= 0.01
    assert all(math.isfinite(getattr(line, field)) for field in line.__struct_fields__)


@pytest.mark.long
@settings(max_examples=100, deadline=None, derandomize=True)
@given(
    pattern=st.lists(st.floats(width=64, min_value=-1e140, max_value=1e140) | st.sampled_from([0.0, 1.0]), min_size=1),
    ramp=st.sampled_from([0.0, 1e-3, 1e6]),
)
def test_whatever_repeats_the_lines_are_finite(pattern: list[float], ramp: float) -> None:
    values = np.resize(np.array(pattern), 2000) + ramp * np.arange(2000)
    for line in lines_in(values, 256):
        assert_legal(line)


@pytest.mark.parametrize("off_bin", [0.0, 0.25, 0.5])
@pytest.mark.parametrize("scale", [1e-100, 1.0, 1e100])
def test_a_pure_sine_is_one_line(off_bin: float, scale: float) -> None:
    sine = scale * np.sin(2.0 * np.pi * (100.0 + off_bin) / 512 * np.arange(20_000))
    # the rounded arguments of the sine are lines of their own, 1e-12 of it
    (line,) = [line for line in lines_in(sine, 512) if line.amplitude > 1e-10 * scale]
    assert_legal(line)
    assert line.amplitude_lo <= scale <= line.amplitude_hi
    assert line.amplitude == pytest.approx(scale, rel=1e-4)
    assert line.frequency_hz == pytest.approx((100.0 + off_bin) / 512 * RATE_HZ, rel=1e-6)


def test_harmonics_over_coloured_noise_are_told_apart() -> None:
    rng = np.random.default_rng(3)
    n = 100_000
    values = 1000.0 * shaped(rng, n, 1.0) / math.sqrt(n) + rng.standard_normal(n)
    for frequency_hz, amplitude in ((12.5, 0.5), (25.0, 0.3), (37.46, 0.2)):
        values += amplitude * np.sin(2.0 * np.pi * frequency_hz / RATE_HZ * np.arange(n))
    found = lines_in(values, 4096)
    assert [round(line.frequency_hz, 1) for line in found] == [12.5, 25.0, 37.5]
    assert [line.amplitude for line in found] == pytest.approx([0.5, 0.3, 0.2], rel=0.1)


@pytest.mark.long
@pytest.mark.parametrize("segments", [1, 2, 8, 40])
def test_the_false_alarm_rate_over_white_noise_is_that_promised(segments: int) -> None:
    size, trials = 512, 2000
    rng = np.random.default_rng(segments)
    window = hann_window(size)
    alarms = 0
    for _ in range(trials):
        values = rng.standard_normal(size + (segments - 1) * size // 2)
        cut = np.lib.stride_tricks.sliding_window_view(values, size)[:: size // 2]
        transforms = scipy.fft.rfft((cut - cut.mean(axis=1, keepdims=True)) * window, axis=1)
        density = np.mean(np.abs(transforms) ** 2, axis=0)
        average = WelchAverage(density=density, first_bin=2, bin_width_hz=1.0, segments=segments, pairs=segments - 1)
        alarms += bool(find_lines(average, 0.01, 0.95))
    assert scipy.stats.binom.sf(alarms - 1, trials, 0.01) > 0.001, f"{alarms} of {trials}"


@pytest.mark.long
@pytest.mark.parametrize("exponent", [-2, 1, 2])
@pytest.mark.parametrize("segments", [1, 8, 100])
def test_coloured_noise_raises_no_more_false_alarms(exponent: int, segments: int) -> None:
    """Quantisation as the difference of white noise, flicker, random walk as its sum."""
    trials = 300
    rng = np.random.default_rng([exponent + 2, segments])
    n = 512 + (segments - 1) * 256
    alarms = 0
    for _ in range(trials):
        white = rng.standard_normal(n)
        noise = {-2: np.diff(white, prepend=0.0), 1: shaped(rng, n, 1.0), 2: np.cumsum(white)}[exponent]
        alarms += bool(lines_in(noise, 512))
    assert scipy.stats.binom.sf(alarms - 1, trials, 0.01) > 0.001, f"{alarms} of {trials}"
