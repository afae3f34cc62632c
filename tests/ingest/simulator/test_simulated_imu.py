"""The simulated inertial measurement unit: its axes, its frames, and the positions that the table carries it to."""

import struct
from pathlib import Path

import numpy as np
import pytest

from ingest.instruments.rate_table import RateTable, RateTableOptions
from ingest.procedures.file import ready_names
from ingest.procedures.procedure import load_procedure
from ingest.simulator.bench import SimulatedBench
from ingest.simulator.physics.accelerometer import AccelerometerParameters
from ingest.simulator.physics.bias import Bias
from ingest.simulator.physics.gyro import GyroParameters
from ingest.simulator.physics.imu import ImuParameters, SimulatedImu
from ingest.simulator.physics.noise import Noise
from ingest.simulator.physics.plan import ImuPlan, load_imu_plan
from ingest.simulator.physics.positions import POSITION_NAMES, mounting_of
from ingest.simulator.physics.readout import Readout
from ingest.simulator.physics.scale import Scale
from ingest.simulator.physics.sensing import Misalignment
from ingest.simulator.physics.truth import imu_truth
from ingest.simulator.processes import GyroBus
from ingest.simulator.scpi.server import ScpiServer
from ingest.simulator.scpi.tables import SimulatedRateTable
from ingest.simulator.station_files import FIRST_ID, Device, write_station
from ingest.station_clock import StationClock
from stream.batch import FloatArray
from stream.errors import BadInput, InstrumentError

SECOND = 10**9
DT_S = 0.01


class Stepped(StationClock):
    """A clock that a test sets."""

    t_ns = 0

    def now_ns(self) -> int:
        return self.t_ns


def bench_at(clock: Stepped) -> SimulatedBench:
    bench = SimulatedBench.at(clock, POSITION_NAMES)
    clock.t_ns = 1  # a command replaces what another gave at the same time
    bench.supply.handle("VOLT 5")
    clock.t_ns = 2
    bench.supply.handle("OUTP ON")
    return bench


def rates_and_forces(imu: SimulatedImu, n: int) -> tuple[FloatArray, FloatArray]:
    samples = imu.samples(n)
    scales = imu.rate_scale_deg_per_s, imu.acceleration_scale_g
    rates, forces = samples.rate_counts * scales[0], samples.acceleration_counts * scales[1]
    return np.asarray(rates, np.float64), np.asarray(forces, np.float64)


