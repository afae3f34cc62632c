"""The simulated gyro as a whole: blocks, seeds, memory, what it asks of its environment."""

import math
import tracemalloc
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ingest.simulator.physics.bias import Bias, BiasStep, Jumps, Line, WarmUp
from ingest.simulator.physics.environment import PiecewiseEnvironment, StaticEnvironment
from ingest.simulator.physics.gyro import GyroParameters, SimulatedGyro
from ingest.simulator.physics.mounting import TableEnvironment
from ingest.simulator.physics.noise import Markov, Noise
from ingest.simulator.physics.readout import Readout, ReadoutFault, Samples, StartUp
from ingest.simulator.physics.scale import Ripple, Scale
from ingest.simulator.physics.sensing import DeadZone, Dynamics, Misalignment
from ingest.simulator.physics.thermal import Hysteresis, TemperatureRate, Thermal
from stream.batch import FloatArray, IntArray
from stream.errors import BadInput

EVERYTHING = GyroParameters(
    scale=Scale(
        error_ppm=100.0,
        turn_on_ppm=10.0,
        day_ppm=10.0,
        nonlinearity_ppm=(5.0, -8.0, 3.0, 2.0),
        ripple=Ripple(amplitude_ppm=10.0, period_deg_per_s=7.0),
        asymmetry_ppm=20.0,
        temperature_ppm_per_deg_c=10.0,
        temperature_ppm_per_deg_c2=0.1,
        acceleration_ppm_per_g=2.0,
        ageing_ppm_per_1000_h=10.0,
    ),
    bias=Bias(
        constant_deg_per_h=5.0,
        turn_on_deg_per_h=1.0,
        day_deg_per_h=1.0,
        warm_up=(WarmUp(amplitude_deg_per_h=10.0, time_constant_s=30.0),),
        acceleration_deg_per_h_per_g=(1.0, 2.0, 3.0),
        acceleration_squared_deg_per_h_per_g2=(0.1, 0.2, 0.3),
        supply_deg_per_h_per_v=2.0,
        magnetic_deg_per_h_per_gauss=(1.0, 2.0, 3.0),
        ageing_deg_per_h_per_decade=5.0,
        step=(BiasStep(at_s=11.0, size_deg_per_h=20.0),),
        jumps=Jumps(rate_per_h=3600.0, sd_deg_per_h=5.0),
        line=(Line(frequency_hz=1.3, amplitude_deg_per_h=3.0),),
    ),
    thermal=Thermal(
        lag_s=20.0,
        bias_polynomial_deg_per_h=(1.0, 0.1),
        rate=TemperatureRate(deg_per_h_per_deg_c_per_min=3.0),
        hysteresis=(Hysteresis(half_loop_deg_per_h=2.0, width_deg_c=0.5),),
    ),
    misalignment=Misalignment(y_arcsec=100.0, cross_z_ppm=50.0),
    noise=Noise(
        angle_quantum_arcsec=0.1,
        angle_random_walk_deg_per_sqrt_h=0.1,
        bias_instability_deg_per_h=5.0,
        rate_random_walk_deg_per_h_per_sqrt_h=50.0,
        rate_ramp_deg_per_h_per_h=20.0,
        markov=(Markov(sd_deg_per_h=2.0, correlation_s=3.0),),
    ),
    dynamics=Dynamics(bandwidth_hz=20.0, delay_s=0.0123, dead_zone=DeadZone(threshold_deg_per_h=10.0, slope=0.5)),
    readout=Readout(
        saturation_deg_per_s=90.0,
        carries_rest=True,
        dropout=ReadoutFault(probability=0.002, mean_samples=4.0),
        stuck=ReadoutFault(probability=0.002, mean_samples=4.0),
    ),
    start_up=StartUp(invalid_s=0.4, invalid_counts=-99, transient_deg_per_s=2.0, time_constant_s=0.5),
)


