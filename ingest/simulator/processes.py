"""The two processes of a simulated station: instruments that speak SCPI, and gyros or IMUs on a CAN bus."""

import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from ingest.simulator.bench import CourseClient, CourseDevice, SimulatedBench
from ingest.simulator.can_frames import CanDevice, Frames, messages_of, powered_device
from ingest.simulator.physics.environment import Environment
from ingest.simulator.physics.gyro import SimulatedGyro
from ingest.simulator.physics.imu import SimulatedImu
from ingest.simulator.physics.plan import ImuPlan, Plan, load_imu_plan, load_plan
from ingest.simulator.physics.positions import POSITION_NAMES
from ingest.simulator.physics.truth import imu_truth, truth
from ingest.simulator.scpi.electrical import SimulatedSupply
from ingest.simulator.scpi.server import ScpiServer
from ingest.simulator.station_files import FIRST_ID, MULTICAST, PLAN, Device, Simulation, read_simulation
from ingest.station_clock import StationClock
from stream.decoding import decode_json
from stream.errors import BadInput, GyrofleetError
from stream.terminal.console import until_stopped

TRUTH = "truth.jsonl"
_TICK_S = 0.01
_LOOK_S = 0.5
_PARENT = os.getppid()


@dataclass
class _Device:
    unit: str
    arbitration_id: int
    power_ons: int = 0
    powered: CanDevice | None = None


class GyroBus:
    """Sends the samples of a fleet as CAN frames, each as soon as its time has passed.

    Without power from the `supply` nothing is sent, and each switching on is a power-on. `send` gets the frames of a
    tick, each an arbitration id and 8 bytes, in order of time; `on_power` is called at the begin and the end of every
    power-on, with its seconds so far; `power_ons` are the earlier ones of each unit.

    `CanGyro` and `CanImu` say what is in the frames.
    """

    def __init__(
        self, plan: Plan | ImuPlan, environment: Environment, supply: SimulatedSupply,
        send: Callable[[Sequence[tuple[int, bytes]]], None],
        on_power: Callable[[SimulatedGyro | SimulatedImu, float], None] = lambda *_: None,
        power_ons: Mapping[str, int] | None = None,
    ) -> None:  # fmt: skip
        power_ons = power_ons or {}
        self._plan, self._environment, self._supply, self._send = plan, environment, supply, send
        self._on_power = on_power
        ids = range(FIRST_ID, 2**11, messages_of(plan))
        self._devices = [_Device(unit, ids[i], power_ons.get(unit, 0)) for i, unit in enumerate(plan.units)]
        self._done_ns = 0
        self.frames = 0

    def advance(self, now_ns: int) -> None:
        """Send everything up to a time."""
        for start_ns, end_ns, on in self._powered(now_ns):
            if on:
                self._sample(start_ns, end_ns)
            else:
                self.end(start_ns)
        self._done_ns = now_ns

    def end(self, t_ns: int | None = None) -> None:
        """End every power-on at a time, by default at that of the last `advance`."""
        for device in self._devices:
            if device.powered is not None:
                end_ns, model = self._done_ns if t_ns is None else t_ns, device.powered.model
                self._on_power(model, (end_ns - model.start_ns) / 1e9)
                device.powered = None

    def _powered(self, now_ns: int) -> list[tuple[int, int, bool]]:
        """Intervals from the last `advance` to now, and whether there was power."""
        course = self._supply.course
        assert course is not None
        _, segments = course.since(self._done_ns)
        borders = [max(segment.start_ns, self._done_ns) for segment in segments if segment.start_ns <= now_ns]
        ends = [*borders[1:], now_ns]
        on = [bool(segment.state.on) and segment.state.set_v > 0.0 for segment in segments[: len(borders)]]
        return [each for each in zip(borders, ends, on, strict=True) if each[0] < each[1]]

    def _sample(self, start_ns: int, end_ns: int) -> None:
        parts: list[Frames] = []
        for device in self._devices:
            if device.powered is None:
                device.power_ons += 1
                device.powered = powered_device(
                    self._plan, device.unit, device.power_ons, self._environment, start_ns, device.arbitration_id
                )
                self._on_power(device.powered.model, 0.0)
            parts.append(device.powered.frames(end_ns))
        frames = Frames(*(np.concatenate(each) for each in zip(*parts, strict=True)))
        if not len(frames.ids):
            return
        order = np.argsort(frames.t_ns, kind="stable")
        all_ids, data = frames.ids[order].tolist(), frames.data[order].tobytes()
        self._send([(each, data[8 * i : 8 * i + 8]) for i, each in enumerate(all_ids)])
        self.frames += len(all_ids)


