"""The noise fit where a curve departs from the five terms: Markov noise, filters, outliers, correlation."""

import math

import numpy as np
import pytest

from stream.estimators.noise.noise_fit import NoiseFit, fit_noise
from stream.estimators.noise.noise_likelihood import CurveLikelihood
from stream.estimators.noise.noise_markov import davies_bound
from stream.estimators.noise.noise_model import TERMS, correlations, markov_column, term_columns
from tests.stream.allan_curves import (
    DAY,
    INTERVAL_S,
    SAMPLES,
    coefficients,
    exact_curve,
    markov_noise,
    point,
    simulated_curve,
    through_a_filter,
)


def test_markov_noise_is_found_with_its_correlation_time() -> None:
    fit = fit_noise(exact_curve((0.0, 0.01, 0.0, 0.06, 0.0), markov=(0.6, 300.0)))
    assert isinstance(fit, NoiseFit)
    assert fit.markov is not None
    assert fit.markov.correlation_s == pytest.approx(300.0, rel=0.05)
    assert fit.markov.correlation_lo_s < 300.0 < fit.markov.correlation_hi_s
    amplitude = fit.markov.amplitude
    assert amplitude.value == pytest.approx(0.6, rel=0.05)
    assert amplitude.lo < 0.6 < amplitude.hi
    assert fit.angle_random_walk.value == pytest.approx(0.01, rel=0.01)


@pytest.mark.long
def test_markov_noise_is_rarely_claimed_where_there_is_none() -> None:
    """A claim has a probability of 0.1 % a run: 2 in 25 one of 3e-4."""
    rng = np.random.default_rng(8)
    claims = 0
    for _ in range(25):
        walk = np.cumsum(rng.standard_normal(100_000)) * 0.01
        fit = fit_noise(simulated_curve(rng.standard_normal(100_000) + walk))
        assert isinstance(fit, NoiseFit)
        claims += fit.markov is not None
    assert claims < 2


@pytest.mark.long
@pytest.mark.parametrize("per_octave", [1, 4])
def test_a_filter_does_not_change_angle_random_walk(per_octave: int) -> None:
    """The filter leaves 1 - 15/(8 m) of the Allan variance of white noise over m samples, from m = 4 on."""
    rng = np.random.default_rng(11)
    for _ in range(4):
        values = through_a_filter(rng.standard_normal(300_000) * 0.01 * 60.0 / math.sqrt(INTERVAL_S))
        fit = fit_noise(simulated_curve(values, per_octave=per_octave))
        assert isinstance(fit, NoiseFit)
        walk = fit.angle_random_walk
        assert walk.value == pytest.approx(0.01, rel=0.04)
        assert walk.lo <= 0.01 <= walk.hi
        assert walk.hi < 1.2 * walk.lo
        assert fit.markov is None
        assert 0.1 < fit.misfit < 0.4
        assert not any(other.observable for other in coefficients(fit) if other is not walk)


@pytest.mark.long
def test_markov_noise_is_found_behind_a_filter() -> None:
    """A day; without the filter there is no misfit beside it, save for one run in 20."""
    rng = np.random.default_rng(12)
    misfits = []
    for _ in range(3):
        values = rng.standard_normal(SAMPLES) * 0.01 * 60.0 / math.sqrt(INTERVAL_S)
        values += markov_noise(rng, 1.2, 300.0)
        plain, filtered = (fit_noise(simulated_curve(each)) for each in (values, through_a_filter(values)))
        for fit in (plain, filtered):
            assert isinstance(fit, NoiseFit)
            assert fit.markov is not None
            assert fit.markov.correlation_lo_s < 300.0 < fit.markov.correlation_hi_s
            assert fit.markov.amplitude.lo < 1.2 < fit.markov.amplitude.hi
            assert fit.angle_random_walk.lo < 0.01 < fit.angle_random_walk.hi
            misfits.append(fit.misfit)
    assert misfits[::2].count(0.0) >= 2
    assert min(misfits[1::2]) > 0.1