class Shaking:
    """An environment in which everything moves, by functions of time."""

    latest_ns = -1
    earliest_ns = 2**62

    def _sines(self, t_ns: IntArray, size: float, hz: float) -> FloatArray:
        self.latest_ns = max(self.latest_ns, int(t_ns.max(initial=-1)))
        self.earliest_ns = min(self.earliest_ns, int(t_ns.min(initial=2**62)))
        return np.stack([size * np.sin(2 * np.pi * hz * t_ns * 1e-9 + k) for k in range(3)])

    def rates_deg_per_s(self, t_ns: IntArray) -> FloatArray:
        return self._sines(t_ns, 100.0, 0.7)

    def specific_force_g(self, t_ns: IntArray) -> FloatArray:
        return self._sines(t_ns, 1.0, 0.3)

    def temperature_deg_c(self, t_ns: IntArray) -> FloatArray:
        return np.asarray(25 + self._sines(t_ns, 3.0, 0.02)[0], np.float64)

    def supply_v(self, t_ns: IntArray) -> FloatArray:
        return np.asarray(5 + self._sines(t_ns, 0.1, 0.5)[0], np.float64)

    def magnetic_field_gauss(self, t_ns: IntArray) -> FloatArray:
        return self._sines(t_ns, 0.5, 0.9)


def gyro(parameters: GyroParameters = EVERYTHING, **given: Any) -> SimulatedGyro:
    arguments: dict[str, Any] = {"seed": 7, "unit": "FOG-1", "environment": Shaking()} | given
    return SimulatedGyro(parameters, **arguments)


def joined(parts: list[Samples]) -> list[Any]:
    return [np.concatenate([part[k] for part in parts]).tolist() for k in (1, 2, 3)]


@pytest.mark.long
@settings(max_examples=15, deadline=None)
@given(blocks=st.lists(st.one_of(st.integers(0, 40), st.integers(0, 9_000)), min_size=1, max_size=12))
def test_samples_do_not_depend_on_the_sizes_of_the_blocks(blocks: list[int]) -> None:
    whole, parts = gyro(), gyro()
    taken = [parts.samples(n) for n in blocks]
    assert [part.first for part in taken] == [sum(blocks[:i]) for i in range(len(blocks))]
    assert joined(taken) == joined([whole.samples(sum(blocks))])
    assert parts.samples(1).first == sum(blocks)


@pytest.mark.parametrize("count", [600, pytest.param(3000, marks=pytest.mark.long)])
def test_one_sample_at_a_time_is_the_same_too(count: int) -> None:
    parts = gyro()
    assert joined([parts.samples(1) for _ in range(count)]) == joined([gyro().samples(count)])


def test_another_start_is_the_same_at_the_same_environment() -> None:
    at = 1_795_000_000 * 10**9
    given = StaticEnvironment(rates_deg_per_s=(10.0, 3.0, 1.0), temperature_deg_c=40.0)
    assert joined([gyro(environment=given).samples(5000)]) == joined(
        [gyro(environment=given, start_ns=at).samples(5000)]
    )


def test_seed_unit_power_on_and_day_each_change_what_they_should() -> None:
    noise = GyroParameters(noise=EVERYTHING.noise, scale=Scale(counts_per_deg_per_s=1e7))
    runs = {
        (seed, unit, power_on): gyro(noise, seed=seed, unit=unit, power_on=power_on, environment=None)
        .samples(20_000)
        .counts
        for seed in (0, 1)
        for unit in ("FOG-1", "FOG-11")
        for power_on in (1, 11)
    }
    white = np.diff(np.array([run.astype(np.float64) for run in runs.values()]))
    # differences of white noise are correlated over one lag with -1/2: sqrt((1 + 2/4)/n)
    assert np.abs(np.corrcoef(white) - np.eye(8)).max() < 5 * math.sqrt(1.5 / 20_000)
    again = gyro(noise, seed=0, unit="FOG-1", power_on=1, environment=None).samples(20_000).counts
    assert np.array_equal(again, runs[0, "FOG-1", 1])
    daily = GyroParameters(bias=Bias(day_deg_per_h=50.0))
    first = [gyro(daily, power_on=n, day=d).samples(1).counts[0] for n, d in ((1, 1), (2, 1), (2, 2))]
    assert first[0] == first[1] != first[2]


