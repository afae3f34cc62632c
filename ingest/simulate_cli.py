"""The command `gyrofleet simulate`."""

import shlex
import subprocess
import sys
from pathlib import Path

import click

from stream.console import Stop, notes, print_json, reporting, results, until_stopped
from stream.errors import InstrumentError

_READY_S = 60.0
_LOOK_S = 0.2


@click.command("simulate")
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False))
@click.option("--units", type=click.IntRange(1, 1000), default=4, show_default=True, help="Gyros, in a new folder.")
@click.option(
    "--speed", type=click.FloatRange(min=0.01, max=1000.0), default=50.0, show_default=True,
    help="Times real time, in a new folder.",
)  # fmt: skip
@click.option(
    "--rate-hz", type=click.FloatRange(min=0.1, max=1000.0), default=10.0, show_default=True,
    help="Samples a second, in a new folder.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Of the fleet, in a new folder.")
@reporting
def simulate(folder: Path, units: int, speed: float, rate_hz: float, seed: int, *, as_json: bool) -> None:
    """Play a test station: chamber, rate table and supply that speak SCPI, and gyros on a CAN bus.

    It is reached like a real one: `gyrofleet run PROCEDURE --station FOLDER/station.toml --units FOLDER/units.csv`. In
    a new folder the files of a station are written first; edit them, fleet.toml says what is planted in the gyros.
    What was drawn for each power-on goes to truth.jsonl, which nothing else reads. Ctrl-C ends it.
    """
    from ingest.instruments.simulated.station_files import STATION, UNITS, read_simulation, write_station

    write_station(folder, [f"SIM-{i:04d}" for i in range(1, units + 1)], speed=speed, rate_hz=rate_hz, seed=seed)
    simulation = read_simulation(folder)
    with until_stopped() as stop:
        playing: list[subprocess.Popen[str]] = []
        try:
            for role in ("instruments", "gyros"):
                playing.append(_start(role, folder))  # noqa: PERF401  what has started is ended, whatever the next does
            if as_json:
                told = {name: str(folder / file) for name, file in (("station", STATION), ("units", UNITS))}
                print_json({"event": "ready", **told, "speed": simulation.speed})
            else:
                command = f"gyrofleet run static_bias --station {shlex.quote(str(folder / STATION))}"
                results().print(
                    f"station ready, {simulation.speed:g} times real time; test it: {command} "
                    f"--units {shlex.quote(str(folder / UNITS))} --yes",
                    soft_wrap=True, markup=False,
                )  # fmt: skip
            _watch(playing, stop)
        finally:
            for process in reversed(playing):
                process.terminate()
            for process in playing:
                process.wait(10.0)
    notes().print("station ended")


def _start(role: str, folder: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "ingest.instruments.simulated.station_roles", role, str(folder)]
    process = subprocess.Popen(  # noqa: S603  a module of ours
        command, stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    assert process.stdout is not None
    if process.stdout.readline() != "ready\n":
        raise InstrumentError(f"the simulated {role} did not start (exit code {process.wait(10.0)}); see above why")
    return process


def _watch(playing: list[subprocess.Popen[str]], stop: Stop) -> None:
    while not stop.wait(_LOOK_S):
        for process in playing:
            if process.poll() is not None:
                raise InstrumentError(
                    f"a process of the simulated station has ended with exit code {process.returncode}"
                )
