"""Bias stability against its definition, by true place in time, and the coverage of its limits."""

import math
from fractions import Fraction
from uuid import UUID

import numpy as np
import pytest
import scipy.stats

from stream.batch import FloatArray, IntArray, SampleBatch
from stream.errors import EstimatorError
from stream.estimators.base import NoEstimate
from stream.estimators.bias_stability import BiasStability
from stream.events import EstimatePoint


def push(
    estimator: BiasStability,
    values: FloatArray,
    dt_ns: int,
    times_ns: IntArray | None = None,
    irregular: bool = False,
    size: int = 777,
) -> BiasStability:
    for i in range(0, len(values), size):
        part = None if times_ns is None else times_ns[i : i + size]
        t0_ns = i * dt_ns if part is None else int(part[0])
        estimator.update(
            SampleBatch(
                "FOG-1",
                "rate",
                "r1",
                UUID(int=1),
                i,
                t0_ns,
                dt_ns,
                "deg/h",
                values=values[i : i + size],
                times_ns=part,
                irregular=irregular,
            )
        )
    return estimator


def the_point(estimator: BiasStability) -> EstimatePoint:
    points = estimator.estimate()
    assert not isinstance(points, NoEstimate), points
    return points[0]


@pytest.mark.parametrize("rate_hz", [10, 1000, Fraction(1024, 10), 3])
def test_equation_29(rate_hz: int | Fraction) -> None:
    dt_ns = round(10**9 / rate_hz)
    values = np.random.default_rng(1).standard_normal(20_000) + 30.0
    point = the_point(push(BiasStability(2.0), values, dt_ns))
    blocks = np.arange(len(values)) * dt_ns // 2_000_000_000
    last = blocks[-1] + (len(values) * dt_ns // 2_000_000_000 > blocks[-1])
    means = [values[blocks == block].mean() for block in range(last)]
    assert point.n == len(means)
    assert point.value == pytest.approx(np.std(means, ddof=1), rel=1e-12)
    assert point.tau_s == 2.0


def test_the_last_average_counts_as_soon_as_it_is_whole() -> None:
    values = np.arange(30.0)
    assert the_point(push(BiasStability(1.0), values[:20], 100_000_000)).n == 2
    assert the_point(push(BiasStability(1.0), values[:29], 100_000_000)).n == 2
    assert the_point(push(BiasStability(1.0), values, 100_000_000)).n == 3


def test_averages_with_fewer_than_nine_tenths_are_left_out() -> None:
    values = np.random.default_rng(2).standard_normal(500)
    values[103] = np.nan
    values[[205, 207]] = np.nan
    values[310:450] = np.nan
    point = the_point(push(BiasStability(1.0), values, 100_000_000))
    means = [np.nanmean(values[10 * i : 10 * i + 10]) for i in range(50) if i != 20 and not 31 <= i < 45]
    assert point.n == len(means)
    assert point.value == pytest.approx(np.std(means, ddof=1), rel=1e-12)


def test_irregular_samples_are_averaged_by_their_true_times() -> None:
    rng = np.random.default_rng(3)
    dt_ns = 100_000_000
    times_ns = np.sort(rng.integers(0, 10**11, 1200)).astype(np.int64)
    times_ns = np.unique(times_ns)
    values = rng.standard_normal(len(times_ns))
    point = the_point(push(BiasStability(5.0), values, dt_ns, times_ns, irregular=True, size=50))
    blocks = (times_ns - times_ns[0]) // 5_000_000_000
    means = [values[blocks == b].mean() for b in range(blocks[-1]) if (blocks == b).sum() >= 45]
    assert point.n == len(means)
    assert point.value == pytest.approx(np.std(means, ddof=1), rel=1e-12)


def test_a_day_of_large_offset_costs_no_digits() -> None:
    values = np.random.default_rng(4).standard_normal(100_000)
    plain = the_point(push(BiasStability(1.0), values, 100_000_000))
    shifted = the_point(push(BiasStability(1.0), values + 2.0**30, 100_000_000))
    assert shifted.value == pytest.approx(plain.value, rel=1e-5)


def test_too_short_averages_and_too_little_data_give_reasons() -> None:
    estimate = push(BiasStability(0.05), np.zeros(100), 100_000_000).estimate()
    assert estimate == NoEstimate(
        "unit FOG-1, signal rate: averages of 0.05 s are shorter than the sample interval of 0.1 s"
    )
    assert push(BiasStability(1.0), np.zeros(19), 100_000_000).estimate() == NoEstimate(
        "2 averages of 1 s needed, 1 seen"
    )
    for average_s in (1e-10, -1.0, math.nan, math.inf):
        with pytest.raises(EstimatorError, match="averages of"):
            BiasStability(average_s)


def test_an_average_of_one_sample_is_the_standard_deviation_of_the_samples() -> None:
    values = np.random.default_rng(5).standard_normal(1000)
    point = the_point(push(BiasStability(0.01), values, 10_000_000))
    assert point.value == pytest.approx(np.std(values, ddof=1), rel=1e-12)
    assert point.n == 1000


def test_the_key_tells_the_averaging_time() -> None:
    assert [BiasStability(p).key for p in (1.0, 10, 0.5)] == [
        "bias_stability_1s",
        "bias_stability_10s",
        "bias_stability_0.5s",
    ]


def test_constant_input_is_a_deviation_of_zero() -> None:
    point = the_point(push(BiasStability(1.0), np.full(500, 7.3), 100_000_000))
    assert (point.value, point.lo, point.hi, point.edf, point.n) == (0.0, 0.0, 0.0, 49.0, 50)


def test_only_neighbouring_averages_are_taken_for_the_correlation() -> None:
    rng = np.random.default_rng(7)
    values = np.convolve(rng.standard_normal(402), np.ones(3), "valid")
    values[rng.random(400) < 0.3] = np.nan
    point = the_point(push(BiasStability(1.0), values, 10**9))
    is_pair = np.isfinite(values[:-1]) & np.isfinite(values[1:])
    r = np.corrcoef(values[:-1][is_pair], values[1:][is_pair])[0, 1]
    assert point.edf == pytest.approx((point.n - 1) * (1 - r**2) / (1 + r**2), rel=1e-9)
    assert point.edf < 0.8 * point.n


@pytest.mark.long
@pytest.mark.parametrize("correlation", [0.0, 0.5])
def test_limits_cover_the_true_deviation(correlation: float) -> None:
    """A first-order process of 200 averages has a known deviation; the limits must hold it as often as they say.

    The degrees of freedom use an estimated correlation and, where neighbours correlate, a chi-square that is only
    about right: 2 % are granted for that, the rest is the binomial bound.
    """
    rng = np.random.default_rng(6)
    trials, n = 1000, 200
    held = 0
    for _ in range(trials):
        noise = rng.standard_normal(n + 100)
        values = np.empty_like(noise)
        last = 0.0
        for i, shock in enumerate(noise.tolist()):
            last = correlation * last + math.sqrt(1 - correlation**2) * shock
            values[i] = last
        point = the_point(push(BiasStability(1.0), values[100:], 10**9))
        held += point.lo <= 1.0 <= point.hi
    assert scipy.stats.binom.ppf(5e-4, trials, 0.93) <= held <= scipy.stats.binom.ppf(1 - 5e-4, trials, 0.97), held


def of_window(means: FloatArray) -> tuple[int, float, float]:
    """Count, deviation and Bartlett's degrees of freedom of averages, NaN where there is none; by definition."""
    held = means[np.isfinite(means)]
    is_pair = np.isfinite(means[:-1]) & np.isfinite(means[1:])
    r = float(np.corrcoef(means[:-1][is_pair], means[1:][is_pair])[0, 1])
    return len(held), float(held.std(ddof=1)), min(len(held) - 1.0, (len(held) - 1) * (1 - r * r) / (1 + r * r))


def test_raw_samples_are_gjb_equation_20() -> None:
    values = np.random.default_rng(8).standard_normal(5000) + np.sin(np.arange(5000) / 50.0) + 1e6
    values[[700, 1500, 1501, 4999]] = np.nan
    point = the_point(push(BiasStability(0.0), values, 1_000_000))
    n, deviation, degrees = of_window(values)
    assert (point.n, point.tau_s) == (n, 0.001)
    assert (point.value, point.edf) == pytest.approx((deviation, degrees), rel=1e-9)


def test_raw_samples_on_no_grid_are_each_taken_once() -> None:
    times_ns = np.cumsum(np.random.default_rng(1).integers(1, 3_000_000, 4000)).astype(np.int64)
    values = np.random.default_rng(2).standard_normal(4000)
    point = the_point(push(BiasStability(0.0), values, 1_000_000, times_ns, irregular=True))
    assert point.n == 4000
    assert point.value == pytest.approx(values.std(ddof=1), rel=1e-12)


@pytest.mark.parametrize("gap", [0, 3, 700])
def test_a_rolling_window_is_that_of_its_averages_alone(gap: int) -> None:
    values = np.random.default_rng(3).standard_normal(20_000).cumsum() * 0.01 + 40.0
    values[500] = 1e9  # long gone
    values[12_000 : 12_000 + gap] = np.nan
    estimator = BiasStability(2.0, window_s=300.0)
    for stop in (4000, 13_000, 20_000 - 5):
        point = the_point(push(BiasStability(2.0, window_s=300.0), values[:stop], 100_000_000))
        whole = stop // 20
        blocks = values[(whole - 150) * 20 : whole * 20].reshape(150, 20)
        missing = np.isnan(blocks).sum(axis=1)
        means = np.where(missing <= 2, np.nanmean(np.where(missing[:, None] <= 2, blocks, 0.0), axis=1), np.nan)
        n, deviation, degrees = of_window(means)
        assert point.n == n
        assert (point.value, point.edf) == pytest.approx((deviation, degrees), rel=1e-9)
    assert estimator.estimate() == NoEstimate("2 averages of 2 s needed within 300 s, 0 seen")


def test_a_window_that_its_averages_do_not_fill_is_refused() -> None:
    for average_s, window_s in ((10.0, 10.0), (10.0, 105.0), (0.0, 100.0), (1.0, 1e7), (1.0, -5.0), (1.0, math.nan)):
        with pytest.raises(EstimatorError, match="a whole number of averages, 2 to 1,000,000"):
            BiasStability(average_s, window_s)
