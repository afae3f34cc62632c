"""Welch's spectrum against its definition, scipy and its limits, however the stream is cut."""

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
import scipy.signal

from stream.errors import EstimatorError
from stream.estimators.base import NoEstimate, default_estimators, estimator_classes
from stream.estimators.spectral_density import SpectralDensity
from stream.estimators.spectrum.spectral_lines import hann_window, welch_edf
from tests.stream.spectra import DT_NS, RATE_HZ, assert_same, fed, lines_of, make, reason_of, spectrum_of, white


def test_it_is_not_among_the_estimators_that_every_signal_is_given() -> None:
    assert SpectralDensity.key not in default_estimators()
    assert SpectralDensity in estimator_classes()
    assert all(SpectralDensity.names[language].strip() for language in ("en", "zh"))


@pytest.mark.parametrize(("segment_samples", "n"), [(128, 128), (256, 5000), (4096, 50_000)])
def test_it_is_scipys_welch(segment_samples: int, n: int) -> None:
    values = 1e3 + white(n) + np.cumsum(white(n, 2))
    spectrum = spectrum_of(fed([make(values)], segment_samples))
    frequency_hz, density = scipy.signal.welch(values, RATE_HZ, "hann", segment_samples, detrend="constant")
    np.testing.assert_allclose(spectrum.density, density[2:-1], rtol=1e-10)
    np.testing.assert_allclose(spectrum.frequency_hz, frequency_hz[2:-1], rtol=1e-14)
    assert spectrum.segments == (n - segment_samples) // (segment_samples // 2) + 1


def test_the_power_of_white_noise_is_its_variance() -> None:
    """The sum over the band is sigma**2; its own spread is that of a variance of n samples, times 3 for the window."""
    n, sigma = 400_000, 3.0
    spectrum = spectrum_of(fed([make(sigma * white(n))]))
    level = 2.0 * sigma**2 / RATE_HZ
    bound = 4.0 * math.sqrt(2.0 / n)
    assert abs(spectrum.density.mean() / level - 1.0) < bound
    assert spectrum.unit_of_measure == "(deg/h)^2/Hz"


def test_limits_cover_the_level_of_white_noise_and_edf_is_that_of_the_spread() -> None:
    runs, segments = 60, 20
    level = 2.0 / RATE_HZ
    spectra = [spectrum_of(fed([make(white(256 + (segments - 1) * 128, seed))])) for seed in range(runs)]
    densities = np.array([s.density for s in spectra])
    assert spectra[0].segments == segments
    assert spectra[0].edf == pytest.approx(2 * segments / (1 + 2 * (segments - 1) / segments / 36), rel=1e-12)
    # neighbouring bins correlate: as if 1/1.94 of them were independent
    independent = densities.size / 1.94
    covered = np.mean([(s.lo <= level) & (level <= s.hi) for s in spectra])
    assert abs(covered - 0.95) < 4.0 * math.sqrt(0.95 * 0.05 / independent)
    assert np.var(densities) / level**2 == pytest.approx(2.0 / spectra[0].edf, rel=4.0 * math.sqrt(2.5 / independent))


def test_overlap_of_the_window_is_what_the_degrees_of_freedom_take() -> None:
    window = hann_window(4096)
    correlation = (window[2048:] @ window[:2048] / (window @ window)) ** 2
    assert correlation == pytest.approx(1.0 / 36.0, rel=1e-12)
    assert welch_edf(2, 0) == 4.0
    assert welch_edf(2, 1) == pytest.approx(4.0 / (1.0 + correlation))


def test_a_gap_of_years_takes_no_time_and_its_segments_are_counted() -> None:
    values = white(1000)
    far = 10**11
    spectral = fed([make(values), make(values, far)])
    assert spectral.segments == 6 + sum(1 for i in range(1000 - 255) if (far + i) % 128 == 0)
    assert spectral.segments + spectral.segments_left_out == (far + 1000 - 256) // 128 + 1
    single = fed([make(values[i : i + 1], i) for i in range(1000)])
    assert_same(single, fed([make(values)]))


def test_late_samples_are_counted_and_input_is_left_alone() -> None:
    values = white(2000)
    values.flags.writeable = False
    batches = [make(values[:1000]), make(values[:1000]), make(values[1000:], 1000)]
    spectral = fed(batches)
    assert spectral.late == 1000
    np.testing.assert_array_equal(spectrum_of(spectral).density, spectrum_of(fed([make(values)])).density)