@pytest.mark.parametrize("group", ["bias", "thermal", "misalignment", "noise", "dynamics", "readout", "start_up"])
def test_a_group_of_which_nothing_is_planted_changes_nothing(group: str) -> None:
    kinds = {"bias": Bias, "thermal": Thermal, "misalignment": Misalignment, "noise": Noise, "dynamics": Dynamics}
    kinds |= {"readout": Readout, "start_up": StartUp}
    empty = GyroParameters(**{group: kinds[group]()})
    environment = PiecewiseEnvironment(
        [0.0, 10.0], rates_deg_per_s=[(-50, 9, 9), (50, 9, 9)], temperature_deg_c=[0, 50], supply_v=[4, 6]
    )
    t_s = np.arange(2000) * 0.005
    expected = np.rint(np.interp(t_s, [0, 10], [-50, 50]) * 20_000).astype(np.int32)
    for parameters in (empty, GyroParameters()):
        samples = gyro(parameters, environment=environment).samples(2000)
        assert np.array_equal(samples.counts, expected)
        assert samples.present.all()
        assert samples.ready.all()


def test_nothing_later_than_the_samples_asked_for_and_nothing_before_power_on_is_looked_at() -> None:
    environment = Shaking()
    start_ns = 5 * 10**9
    model = gyro(environment=environment, start_ns=start_ns)
    for n in (1, 7, 1000):
        last = model.samples(n).first + n - 1
        assert environment.latest_ns <= model.time_ns(last)
    assert environment.earliest_ns == start_ns


@pytest.mark.long
def test_memory_stays_bounded() -> None:
    model = gyro()
    model.samples(50_000)
    tracemalloc.start()
    try:
        for _ in range(60):
            model.samples(1000)
        settled = tracemalloc.get_traced_memory()[0]
        for _ in range(240):
            model.samples(1000)
        current, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 3_000_000
    assert current - settled < 700_000  # one refill of the noise more or less


def test_due_counts_the_samples_up_to_a_time() -> None:
    model = gyro(start_ns=100)
    assert [model.due(t) for t in (0, 99, 100, 5_000_099, 5_000_100)] == [0, 0, 1, 1, 2]
    model.samples(2)
    assert [model.due(t) for t in (5_000_100, 10_000_100)] == [0, 1]


def test_what_makes_no_sense_is_refused() -> None:
    for name in ("seed", "power_on", "day", "age_h"):
        with pytest.raises(BadInput, match=f"FOG-1: {name} is -1"):
            gyro(EVERYTHING, **{name: -1})
    with pytest.raises(BadInput, match="age_h is nan"):
        gyro(age_h=math.nan)
    with pytest.raises(BadInput, match="unit 'a b'"):
        gyro(unit="a b")
    with pytest.raises(BadInput, match="-3 samples"):
        gyro().samples(-3)


def test_an_environment_that_gives_no_numbers_is_named() -> None:
    class Broken(Shaking):
        def temperature_deg_c(self, t_ns: IntArray) -> FloatArray:
            return np.where(t_ns == 15_000_000, np.nan, 20.0)

        def supply_v(self, t_ns: IntArray) -> FloatArray:
            return np.zeros(1)

    thermal = GyroParameters(thermal=Thermal(bias_polynomial_deg_per_h=(1.0,)))
    with pytest.raises(BadInput, match="FOG-1: the environment's temperature_deg_c is not finite at 15000000 ns"):
        gyro(thermal, environment=Broken()).samples(10)
    supply = GyroParameters(bias=Bias(supply_deg_per_h_per_v=1.0))
    with pytest.raises(BadInput, match=r"supply_v has the shape \(1,\), \(10,\) is needed"):
        gyro(supply, environment=Broken()).samples(10)
    gyro(GyroParameters(), environment=Broken()).samples(10)  # what no effect needs is not asked for
    for wrong in ({"temperature_deg_c": [1.0]}, {"rates_deg_per_s": [(1, 2), (3, 4)]}, {"supply_v": [5.0, math.inf]}):
        with pytest.raises(BadInput, match=next(iter(wrong))):
            PiecewiseEnvironment([0, 1], **wrong)
    with pytest.raises(BadInput, match="out of order"):
        PiecewiseEnvironment([1, 0])
    with pytest.raises(BadInput, match="at least one knot"):
        PiecewiseEnvironment([])


