"""Each planted effect alone comes back with its sign and its size, fitted by plain numpy."""

import math
from typing import Any

import numpy as np
import pytest

from ingest.simulator.physics.bias import Bias, BiasStep, Jumps, Line, WarmUp
from ingest.simulator.physics.environment import Environment, PiecewiseEnvironment, StaticEnvironment
from ingest.simulator.physics.gyro import GyroParameters, SimulatedGyro
from ingest.simulator.physics.scale import Ripple, Scale
from ingest.simulator.physics.sensing import Misalignment
from ingest.simulator.physics.thermal import Hysteresis, TemperatureRate, Thermal
from stream.batch import FloatArray

SECOND_NS = 1_000_000_000
FINE = 1e9  # counts per deg/s: half a count is 1.8e-6 deg/h
HALF_COUNT_DEG_PER_H = 1.8e-6 * 1.01
COARSE = 1e7  # counts per deg/s, up to 214 deg/s


def output_deg_per_h(
    n: int, environment: Environment | None = None, counts: float = FINE, interval_ns: int = SECOND_NS, **given: Any
) -> FloatArray:
    whose: dict[str, Any] = {"seed": 1, "unit": "G"}
    whose |= {key: given.pop(key) for key in ("power_on", "day", "age_h", "seed", "unit") if key in given}
    planted: dict[str, Any] = {"scale": Scale(counts_per_deg_per_s=counts)} | given
    parameters = GyroParameters(sample_interval_ns=interval_ns, **planted)
    gyro = SimulatedGyro(parameters, environment=environment, **whose)
    rate: FloatArray = gyro.samples(n).counts.astype(np.float64) * (gyro.scale_deg_per_s_per_count * 3600)
    return rate


def sweep(
    low: float = -200.0, high: float = 200.0, n: int = 401, **more: Any
) -> tuple[FloatArray, PiecewiseEnvironment]:
    """Rates about the input axis, one a second, and the environment that has them."""
    rates = np.linspace(low, high, n)
    environment = PiecewiseEnvironment(
        np.arange(n, dtype=np.float64).tolist(), rates_deg_per_s=[(rate, 0.0, 0.0) for rate in rates], **more
    )
    return rates, environment


def response(scale: Scale, rates: FloatArray, environment: Environment, **more: Any) -> FloatArray:
    return output_deg_per_h(len(rates), environment, scale=scale, **more) / 3600


def kept(**given: Any) -> Scale:
    return Scale(**{"counts_per_deg_per_s": COARSE, "full_range_deg_per_s": 200.0} | given)


# half a count of COARSE over the range of 200 deg/s, in ppm; a least-squares coefficient is off by at most a few of it
COUNT_PPM = 0.5 / COARSE / 200 * 1e6


def test_without_effects_the_counts_are_the_rate() -> None:
    rates, environment = sweep()
    gyro = SimulatedGyro(
        GyroParameters(sample_interval_ns=SECOND_NS, scale=kept()), seed=1, unit="G", environment=environment
    )
    assert np.array_equal(gyro.samples(len(rates)).counts, np.rint(rates * COARSE).astype(np.int32))
    assert not output_deg_per_h(1000).any()


@pytest.mark.parametrize("error_ppm", [150.0, -80.0])
def test_scale_factor_error(error_ppm: float) -> None:
    rates, environment = sweep()
    slope, zero = np.polyfit(rates, response(kept(error_ppm=error_ppm), rates, environment), 1)
    assert (slope - 1) * 1e6 == pytest.approx(error_ppm, abs=2 * COUNT_PPM)
    assert abs(zero) < 1 / COARSE


def test_nonlinearity_of_every_order() -> None:
    planted = [5.0, -8.0, 3.0, 12.0]
    rates, environment = sweep()
    x = rates / 200
    deviation = (response(kept(nonlinearity_ppm=tuple(planted)), rates, environment) - rates) / 200 * 1e6
    found = np.linalg.lstsq(np.stack([x**m for m in (1, 2, 3, 4, 5)], axis=1), deviation, rcond=None)[0]
    assert found == pytest.approx([0.0, *planted], abs=10 * COUNT_PPM)


def test_asymmetry_is_the_difference_of_the_two_slopes() -> None:
    rates, environment = sweep()
    out = response(kept(asymmetry_ppm=30.0), rates, environment)
    above, below = (np.polyfit(rates[side], out[side], 1)[0] for side in (rates >= 0, rates <= 0))
    assert (above - below) * 1e6 == pytest.approx(30.0, abs=8 * COUNT_PPM)
    assert (above + below) / 2 == pytest.approx(1.0, abs=8e-6 * COUNT_PPM)


