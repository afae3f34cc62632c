"""Changes of level: found, sized and dated with intervals that cover, and seldom seen in noise that wanders."""

import itertools

import numpy as np
import pytest
from scipy.stats import binom

from analytics.trends.levels.change_points import Changes, change_points
from analytics.trends.levels.change_search import LEAST_SEGMENT, ChangeSearch
from analytics.trends.levels.divisions import divisions
from analytics.trends.wander import NOISES, Noise, products, reduced, simulated
from analytics.trends.words import NotComputed


def _found(values: np.ndarray, false_alarm: float = 0.01) -> Changes:
    found = change_points(values, false_alarm=false_alarm)
    assert isinstance(found, Changes)
    return found


def _covariance(noise: Noise, n: int) -> np.ndarray:
    at = np.arange(n)
    wander = noise.correlation ** np.abs(at[:, None] - at[None, :])
    return np.asarray(noise.share * wander + (1 - noise.share) * np.eye(n))


def test_products_are_those_of_the_covariance() -> None:
    """The filter's products against the inverse of the matrix, with each noise."""
    n = 17
    series = np.random.default_rng(20261128).standard_normal((3, n))
    steps = np.tri(n).T
    found = products(series)
    for number, noise in enumerate(NOISES):
        covariance = _covariance(noise, n)
        inverse = np.linalg.inv(covariance)
        np.testing.assert_allclose(found.among[number], series @ inverse @ series.T, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(found.steps[number], series @ inverse @ steps.T, rtol=1e-9, atol=1e-8)
        np.testing.assert_allclose(found.norms[number], np.diag(steps @ inverse @ steps.T), rtol=1e-9)
        assert found.log_root[number] == pytest.approx(-0.5 * np.linalg.slogdet(covariance)[1], abs=1e-10)


def test_evidence_is_that_of_direct_fits() -> None:
    """A step and a pair beside a known change, against least squares with the matrix."""
    n = 24
    values = np.random.default_rng(20261129).standard_normal(n)
    known = np.vstack([np.ones(n), np.arange(n) >= 8])
    found = reduced(values, known)
    for number in (0, 7, len(NOISES) - 1):
        inverse = np.linalg.inv(_covariance(NOISES[number], n))

        def squares(columns: np.ndarray, inverse: np.ndarray = inverse) -> tuple[float, float]:
            normal = columns @ inverse @ columns.T
            left = values - np.linalg.solve(normal, columns @ inverse @ values) @ columns
            return float(left @ inverse @ left), float(np.linalg.slogdet(normal)[1])

        before, root = squares(known)
        after, with_step = squares(np.vstack([known, np.arange(n) >= 15]))
        gained = found.with_steps()[number, 15] - found.log_likelihood[number]
        freedom = n - 2
        direct = -0.5 * (with_step - root - np.log(freedom)) - 0.5 * freedom * np.log(after / before)
        assert gained == pytest.approx(direct, abs=1e-8)


@pytest.mark.long
@pytest.mark.parametrize("series", [300, 1000])
@pytest.mark.parametrize(
    ("n", "correlation", "share"),
    [(12, 0.8, 1.0), (30, 0.0, 1.0), (30, 0.4, 1.0), (30, 0.8, 1.0), (90, 0.6, 1.0), (90, 0.8, 1.0), (90, 0.8, 0.7)],
)
def test_noise_that_wanders_shows_a_change_in_few_series(n: int, correlation: float, share: float, series: int) -> None:
    rng = np.random.default_rng([20261130, n, round(10 * correlation), round(10 * share)])
    alarms = sum(bool(_found(each).points) for each in simulated(Noise(correlation, share), series, n, rng))
    assert alarms <= binom.isf(0.001 / 7, series, 0.015)


@pytest.mark.long
@pytest.mark.parametrize("series", [200, pytest.param(800, marks=pytest.mark.long)])
def test_a_dearer_price_makes_alarms_rarer(series: int) -> None:
    noise = simulated(Noise(0.8, 1.0), series, 30, np.random.default_rng(20260712))
    often = sum(bool(_found(each, 0.1).points) for each in noise)
    assert often <= binom.isf(0.001, series, 0.15)
    assert often >= binom.ppf(0.001, series, 0.04)  # it is not idle either


@pytest.mark.in_gate("30-0.0-0.5-40", "90-0.8-0.8-20")
@pytest.mark.parametrize("series", [20, 40, 50, 100, 200])
@pytest.mark.parametrize(
    ("n", "correlation", "least"), [(30, 0.0, 0.5), (30, 0.8, 0.7), (90, 0.0, 0.95), (90, 0.8, 0.8)]
)
def test_a_step_of_three_sigma_is_found(n: int, correlation: float, least: float, series: int) -> None:
    rng = np.random.default_rng([20261201, n, round(10 * correlation)])
    noise = simulated(Noise(correlation, 1.0), series, n, rng)
    found = sum(bool(_found(each + 3.0 * (np.arange(n) >= n // 2)).points) for each in noise)
    assert found >= binom.ppf(0.001 / 4, series, least)


@pytest.mark.long
@pytest.mark.parametrize("series", [35, pytest.param(100, marks=pytest.mark.long)])
def test_a_bump_that_returns_is_two_changes(series: int) -> None:
    rng = np.random.default_rng(20261202)
    bump = 4.0 * ((np.arange(90) >= 30) & (np.arange(90) < 60))
    found = [_found(rng.standard_normal(90) + bump) for _ in range(series)]
    moments = [tuple(point.at for point in each.points) for each in found]
    both = sum(len(each) == 2 and abs(each[0] - 30) <= 2 and abs(each[1] - 60) <= 2 for each in moments)
    assert both >= 0.97 * series


@pytest.mark.long
def test_changes_of_many_levels_are_found_in_a_long_series() -> None:
    values = np.random.default_rng(20261203).standard_normal(5000) + np.repeat([0.0, 1.0, 0.0, 2.0, 3.0], 1000)
    found = _found(values)
    assert [round(each.at / 1000) * 1000 for each in found.points] == [1000, 2000, 3000, 4000]
    assert all(each.lo < size < each.hi for each, size in zip(found.points, (1, -1, 2, 1), strict=True))


@pytest.mark.long
@pytest.mark.parametrize("series", [100, 400])
@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_moment_and_size_of_a_change_are_covered(correlation: float, series: int) -> None:
    rng = np.random.default_rng([20260714, round(10 * correlation)])
    seen = moments = sizes = 0
    for noise in simulated(Noise(correlation, 1.0), series, 60, rng):
        found = _found(noise + 4.0 * (np.arange(60) >= 35))
        if len(found.points) == 1:
            (point,) = found.points
            seen += 1
            moments += point.first <= 35 <= point.last
            sizes += point.lo <= 4.0 <= point.hi
    assert seen >= 0.9 * series
    for covered in (moments, sizes):
        assert covered >= binom.ppf(0.001 / 4, seen, 0.92)


def test_segments_keep_their_least_length() -> None:
    values = np.random.default_rng(20260713).standard_normal(40) + np.repeat([0.0, 6.0, -3.0, 4.0], 10)
    edges = [0, *(each.at for each in _found(values).points), 40]
    assert len(edges) == 5
    assert min(np.diff(edges)) >= LEAST_SEGMENT
    assert ChangeSearch(np.arange(12.0), (4, 8)).one() is None


@pytest.mark.long
@pytest.mark.parametrize("series", [100, pytest.param(300, marks=pytest.mark.long)])
def test_wild_points_are_no_change(series: int) -> None:
    rng = np.random.default_rng(20260715)
    alarms = 0
    for _ in range(series):
        values = rng.standard_normal(80)
        values[[17, 55]] += 25.0
        alarms += bool(_found(values).points)
    assert alarms <= binom.isf(0.001, series, 0.02)


def test_a_drift_is_no_staircase() -> None:
    values = 0.05 * np.arange(100) + np.random.default_rng(20260716).standard_normal(100)
    assert not _found(values).points


def test_constant_and_short_series() -> None:
    assert not _found(np.full(40, 3.5)).points
    short = change_points(np.zeros(11))
    assert isinstance(short, NotComputed)
    assert "11 points" in short.why.en


def test_units_of_measure_do_not_matter() -> None:
    rng = np.random.default_rng(20260717)
    values = rng.standard_normal(50) + np.repeat([0.0, 4.0], 25)
    plain, large = _found(values), _found(values * 1e6 + 1e9)
    assert plain.points
    assert [each.at for each in plain.points] == [each.at for each in large.points]
    assert large.points[0].size == pytest.approx(plain.points[0].size * 1e6, rel=1e-6)


def test_the_best_division_is_found() -> None:
    """Against all divisions there are."""
    rng = np.random.default_rng(20260713)
    for _ in range(20):
        values = rng.standard_normal(18) + np.repeat([0.0, 4.0, -2.0], 6)
        best = min(
            (sum(((part - part.mean()) ** 2).sum() for part in np.split(values, cut)), cut)
            for cut in itertools.combinations(range(1, 18), 2)
            if min(np.diff([0, *cut, 18])) >= LEAST_SEGMENT
        )
        assert divisions(values, 2)[1] == best[1]