@pytest.mark.parametrize(
    ("position", "expected"),
    [
        ("input_up", (0.5, 1.0)),
        ("input_down", (-0.5, -1.0)),
        ("input_north", (math.sqrt(0.75), 0.0)),
        ("input_south", (-math.sqrt(0.75), 0.0)),
        ("input_east", (0.0, 0.0)),
        ("input_west", (0.0, 0.0)),
    ],
)
def test_earth_rate_and_gravity_by_position_at_30_degrees_north(position: str, expected: tuple[float, float]) -> None:
    environment = TableEnvironment(30.0, position)
    t_ns = np.array([0, 10**15])
    assert environment.rates_deg_per_s(t_ns)[0] * 3600 == pytest.approx(15.041067 * expected[0], abs=1e-12)
    assert environment.specific_force_g(t_ns)[0] == pytest.approx(expected[1], abs=1e-12)
    assert np.linalg.norm(environment.rates_deg_per_s(t_ns)[:, 0]) * 3600 == pytest.approx(15.041067)
    model = gyro(GyroParameters(scale=Scale(counts_per_deg_per_s=1e9)), environment=environment)
    assert model.samples(1).counts[0] == round(15.041067 * expected[0] / 3600 * 1e9)


def test_a_turning_table_carries_the_axes_with_it() -> None:
    # independent of the code: the housing's axes as complex numbers in the horizontal plane
    rate, latitude = 12.0, math.radians(-35.0)
    environment = TableEnvironment(
        -35.0,
        "input_east",
        rate_deg_per_s=lambda t_ns: np.full(len(t_ns), rate),
        angle_deg=lambda t_ns: np.asarray(rate * t_ns * 1e-9, np.float64),
        magnetic_field_enu_gauss=(0.0, 0.2, -0.4),
    )
    t_ns = np.arange(0, 120) * 10**9
    direction = np.exp(1j * np.radians(rate * t_ns * 1e-9))  # of x; counter-clockwise from east, seen from above
    rates = environment.rates_deg_per_s(t_ns)
    north = 15.041067 / 3600 * math.cos(latitude)
    assert rates[0] == pytest.approx(north * direction.imag, abs=1e-12)
    assert rates[1] == pytest.approx(north * (1j * direction).imag, abs=1e-12)
    assert rates[2] == pytest.approx(15.041067 / 3600 * math.sin(latitude) + rate, abs=1e-12)
    assert environment.magnetic_field_gauss(t_ns)[0] == pytest.approx(0.2 * direction.imag, abs=1e-12)
    # tilted over a horizontal axis, x goes from east to up and gravity with it: k = -north
    tumbling = TableEnvironment(
        0.0, "input_east", (0.0, -2.0, 0.0), angle_deg=lambda t_ns: np.asarray(rate * t_ns * 1e-9, np.float64)
    )
    assert tumbling.specific_force_g(t_ns)[0] == pytest.approx(direction.imag, abs=1e-12)


def test_mountings_that_cannot_be_are_refused() -> None:
    with pytest.raises(BadInput, match="latitude of 91"):
        TableEnvironment(91.0, "input_up")
    with pytest.raises(BadInput, match="position 'up' is not known; one of input_up"):
        TableEnvironment(0.0, "up")
    with pytest.raises(BadInput, match="right-handed"):
        TableEnvironment(0.0, ((1, 0, 0), (0, 1, 0), (0, 0, -1)))
    with pytest.raises(BadInput, match="no direction"):
        TableEnvironment(0.0, "input_up", (0, 0, 0))
