"""The files of a simulated station, from templates: those that `gyrofleet run` needs, and those of the simulation."""

import socket
import time
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from string import Template

import msgspec

from stream.errors import BadInput
from stream.identity import check_name

STATION, SIMULATION, PLAN, UNITS = "station.toml", "simulation.json", "fleet.toml", "units.csv"
MULTICAST = "239.74.163.2"
FIRST_ID = 0x100

_TEMPLATES = (PLAN, "gyros.dbc", "gyros.toml", UNITS)
_DAYS_BACK_NS = 30 * 86_400 * 10**9


class Simulation(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`simulation.json`: clock, ports and place of the station."""

    speed: float
    start_ns: int
    origin_s: float
    ports: dict[str, int]  # TCP port of every instrument by name, and of `world`, which serves their courses
    multicast_port: int  # UDP port of the CAN bus
    latitude_deg: float = 39.9
    position: str = "input_up"  # orientation of the gyros on the table


def write_station(
    folder: Path, units: Sequence[str], *, speed: float, rate_hz: float, seed: int, now_s: float | None = None
) -> None:
    """Write the files that do not exist yet; raises BadInput if they cannot be, or a unit cannot be a name."""
    for unit in units:
        check_name("unit", unit)
    now_s = time.time() if now_s is None else now_s
    # a fast clock is soon in the future, so it starts in the past
    start_ns = round(now_s * 1e9) - (_DAYS_BACK_NS if speed > 1.0 else 0)
    ports = dict(zip(("chamber", "table", "vibration", "supply", "world"), _free_ports(5), strict=True))
    (multicast_port,) = _free_ports(1, socket.SOCK_DGRAM)
    simulation = Simulation(speed=speed, start_ns=start_ns, origin_s=now_s, ports=ports, multicast_port=multicast_port)
    values = {
        **msgspec.structs.asdict(simulation),
        **ports,
        "multicast": MULTICAST,
        "slots": "".join(f'[slots.S{i}]\npower = "supply"\n\n' for i in range(1, len(units) + 1)).rstrip("\n"),
        "ids": ", ".join(f'"{unit}" = {FIRST_ID + i:#x}' for i, unit in enumerate(units)),
        "interval_s": 1.0 / rate_hz,
        "seed": seed,
        "units": ", ".join(f'"{unit}"' for unit in units),
        "sample_interval_ns": round(1e9 / rate_hz),
        "rows": "\n".join(f"{unit},S{i},SIM,FOG-SIM" for i, unit in enumerate(units, 1)),
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / SIMULATION).exists():
            (folder / SIMULATION).write_bytes(msgspec.json.format(msgspec.json.encode(simulation)) + b"\n")
            (folder / STATION).write_text(_filled(STATION, values))
        for name in _TEMPLATES:
            if not (folder / name).exists():
                (folder / name).write_text(_filled(name, values))
    except OSError as error:
        raise BadInput(f"the simulated station's folder {folder} cannot be written: {error}") from error


def _filled(name: str, values: dict[str, object]) -> str:
    return Template(files("ingest.simulator").joinpath("station_template", name).read_text()).substitute(values)


def read_simulation(folder: Path) -> Simulation:
    """Read `simulation.json` of a folder."""
    path = folder / SIMULATION
    try:
        return msgspec.json.decode(path.read_bytes(), type=Simulation)
    except (OSError, msgspec.DecodeError) as error:
        raise BadInput(f"{path} is no simulated station: {error}; `gyrofleet simulate FOLDER` makes one") from error


def _free_ports(n: int, kind: socket.SocketKind = socket.SOCK_STREAM) -> list[int]:
    sockets = [socket.socket(socket.AF_INET, kind) for _ in range(n)]
    try:
        for each in sockets:
            each.bind(("127.0.0.1", 0))
        return [each.getsockname()[1] for each in sockets]
    finally:
        for each in sockets:
            each.close()
