"""Planted noise against the Allan variances of IEEE 952, and its processes against each other."""

import math
from collections.abc import Callable

import allantools
import numpy as np
import pytest

from ingest.simulator.physics.gyro import GyroParameters, SimulatedGyro
from ingest.simulator.physics.noise import Markov, Noise
from ingest.simulator.physics.scale import Scale
from stream.batch import FloatArray

FLOOR = math.sqrt(2 * math.log(2) / math.pi)


def rate_deg_per_h(noise: Noise, n: int, interval_s: float, seed: int = 1) -> FloatArray:
    parameters = GyroParameters(
        sample_interval_ns=round(interval_s * 1e9), scale=Scale(counts_per_deg_per_s=1e7), noise=noise
    )
    gyro = SimulatedGyro(parameters, seed=seed, unit="G")
    rate: FloatArray = gyro.samples(n).counts.astype(np.float64) * (gyro.scale_deg_per_s_per_count * 3600)
    return rate


def allan_deviation(rate: FloatArray, interval_s: float, tau_s: FloatArray) -> FloatArray:
    _, deviation, _, _ = allantools.oadev(rate, rate=1 / interval_s, data_type="freq", taus=tau_s)
    found: FloatArray = deviation
    assert len(found) == len(tau_s)
    return found


def chance(tau_s: FloatArray, record_s: float) -> FloatArray:
    """Five standard deviations of an Allan deviation of at least 0.7 T/tau degrees of freedom, relative.

    0.7 T/tau is less than the overlapping estimator has for any of these noises at T > 20 tau (NIST SP 1065, table 5:
    least for random walk, (N - 2)/m ((N - 1)^2 - 3m(N - 1) + 4m^2)/(N - 3)^2 > 0.85 N/m there).
    """
    bound: FloatArray = 5 / np.sqrt(2 * 0.7 * record_s / tau_s)
    return bound


def markov_variance(sd: float, correlation_s: float, tau_s: FloatArray) -> FloatArray:
    """Allan variance of a first-order Gauss-Markov process (IEEE 952-1997 C.1.2.1)."""
    u = tau_s / correlation_s
    variance: FloatArray = 2 * sd**2 / u * (1 - (3 - 4 * np.exp(-u) + np.exp(-2 * u)) / (2 * u))
    return variance


CASES: dict[str, tuple[Noise, Callable[[FloatArray], FloatArray]]] = {
    "Q": (Noise(angle_quantum_arcsec=2.0), lambda tau: math.sqrt(3) * 2.0 / math.sqrt(12) / tau),
    "N": (Noise(angle_random_walk_deg_per_sqrt_h=0.02), lambda tau: 0.02 / np.sqrt(tau / 3600)),
    "B": (Noise(bias_instability_deg_per_h=5.0), lambda tau: FLOOR * 5.0 + 0 * tau),
    "K": (Noise(rate_random_walk_deg_per_h_per_sqrt_h=20.0), lambda tau: 20.0 * np.sqrt(tau / 3600 / 3)),
    "R": (Noise(rate_ramp_deg_per_h_per_h=-50.0), lambda tau: 50.0 * tau / 3600 / math.sqrt(2)),
    "long Markov": (
        Noise(markov=(Markov(sd_deg_per_h=3.0, correlation_s=30.0),)),
        lambda tau: np.sqrt(markov_variance(3.0, 30.0, tau)),
    ),
    "short Markov": (
        Noise(markov=(Markov(sd_deg_per_h=3.0, correlation_s=0.05),)),
        lambda tau: np.sqrt(markov_variance(3.0, 0.05, tau)),
    ),
}


