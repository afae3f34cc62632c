"""Bandwidth, delay, dead zone and readout of a simulated gyro, each alone."""

import math
from typing import Any

import numpy as np
import pytest

from ingest.simulator.physics.bias import Bias
from ingest.simulator.physics.environment import Environment, PiecewiseEnvironment, StaticEnvironment
from ingest.simulator.physics.gyro import GyroParameters, SimulatedGyro
from ingest.simulator.physics.noise import Noise
from ingest.simulator.physics.readout import Readout, ReadoutFault, Samples, StartUp
from ingest.simulator.physics.scale import Scale
from ingest.simulator.physics.sensing import DeadZone, Dynamics
from stream.batch import BoolArray, FloatArray, IntArray

INTERVAL_NS = 1_000_000


class Vibration(StaticEnvironment):
    """A sine of the rate, begun long before power-on."""

    def __init__(self, hz: float) -> None:
        super().__init__()
        self._hz = hz

    def rates_deg_per_s(self, t_ns: IntArray) -> FloatArray:
        rate = 10 * np.sin(2 * np.pi * self._hz * t_ns * 1e-9)
        return np.stack([rate, 0 * rate, 0 * rate])


def samples(n: int, environment: Environment | None = None, counts: float = 1e7, **given: Any) -> Samples:
    interval_ns = given.pop("interval_ns", INTERVAL_NS)
    parameters = GyroParameters(sample_interval_ns=interval_ns, scale=Scale(counts_per_deg_per_s=counts), **given)
    return SimulatedGyro(parameters, seed=3, unit="G", environment=environment).samples(n)


def rate_deg_per_s(n: int, environment: Environment | None = None, **given: Any) -> FloatArray:
    rate: FloatArray = samples(n, environment, **given).counts.astype(np.float64) * 1e-7
    return rate


