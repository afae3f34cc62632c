"""Equivalent degrees of freedom and limits, against independent code, known noise and simulation."""

import itertools
import math

import allantools.ci
import numpy as np
import pytest
import scipy.stats

from stream.estimators.confidence import NOISE_EXPONENTS, deviation_bounds, edf, least_edf, sw, sx
from tests.allan_definition import overlapping_allan_variance


@pytest.mark.long
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("alpha", NOISE_EXPONENTS)
@pytest.mark.parametrize("m", [1, 2, 5, 16, 33])
@pytest.mark.parametrize("n", [120, 1000, 100_000])
def test_equal_to_allantools_exact_sum_for_full_overlap(alpha: int, d: int, m: int, n: int) -> None:
    expected = allantools.ci.edf_greenhall_simple(alpha, d, m, m, m, n + 1)
    assert edf(alpha, d, m, n + 1 - d * m, m) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("alpha", NOISE_EXPONENTS)
@pytest.mark.parametrize("m", [1, 4, 16, 64, 256])
def test_close_to_the_published_tables(alpha: int, m: int) -> None:
    n = 5000
    expected = allantools.ci.edf_greenhall(alpha, 2, m, n + 1, overlapping=True)
    assert edf(alpha, 2, m, n + 1 - 2 * m, m) == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("alpha", NOISE_EXPONENTS)
@pytest.mark.parametrize("m", [1, 2, 16, 64, 1000])
def test_stable_form_equals_the_plain_one_where_that_holds(alpha: int, m: int) -> None:
    t = np.arange(-100, 101) / 16.0
    plain = m**2 * (2 * sw(t, alpha) - sw(t - 1 / m, alpha) - sw(t + 1 / m, alpha))
    np.testing.assert_allclose(sx(t, m, alpha), plain, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("alpha", NOISE_EXPONENTS)
def test_large_averaging_factors_keep_their_digits(alpha: int) -> None:
    factors = [16 << k for k in range(8, 28)]
    degrees = [edf(alpha, 2, factor, 100_000, 16) for factor in factors]
    assert all(math.isfinite(value) and 1 <= value <= 100_000 for value in degrees)
    slowest = 0.07 if alpha == 1 else 1e-3
    assert all(abs(after / before - 1) < slowest for before, after in itertools.pairwise(degrees))


@pytest.mark.parametrize("alpha", [0, -1, -2])
def test_a_stride_of_a_sixteenth_costs_no_freedom(alpha: int) -> None:
    m, length = 256, 64
    full = edf(alpha, 2, m, m * (length - 2) + 1, m)
    assert edf(alpha, 2, m, 16 * (length - 2) + 1, 16) == pytest.approx(full, rel=6e-3)


@pytest.mark.parametrize("factor", [1, 2, 16, 1 << 20])
@pytest.mark.parametrize("windows", [1, 2, 3, 10, 1000, 10**9])
def test_degrees_lie_between_one_and_the_number_of_windows(factor: int, windows: int) -> None:
    stride = min(factor, 16)
    for alpha in NOISE_EXPONENTS:
        assert 1.0 <= edf(alpha, 2, factor, windows, stride) <= windows * (1 + 1e-12)
    assert least_edf(factor, windows, stride) == min(edf(a, 2, factor, windows, stride) for a in NOISE_EXPONENTS)


@pytest.mark.parametrize("m", [1, 2, 4, 8, 16, 32])
@pytest.mark.parametrize("windows", [1, 2, 5, 20, 100, 10_000])
def test_never_more_than_white_samples_truly_have(m: int, windows: int) -> None:
    weights = np.concatenate([-np.ones(m), np.ones(m)])
    covariance = np.correlate(weights, weights, "full")[2 * m - 1 :] / (2.0 * m)
    lags = np.arange(1, min(windows, 2 * m))
    true = windows / (1 + 2 * float(np.sum((1 - lags / windows) * covariance[lags] ** 2)))
    assert least_edf(m, windows, m) <= true * (1 + 1e-12)


@pytest.mark.parametrize("degrees", [1.0, 1.3, 7.5, 1e3, 1e9])
@pytest.mark.parametrize("confidence", [0.683, 0.95, 0.999])
def test_limits_are_chi_square(degrees: float, confidence: float) -> None:
    lo, hi = deviation_bounds(2.0, degrees, confidence)
    assert scipy.stats.chi2.sf(degrees * 4 / lo**2, degrees) == pytest.approx((1 - confidence) / 2, rel=1e-6)
    assert scipy.stats.chi2.cdf(degrees * 4 / hi**2, degrees) == pytest.approx((1 - confidence) / 2, rel=1e-6)
    assert 0 < lo < 2 < hi < math.inf


def test_limits_of_nothing_are_nothing() -> None:
    assert deviation_bounds(0.0, 1.0, 0.95) == (0.0, 0.0)


def test_limits_cover_white_noise_and_random_walk() -> None:
    rng = np.random.default_rng(20240607)
    trials, n, factors = 400, 512, (1, 2, 4, 16, 64, 128)
    covered = {"white": np.zeros(len(factors), int), "walk": np.zeros(len(factors), int)}
    for _ in range(trials):
        white = rng.standard_normal(n)
        for name, values in (("white", white), ("walk", np.cumsum(white))):
            for i, m in enumerate(factors):
                true = 1 / m if name == "white" else (2 * m**2 + 1) / (6 * m)
                value = math.sqrt(overlapping_allan_variance(values, m))
                lo, hi = deviation_bounds(value, least_edf(m, n + 1 - 2 * m, m), 0.95)
                covered[name][i] += lo <= math.sqrt(true) <= hi
    # the least degrees of freedom make the limits too wide, never too narrow: only the lower bound binds
    bound = scipy.stats.binom.ppf(0.001 / (2 * len(factors)), trials, 0.95)
    assert min(covered["white"].min(), covered["walk"].min()) >= bound, covered


@pytest.mark.parametrize("alpha", NOISE_EXPONENTS)
@pytest.mark.parametrize("m", [1, 2, 5, 16, 33])
@pytest.mark.parametrize("n", [120, 1000, 100_000])
def test_a_modified_variance_has_the_filter_factor_one(alpha: int, m: int, n: int) -> None:
    expected = allantools.ci.edf_greenhall_simple(alpha, 2, m, m, 1, n + 1)
    assert edf(alpha, 2, 1, n + 2 - 3 * m, m) == pytest.approx(expected, rel=1e-9)