def play_instruments(folder: Path) -> None:
    """Play the instruments until asked to stop; the supply is on from the beginning."""
    simulation = read_simulation(folder)
    bench = _bench(simulation)
    bench.supply.handle("VOLT 5;CURR 5;OUTP ON")
    courses = CourseDevice(bench.supply.clock, bench.named)
    with ScpiServer({**bench.named, "world": courses}, ports=simulation.ports), until_stopped() as stop:
        print("ready", flush=True)
        while not (stop.wait(_LOOK_S) or os.getppid() != _PARENT):
            pass


def play_gyros(folder: Path) -> None:
    """Play the gyros until asked to stop, or the instruments have ended; the truth goes to a file of its own."""
    import can

    simulation = read_simulation(folder)
    bench = _bench(simulation)

    def write(model: SimulatedGyro | SimulatedImu, duration_s: float) -> None:
        planted = truth(model, duration_s) if isinstance(model, SimulatedGyro) else imu_truth(model, duration_s)
        with (folder / TRUTH).open("ab") as file:
            file.write(msgspec.json.encode(planted) + b"\n")

    with (
        CourseClient("127.0.0.1", simulation.ports["world"], bench.named) as courses,
        can.Bus(channel=MULTICAST, interface="udp_multicast", port=simulation.multicast_port) as bus,
        until_stopped() as stop,
    ):

        def send(frames: Sequence[tuple[int, bytes]]) -> None:
            for arbitration_id, data in frames:
                bus.send(can.Message(arbitration_id=arbitration_id, data=data, is_extended_id=False, check=False))

        is_imu = simulation.device is Device.IMU
        plan = load_imu_plan(folder / PLAN) if is_imu else load_plan(folder / PLAN)
        interval_ns = _interval_ns(plan) if isinstance(plan, ImuPlan) else 0
        environment = bench.environment(simulation.latitude_deg, simulation.position, interval_ns)
        power_ons = power_ons_so_far(folder / TRUTH)
        gyros = GyroBus(plan, environment, bench.supply, send, write, power_ons)
        print("ready", flush=True)
        try:
            while stop.asked_at is None and os.getppid() == _PARENT:
                gyros.advance(courses.update())
                time.sleep(_TICK_S)
        finally:
            gyros.end()


def _interval_ns(plan: ImuPlan) -> int:
    """The sample interval of all units, which share the environment that they take means of."""
    intervals_ns = {each.sample_interval_ns for each in plan.parameters.values()}
    if len(intervals_ns) > 1:
        raise BadInput("simulated station: its inertial measurement units have one sample_interval_ns, in [fleet]")
    return intervals_ns.pop()


def _bench(simulation: Simulation) -> SimulatedBench:
    """The instruments; the gyros' process has copies, which follow those of the instruments' process."""
    clock = StationClock(simulation.speed, simulation.start_ns, simulation.origin_s)
    positions = POSITION_NAMES if simulation.device is Device.IMU else ()
    return SimulatedBench.at(clock, positions)


class _PowerOn(msgspec.Struct):
    unit: str
    power_on: int


def power_ons_so_far(path: Path) -> dict[str, int]:
    """Number of power-ons of each unit in a truth file; a line that a crash has cut off is skipped."""
    found: dict[str, int] = {}
    for line in path.read_bytes().splitlines() if path.exists() else ():
        with suppress(msgspec.DecodeError):
            each = decode_json(line, _PowerOn)
            found[each.unit] = max(found.get(each.unit, 0), each.power_on)
    return found


def main() -> None:
    """`python -m ingest.simulator.processes instruments|gyros FOLDER`."""
    _, role, folder = sys.argv
    # python-can imports it where it is installed, in most of a second, for logs in MF4; there are none here
    vars(sys)["modules"]["asammdf"] = None
    try:
        {"instruments": play_instruments, "gyros": play_gyros}[role](Path(folder))
    except GyrofleetError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    main()