def response(hz: float, dynamics: Dynamics, n: int = 4000) -> complex:
    """Gain and phase of the output to a sine, from the second half of a record: the first has died away."""
    out = rate_deg_per_s(n, Vibration(hz), dynamics=dynamics)[n // 2 :]
    phase = 2 * np.pi * hz * np.arange(n // 2, n) * INTERVAL_NS * 1e-9
    a, b = np.linalg.lstsq(np.stack([np.sin(phase), np.cos(phase)], axis=1), out, rcond=None)[0]
    return complex(a, b) / 10


@pytest.mark.long
@pytest.mark.parametrize("damping", [0.4, math.sqrt(0.5), 1.3])
@pytest.mark.parametrize("hz", [1.0, 10.0, 25.0, 50.0, 100.0])
def test_bandwidth_is_a_second_order_low_pass(hz: float, damping: float) -> None:
    dynamics = Dynamics(bandwidth_hz=50.0, damping=damping)
    # the frequency at which H = 1/(1 - x^2 + 2 i zeta x) has the gain 1/sqrt(2), by bisection
    low, high = 0.0, 10.0
    for _ in range(80):
        middle = (low + high) / 2
        low, high = (
            (middle, high) if abs(1 / (1 - middle**2 + 2j * damping * middle)) > math.sqrt(0.5) else (low, middle)
        )
    x = low * hz / 50.0
    expected = 1 / (1 - x**2 + 2j * damping * x)
    # the parabola between samples: (2 pi f h)^4/960 and the next even order; counts of 1e-7 of 10 deg/s beside it
    u = 2 * math.pi * hz * 1e-3
    bound = u**4 / 960 * (1 + u**2 / 4) + 1e-7
    assert abs(response(hz, dynamics) / expected - 1) < bound
    if hz == 50.0:
        assert abs(expected) == pytest.approx(math.sqrt(0.5))


@pytest.mark.parametrize("delay_s", [0.00037, 0.001, 0.01234])
def test_delay_is_exact_for_any_fraction_of_a_sample(delay_s: float) -> None:
    for hz in (1.0, 37.0, 200.0):
        found = response(hz, Dynamics(delay_s=delay_s))
        expected = np.exp(-2j * math.pi * hz * delay_s)
        assert abs(found - expected) < 1e-7


def test_before_a_delay_has_passed_the_rate_at_power_on_holds() -> None:
    ramp = PiecewiseEnvironment([-1, 1], rates_deg_per_s=[(-10, 0, 0), (10, 0, 0)])
    out = rate_deg_per_s(10, ramp, dynamics=Dynamics(delay_s=0.0045))
    assert out == pytest.approx([0, 0, 0, 0, 0, 0.005, 0.015, 0.025, 0.035, 0.045], abs=1e-7)


def test_low_pass_begins_in_steady_state_and_has_no_gain_error_at_rest() -> None:
    still = StaticEnvironment(rates_deg_per_s=(33.0, 0, 0))
    out = rate_deg_per_s(20_000, still, dynamics=Dynamics(bandwidth_hz=300.0, damping=0.3, delay_s=0.0002))
    assert out == pytest.approx(33.0, abs=1e-7)


def test_a_delay_and_a_bandwidth_leave_the_bias_where_it_is() -> None:
    out = rate_deg_per_s(100, dynamics=Dynamics(bandwidth_hz=1.0, delay_s=0.5), bias=Bias(constant_deg_per_h=3.6))
    assert out == pytest.approx(0.001, abs=1e-7)


@pytest.mark.parametrize("beyond", ["full", "offset", "lock_in"])
def test_dead_zone(beyond: Any) -> None:
    rates = np.linspace(-5, 5, 1001)  # deg/h
    environment = PiecewiseEnvironment(
        (np.arange(1001) * 1e-3).tolist(), rates_deg_per_s=[(rate / 3600, 0, 0) for rate in rates]
    )
    zone = DeadZone(threshold_deg_per_h=2.0, slope=0.25, beyond=beyond)
    bias = Bias(constant_deg_per_h=100.0)  # it does not move the zone
    out = samples(1001, environment, counts=1e9, dynamics=Dynamics(dead_zone=zone), bias=bias).counts * 3600e-9 - 100
    inside = np.abs(rates) < 2.0 - 1e-9
    assert out[inside] == pytest.approx(0.25 * rates[inside], abs=2e-6)
    outside = rates[np.abs(rates) > 2.0 + 1e-9]
    expected = {
        "full": outside,
        "offset": outside - 1.5 * np.sign(outside),
        "lock_in": np.sign(outside) * np.sqrt(outside**2 - 4.0 * (1 - 0.0625)),
    }
    assert out[np.abs(rates) > 2.0 + 1e-9] == pytest.approx(expected[beyond], abs=2e-6)


def test_saturation_and_the_ends_of_int32() -> None:
    environment = PiecewiseEnvironment([0.0, 1.0], rates_deg_per_s=[(-500, 0, 0), (500, 0, 0)])
    rates = np.linspace(-500, 500, 1001)
    out = samples(1001, environment, counts=1000.0, readout=Readout(saturation_deg_per_s=300.5)).counts
    assert np.array_equal(out, np.rint(np.clip(rates, -300.5, 300.5) * 1000))
    out = samples(1001, environment, counts=1e8).counts
    assert (out.min(), out.max()) == (-(2**31), 2**31 - 1)
    assert samples(1, StaticEnvironment(rates_deg_per_s=(1e300, 0, 0)), counts=1e8).counts[0] == 2**31 - 1


def test_resolution_rounds_to_the_nearest_multiple() -> None:
    environment = PiecewiseEnvironment([0.0, 1.0], rates_deg_per_s=[(-0.1, 0, 0), (0.1, 0, 0)])
    rates = np.linspace(-0.1, 0.1, 1001)
    out = samples(1001, environment, counts=1000.0, readout=Readout(resolution_counts=8)).counts
    assert set(np.unique(out)) <= set(range(-104, 105, 8))
    assert np.abs(out - rates * 1000).max() <= 4 + 1e-9


def test_a_carried_rest_keeps_the_sum_of_the_counts_at_the_angle() -> None:
    still = StaticEnvironment(rates_deg_per_s=(0.00037, 0, 0))  # 0.37 counts
    assert not samples(1000, still, counts=1000.0).counts.any()
    out = samples(1000, still, counts=1000.0, readout=Readout(carries_rest=True)).counts
    assert np.abs(np.cumsum(out) - 0.37 * np.arange(1, 1001)).max() <= 0.5 + 1e-9


def lengths(mask: BoolArray) -> tuple[IntArray, IntArray]:
    """Lengths of the stretches of True and of those of False, without the first and the last."""
    edges = np.flatnonzero(np.diff(mask.astype(np.int8)))
    runs = np.diff(edges)
    begins_true = bool(mask[edges[0] + 1])
    return runs[0 if begins_true else 1 :: 2], runs[1 if begins_true else 0 :: 2]


def test_dropouts_have_their_probability_and_length() -> None:
    n, p, mean = 1_000_000, 0.002, 5.0
    given = samples(n, readout=Readout(dropout=ReadoutFault(probability=p, mean_samples=mean)))
    lost, kept = lengths(~given.present)
    # a stretch that follows another at once is one with it: the chance of that is p
    assert np.mean(lost) == pytest.approx(mean / (1 - p), rel=5 / math.sqrt(len(lost)))
    assert np.mean(kept) == pytest.approx(1 / p, rel=5 / math.sqrt(len(kept)))
    # of geometric lengths sd^2 = mean^2 - mean
    assert np.std(lost) == pytest.approx(math.sqrt(mean**2 - mean), rel=5 * math.sqrt(2 / len(lost)))
    assert not given.counts.any()


def test_stuck_values_repeat_the_one_before() -> None:
    noise = Noise(angle_random_walk_deg_per_sqrt_h=1.0)
    moving = samples(200_000, noise=noise).counts
    stuck = samples(
        200_000, noise=noise, readout=Readout(stuck=ReadoutFault(probability=0.001, mean_samples=20.0))
    ).counts
    differs = np.flatnonzero(stuck != moving)
    assert len(differs) == pytest.approx(200_000 * 0.02 / 1.02, rel=5 * math.sqrt(2 / 200))
    begin = differs[np.flatnonzero(np.diff(differs, prepend=-2) > 1)]
    for i in begin[begin > 0]:
        assert stuck[i] == stuck[i - 1]
    assert (np.diff(stuck)[differs[differs > 0] - 1] == 0).all()


def test_start_up_is_a_fixed_word_and_then_a_transient() -> None:
    start_up = StartUp(invalid_s=0.05, invalid_counts=-7, transient_deg_per_s=5.0, time_constant_s=0.02)
    given = samples(300, StaticEnvironment(rates_deg_per_s=(1.0, 0, 0)), start_up=start_up)
    assert (given.counts[:50] == -7).all()
    assert not given.ready[:50].any()
    assert given.ready[50:].all()
    expected = 1 + 5.0 * np.exp(-np.arange(250) * 1e-3 / 0.02)
    assert given.counts[50:] * 1e-7 == pytest.approx(expected, abs=1e-7)
