"""Batches, spectra and their comparison."""

import numpy as np

from stream.batch import FloatArray, SampleBatch
from stream.estimators.base import NoEstimate
from stream.estimators.spectral_density import SpectralDensity
from stream.estimators.spectrum.spectral_lines import SpectralLine, Spectrum
from tests.batches import rate_batch

DT_NS = 10_000_000


RATE_HZ = 100.0


make = rate_batch


def fed(batches: list[SampleBatch], segment_samples: int = 256) -> SpectralDensity:
    spectral = SpectralDensity(segment_samples)
    for batch in batches:
        spectral.update(batch)
    return spectral


def spectrum_of(spectral: SpectralDensity) -> Spectrum:
    spectrum = spectral.estimate()
    assert not isinstance(spectrum, NoEstimate), spectrum
    return spectrum


def lines_of(spectral: SpectralDensity) -> tuple[SpectralLine, ...]:
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
