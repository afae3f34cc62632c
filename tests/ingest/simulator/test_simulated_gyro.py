"""The simulated gyro: its counts, batches and power-ons; neither length nor blocks change anything."""

import math
import tracemalloc
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ingest.simulator.demo_fleet import demo_fleet
from ingest.simulator.physics.bias import Bias, WarmUp
from ingest.simulator.physics.environment import PiecewiseEnvironment
from ingest.simulator.physics.gyro import GyroParameters, SimulatedGyro
from ingest.simulator.physics.mounting import ChamberParameters
from ingest.simulator.physics.noise import Noise
from ingest.simulator.physics.plan import Plan
from ingest.simulator.physics.scale import Scale
from ingest.simulator.physics.thermal import TemperatureRate, Thermal
from ingest.simulator.station import PowerCycle, SimulatedStation
from stream.batch import SampleBatch
from stream.errors import BadInput
from tests.ingest.simulator.simulated_gyros import FINE, STILL, of_scale, powered, rate_deg_per_h

LIVELY = GyroParameters(
    hold_s=0.1,
    noise=Noise(
        angle_random_walk_deg_per_sqrt_h=0.02, bias_instability_deg_per_h=0.1, rate_random_walk_deg_per_h_per_sqrt_h=0.1
    ),
    bias=Bias(turn_on_deg_per_h=1.0, warm_up=(WarmUp(amplitude_deg_per_h=3.0, time_constant_s=300.0),)),
    thermal=Thermal(bias_polynomial_deg_per_h=(0.5,)),
)
WHITE = GyroParameters(hold_s=0.1, noise=Noise(angle_random_walk_deg_per_sqrt_h=0.02))


def sent(parameters: GyroParameters, duration_s: float, seed: int, run: str = "r1") -> list[SampleBatch]:
    station = SimulatedStation(Plan(seed, {"FOG-1": parameters}), run, batch=1000, temperature_batch=60)
    return list(station.batches(run, PowerCycle(0, 10**18), 10**18 + round(duration_s * 1e9)))


@settings(max_examples=25, deadline=None)
@given(
    blocks=st.lists(st.integers(0, 30_000), min_size=1, max_size=8),
    seconds=st.lists(st.integers(0, 300), min_size=1, max_size=5),
    temperature_first=st.booleans(),
)
def test_counts_do_not_depend_on_the_sizes_of_the_blocks(
    blocks: list[int], seconds: list[int], temperature_first: bool
) -> None:
    whole, parts = powered(LIVELY, seed=7), powered(LIVELY, seed=7)
    temperature = [parts.temperature_counts(n) for n in seconds] if temperature_first else []
    rate = [parts.rate_counts(n) for n in blocks]
    temperature = temperature or [parts.temperature_counts(n) for n in seconds]
    assert np.array_equal(np.concatenate(rate), whole.rate_counts(sum(blocks)))
    assert np.array_equal(np.concatenate(temperature), whole.temperature_counts(sum(seconds)))


def test_seeds_and_units_give_other_noise_and_the_same_ones_the_same() -> None:
    counts = {
        (unit, seed): powered(WHITE, seed, unit=unit).rate_counts(20_000)
        for unit in ("FOG-1", "FOG-2")
        for seed in (0, 1)
    }
    correlation = np.corrcoef(list(counts.values()))
    assert np.abs(correlation - np.eye(4)).max() < 5 / math.sqrt(20_000)
    assert np.array_equal(powered(WHITE, 1).rate_counts(20_000), counts["FOG-1", 1])


@pytest.mark.long
def test_memory_stays_bounded() -> None:
    gyro = powered(LIVELY)
    gyro.rate_counts(1000)
    tracemalloc.start()
    try:
        for _ in range(3000):
            gyro.rate_counts(1000)
        current, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 1_000_000
    assert current < 200_000


