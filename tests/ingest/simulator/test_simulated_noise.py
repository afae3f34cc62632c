"""Noise of the simulated gyro against theory, also where it is held for a tenth of a second."""

import math

import allantools
import numpy as np
import pytest
import scipy.linalg

from ingest.simulator.physics.noise import GaussMarkovSum, Noise, flicker_noise, rate_random_walk
from stream.batch import FloatArray
from tests.ingest.simulator.simulated_gyros import FINE, of_scale, rate_deg_per_h

FLOOR = math.sqrt(2 * math.log(2) / math.pi)


def allan_deviation(rate: FloatArray, interval_s: float, tau_s: FloatArray) -> FloatArray:
    _, deviation, _, _ = allantools.oadev(rate, rate=1 / interval_s, data_type="freq", taus=tau_s)
    found: FloatArray = deviation
    assert len(found) == len(tau_s)
    return found


def chance(tau_s: FloatArray, record_s: float) -> FloatArray:
    """Five standard deviations of an Allan deviation with at least 0.7 T/tau degrees of freedom, relative."""
    bound: FloatArray = 5 / np.sqrt(2 * 0.7 * record_s / tau_s)
    return bound


def test_white_noise_alone_has_the_slope_of_angle_random_walk() -> None:
    gyro = of_scale(1e-7, noise=Noise(angle_random_walk_deg_per_sqrt_h=0.02))
    tau_s = np.array([0.005, 0.1, 1.0, 10.0, 100.0])
    measured = allan_deviation(rate_deg_per_h(gyro, 2_000_000, seed=11), 0.005, tau_s)
    expected = 0.02 / np.sqrt(tau_s / 3600)
    assert (np.abs(measured / expected - 1) < chance(tau_s, 10_000.0)).all()


def test_flicker_alone_is_flat_at_0_664_b_over_two_decades() -> None:
    gyro = of_scale(FINE * 100, noise=Noise(bias_instability_deg_per_h=5.0))
    tau_s = np.array([1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0])
    records = [allan_deviation(rate_deg_per_h(gyro, 1_000_000, seed), 0.005, tau_s) for seed in range(20, 24)]
    measured = np.sqrt(np.mean(np.square(records), axis=0))
    assert (np.abs(measured / (FLOOR * 5.0) - 1) < np.minimum(0.1, 0.01 + chance(tau_s, 20_000.0))).all()


def test_flicker_bank_is_flat_in_theory_from_half_a_second_to_a_day() -> None:
    bank = flicker_noise(1.0, 0.1, np.random.default_rng(0))
    variances = (bank._kick**2) / (1 - bank._decay**2)
    correlation_s = -0.1 / np.log(bank._decay)
    for tau_s in np.geomspace(0.5, 1e5, 60):
        u = tau_s / correlation_s
        # the series where the difference loses its digits: AVAR = (2/3) u
        shape = np.where(u < 1e-4, 2 / 3 * u, (2 * u - 3 + 4 * np.exp(-u) - np.exp(-2 * u)) / u**2)
        assert math.sqrt(float(np.sum(variances * shape))) == pytest.approx(FLOOR, rel=0.02)


def test_rate_random_walk_alone_has_the_slope_of_rate_random_walk() -> None:
    gyro = of_scale(1e-7, noise=Noise(rate_random_walk_deg_per_h_per_sqrt_h=2.0), sample_interval_ns=10**9)
    tau_s = np.array([1.0, 10.0, 100.0, 1000.0, 10_000.0])
    measured = allan_deviation(rate_deg_per_h(gyro, 1_000_000, seed=5), 1.0, tau_s)
    # means over a second of a random walk: at tau equal to the interval the formula still holds exactly
    expected = 2.0 * np.sqrt(tau_s / 3600 / 3)
    assert (np.abs(measured / expected - 1) < chance(tau_s, 1e6)).all()


def held_covariance(process: GaussMarkovSum, n: int) -> FloatArray:
    """Exact covariance of n + 1 interval means of stationary processes, lag by lag."""
    a, w = process._decay, process._weight
    v = process._kick**2 / (1 - a**2)
    lag = np.arange(1, n + 1)[:, None]
    tail = np.sum(w**2 * v * (1 + a) ** 2 * a ** (lag - 1), axis=1)
    head = float(np.sum(2 * w**2 * v * (1 + a))) + process._scatter**2
    return np.concatenate([[head], tail])


@pytest.mark.parametrize("samples", [200, 201, 205, 210, 219, 310, 410])
def test_holding_for_a_tenth_of_a_second_disturbs_flicker_by_less_than_2_percent(samples: int) -> None:
    hold = 20
    process = flicker_noise(1.0, 0.1, np.random.default_rng(0))
    n = 2 * samples // hold + 2
    covariance = scipy.linalg.toeplitz(held_covariance(process, n))
    variances = []
    for phase in range(hold):
        interval = (phase + np.arange(2 * samples)) // hold
        signs = np.repeat([-1.0, 1.0], samples) / samples
        weights = np.bincount(interval, signs, minlength=n + 1)
        variances.append(weights @ covariance @ weights / 2)
    u = samples * 0.005 / (-0.1 / np.log(process._decay))
    v = process._kick**2 / (1 - process._decay**2)
    shape = np.where(u < 1e-4, 2 / 3 * u, (2 * u - 3 + 4 * np.exp(-u) - np.exp(-2 * u)) / u**2)
    exact = float(np.sum(v * shape))
    assert math.sqrt(float(np.mean(variances)) / exact) == pytest.approx(1, abs=0.02)
    if samples % hold == 0:
        assert math.sqrt(variances[0] / exact) == pytest.approx(1, abs=1e-6)


@pytest.mark.long
def test_holding_disturbs_rate_random_walk_by_less_than_2_percent() -> None:
    process = rate_random_walk(1.0, 0.1, np.random.default_rng(3))
    means = np.repeat(process.means(200_000), 20)
    tau_s = np.array([1.0, 1.025, 1.05, 1.5])
    measured = allan_deviation(means, 0.005, tau_s)
    expected = np.sqrt(tau_s / 3600 / 3)
    assert (np.abs(measured / expected - 1) < 0.02 + chance(tau_s, 20_000.0)).all()
