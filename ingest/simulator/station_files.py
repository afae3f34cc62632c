"""The files of a simulated station, from templates: those that `gyrofleet run` needs, and those of the simulation."""

import socket
import time
from collections.abc import Sequence
from enum import StrEnum
from importlib.resources import files
from pathlib import Path
from string import Template

import msgspec

from ingest.simulator.can_frames import MESSAGES_OF_IMU
from ingest.simulator.physics.positions import POSITION_NAMES
from stream.decoding import decode_json
from stream.errors import BadInput
from stream.identity import check_name


class Device(StrEnum):
    """What the units of a simulated station are."""

    GYRO = "gyro"  # one axis
    IMU = "imu"  # three gyros and three accelerometers


STATION, SIMULATION, PLAN, UNITS = "station.toml", "simulation.json", "fleet.toml", "units.csv"
MULTICAST = "239.74.163.2"
FIRST_ID = 0x100

# files of a station, and their templates where a device has its own
_FILES = (PLAN, "gyros.dbc", "gyros.toml", UNITS)
_OF_IMU = {PLAN: "imu_fleet.toml", "gyros.dbc": "imu.dbc", "gyros.toml": "imu.toml"}
_DAYS_BACK_NS = 30 * 86_400 * 10**9


class Simulation(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`simulation.json`: clock, ports and place of the station."""

    speed: float
    start_ns: int
    origin_s: float
    ports: dict[str, int]  # TCP port of every instrument by name, and of `world`, which serves their courses
    multicast_port: int  # UDP port of the CAN bus
    latitude_deg: float = 39.9
    position: str = "input_up"  # orientation of the units on the table
    device: Device = Device.GYRO


def write_station(
    folder: Path, units: Sequence[str], *, speed: float, rate_hz: float, seed: int, now_s: float | None = None,
    device: Device = Device.GYRO,
) -> None:  # fmt: skip
    """Write the files that do not exist yet; raises BadInput if they cannot be, or a unit cannot be a name."""
    for unit in units:
        check_name("unit", unit)
    now_s = time.time() if now_s is None else now_s
    # a fast clock is soon in the future, so it starts in the past
    start_ns = round(now_s * 1e9) - (_DAYS_BACK_NS if speed > 1.0 else 0)
    ports = dict(zip(("chamber", "table", "vibration", "supply", "world"), _free_ports(5), strict=True))
    (multicast_port,) = _free_ports(1, socket.SOCK_DGRAM)
    is_imu = device is Device.IMU
    simulation = Simulation(
        speed=speed, start_ns=start_ns, origin_s=now_s, ports=ports, multicast_port=multicast_port, device=device,
        position="Z_up" if is_imu else "input_up",
    )  # fmt: skip
    step = MESSAGES_OF_IMU if is_imu else 1
    own = dict(zip("xyzt", range(FIRST_ID, FIRST_ID + step), strict=False))
    values = {
        **msgspec.structs.asdict(simulation),
        **ports,
        "multicast": MULTICAST,
        "slots": "".join(f'[slots.S{i}]\npower = "supply"\n\n' for i in range(1, len(units) + 1)).rstrip("\n"),
        "ids": _ids(units, FIRST_ID, step),
        **{f"ids_{name}": _ids(units, first, step) for name, first in own.items()},
        "positions": _position_commands() if is_imu else "",
        "interval_s": 1.0 / rate_hz,
        "seed": seed,
        "units": ", ".join(f'"{unit}"' for unit in units),
        "sample_interval_ns": round(1e9 / rate_hz),
        "rows": "\n".join(
            f"{unit},S{i},SIM,{device.upper().replace('GYRO', 'FOG')}-SIM" for i, unit in enumerate(units, 1)
        ),
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / SIMULATION).exists():
            (folder / SIMULATION).write_bytes(msgspec.json.format(msgspec.json.encode(simulation)) + b"\n")
            (folder / STATION).write_text(_filled(STATION, values))
        for name in _FILES:
            template = _OF_IMU.get(name, name) if is_imu else name
            if not (folder / name).exists():
                (folder / name).write_text(_filled(template, values))
    except OSError as error:
        raise BadInput(f"the simulated station's folder {folder} cannot be written: {error}") from error


def _ids(units: Sequence[str], first: int, step: int) -> str:
    return ", ".join(f'"{unit}" = {first + step * i:#x}' for i, unit in enumerate(units))


def _position_commands() -> str:
    """The positions to which the table carries the units, as a table of the station's file."""
    lines = (f'{name} = "POS {name}"' for name in POSITION_NAMES)
    return "\n".join(["", "[instruments.table.positions]", *lines, ""])


def _filled(name: str, values: dict[str, object]) -> str:
    return Template(files("ingest.simulator").joinpath("station_template", name).read_text()).substitute(values)


def read_simulation(folder: Path) -> Simulation:
    """Read `simulation.json` of a folder."""
    path = folder / SIMULATION
    try:
        return decode_json(path.read_bytes(), Simulation)
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
