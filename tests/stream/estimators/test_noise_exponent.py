"""Noise exponents of an Allan curve: exact curves, random records, coverage, and what a curve cannot tell."""

import itertools
import math
from functools import lru_cache

import numpy as np
import pytest
import scipy.stats

from stream.batch import FloatArray, IntArray
from stream.errors import EstimatorError
from stream.estimators.confidence import NOISE_EXPONENTS, deviation_bounds, edf, least_edf
from stream.estimators.noise.noise_exponent import Identified, identify

OVERLAP = 16
# alpha by what is drawn
DRAWN = {"quantisation": 2, "white": 0, "flicker": -1, "walk": -2}


def times(samples: int, per_octave: int = 1) -> tuple[IntArray, IntArray, IntArray]:
    """Factors, windows and strides of a record without gaps."""
    grid = np.unique(np.round(2.0 ** (np.arange(0, 40 * per_octave) / per_octave)).astype(np.int64))
    factors = grid[2 * grid <= samples]
    levels = np.maximum(0, np.floor(np.log2(factors / OVERLAP)).astype(np.int64))
    strides = factors >> levels
    factors = strides << levels
    return factors, (samples - 2 * factors) // (1 << levels) + 1, strides


def slope(alpha: int, factors: IntArray) -> FloatArray:
    """Allan variance of a power law; that of flicker of angle by IEEE 1139 at the highest frequency of the samples."""
    power = factors.astype(np.float64) ** (-1.0 - alpha)
    return power * (1.038 + 3.0 * np.log(math.pi * factors)) if alpha == 1 else power


def identified(samples: int, variances: FloatArray, per_octave: int = 1) -> tuple[Identified, ...]:
    factors, windows, strides = times(samples, per_octave)
    return identify(factors, variances, windows, strides)


@lru_cache(maxsize=1)
def roots(samples: int) -> FloatArray:
    """Of the spectrum of increments of flicker, white noise differenced to the half order, by circulant embedding."""
    k = np.arange(1, samples + 1, dtype=np.float64)
    covariance = np.concatenate([[1.0], np.cumprod((k - 1.5) / (k + 0.5))])
    return np.sqrt(np.fft.rfft(np.concatenate([covariance, covariance[-2:0:-1]])).real)


def records(noise: str, runs: int, samples: int, seed: int) -> FloatArray:
    rng = np.random.default_rng([seed, *noise.encode()])
    if noise == "quantisation":
        return np.diff(rng.standard_normal((runs, samples + 1)))
    if noise == "flicker":
        white = np.fft.rfft(rng.standard_normal((runs, 2 * samples)))
        return np.cumsum(np.fft.irfft(white * roots(samples), 2 * samples)[:, :samples], axis=1)
    white_samples = rng.standard_normal((runs, samples))
    return white_samples if noise == "white" else np.cumsum(white_samples, axis=1)


