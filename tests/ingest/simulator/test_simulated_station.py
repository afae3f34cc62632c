"""Simulated gyros on a bus: the same frames however time is cut, a power-on for each switching on."""

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import strategies as st

from ingest.simulator.bench import CourseClient, CourseDevice
from ingest.simulator.physics.gyro import SimulatedGyro
from ingest.simulator.physics.imu import SimulatedImu
from ingest.simulator.physics.mounting import TableEnvironment
from ingest.simulator.physics.plan import parse_plan
from ingest.simulator.processes import GyroBus, power_ons_so_far
from ingest.simulator.scpi.chamber import SimulatedChamber
from ingest.simulator.scpi.device import SimulatedDevice
from ingest.simulator.scpi.electrical import SimulatedSupply
from ingest.simulator.scpi.server import ScpiServer
from ingest.simulator.scpi.tables import SimulatedRateTable
from ingest.station_clock import StationClock
from stream.errors import InstrumentError
from tests.stream.examples import examples

SECOND = 10**9
PLAN = parse_plan(
    """
    [fleet]
    seed = 3
    units = ["FOG-1", "FOG-2"]
    sample_interval_ns = 100_000_000
    [fleet.bias]
    turn_on_deg_per_h = 5.0
    [fleet.noise]
    angle_random_walk_deg_per_sqrt_h = 0.02
    bias_instability_deg_per_h = 0.1
    """,
    "test",
)
# seconds, instrument, command
SCRIPT = [
    (1.0, "supply", "OUTP ON"), (2.0, "table", "RATE:SETP 20"), (4.05, "supply", "OUTP OFF"),
    (5.0, "supply", "OUTP ON"), (5.3, "table", "RATE:SETP -3"), (5.55, "supply", "OUTP OFF"),
    (5.551, "supply", "OUTP ON"),
]  # fmt: skip
END_S = 8.0
Frames = list[tuple[int, bytes]]


class Stepped(StationClock):
    """A clock that a test sets."""

    t_ns = 0

    def now_ns(self) -> int:
        return self.t_ns


def played(
    ticks_s: Sequence[float], power_ons: dict[str, int] | None = None
) -> tuple[Frames, list[tuple[str, int, float]]]:
    """Frames and power-ons of the script, seen at these moments and at its end."""
    clock = Stepped(start_ns=0)
    chamber, table, supply = SimulatedChamber(clock), SimulatedRateTable(clock), SimulatedSupply(clock)
    devices: dict[str, SimulatedDevice] = {"chamber": chamber, "table": table, "supply": supply}
    supply.handle("VOLT 5")
    environment = TableEnvironment(
        39.9, "input_up", rate_deg_per_s=table.rate_deg_per_s, angle_deg=table.angle_deg,
        temperature_deg_c=chamber.temperature_deg_c,
    )  # fmt: skip
    frames: Frames = []
    reported: list[tuple[str, int, float]] = []

    def tell(model: SimulatedGyro | SimulatedImu, duration_s: float) -> None:
        reported.append((model.unit, model.power_on, duration_s))

    bus = GyroBus(PLAN, environment, supply, frames.extend, tell, power_ons)
    events = [(t_s, name, command) for t_s, name, command in SCRIPT]
    for t_s, name, command in sorted([*events, *((t_s, "", "") for t_s in (*ticks_s, END_S))]):
        clock.t_ns = round(t_s * SECOND)
        if name:
            devices[name].handle(command)
        else:
            bus.advance(clock.t_ns)
    bus.end()
    assert bus.frames == len(frames)
    return frames, reported


@examples(8, 40, st.lists(st.floats(0.0, END_S), max_size=30))
def test_frames_are_the_same_however_time_is_cut(ticks_s: list[float]) -> None:
    at_once, told_at_once = played([])
    frames, reported = played(ticks_s)
    for arbitration_id in (0x100, 0x101):
        mine = [[data for each, data in found if each == arbitration_id] for found in (frames, at_once)]
        assert mine[0] == mine[1]
    assert sorted(reported) == sorted(told_at_once)


def test_each_switching_on_is_a_power_on_and_numbers_count_from_it() -> None:
    frames, reported = played(np.arange(0.0, END_S, 0.37).tolist())
    ends = [(unit, power_on, duration_s) for unit, power_on, duration_s in reported if duration_s]
    lengths_s = [3.05, 0.55, END_S - 5.551]
    assert [(unit, power_on) for unit, power_on, _ in sorted(ends)] == [
        (unit, power_on) for unit in PLAN.units for power_on in (1, 2, 3)
    ]
    assert [duration_s for unit, _, duration_s in sorted(ends) if unit == "FOG-1"] == pytest.approx(lengths_s)
    counters = [struct.unpack("<ihH", data)[2] for each, data in frames if each == 0x100]
    expected = [n for length_s in lengths_s for n in range(int(length_s / 0.1 + 1e-6) + 1)]
    assert counters == expected


def test_power_ons_go_on_where_those_of_another_process_ended(tmp_path: Path) -> None:
    path = tmp_path / "truth.jsonl"
    assert power_ons_so_far(path) == {}
    path.write_text('{"unit":"FOG-1","power_on":1}\n{"unit":"FOG-1","power_on":4,"more":1}\n{"unit":"FOG-2","pow')
    assert power_ons_so_far(path) == {"FOG-1": 4}
    frames, reported = played([], {"FOG-1": 4})
    assert {power_on for unit, power_on, _ in reported if unit == "FOG-1"} == {5, 6, 7}
    assert {power_on for unit, power_on, _ in reported if unit == "FOG-2"} == {1, 2, 3}
    fresh, _ = played([])
    of = [[data for each, data in found if each == 0x100] for found in (frames, fresh)]
    assert of[0] != of[1], "another power-on has another bias"


def test_copies_follow_through_many_commands_and_learn_that_the_world_has_ended() -> None:
    clock = StationClock(speed=1000.0)
    real, copy = SimulatedRateTable(clock), SimulatedRateTable(clock)
    rng = np.random.default_rng(7)
    courses = CourseDevice(clock, {"table": real})
    with (
        ScpiServer({"world": courses}) as server,
        CourseClient("127.0.0.1", server.port("world"), {"table": copy}) as world,
    ):
        before_ns = clock.now_ns()
        for _ in range(30):
            real.handle(f"RATE:SETP {rng.uniform(-50, 50):.3f}")
            clock.sleep(float(rng.uniform(0.0, 2.0)))
            now_ns = world.update()
            t_ns = rng.integers(before_ns, now_ns, 50)
            assert (copy.rate_deg_per_s(t_ns) == real.rate_deg_per_s(t_ns)).all()
            assert (copy.angle_deg(t_ns) == real.angle_deg(t_ns)).all()
    with pytest.raises(InstrumentError, match="cannot be reached"):
        CourseClient("127.0.0.1", server.port("world"), {"table": copy})
