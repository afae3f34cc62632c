"""Noise coefficients come back from exact and simulated Allan curves, with limits that are honest about the rest."""

import math
from uuid import UUID

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from stream.batch import FloatArray, SampleBatch
from stream.errors import EstimatorError
from stream.estimators.allan_variance import AllanDeviation
from stream.estimators.base import NoEstimate
from stream.estimators.confidence import least_edf
from stream.estimators.noise.noise_fit import Coefficient, NoiseFit, fit_noise
from stream.estimators.noise.noise_likelihood import CurveLikelihood
from stream.estimators.noise.noise_markov import davies_bound
from stream.estimators.noise.noise_model import TERMS, correlations, markov_column, term_columns
from stream.events import EstimatePoint

DAY = (0.35, 0.01, 0.05, 0.078, 0.0432)
INTERVAL_S = 0.1
SAMPLES = 864_000


def coefficients(fit: NoiseFit | NoEstimate) -> tuple[Coefficient, ...]:
    assert isinstance(fit, NoiseFit), fit
    return tuple(getattr(fit, term.key) for term in TERMS)


def exact_curve(
    truth: tuple[float, ...],
    *,
    samples: int = SAMPLES,
    interval_s: float = INTERVAL_S,
    markov: tuple[float, float] = (0.0, 300.0),
    per_octave: int = 1,
) -> list[EstimatePoint]:
    """The model's own curve with the degrees of freedom of a record; coefficients in reported units."""
    factors = np.unique(np.round(2 ** np.arange(0, math.log2(samples / 2), 1 / per_octave)).astype(int))
    taus_s = factors * interval_s
    si = np.array(truth) / [term.per_si for term in TERMS]
    variances = term_columns(taus_s) @ si**2 + (markov[0] / 60.0) ** 2 * markov_column(taus_s, markov[1])
    return [
        point(float(tau), math.sqrt(variance), degrees(int(factor), samples))
        for tau, variance, factor in zip(taus_s, variances, factors, strict=True)
    ]