def test_bias_follows_temperature_and_warm_up() -> None:
    warm_up = WarmUp(amplitude_deg_per_h=3.0, time_constant_s=200.0)
    gyro = of_scale(
        FINE, bias=Bias(constant_deg_per_h=2.0, warm_up=(warm_up,)), thermal=Thermal(bias_polynomial_deg_per_h=(0.5,))
    )
    chamber = ChamberParameters(draught_deg_c=0.5, draught_correlation_s=30.0, thermometer_noise_deg_c=0.0)
    simulated = powered(gyro, 3, chamber)
    rate = simulated.rate_counts(200 * 600).reshape(600, 200).mean(axis=1) * FINE * 3600
    reading = simulated.temperature_counts(601) * 0.01
    middle_s = 199 / 2 * 0.005  # of the samples of a second
    seconds = np.arange(600) + middle_s
    felt = reading[:-1] + middle_s * (reading[1:] - reading[:-1])
    expected = 2.0 + 0.5 * (felt - 25) + 3.0 * np.exp(-seconds / 200)
    assert np.abs(rate - expected).max() < 0.5 * 0.005 + 1e-4


@pytest.mark.long
def test_turn_on_bias_scatters_as_declared() -> None:
    gyro = of_scale(FINE, bias=Bias(turn_on_deg_per_h=2.0))
    bias = [rate_deg_per_h(gyro, 1, seed)[0] for seed in range(300)]
    assert np.std(bias, ddof=1) == pytest.approx(2.0, rel=5 / math.sqrt(2 * 299))


def test_thermometer_noise_and_draught_scatter_as_declared() -> None:
    chamber = ChamberParameters(
        start_offset_deg_c=0, daily_amplitude_deg_c=0, draught_deg_c=0, thermometer_noise_deg_c=0.05
    )
    counts = powered(LIVELY, 2, chamber).temperature_counts(20_000)
    assert counts.dtype == np.int32
    assert (counts * 0.01).std() == pytest.approx(math.hypot(0.05, 0.01 / math.sqrt(12)), rel=5 / math.sqrt(40_000))
    assert (counts * 0.01).mean() == pytest.approx(25.5, abs=5 * 0.05 / math.sqrt(20_000))


def test_rates_are_rounded_to_the_nearest_count_and_stop_at_the_ends_of_int32() -> None:
    for bias, count in ((1.6, 2), (-1.6, -2), (0.4, 0), (1e15, 2**31 - 1), (-1e15, -(2**31))):
        gyro = of_scale(1 / 3600, bias=Bias(constant_deg_per_h=bias))
        assert powered(gyro, 0, STILL).rate_counts(3).tolist() == [count] * 3


def test_batches_are_numbered_and_in_order() -> None:
    batches = sent(LIVELY, 130.0, seed=4)
    assert [batch.last_ns for batch in batches] == sorted(batch.last_ns for batch in batches)
    rate = [batch for batch in batches if batch.signal == "rate"]
    temperature = [batch for batch in batches if batch.signal == "temperature"]
    assert [len(batch) for batch in temperature] == [60, 60, 10]
    assert sum(len(batch) for batch in rate) == 26_000
    for line in (rate, temperature):
        assert [batch.seq for batch in line[1:]] == [batch.next_seq for batch in line[:-1]]
        assert all(batch.t0_ns == 10**18 + batch.seq * batch.dt_ns for batch in line)
    assert {batch.epoch for batch in batches} == {batches[0].epoch}
    assert [b.unit_of_measure for b in (rate[0], temperature[0])] == ["deg/s", "degC"]
    assert batches == sent(LIVELY, 130.0, seed=4)
    whole = powered(LIVELY, 4).rate_counts(26_000)
    assert np.array_equal(np.concatenate([batch.counts for batch in rate if batch.counts is not None]), whole)


def test_other_runs_seeds_and_power_cycles_are_other_power_ons() -> None:
    def epoch(run: str, seed: int, number: int) -> object:
        return SimulatedStation(Plan(seed, {"FOG-1": LIVELY}), run, batch=10).epoch(PowerCycle(number, 0), "FOG-1")

    assert len({epoch("a", 1, 0), epoch("b", 1, 0), epoch("a", 2, 0), epoch("a", 1, 1)}) == 4