def test_ripple_over_the_rate() -> None:
    rates, environment = sweep()
    ripple = Ripple(amplitude_ppm=20.0, period_deg_per_s=37.0, phase_deg=30.0)
    deviation = (response(kept(ripple=ripple), rates, environment) - rates) / 200 * 1e6
    phase = 2 * np.pi * rates / 37.0
    a, b = np.linalg.lstsq(np.stack([np.sin(phase), np.cos(phase)], axis=1), deviation, rcond=None)[0]
    assert math.hypot(a, b) == pytest.approx(20.0, abs=2 * COUNT_PPM)
    assert math.degrees(math.atan2(b, a)) == pytest.approx(30.0, abs=0.01)


def test_scale_factor_over_temperature_and_specific_force_and_age() -> None:
    n = 201
    temperature = np.linspace(-40, 60, n)
    rates = np.full(n, 200.0)
    environment = PiecewiseEnvironment(
        np.arange(n, dtype=np.float64).tolist(),
        rates_deg_per_s=[(200.0, 0.0, 0.0)] * n,
        temperature_deg_c=temperature.tolist(),
        specific_force_g=[(1.0, 5.0, 5.0)] * n,
    )

    def ppm(scale: Scale, **more: Any) -> FloatArray:
        return np.asarray((response(scale, rates, environment, **more) / rates - 1) * 1e6, np.float64)

    planted = kept(temperature_ppm_per_deg_c=-12.0, temperature_ppm_per_deg_c2=0.3)
    found = np.polyfit(temperature - 25, ppm(planted), 2)
    assert found == pytest.approx([0.3, -12.0, 0.0], abs=5 * COUNT_PPM)
    assert ppm(kept(acceleration_ppm_per_g=-7.0)) == pytest.approx(-7.0, abs=1.01 * COUNT_PPM)
    aged = ppm(kept(ageing_ppm_per_1000_h=40.0), age_h=500.0)
    assert aged == pytest.approx(20.0 + 0.04 * np.arange(n) / 3600, abs=1.01 * COUNT_PPM)


@pytest.mark.long
@pytest.mark.parametrize("group", ["bias", "scale"])
def test_turn_on_and_day_scatter_have_their_sizes_and_days_are_shared(group: str) -> None:
    environment = StaticEnvironment(rates_deg_per_s=(100.0 if group == "scale" else 0.0, 0, 0))

    def drawn(turn_on: float, day_sd: float, power_on: int, day: int) -> float:
        if group == "bias":
            given: dict[str, Any] = {"bias": Bias(turn_on_deg_per_h=turn_on, day_deg_per_h=day_sd)}
            return float(output_deg_per_h(1, power_on=power_on, day=day, **given)[0])
        scale = kept(turn_on_ppm=turn_on, day_ppm=day_sd)
        out = output_deg_per_h(1, environment, scale=scale, power_on=power_on, day=day)
        return float((out[0] / 3600 / 100 - 1) * 1e6)

    turn_on = [drawn(2.0, 0.0, i, 1) for i in range(1, 301)]
    assert np.std(turn_on, ddof=1) == pytest.approx(2.0, rel=5 / math.sqrt(2 * 299))
    assert abs(np.mean(turn_on)) < 5 * 2.0 / math.sqrt(300)
    by_day = [drawn(0.0, 3.0, 1, day) for day in range(1, 301)]
    assert np.std(by_day, ddof=1) == pytest.approx(3.0, rel=5 / math.sqrt(2 * 299))
    assert drawn(0.0, 3.0, 1, 4) == drawn(0.0, 3.0, 2, 4) != drawn(0.0, 3.0, 2, 5)


def test_constant_bias_and_its_sign() -> None:
    assert output_deg_per_h(5, bias=Bias(constant_deg_per_h=-3.25)) == pytest.approx(-3.25, abs=HALF_COUNT_DEG_PER_H)


def test_warm_up_is_a_sum_of_exponentials_from_power_on() -> None:
    planted = (
        WarmUp(amplitude_deg_per_h=3.0, time_constant_s=20.0),
        WarmUp(amplitude_deg_per_h=-1.0, time_constant_s=300.0),
    )
    t_s = np.arange(2000.0)
    expected = 3.0 * np.exp(-t_s / 20) - 1.0 * np.exp(-t_s / 300)
    assert output_deg_per_h(2000, bias=Bias(warm_up=planted)) == pytest.approx(expected, abs=HALF_COUNT_DEG_PER_H)