def degrees(factor: int, samples: int) -> float:
    stride = max(1, factor // 16)
    return least_edf(
        averaging_factor=factor, windows=(samples - 2 * factor) // stride + 1, stride_per_tau=min(factor, 16)
    )


def point(tau_s: float, value: float, edf: float) -> EstimatePoint:
    return EstimatePoint(tau_s=tau_s, value=value, lo=0.0, hi=2.0 * value, edf=edf, n=1 + int(edf))


def simulated_curve(
    values: FloatArray, interval_s: float = INTERVAL_S, *, per_octave: int = 1
) -> tuple[EstimatePoint, ...]:
    estimator = AllanDeviation(per_octave)
    batch = SampleBatch("FOG-1", "rate", "r1", UUID(int=1), 0, 0, round(interval_s * 1e9), "deg/h", values=values)
    estimator.update(batch)
    curve = estimator.estimate()
    assert not isinstance(curve, NoEstimate)
    return curve


def a_day(rng: np.random.Generator, truth: tuple[float, ...] = DAY) -> FloatArray:
    """24 h at 10 Hz; flicker from a circular spectrum of more than twice the length."""
    q, n, b, k, r = truth
    values = rng.standard_normal(SAMPLES) * n * 60.0 / math.sqrt(INTERVAL_S)
    values += np.diff(rng.standard_normal(SAMPLES + 1)) * q / INTERVAL_S
    values += np.cumsum(rng.standard_normal(SAMPLES)) * k / 60.0 * math.sqrt(INTERVAL_S)
    values += np.arange(SAMPLES) * r / 3600.0 * INTERVAL_S
    length = 1 << 21
    spectrum = rng.standard_normal(length // 2 + 1) + 1j * rng.standard_normal(length // 2 + 1)
    spectrum *= length / np.sqrt(4.0 * np.pi * np.maximum(1.0, np.arange(length // 2 + 1)))
    spectrum[0] = 0.0
    return values + b * np.fft.irfft(spectrum, length)[:SAMPLES]


POSITIVE = st.floats(min_value=-1.0, max_value=1.0).map(lambda exponent: 10.0**exponent)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(factors=st.tuples(*[POSITIVE] * 5), per_octave=st.sampled_from([1, 2, 4]))
def test_an_exact_curve_gives_its_coefficients_back(factors: tuple[float, ...], per_octave: int) -> None:
    truth = tuple(a * b for a, b in zip(DAY, factors, strict=True))
    fit = fit_noise(exact_curve(truth, per_octave=per_octave))
    for found, true in zip(coefficients(fit), truth, strict=True):
        assert found.value == pytest.approx(true, rel=1e-4)
        assert found.lo <= true * (1 + 1e-4)
        assert true <= found.hi * (1 + 1e-4)
    assert isinstance(fit, NoiseFit)
    assert fit.markov is None


@settings(max_examples=20, deadline=None, derandomize=True)
@given(
    logarithms=st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=20),
    edfs=st.lists(st.floats(1.0, 1e5), min_size=20, max_size=20),
    confidence=st.sampled_from([0.5, 0.95, 0.999]),
)
def test_whatever_the_curve_the_limits_are_ordered_finite_and_never_negative(
    logarithms: list[float], edfs: list[float], confidence: float
) -> None:
    points = [point(0.1 * 2.0**i, 10.0**x, edfs[i]) for i, x in enumerate(logarithms)]
    for found in coefficients(fit_noise(points, confidence=confidence)):
        assert all(math.isfinite(x) for x in (found.lo, found.value, found.hi))
        assert 0.0 <= found.lo <= found.value <= found.hi
        assert found.hi > 0.0
        assert found.observable == (found.reason == "") == (found.lo > 0.0)


@pytest.mark.parametrize("factor", [1e-100, 1e-3, 1e6, 1e100])
def test_coefficients_scale_with_the_curve(factor: float) -> None:
    curve = exact_curve(DAY)
    scaled = [point(p.tau_s, p.value * factor, p.edf) for p in curve]
    for one, other in zip(coefficients(fit_noise(curve)), coefficients(fit_noise(scaled)), strict=True):
        expected = (factor * one.value, factor * one.lo, factor * one.hi)
        assert (other.value, other.lo, other.hi) == pytest.approx(expected, rel=1e-4)


def test_coefficients_scale_with_time() -> None:
    """The same curve at taus 4 times longer: Q by 4, N by 2, K by 1/2, R by 1/4."""
    curve = exact_curve(DAY)
    slower = [point(4.0 * p.tau_s, p.value, p.edf) for p in curve]
    powers = (4.0, 2.0, 1.0, 0.5, 0.25)
    for one, other, power in zip(coefficients(fit_noise(curve)), coefficients(fit_noise(slower)), powers, strict=True):
        assert (other.value, other.hi) == pytest.approx((power * one.value, power * one.hi), rel=1e-4)


def test_the_order_of_points_does_not_matter_and_more_confidence_is_wider() -> None:
    curve = simulated_curve(a_day(np.random.default_rng(5)))
    assert fit_noise(curve) == fit_noise(curve[::-1])
    for narrow, wide in zip(
        coefficients(fit_noise(curve, confidence=0.5)), coefficients(fit_noise(curve, confidence=0.99)), strict=True
    ):
        assert wide.lo <= narrow.lo
        assert narrow.hi < wide.hi


def test_units_are_those_of_ieee_952() -> None:
    """1 deg/sqrt(h) is 60 (deg/h) sqrt(s): a deviation of 60 deg/h at 1 s."""
    assert [found.unit_of_measure for found in coefficients(fit_noise(exact_curve(DAY)))] == [
        "arcsec",
        "deg/sqrt(h)",
        "deg/h",
        "deg/h/sqrt(h)",
        "deg/h/h",
    ]
    white = [point(2.0**i, 60.0 / math.sqrt(2.0**i), 1e4) for i in range(12)]
    assert coefficients(fit_noise(white))[1].value == pytest.approx(1.0, rel=1e-6)
    ramp_per_h = 3.0
    ramp = [point(2.0**i, ramp_per_h * 2.0**i / 3600.0 / math.sqrt(2.0), 1e4) for i in range(12)]
    assert coefficients(fit_noise(ramp))[4].value == pytest.approx(ramp_per_h, rel=1e-6)
    for term in TERMS:
        assert all(term.names[language].strip() for language in ("en", "zh"))


def test_too_little_or_constant_data_is_a_reason() -> None:
    for points in ([], exact_curve(DAY)[:5], [exact_curve(DAY)[0]] * 9):
        fit = fit_noise(points)
        assert isinstance(fit, NoEstimate)
        assert "6 averaging times" in fit.reason
    fit = fit_noise([point(2.0**i, 0.0, 10.0) for i in range(9)])
    assert isinstance(fit, NoEstimate)
    assert "constant" in fit.reason
    with pytest.raises(EstimatorError, match="between 0 and 1"):
        fit_noise(exact_curve(DAY), confidence=95.0)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_white_noise_shows_nothing_but_angle_random_walk(seed: int) -> None:
    """N to four standard deviations: its square is known to sqrt(2/edf) at the shortest tau, edf > n/2."""
    samples = 200_000
    values = np.random.default_rng(seed).standard_normal(samples) * 0.01 * 60.0 / math.sqrt(INTERVAL_S)
    q, n, b, k, r = coefficients(fit_noise(simulated_curve(values)))
    assert n.value == pytest.approx(0.01, rel=4.0 * math.sqrt(1.0 / samples))
    assert n.lo <= n.value <= n.hi
    assert n.observable
    for other in (q, b, k, r):
        assert other.lo == 0.0
        assert not other.observable
        assert other.reason.startswith("not observable in this record: at most")


def test_a_day_with_all_five_terms() -> None:
    """Ten days: bounds are those of the bench (N 0.3 %, B 7 %, K 35 % RMS) with room for ten runs."""
    rng = np.random.default_rng(20)
    runs = [coefficients(fit_noise(simulated_curve(a_day(rng)))) for _ in range(10)]
    values = np.array([[found.value for found in run] for run in runs])
    errors = np.sqrt(np.mean((values / np.array(DAY) - 1.0) ** 2, axis=0))
    assert errors[0] < 0.005
    assert errors[1] < 0.01
    assert errors[2] < 0.15
    assert errors[3] < 0.7
    held = [[found.lo <= true <= found.hi for found, true in zip(run, DAY, strict=True)] for run in runs]
    # 50 intervals at 95 %: 9 or more misses have a probability below 1e-3
    assert np.sum(held) >= 42
    assert all(run[i].observable for run in runs for i in (0, 1, 2))


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


def through_a_filter(values: FloatArray) -> FloatArray:
    """The average of four samples, as a sensor's filter at the sample rate gives it: angle random walk is the same."""
    return np.convolve(values, np.full(4, 0.25), mode="valid")


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


def markov_noise(rng: np.random.Generator, amplitude: float, correlation_s: float) -> FloatArray:
    """Exponentially correlated noise over a day, its amplitude in deg/h/sqrt(h)."""
    kept = math.exp(-INTERVAL_S / correlation_s)
    deviation = amplitude / 60.0 * math.sqrt(correlation_s / 2.0)
    drive = rng.standard_normal(SAMPLES) * deviation * math.sqrt(1.0 - kept**2)
    drive[0] = rng.standard_normal() * deviation
    values: FloatArray = lfilter([1.0], [1.0, -kept], drive)
    return values


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