@pytest.mark.long
@pytest.mark.parametrize("factor", [0.5, 0.8, 1.25, 2.0])
def test_one_wrong_point_does_not_pull_the_random_walk(factor: float) -> None:
    """By 5 % at most, though the shortest tau has half of all degrees of freedom, and within the limits."""
    curve = exact_curve((0.0, 0.01, 0.05, 0.078, 0.0))
    wrong = [point(curve[0].tau_s, factor * curve[0].value, curve[0].edf), *curve[1:]]
    fit = fit_noise(wrong)
    assert isinstance(fit, NoiseFit)
    assert fit.angle_random_walk.value == pytest.approx(0.01, rel=0.05)
    assert fit.angle_random_walk.lo <= 0.01 <= fit.angle_random_walk.hi
    assert fit.misfit > 0.0
    fit = fit_noise(curve)
    assert isinstance(fit, NoiseFit)
    assert fit.misfit == 0.0


@pytest.mark.long
def test_where_the_model_fits_there_is_hardly_ever_a_misfit() -> None:
    """A misfit has a probability of 5 % a run: 6 in 30 one of 3e-3; the error that it is taken for stays small."""
    rng = np.random.default_rng(9)
    misfits = []
    for _ in range(30):
        fit = fit_noise(simulated_curve(rng.standard_normal(100_000) + np.cumsum(rng.standard_normal(100_000)) * 0.01))
        assert isinstance(fit, NoiseFit)
        misfits.append(fit.misfit)
    assert np.count_nonzero(misfits) < 6
    assert max(misfits) < 0.05


def test_the_markov_column_has_the_limits_of_random_walk_and_white_noise() -> None:
    taus_s = np.geomspace(1e-6, 1e6, 200)
    column = markov_column(taus_s, 1.0)
    assert (column > 0.0).all()
    assert column[0] == pytest.approx(taus_s[0] / 3.0, rel=1e-4)
    assert column[-1] == pytest.approx(1.0 / taus_s[-1], rel=1e-4)
    slopes = np.diff(np.log(column)) / np.diff(np.log(taus_s))
    assert (np.diff(slopes) < 1e-4).all()


@pytest.mark.long
@pytest.mark.parametrize(("noise", "which"), [("white", 1), ("walk", 3), ("quantization", 0)])
def test_the_correlation_between_taus_is_that_of_simulated_records(noise: str, which: int) -> None:
    """300 records: a correlation is known to 1/sqrt(300), four of which are 0.23."""
    rng = np.random.default_rng(3)
    curves = []
    for _ in range(300):
        drawn = rng.standard_normal(4097)
        values = {"white": drawn, "walk": np.cumsum(drawn), "quantization": np.diff(drawn)}[noise]
        curves.append([p.value**2 for p in simulated_curve(values, 1.0)[:8]])
    simulated = np.corrcoef(np.array(curves).T)
    taus_s = np.array([2.0**i for i in range(8)])
    parts = np.zeros((8, 4))
    parts[:, which] = term_columns(taus_s)[:, which]
    correlation = correlations(taus_s, parts)
    np.testing.assert_allclose(correlation, simulated, atol=0.23)
    assert np.linalg.eigvalsh(correlation).min() > 0.0


def test_the_minimum_is_one() -> None:
    """No step away from the minimum, along any coefficient, lowers the deviance by more than 1e-5 of a limit's 4."""
    rng = np.random.default_rng(4)
    taus_s = np.array([0.1 * 2.0**i for i in range(18)])
    columns = term_columns(taus_s)
    edf = np.array([1e5 / 4.0**i + 1.0 for i in range(18)])
    for _ in range(20):
        variances = columns @ (np.array(DAY) / [term.per_si for term in TERMS]) ** 2 * rng.chisquare(edf) / edf
        likelihood = CurveLikelihood(columns, variances, edf, np.eye(18))
        theta, least = likelihood.minimum()
        assert least == pytest.approx(likelihood.deviance(likelihood.columns @ theta))
        for which in range(5):
            for factor in (0.99, 1.01):
                moved = theta.copy()
                moved[which] = moved[which] * factor + (1e-4 if factor > 1.0 else 0.0)
                assert likelihood.deviance(likelihood.columns @ moved) >= least - 1e-5


def test_the_bound_on_the_best_of_many_is_no_less_than_that_of_one() -> None:
    bounds = [davies_bound(length, 0.01) for length in (0.0, 1.0, 5.0, 25.0)]
    assert bounds == sorted(bounds)
    assert bounds[0] == pytest.approx(2.326348**2, rel=1e-5)