@pytest.mark.parametrize("name", POSITION_NAMES)
def test_every_position_is_a_right_handed_frame_with_a_table_axis_of_length_one(name: str) -> None:
    mounting = mounting_of(name)
    axes = np.array(mounting.axes_enu)
    assert np.array_equal(axes @ axes.T, np.eye(3))
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert np.linalg.norm(mounting.table_axis_enu) == 1.0
    if name.startswith("rotation_"):
        turning = "XYZ"[(int(name[-1]) - 1) // 3]
        assert np.array_equal(axes["XYZ".index(turning)], mounting.table_axis_enu)
        assert mounting.table_axis_enu[2] == 0.0, "gravity turns over"


@pytest.mark.parametrize("name", ["X_east_Y_east", "X_east_X_north", "X_sideways_Y_north", "rotation_10", ""])
def test_what_is_no_position_is_refused(name: str) -> None:
    with pytest.raises(BadInput, match="mounting: position"):
        mounting_of(name)


def test_carried_and_turned_it_feels_gravity_and_the_earth_along_the_axes_of_each_position() -> None:
    clock = Stepped(start_ns=0)
    bench = bench_at(clock)
    plan = ImuPlan(1, {"IMU-1": ImuParameters()})
    imu = plan.imu("IMU-1", environment=bench.environment(30.0, "Z_up", 10_000_000))
    clock.t_ns = SECOND
    bench.table.handle("POS rotation_4")
    clock.t_ns = 2 * SECOND
    bench.table.handle("ANGL:SETP 180")
    clock.t_ns = 20 * SECOND
    rates, forces = rates_and_forces(imu, 1901)
    earth = 15.041067 / 3600 * np.array([0.0, np.cos(np.radians(30)), np.sin(np.radians(30))])
    for at, axes in (
        (50, [[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        (150, [[1, 0, 0], [0, -1, 0], [0, 0, -1]]),
        (1900, [[-1, 0, 0], [0, -1, 0], [0, 0, 1]]),
    ):
        assert forces[:, at] == pytest.approx(np.array(axes)[:, 2], abs=1e-6)
        assert rates[:, at] == pytest.approx(np.array(axes) @ earth, abs=5.1e-5)
    turned = (rates[1, 200:] - rates[1, 150]).sum() * DT_S
    assert turned == pytest.approx(180.0, abs=2e-3)
    assert bench.table.handle("POS nowhere;SYST:ERR?") == '-224,"Illegal parameter value;no position nowhere"'


@pytest.mark.parametrize("name", [each for each in ready_names() if each.startswith("attitude_unit")])
def test_each_mount_of_an_attitude_unit_is_a_position_that_the_table_carries_it_to(name: str) -> None:
    """Without a position the unit would stay as it was mounted for the axis before."""
    mounts = [step for step in load_procedure(name).steps() if step.prompt is not None]
    assert {step.words.axis for step in mounts} == set("XYZ")
    for step in mounts:
        assert step.words.position in POSITION_NAMES
    if name.startswith("attitude_unit_bias"):  # the directions are those of the table's zero
        before = [step for step in load_procedure(name).steps() if step.number < mounts[0].number]
        assert before[-1].settings == {"angle": 0.0}


def test_the_instrument_carries_to_the_positions_of_its_file_over_the_wire() -> None:
    clock = StationClock(speed=100.0)
    device = SimulatedRateTable(clock, positions=POSITION_NAMES)
    with ScpiServer({"T": device}) as server:
        positions = {"X_up": "POS X_up", "Y_up": "POS sideways"}
        options = RateTableOptions(resource=server.resource("T"), max_rate_deg_per_s=100.0, positions=positions)
        with RateTable("T1", options, clock) as table:
            assert set(table.positions) == {"X_up", "Y_up"}
            table.carry("X_up")
            with pytest.raises(InstrumentError, match=r"it reports -224.*no position sideways"):
                table.carry("Y_up")
    names, which = device.positions(np.array([clock.now_ns()]))
    assert [names[at] for at in which] == ["X_up"]


def test_its_samples_are_the_same_in_blocks_of_any_size() -> None:
    noisy = GyroParameters(noise=Noise(angle_random_walk_deg_per_sqrt_h=0.02), readout=Readout(carries_rest=True))
    parameters = ImuParameters(
        gyro_x=noisy, gyro_z=noisy, accelerometer_y=AccelerometerParameters(noise_ug_per_sqrt_hz=20.0)
    )
    whole, parted = (SimulatedImu(parameters, seed=4, unit="IMU-1") for _ in range(2))
    at_once = whole.samples(500)
    parts = [parted.samples(n) for n in (1, 0, 7, 192, 300)]
    assert [part.first for part in parts] == [0, 1, 1, 8, 200]
    for name in ("rate_counts", "acceleration_counts"):
        joined = np.concatenate([getattr(part, name) for part in parts], axis=1)
        assert np.array_equal(joined, getattr(at_once, name))
    assert not np.array_equal(at_once.rate_counts[0], at_once.rate_counts[2]), "each sensor has noise of its own"


def test_planted_errors_come_out_at_each_axis() -> None:
    bench = bench_at(Stepped(start_ns=0))
    fine = Scale(counts_per_deg_per_s=1e7)
    parameters = ImuParameters(
        gyro_y=GyroParameters(scale=fine, bias=Bias(constant_deg_per_h=7.2)),
        gyro_x=GyroParameters(scale=fine, misalignment=Misalignment(z_arcsec=3600.0)),
        gyro_z=GyroParameters(scale=fine),
        accelerometer_x=AccelerometerParameters(bias_ug=40.0, z_arcsec=206.265),
        accelerometer_z=AccelerometerParameters(scale_error_ppm=100.0, second_order_ug_per_g2=30.0, bias_ug=-20.0),
    )
    still = SimulatedImu(parameters, seed=1, unit="I", environment=bench.environment(30.0, "Z_up"))
    rates, forces = rates_and_forces(still, 1)
    earth = 15.041067 * np.array([0.0, np.cos(np.radians(30)), np.sin(np.radians(30))])
    expected = earth + np.array([np.sin(np.radians(1.0)) * earth[2], 7.2, 0.0])
    assert rates[:, 0] * 3600 == pytest.approx(expected, abs=2e-3)
    assert forces[:, 0] * 1e6 == pytest.approx([40 + 1000, 0, 1e6 + 100 + 30 - 20], abs=1.0)
    planted = imu_truth(still, 1.0)
    assert planted["gyros"]["y"]["parameters"]["bias"]["constant_deg_per_h"] == 7.2
    assert planted["accelerometers"]["x"]["parameters"]["bias_ug"] == 40.0


def test_its_frames_carry_every_sample_of_six_sensors_and_the_temperature(tmp_path: Path) -> None:
    write_station(tmp_path, ["A", "B"], speed=10.0, rate_hz=100.0, seed=5, now_s=1.8e9, device=Device.IMU)
    plan = load_imu_plan(tmp_path / "fleet.toml")
    assert plan.parameters["A"] != plan.parameters["B"], "drawn for each"
    clock = Stepped(start_ns=0)
    bench = bench_at(clock)
    environment = bench.environment(39.9, "Z_up", 10_000_000)
    frames: list[tuple[int, bytes]] = []
    bus = GyroBus(plan, environment, bench.supply, frames.extend)
    for end_s in (0.5, 2.5):
        clock.t_ns = round(end_s * SECOND)
        bus.advance(clock.t_ns)
    expected = plan.imu("B", environment=environment, start_ns=2).samples(250)
    for axis in range(3):
        mine = [data for each, data in frames if each == FIRST_ID + 4 + axis]
        rates = [int.from_bytes(data[:3], "little", signed=True) for data in mine]
        forces = [int.from_bytes(data[3:6], "little", signed=True) for data in mine]
        assert rates == expected.rate_counts[axis].tolist()
        assert forces == expected.acceleration_counts[axis].tolist()
        assert [struct.unpack("<H", data[6:])[0] for data in mine] == list(range(250))
    temperatures = [struct.unpack("<hH", data[:4]) for each, data in frames if each == FIRST_ID + 7]
    assert temperatures == [(2500, 0), (2500, 1), (2500, 2)]