def test_sensitivities_to_force_its_square_supply_and_field_by_axis() -> None:
    rng = np.random.default_rng(3)
    n = 60
    force, field, supply = rng.normal(size=(n, 3)), rng.normal(size=(n, 3)), 5 + rng.normal(size=n)
    environment = PiecewiseEnvironment(
        np.arange(n, dtype=np.float64).tolist(),
        specific_force_g=force.tolist(),
        magnetic_field_gauss=field.tolist(),
        supply_v=supply.tolist(),
    )
    bias = Bias(
        acceleration_deg_per_h_per_g=(0.5, -0.2, 0.1),
        acceleration_squared_deg_per_h_per_g2=(0.05, 0.02, -0.03),
        magnetic_deg_per_h_per_gauss=(0.3, -0.4, 0.6),
        supply_deg_per_h_per_v=-1.5,
        supply_nominal_v=4.8,
    )
    out = output_deg_per_h(n, environment, bias=bias)
    design = np.column_stack([np.ones(n), force, force**2, field, supply])
    found = np.linalg.lstsq(design, out, rcond=None)[0]
    expected = [1.5 * 4.8, 0.5, -0.2, 0.1, 0.05, 0.02, -0.03, 0.3, -0.4, 0.6, -1.5]
    assert found == pytest.approx(expected, abs=1e-4)
    for axis in range(3):
        alone = [0.0, 0.0, 0.0]
        alone[axis] = 0.7
        out = output_deg_per_h(n, environment, bias=Bias(acceleration_deg_per_h_per_g=tuple(alone)))  # type: ignore[arg-type]
        assert out == pytest.approx(0.7 * force[:, axis], abs=HALF_COUNT_DEG_PER_H)


def test_ageing_goes_with_the_logarithm_of_the_hours() -> None:
    bias = Bias(ageing_deg_per_h_per_decade=0.5, ageing_onset_h=10.0)
    for age_h, expected in ((0.0, 0.0), (90.0, 0.5), (990.0, 1.0)):
        assert output_deg_per_h(1, bias=bias, age_h=age_h)[0] == pytest.approx(expected, abs=HALF_COUNT_DEG_PER_H)
    assert output_deg_per_h(3601, bias=bias, age_h=0.0)[-1] == pytest.approx(
        0.5 * math.log10(1.1), abs=HALF_COUNT_DEG_PER_H
    )


def test_steps_begin_at_their_first_sample() -> None:
    planted = (
        BiasStep(at_s=7.2, size_deg_per_h=-0.5),
        BiasStep(at_s=3.0, size_deg_per_h=2.0),
        BiasStep(at_s=0.0, size_deg_per_h=1.0),
    )
    out = output_deg_per_h(10, bias=Bias(step=planted))
    assert out == pytest.approx([1, 1, 1, 3, 3, 3, 3, 3, 2.5, 2.5], abs=HALF_COUNT_DEG_PER_H)


def test_jumps_come_at_their_rate_with_their_size_and_stay() -> None:
    out = output_deg_per_h(200_000, bias=Bias(jumps=Jumps(rate_per_h=20.0, sd_deg_per_h=0.1)))
    change = np.diff(out)
    # two in one second merge into one: a thirty-sixth of a jump in a thousand
    sizes = change[np.abs(change) > 2 * HALF_COUNT_DEG_PER_H]
    expected = 200_000 / 180
    assert len(sizes) == pytest.approx(expected, abs=5 * math.sqrt(expected) + expected / 180)
    assert np.std(sizes) == pytest.approx(0.1, rel=5 / math.sqrt(2 * expected) + 1 / 180)
    gaps = np.diff(np.flatnonzero(np.abs(change) > 2 * HALF_COUNT_DEG_PER_H))
    # of exponential gaps the deviation is the mean; its own relative error is sqrt(2/n)
    assert np.std(gaps) / np.mean(gaps) == pytest.approx(1.0, abs=5 * math.sqrt(2 / expected))


def test_line_has_frequency_amplitude_and_phase() -> None:
    line = Line(frequency_hz=3.7, amplitude_deg_per_h=0.4, phase_deg=-50.0)
    out = output_deg_per_h(20_000, interval_ns=10_000_000, bias=Bias(line=(line,)))
    phase = 2 * np.pi * 3.7 * 0.01 * np.arange(20_000)
    a, b = np.linalg.lstsq(np.stack([np.sin(phase), np.cos(phase)], axis=1), out, rcond=None)[0]
    assert math.hypot(a, b) == pytest.approx(0.4, abs=1e-6)
    assert math.degrees(math.atan2(b, a)) == pytest.approx(-50.0, abs=1e-3)