def test_too_little_or_irregular_data_is_a_reason() -> None:
    assert reason_of(fed([])) == "a segment of 256 samples without a gap needed, 0 samples seen"
    assert "255 samples seen" in reason_of(fed([make(white(255))]))
    holed = white(5000)
    holed[::200] = np.nan
    assert reason_of(fed([make(holed)])).endswith("4975 samples seen, 25 missing")
    times_ns = np.cumsum(np.random.default_rng(4).integers(1, 2 * DT_NS, 5000)).astype(np.int64)
    irregular = fed([make(white(5000), times_ns=times_ns, irregular=True)])
    assert "lie on no grid of 0.01 s" in reason_of(irregular)
    assert (irregular.samples, irregular.segments, irregular.segments_left_out) == (5000, 0, 0)
    assert "too large to be squared" in reason_of(fed([make(1e300 * white(5000))]))


@pytest.mark.parametrize("value", [0.0, 0.1, -1e300, 5e-324])
def test_a_constant_has_no_power_and_no_lines(value: float) -> None:
    spectral = fed([make(np.full(2000, value))])
    spectrum = spectrum_of(spectral)
    assert not spectrum.density.any()
    assert not spectrum.lo.any()
    assert not spectrum.hi.any()
    assert lines_of(spectral) == ()


def test_a_ramp_has_no_lines() -> None:
    assert lines_of(fed([make(1e6 + 0.1 * np.arange(20_000.0))], 1024)) == ()


def test_memory_is_bounded() -> None:
    spectral = SpectralDensity()
    sizes = []
    for i in range(20):
        spectral.update(make(white(100_000, i), i * 100_000))
        sizes.append(len(pickle.dumps(spectral)))
    assert sizes[-1] <= sizes[0] + 64
    assert sizes[-1] < 65_536
    assert spectral.state_bytes == 8 * (4096 + 2049 + 7)
    twin = pickle.loads(pickle.dumps(spectral))
    assert_same(twin, spectral)


def test_limits_are_finite_or_there_are_none() -> None:
    """One segment has 2 degrees of freedom: its upper limit is 40 times the density."""
    values = white(256)
    for exponent in np.arange(150.0, 155.0, 0.1):
        estimate = fed([make(values * 10.0**exponent)]).estimate()
        assert isinstance(estimate, NoEstimate) or np.isfinite(estimate.hi).all()


def test_units_and_counts() -> None:
    values = white(5000) + 5.0 * np.sin(2.0 * np.pi * 0.23 * np.arange(5000))
    in_h, in_s = fed([make(values)]), fed([make(values / 3600.0, unit="deg/s")])
    np.testing.assert_allclose(spectrum_of(in_s).density, spectrum_of(in_h).density, rtol=1e-9)
    assert lines_of(in_s)[0].amplitude == pytest.approx(lines_of(in_h)[0].amplitude, rel=1e-9)
    assert in_s.unit_of_measure == "deg/h"
    assert spectrum_of(fed([make(values, unit="degC")])).unit_of_measure == "(degC)^2/Hz"
    counts = np.round(1000.0 * values).astype(np.int32)
    counted = fed([replace(make(values), values=None, counts=counts, scale=0.001)])
    assert_same(counted, fed([make(counts * 0.001)]))


@pytest.mark.parametrize("segment_samples", [0, 64, 1000, 2**21, -256])
def test_other_segments_are_refused(segment_samples: int) -> None:
    with pytest.raises(EstimatorError, match="power of two"):
        SpectralDensity(segment_samples)


def test_what_cannot_be_used_is_refused() -> None:
    spectral = fed([make(white(1000))])
    for other in (
        replace(make(white(500), 1000), unit="FOG-2"),
        replace(make(white(500), 1000), signal="temperature"),
        replace(make(white(500), 1000), dt_ns=2 * DT_NS),
    ):
        with pytest.raises(EstimatorError, match="unit FOG-"):
            spectral.update(other)
    assert (spectral.samples, spectral.segments) == (1000, 6)
    with pytest.raises(EstimatorError, match="false-alarm"):
        spectral.lines(0.0)
    with pytest.raises(EstimatorError, match="confidence"):
        SpectralDensity(confidence=1.0)