@pytest.mark.parametrize("records", [1, pytest.param(4, marks=pytest.mark.long)])
@pytest.mark.parametrize("name", list(CASES))
def test_each_noise_alone_has_its_allan_curve(name: str, records: int) -> None:
    noise, curve = CASES[name]
    tau_s = np.array([0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 50.0, 100.0])
    if name == "B":
        tau_s = tau_s[1:]  # below 0.5 s the bank of processes is not flat
    n = 500_000
    squares = [allan_deviation(rate_deg_per_h(noise, n, 0.01, seed), 0.01, tau_s) ** 2 for seed in range(records)]
    measured = np.sqrt(np.mean(squares, axis=0))
    # counts of 3.6e-4 deg/h: white, a tenth of a percent at most beside the least of these; flicker within 2 %
    systematic = 0.02 if name == "B" else 0.002
    count = 3.6e-4 / math.sqrt(12) / np.sqrt(tau_s / 0.01)
    expected = curve(tau_s)
    assert (np.abs(measured / expected - 1) < systematic + chance(tau_s, records * n * 0.01) + count / expected).all()


def test_quantisation_noise_is_uniform_over_one_step_of_angle_and_never_adds_up() -> None:
    angle = np.cumsum(rate_deg_per_h(Noise(angle_quantum_arcsec=2.0), 200_000, 0.01)) * 0.01  # arcsec
    # rounding to counts walks by 3.6e-4 deg/h x 0.01 s x sqrt(n/12): 5e-4 arcsec
    assert np.ptp(angle) == pytest.approx(2.0, abs=0.01)
    # the deviation of a uniform distribution is known to sqrt((1.8 - 1)/4/n)
    assert angle.std() == pytest.approx(2.0 / math.sqrt(12), rel=5 * math.sqrt(0.2 / 200_000) + 0.002)


def test_rate_ramp_keeps_its_sign_and_begins_at_power_on() -> None:
    rate = rate_deg_per_h(Noise(rate_ramp_deg_per_h_per_h=-2.0), 3601, 1.0)
    assert rate[0] == 0.0
    assert rate[-1] == pytest.approx(-2.0, abs=3.6e-4)


def test_all_together_their_variances_add() -> None:
    parts = [
        Noise(angle_quantum_arcsec=2.0),
        Noise(angle_random_walk_deg_per_sqrt_h=0.02),
        Noise(bias_instability_deg_per_h=5.0),
        Noise(markov=(Markov(sd_deg_per_h=3.0, correlation_s=30.0),)),
    ]
    together = Noise(
        angle_quantum_arcsec=2.0,
        angle_random_walk_deg_per_sqrt_h=0.02,
        bias_instability_deg_per_h=5.0,
        markov=(Markov(sd_deg_per_h=3.0, correlation_s=30.0),),
    )
    whole = rate_deg_per_h(together, 100_000, 0.01)
    # every process draws from its own seed: alone it is what it is in company, to the rounding of five counts
    apart = np.sum([rate_deg_per_h(part, 100_000, 0.01) for part in parts], axis=0)
    assert np.abs(whole - apart).max() <= 2.5 * 3.6e-4 + 1e-9


def test_markov_noises_of_one_unit_are_independent_of_each_other() -> None:
    markov = Markov(sd_deg_per_h=3.0, correlation_s=1.0)
    one = rate_deg_per_h(Noise(markov=(markov,)), 100_000, 1.0)
    two = rate_deg_per_h(Noise(markov=(markov, markov)), 100_000, 1.0) - one
    # samples one correlation time apart: the correlation of independent ones scatters by
    # sqrt(sum of rho_k^2 / n), below sqrt(1.4/n) for means over a correlation time
    assert abs(np.corrcoef(one, two)[0, 1]) < 5 * math.sqrt(1.4 / 100_000)
    assert two.std() == pytest.approx(one.std(), rel=10 * math.sqrt(1.4 / 2 / 100_000))


def test_intervals_longer_than_the_hold_are_exact_too() -> None:
    noise = Noise(rate_random_walk_deg_per_h_per_sqrt_h=20.0, markov=(Markov(sd_deg_per_h=3.0, correlation_s=2.0),))
    tau_s = np.array([2.0, 10.0, 100.0])
    measured = allan_deviation(rate_deg_per_h(noise, 200_000, 2.0), 2.0, tau_s)
    expected = np.sqrt(20.0**2 * tau_s / 3600 / 3 + markov_variance(3.0, 2.0, tau_s))
    assert (np.abs(measured / expected - 1) < chance(tau_s, 400_000.0)).all()
