"""Welch's spectrum against its definition, scipy and its limits, however the stream is cut."""

import itertools
import math
import pickle
from dataclasses import replace
from uuid import UUID

import numpy as np
import pytest
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st

from stream.batch import FloatArray, IntArray, SampleBatch
from stream.errors import EstimatorError
from stream.estimators.base import NoEstimate, default_estimators, estimator_classes
from stream.estimators.snapshot import restore, take_snapshot
from stream.estimators.spectral_density import SpectralDensity
from stream.estimators.spectrum.spectral_lines import Line, Spectrum, hann_window, welch_edf

DT_NS = 10_000_000
RATE_HZ = 100.0


def make(
    values: FloatArray,
    first_slot: int = 0,
    unit: str = "deg/h",
    times_ns: IntArray | None = None,
    irregular: bool = False,
) -> SampleBatch:
    t0_ns = first_slot * DT_NS if times_ns is None else int(times_ns[0])
    return SampleBatch(
        "FOG-1",
        "rate",
        "r1",
        UUID(int=1),
        first_slot,
        t0_ns,
        DT_NS,
        unit,
        values=values,
        times_ns=times_ns,
        irregular=irregular,
    )


def fed(batches: list[SampleBatch], segment_samples: int = 256) -> SpectralDensity:
    spectral = SpectralDensity(segment_samples)
    for batch in batches:
        spectral.update(batch)
    return spectral


def spectrum_of(spectral: SpectralDensity) -> Spectrum:
    spectrum = spectral.estimate()
    assert not isinstance(spectrum, NoEstimate), spectrum
    return spectrum


def lines_of(spectral: SpectralDensity) -> tuple[Line, ...]:
    lines = spectral.lines()
    assert not isinstance(lines, NoEstimate), lines
    return lines


def reason_of(spectral: SpectralDensity) -> str:
    refused = spectral.estimate()
    assert isinstance(refused, NoEstimate)
    assert spectral.lines() == refused
    return refused.reason


def white(n: int, seed: int = 1) -> FloatArray:
    values: FloatArray = np.random.default_rng(seed).standard_normal(n)
    return values


def assert_same(a: SpectralDensity, b: SpectralDensity) -> None:
    counts = [(s.samples, s.missing, s.late, s.segments, s.segments_left_out) for s in (a, b)]
    assert counts[0] == counts[1]
    if not a.segments:
        assert a.estimate() == b.estimate()
        return
    first, second = spectrum_of(a), spectrum_of(b)
    np.testing.assert_allclose(first.density, second.density, rtol=1e-11, atol=0.0)
    assert first.edf == second.edf


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


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    cuts=st.lists(st.integers(1, 2999), max_size=30),
    holes=st.lists(st.tuples(st.integers(1, 2990), st.integers(1, 600)), max_size=3),
)
def test_the_result_does_not_depend_on_how_the_stream_is_cut(cuts: list[int], holes: list[tuple[int, int]]) -> None:
    values = white(3000) + 15.0
    for start, length in holes:
        values[start : min(start + length, 2999)] = np.nan
    whole = fed([make(values)])
    edges = sorted({0, *cuts, len(values)})
    assert_same(fed([make(values[a:b], a) for a, b in itertools.pairwise(edges)]), whole)
    sent = np.isfinite(values)
    edges = np.flatnonzero(np.diff(sent.astype(np.int8), prepend=0, append=0)).tolist()
    runs = [make(values[a:b], a) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    assert_same(fed(runs), whole)
    used = [i for i in range(0, 3000 - 255, 128) if sent[i : i + 256].all()]
    assert whole.segments == len(used)
    assert whole.segments_left_out == 22 - len(used)
    if used:
        segments = np.array([values[i : i + 256] for i in used])
        _, expected = scipy.signal.periodogram(segments, RATE_HZ, hann_window(256), detrend="constant")
        spectrum = spectrum_of(whole)
        np.testing.assert_allclose(spectrum.density, expected.mean(axis=0)[2:-1], rtol=1e-10)
        pairs = sum(b - a == 128 for a, b in itertools.pairwise(used))
        assert spectrum.edf == welch_edf(len(used), pairs)


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


@settings(max_examples=300, deadline=None, derandomize=True)
@given(data=st.data())
def test_parts_merge_to_one_pass_wherever_the_seams_lie(data: st.DataObject) -> None:
    """Around the seams: parts shorter than a segment, gaps at and across them, merged in any association."""
    values = white(3000) + 15.0
    values[: data.draw(st.sampled_from([0, 1, 128, 700]))] = np.nan
    seams = data.draw(st.lists(st.integers(0, 3000) | st.sampled_from([128, 256, 1024, 1025]), min_size=1, max_size=8))
    edges = sorted({0, *seams, 3000})
    shift = 0
    batches = []
    for a, b in itertools.pairwise(edges):
        batches.append(make(values[a:b], a + shift))
        shift += data.draw(st.sampled_from([0, 0, 0, 1, 100, 128, 256, 1000]))
    whole = fed(batches)
    waiting = [SpectralDensity(256)]
    for batch in batches:
        waiting[-1].update(batch)
        waiting.append(waiting[-1].continuation())
        if data.draw(st.booleans()):
            waiting.append(waiting[-1].continuation())
    while len(waiting) > 1:
        at = data.draw(st.integers(0, len(waiting) - 2))
        later = waiting.pop(at + 1)
        waiting[at].merge(pickle.loads(pickle.dumps(later)) if data.draw(st.booleans()) else later)
    assert_same(waiting[0], whole)
    assert waiting[0].state_bytes == whole.state_bytes
    after = make(white(600, 2), edges[-1] + shift)
    for each in (waiting[0], whole):
        each.update(after)
    assert_same(waiting[0], whole)


def test_a_part_alone_is_the_spectrum_of_its_own_segments() -> None:
    values = white(3000)
    first = fed([make(values[:1000])])
    part = first.continuation()
    part.update(make(values[1000:], 1000))
    expected = fed([make(values[1024:])])
    np.testing.assert_allclose(spectrum_of(part).density, spectrum_of(expected).density, rtol=1e-10)
    assert (part.samples, part.segments, part.segments_left_out) == (2000, 14, 0)
    first.merge(part)
    assert (first.segments, first.segments_left_out) == (22, 0)
    assert spectrum_of(first).edf == welch_edf(22, 21)


def test_only_a_part_behind_another_pays_for_its_head() -> None:
    first = fed([make(white(1001))])
    part = first.continuation()
    # segments at 768 and 896 lie across the seam at 1001: slots up to 1152
    assert part.state_bytes - first.state_bytes == 8 * (1152 - 1001)
    assert SpectralDensity(256).continuation().state_bytes == first.state_bytes
    again = restore(take_snapshot(part))
    assert again.state_bytes == part.copy().state_bytes == part.state_bytes
    state = part.export_state()
    with pytest.raises(EstimatorError, match="of another estimator"):
        SpectralDensity(512).import_state(state)
    with pytest.raises(EstimatorError, match="of another estimator"):
        first.import_state(state._replace(arrays=state.arrays[:3]))
    assert first.segments == 6


def test_a_copy_keeps_its_confidence() -> None:
    spectral = SpectralDensity(256, confidence=0.5)
    assert [each.confidence for each in (spectral.copy(), spectral.continuation())] == [0.5, 0.5]
    assert restore(take_snapshot(spectral)).confidence == 0.5
    with pytest.raises(EstimatorError, match="settings must agree"):
        spectral.merge(SpectralDensity(256))


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