def test_what_cannot_be_simulated_is_refused() -> None:
    for parameters, message in (
        (GyroParameters(noise=Noise(angle_random_walk_deg_per_sqrt_h=-1)), ">= 0.*`.noise.angle_random_walk_deg_per"),
        (GyroParameters(sample_interval_ns=0), ">= 1.*`.sample_interval_ns`"),
        (GyroParameters(hold_s=-0.1), ">= 0.0.*`.hold_s`"),
        (GyroParameters(scale=Scale(error_ppm=math.nan)), "got no finite number.*`.scale.error_ppm`"),
    ):
        with pytest.raises(BadInput, match="simulated gyro FOG-1: .*" + message.replace("`.", r"`\$\.")):
            powered(parameters)
    with pytest.raises(BadInput, match=r"chamber: .*got no finite number.*`\$\.mean_deg_c`"):
        powered(LIVELY, chamber=ChamberParameters(mean_deg_c=math.nan))
    with pytest.raises(BadInput, match=r">= 0.0.*`\$\.draught_deg_c`"):
        powered(LIVELY, chamber=ChamberParameters(draught_deg_c=-1.0))
    with pytest.raises(BadInput, match="unit 'a b' cannot be used"):
        powered(LIVELY, unit="a b")
    with pytest.raises(BadInput, match="seed is -1"):
        SimulatedGyro(LIVELY, seed=-1, unit="FOG-1")
    assert sent(LIVELY, -1.0, seed=0) == sent(LIVELY, 0.0, seed=0) == []
    with pytest.raises(BadInput, match="at least one sample"):
        SimulatedStation(demo_fleet(1), "r", batch=0)


def test_demo_fleet_has_eight_names_and_its_planted_units() -> None:
    fleet = demo_fleet(seed=1)
    assert len(fleet.units) == 8
    noise = {unit: each.noise.angle_random_walk_deg_per_sqrt_h for unit, each in fleet.parameters.items() if each.noise}
    assert noise["FOG-0234"] == 0.06
    thermal = {unit: each.thermal.bias_polynomial_deg_per_h for unit, each in fleet.parameters.items() if each.thermal}
    assert max(thermal, key=lambda unit: thermal[unit]) == "FOG-0236"
    assert {each.hold_s for each in fleet.parameters.values()} == {0.1}


def test_a_hold_follows_a_slow_environment_and_keeps_the_white_noise() -> None:
    """Effects of a ramp, with and without hold: the same but for the half-width of the hold on the slope."""
    ramp = PiecewiseEnvironment(
        [0, 600], temperature_deg_c=[20, 40], rates_deg_per_s=[(0, 0, 0), (6, 0, 0)], supply_v=[5, 6]
    )
    groups: dict[str, Any] = {
        "scale": Scale(counts_per_deg_per_s=1e7, temperature_ppm_per_deg_c=20.0),
        "bias": Bias(supply_deg_per_h_per_v=30.0, warm_up=(WarmUp(amplitude_deg_per_h=10.0, time_constant_s=60.0),)),
        "thermal": Thermal(lag_s=20.0, bias_polynomial_deg_per_h=(2.0,), rate=TemperatureRate(
            deg_per_h_per_deg_c_per_min=3.0)),
        "noise": Noise(angle_random_walk_deg_per_sqrt_h=1e-4),
    }  # fmt: skip
    held, exact = (
        SimulatedGyro(GyroParameters(hold_s=hold_s, **groups), seed=1, unit="G", environment=ramp).samples(120_000)
        for hold_s in (0.1, 0.0)
    )
    difference = (held.counts.astype(np.float64) - exact.counts) * 1e-7
    # 0.01 deg/s^2 over 9.5 samples of 5 ms; the same white noise, to a count
    assert np.abs(difference).max() == pytest.approx(0.01 * 9.5 * 0.005, rel=0.01)
    means = difference.reshape(-1, 20).mean(axis=1)
    # the lags start in equilibrium at the first evaluation, which the hold has 47.5 ms later: 0.006 deg/h for a while
    assert np.abs(means).max() < 2e-6
    assert np.abs(means[-600:]).max() < 1e-7
