"""The two processes of a simulated station: its instruments, which speak SCPI, and its gyros, which speak CAN."""

import os
import sys
from pathlib import Path

import msgspec

from ingest.simulator.bench import SimulatedBench
from ingest.simulator.gyro_bus import play
from ingest.simulator.physics.gyro_model import SimulatedGyroModel
from ingest.simulator.physics.plan import load_plan
from ingest.simulator.physics.truth import truth
from ingest.simulator.scpi.server import ScpiServer
from ingest.simulator.station_files import MULTICAST, PLAN, Simulation, read_simulation
from ingest.simulator.world import World, WorldServer
from ingest.station_clock import StationClock
from stream.console import until_stopped
from stream.errors import GyrofleetError

TRUTH = "truth.jsonl"
_LOOK_S = 0.5
_PARENT = os.getppid()


class _Told(msgspec.Struct):
    unit: str
    power_on: int


def bench_of(simulation: Simulation) -> SimulatedBench:
    """The instruments; the gyros' process has the like, which follow those of the instruments' process."""
    return SimulatedBench.at(StationClock(simulation.speed, simulation.start_ns, simulation.origin_s))


def instruments(folder: Path) -> None:
    """Play the instruments until asked to stop; the supply is on from the beginning."""
    simulation = read_simulation(folder)
    bench = bench_of(simulation)
    bench.supply.handle("VOLT 5;CURR 5;OUTP ON")
    with (
        ScpiServer(bench.named, ports=simulation.ports),
        WorldServer(bench.named, simulation.ports["world"]),
        until_stopped() as stop,
    ):
        print("ready", flush=True)
        while not (stop.wait(_LOOK_S) or _is_orphan()):
            pass


def gyros(folder: Path) -> None:
    """Play the gyros until asked to stop, or the instruments have ended; what was planted goes to a file of its own."""
    import can

    simulation = read_simulation(folder)
    bench = bench_of(simulation)

    def tell(model: SimulatedGyroModel, duration_s: float) -> None:
        with (folder / TRUTH).open("ab") as file:
            file.write(msgspec.json.encode(truth(model, duration_s)) + b"\n")

    with (
        World("127.0.0.1", simulation.ports["world"], bench.named) as world,
        can.Bus(channel=MULTICAST, interface="udp_multicast", port=simulation.multicast_port) as bus,
        until_stopped() as stop,
    ):
        print("ready", flush=True)
        play(
            load_plan(folder / PLAN), world, bench, simulation.latitude_deg, simulation.position, bus,
            lambda: stop.asked_at is not None or _is_orphan(), tell, power_ons_so_far(folder / TRUTH),
        )  # fmt: skip


def power_ons_so_far(path: Path) -> dict[str, int]:
    """How often each unit has been powered on already; a line of the file that a crash has cut off says nothing."""
    found: dict[str, int] = {}
    try:
        lines = path.read_bytes().splitlines()
    except FileNotFoundError:
        return found
    for line in lines:
        try:
            told = msgspec.json.decode(line, type=_Told)
        except msgspec.DecodeError:
            continue
        found[told.unit] = max(found.get(told.unit, 0), told.power_on)
    return found


def _is_orphan() -> bool:
    """Whether the process that plays the station has been killed."""
    return os.getppid() != _PARENT


def main() -> None:
    """`python -m ingest.simulator.station_roles instruments|gyros FOLDER`."""
    _, role, folder = sys.argv
    try:
        {"instruments": instruments, "gyros": gyros}[role](Path(folder))
    except GyrofleetError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    main()
