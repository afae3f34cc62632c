"""The command `gyrofleet simulate`."""

import fcntl
import select
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import click

from stream.errors import BadInput, InstrumentError
from stream.terminal.console import Stop, notes, print_json, reporting, results, until_stopped

_defaulted = partial(click.option, show_default=True)
_READY_S = 60.0
_LOOK_S = 0.2
_END_S = 5.0
_LEFT_S = 2.0  # for the processes of a killed station to end


@click.command("simulate")
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False))
@_defaulted("--units", type=click.IntRange(1, 1000), default=4, help="Units, in a new folder.")
@_defaulted("--device", type=click.Choice(["gyro", "imu"]), default="gyro", help="What they are, in a new folder.")
@_defaulted("--speed", type=click.FloatRange(0.01, 1000.0), default=50.0, help="Times real time, in a new folder.")
@click.option(
    "--rate-hz", type=click.FloatRange(0.1, 1000.0), help="Samples a second, in a new folder: 10, of an imu 100."
)
@_defaulted("--seed", type=click.IntRange(min=0), default=1, help="Seed, in a new folder.")
@reporting
def simulate(
    folder: Path, units: int, device: str, speed: float, rate_hz: float | None, seed: int, *, as_json: bool
) -> None:
    """Simulate a test station: chamber, rate table and supply that speak SCPI, and units on a CAN bus.

    A gyro has one axis. An imu (inertial measurement unit) has three gyros and three accelerometers, rate_x to accel_z,
    and a table that also carries it to the positions of `system_level_asymmetry` and of the attitude units' procedures.

    It is used like a real one: `gyrofleet run PROCEDURE --station FOLDER/station.toml --units FOLDER/units.csv`. In a
    new folder the files of a station are written first; fleet.toml holds the effects planted in them. What was
    drawn for each power-on goes to truth.jsonl, which nothing else reads. Ctrl-C ends it.
    """
    from ingest.simulator.station_files import STATION, UNITS, Device, read_simulation, write_station

    names = [f"SIM-{i:04d}" for i in range(1, units + 1)]
    rate_hz = rate_hz or (100.0 if device == "imu" else 10.0)
    write_station(folder, names, speed=speed, rate_hz=rate_hz, seed=seed, device=Device(device))
    simulation = read_simulation(folder)
    with until_stopped() as stop, _locked(folder) as lock:
        processes: list[subprocess.Popen[str]] = []
        try:
            for role in ("instruments", "gyros"):
                processes.append(_start(role, folder, lock, stop))  # noqa: PERF401  what has started is ended if the next fails
            if as_json:
                paths = {"station": str(folder / STATION), "units": str(folder / UNITS)}
                print_json({"event": "ready", **paths, "speed": simulation.speed})
            else:
                files = f"--station {shlex.quote(str(folder / STATION))} --units {shlex.quote(str(folder / UNITS))}"
                command = f"gyrofleet run static_bias {files} --yes"
                ready = f"station ready, {simulation.speed:g} times real time"
                results().print(f"{ready}; test it: {command}", soft_wrap=True)
            while not stop.wait(_LOOK_S):
                if ended := [process for process in processes if process.poll() is not None]:
                    code = ended[0].returncode
                    raise InstrumentError(f"a process of the simulated station has ended with exit code {code}")
        finally:
            for process in reversed(processes):
                process.terminate()
            for process in processes:
                _end(process)
    notes().print("station ended")


@contextmanager
def _locked(folder: Path) -> Iterator[int]:
    """Lock the folder, whose ports have one user; the station's processes hold the lock until the last has ended."""
    with (folder / "lock").open("a") as file:
        until = time.monotonic() + _LEFT_S
        while True:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() > until:
                    raise BadInput(
                        f"another gyrofleet simulate runs the station in {folder}: use that one, or end it with Ctrl-C"
                    ) from None
                time.sleep(_LOOK_S)
        yield file.fileno()


def _start(role: str, folder: Path, lock: int, stop: Stop) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "ingest.simulator.processes", role, str(folder)]
    process = subprocess.Popen(  # noqa: S603  a module of ours
        command, stdout=subprocess.PIPE, text=True, start_new_session=True, pass_fds=(lock,)
    )
    assert process.stdout is not None
    until = time.monotonic() + _READY_S
    has_output = False
    while not has_output and stop.asked_at is None and time.monotonic() < until:
        has_output = bool(select.select([process.stdout], [], [], _LOOK_S)[0])
    if has_output and process.stdout.readline() == "ready\n":
        return process
    _end(process)
    if stop.asked_at is not None:
        raise KeyboardInterrupt
    raise InstrumentError(f"the simulated {role} did not start (exit code {process.returncode}); the reason is above")


def _end(process: subprocess.Popen[str]) -> None:
    process.terminate()
    try:
        process.wait(_END_S)
    except subprocess.TimeoutExpired:  # stopped, perhaps
        process.kill()
        process.wait()