def test_thermal_polynomial_is_about_25_degrees() -> None:
    temperature = np.linspace(-40, 60, 101)
    environment = PiecewiseEnvironment(np.arange(101.0).tolist(), temperature_deg_c=temperature.tolist())
    out = output_deg_per_h(101, environment, thermal=Thermal(bias_polynomial_deg_per_h=(0.2, -0.01, 1e-4)))
    assert np.polyfit(temperature - 25, out, 3) == pytest.approx([1e-4, -0.01, 0.2, 0.0], abs=1e-5)


def test_inside_follows_the_housing_with_its_lag() -> None:
    environment = PiecewiseEnvironment([10.0, 10.0], temperature_deg_c=[25.0, 35.0])
    out = output_deg_per_h(300, environment, thermal=Thermal(lag_s=30.0, bias_polynomial_deg_per_h=(1.0,)))
    assert not out[:10].any()
    # between samples 9 and 10 the input is taken to be a straight line
    early = 10 * (1 - 30 * (1 - math.exp(-1 / 30)))
    t_s = np.arange(290.0)
    assert out[10:] == pytest.approx(10 - (10 - early) * np.exp(-t_s / 30), abs=HALF_COUNT_DEG_PER_H)


def test_temperature_rate_has_its_full_size_on_a_ramp_and_decays_after_it() -> None:
    environment = PiecewiseEnvironment([0.0, 600.0], temperature_deg_c=[20.0, 0.0])
    rate = TemperatureRate(deg_per_h_per_deg_c_per_min=0.7, time_constant_s=20.0)
    out = output_deg_per_h(1200, environment, thermal=Thermal(rate=rate))
    t_s = np.arange(1200.0)
    on_ramp = -2.0 * 0.7 * (1 - np.exp(-np.minimum(t_s, 600) / 20))
    assert out == pytest.approx(on_ramp * np.exp(-np.maximum(t_s - 600, 0) / 20), abs=HALF_COUNT_DEG_PER_H)
    assert out[599] == pytest.approx(-1.4, abs=1e-5)


def test_hysteresis_opens_a_loop_of_its_size_and_width() -> None:
    # up by 20, down by 20, up by 1: 0.1 degC a sample
    knots = [0.0, 200.0, 400.0, 410.0]
    environment = PiecewiseEnvironment(knots, temperature_deg_c=[20.0, 40.0, 20.0, 21.0])
    loop = Hysteresis(half_loop_deg_per_h=0.3, width_deg_c=4.0)
    out = output_deg_per_h(411, environment, thermal=Thermal(hysteresis=(loop,)))
    near: dict[str, Any] = {"abs": HALF_COUNT_DEG_PER_H}
    assert out[0] == 0.0
    assert out[10] == pytest.approx(0.15, **near)  # half way to the branch: 1 of 2 degC
    assert out[20:201] == pytest.approx(0.3, **near)
    assert out[220] == pytest.approx(0.0, **near)  # 2 of 4 degC back
    assert out[240:401] == pytest.approx(-0.3, **near)
    assert out[410] == pytest.approx(-0.3 + 0.6 / 4, **near)
    warmed = output_deg_per_h(
        1, environment, thermal=Thermal(hysteresis=(Hysteresis(half_loop_deg_per_h=0.3, width_deg_c=4.0, start=1.0),))
    )
    assert warmed[0] == pytest.approx(0.3, **near)
    two = output_deg_per_h(
        411, environment, thermal=Thermal(hysteresis=(loop, Hysteresis(half_loop_deg_per_h=-0.1, width_deg_c=1.0)))
    )
    assert two[200] == pytest.approx(0.2, **near)


def test_misalignment_and_cross_axis_sensitivity_by_axis() -> None:
    rng = np.random.default_rng(5)
    rates = rng.uniform(-100, 100, (50, 3))
    environment = PiecewiseEnvironment(np.arange(50.0).tolist(), rates_deg_per_s=rates.tolist())

    def fitted(misalignment: Misalignment) -> FloatArray:
        out = output_deg_per_h(50, environment, counts=COARSE, misalignment=misalignment) / 3600
        return np.asarray(np.linalg.lstsq(rates, out, rcond=None)[0], np.float64)

    y, z = math.sin(math.radians(600 / 3600)), math.sin(math.radians(-200 / 3600))
    length = math.sqrt(1 - y**2 - z**2)
    assert fitted(Misalignment(y_arcsec=600.0, z_arcsec=-200.0)) == pytest.approx([length, y, z], abs=1e-9)
    assert fitted(Misalignment(cross_y_ppm=30.0, cross_z_ppm=-70.0)) == pytest.approx([1.0, 3e-5, -7e-5], abs=1e-9)