def curves(values: FloatArray) -> FloatArray:
    """Allan variances of each row, at the strides of `times`."""
    runs, samples = values.shape
    integral = np.concatenate([np.zeros((runs, 1)), np.cumsum(values, axis=1)], axis=1)
    columns = []
    for m, stride in zip(*(array.tolist() for array in times(samples)[::2]), strict=True):
        lattice = integral[:, :: m // stride]
        differences = lattice[:, 2 * stride :] - 2.0 * lattice[:, stride:-stride] + lattice[:, : -2 * stride]
        columns.append(np.mean(differences**2, axis=1) / (2.0 * m**2))
    return np.stack(columns, axis=1)


def true_variance(noise: str, factor: int) -> float:
    if noise == "flicker":
        triangle = np.convolve(np.ones(factor), np.ones(factor)) / factor
        products = np.correlate(triangle, triangle, "full")[len(triangle) - 1 :]
        k = np.arange(1, len(triangle), dtype=np.float64)
        return float(products @ np.concatenate([[1.0], 2.0 * np.cumprod((k - 1.5) / (k + 0.5))])) / 2.0
    return {"quantisation": 3.0 / factor**2, "white": 1.0 / factor, "walk": (2 * factor**2 + 1) / (6 * factor)}[noise]


@pytest.mark.parametrize("per_octave", [1, 2, *(pytest.param(more, marks=pytest.mark.long) for more in (4, 8))])
@pytest.mark.parametrize("alpha", NOISE_EXPONENTS)
def test_exact_power_laws_are_named(alpha: int, per_octave: int) -> None:
    samples = 1 << 20
    factors, windows, strides = times(samples, per_octave)
    for i, noise in enumerate(identified(samples, slope(alpha, factors), per_octave)):
        if factors[i] > OVERLAP and windows[i] > 2 * OVERLAP:
            assert noise.exponent == alpha, (factors[i], noise)
        if OVERLAP < factors[i] <= samples / 1000 and alpha != 1:
            assert noise.plausible == (alpha,), (factors[i], noise)
            assert noise.edf == edf(alpha, 2, int(factors[i]), int(windows[i]), int(strides[i]))


@pytest.mark.parametrize("noise", DRAWN)
def test_samples_are_named_from_one_interval_on(noise: str) -> None:
    samples = 1 << 16
    factors, _, _ = times(samples)
    found = identified(samples, np.array([true_variance(noise, min(m, 1024)) for m in factors.tolist()]))
    assert {each.exponent for each, m in zip(found, factors.tolist(), strict=True) if m <= 1024} == {DRAWN[noise]}


@pytest.mark.long
@pytest.mark.parametrize("noise", DRAWN)
def test_the_true_exponent_is_plausible_as_often_as_the_level_says(noise: str) -> None:
    runs, samples = 300, 1024
    counts = np.zeros(len(times(samples)[0]), np.int64)
    for variances in curves(records(noise, runs, samples, 1)):
        counts += [DRAWN[noise] in each.plausible for each in identified(samples, variances)]
    # one test of 5 %, or nearly so: ln chi-square is normal only for many degrees, which the last two octaves lack
    assert counts[:-2].min() >= scipy.stats.binom.ppf(0.001 / (4 * len(counts)), runs, 0.95), counts


@pytest.mark.long
@pytest.mark.parametrize("noise", DRAWN)
def test_limits_cover_between_93_and_98_percent(noise: str) -> None:
    runs, samples = 1000, 1024
    factors, windows, strides = times(samples)
    wanted = np.flatnonzero(samples // factors >= 8)
    truth = np.sqrt([true_variance(noise, m) for m in factors[wanted].tolist()])
    limits = lru_cache(maxsize=None)(lambda degrees: deviation_bounds(1.0, degrees, 0.95))
    counts = np.zeros(len(wanted), np.int64)
    for variances in curves(records(noise, runs, samples, 2)):
        found = identify(factors, variances, windows, strides)
        lo, hi = np.array([limits(found[i].edf) for i in wanted]).T
        values = np.sqrt(variances[wanted])
        counts += (values * lo <= truth) & (truth <= values * hi)
    level = 0.001 / (2 * len(DRAWN) * len(wanted))
    assert counts.min() >= scipy.stats.binom.ppf(level, runs, 0.93), counts
    assert counts.max() <= scipy.stats.binom.isf(level, runs, 0.98), counts


def test_redder_curves_have_no_bluer_exponents() -> None:
    samples = 1 << 18
    factors, _, _ = times(samples)
    # without 1, whose slope is that of 2 but for a logarithm
    found = [identified(samples, factors.astype(np.float64) ** tilt) for tilt in np.arange(-2.0, 1.01, 0.125)]
    for bluer, redder in itertools.pairwise(found):
        for a, b in zip(bluer, redder, strict=True):
            assert b.exponent <= a.exponent
            assert max(b.plausible) <= max(a.plausible)
            assert min(b.plausible) <= min(a.plausible)


def test_between_two_exponents_both_are_plausible() -> None:
    samples = 1 << 20
    factors, _, _ = times(samples)
    found = identified(samples, 1.0 / np.sqrt(factors))
    assert {each.plausible for each, m in zip(found, factors, strict=True) if OVERLAP < m < 1000} == {(0, -1)}
    redder, bluer = (identified(samples, factors.astype(np.float64) ** tilt) for tilt in (2.0, -3.0))
    assert redder[10].plausible == (-2,)
    assert bluer[10].plausible == (2,)


def test_a_markov_bump_turns_red_and_white_again() -> None:
    samples, correlation = 1 << 20, 256.0
    factors, _, _ = times(samples)
    u = factors / correlation
    variances = (1.0 - (3.0 - 4.0 * np.exp(-u) + np.exp(-2.0 * u)) / (2.0 * u)) / u
    found = dict(zip(factors.tolist(), identified(samples, variances), strict=True))
    assert found[16].exponent == found[32].exponent == -2
    assert found[8192].plausible == found[16384].plausible == (0,)


@pytest.mark.parametrize("samples", [2, 3, 4, 7, 40, 1000])
def test_degrees_lie_between_the_least_and_the_windows(samples: int) -> None:
    factors, windows, strides = times(samples)
    rng = np.random.default_rng(samples)
    for _ in range(20):
        for i, each in enumerate(identified(samples, np.exp(rng.normal(0.0, 3.0, len(factors))))):
            least = least_edf(int(factors[i]), int(windows[i]), int(strides[i]))
            assert least <= each.edf <= windows[i]
            assert each.exponent in each.plausible
            positions = [NOISE_EXPONENTS.index(alpha) for alpha in each.plausible]
            assert positions == list(range(positions[0], positions[-1] + 1))


def test_what_tells_nothing_leaves_all_plausible() -> None:
    factors, windows, strides = times(4096)
    least = [least_edf(*each) for each in zip(factors.tolist(), windows.tolist(), strides.tolist(), strict=True)]
    for found in (
        identify(factors, np.zeros(len(factors)), windows, strides),
        identify(factors[3:4], np.ones(1), windows[3:4], strides[3:4]),
    ):
        assert {each.plausible for each in found} == {NOISE_EXPONENTS}
        assert {each.edf for each in found} <= set(least)
    assert identify(factors[:0], np.zeros(0), windows[:0], strides[:0]) == ()


def test_a_variance_of_zero_tells_nothing_where_it_is_compared() -> None:
    factors, windows, strides = times(4096)
    variances = 1.0 / factors
    variances[-1] = 0.0
    found = identify(factors, variances, windows, strides)
    assert found[-1].plausible == NOISE_EXPONENTS
    assert found[5].plausible == (0,)


def test_the_unit_does_not_matter() -> None:
    factors, windows, strides = times(4096)
    variances = curves(records("white", 1, 4096, 3))[0]
    assert identify(factors, variances * 1e-12, windows, strides) == identify(factors, variances, windows, strides)


@pytest.mark.parametrize(("factors", "count"), [([1, 2, 2], 3), ([4, 2, 1], 3), ([1, 2, 4], 2)])
def test_no_curve_is_refused(factors: list[int], count: int) -> None:
    ones = np.ones(count, np.int64)
    with pytest.raises(EstimatorError, match="ascending factors"):
        identify(np.array(factors), np.ones(3), ones, ones)
