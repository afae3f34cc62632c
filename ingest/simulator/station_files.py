"""The files of a simulated station: what `gyrofleet run` needs to find it, and what the simulation plays."""

import socket
import time
from collections.abc import Sequence
from pathlib import Path

import msgspec

from stream.errors import BadInput
from stream.identity import check_name

STATION, SIMULATION, PLAN, DBC, MAPPING, UNITS = (
    "station.toml", "simulation.json", "fleet.toml", "gyros.dbc", "gyros.toml", "units.csv",
)  # fmt: skip
MULTICAST = "239.74.163.2"
FIRST_ID = 0x100

_DAYS_BACK_NS = 30 * 86_400 * 10**9


class Simulation(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`simulation.json`: how the station is played.

    Parameters
    ----------
    speed, start_ns, origin_s: Its clock, as in the station's file.
    ports: TCP port of every instrument by name, and of `world`.
    multicast_port: UDP port of the CAN bus.
    latitude_deg: Where it stands.
    position: How the gyros stand on the table.
    """

    speed: float
    start_ns: int
    origin_s: float
    ports: dict[str, int]
    multicast_port: int
    latitude_deg: float = 39.9
    position: str = "input_up"


def write_station(
    folder: Path, units: Sequence[str], *, speed: float, rate_hz: float, seed: int, now_s: float | None = None
) -> None:
    """Write the files that are not there yet; those that are stay as they are.

    Raises
    ------
    BadInput: If the folder cannot be written, or a unit cannot be a name.
    """
    for unit in units:
        check_name("unit", unit)
    now_s = time.time() if now_s is None else now_s
    # a fast clock is soon in the future, so it starts in the past
    start_ns = round(now_s * 1e9) - (_DAYS_BACK_NS if speed > 1.0 else 0)
    ports = dict(zip(("chamber", "table", "vibration", "supply", "world"), _free_ports(5), strict=True))
    simulation = Simulation(
        speed=speed, start_ns=start_ns, origin_s=now_s, ports=ports, multicast_port=_free_udp_port()
    )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / SIMULATION).exists():
            (folder / SIMULATION).write_bytes(msgspec.json.format(msgspec.json.encode(simulation)) + b"\n")
            (folder / STATION).write_text(_station(simulation, units))
        texts = {
            PLAN: _fleet(units, rate_hz, seed),
            DBC: _DATABASE,
            MAPPING: _mapping(units, rate_hz),
            UNITS: "serial,slot,lot,product\n"
            + "".join(f"{unit},S{i},SIM,FOG-SIM\n" for i, unit in enumerate(units, 1)),
        }
        for name, text in texts.items():
            if not (folder / name).exists():
                (folder / name).write_text(text)
    except OSError as error:
        raise BadInput(f"the simulated station's folder {folder} cannot be written: {error}") from error


def read_simulation(folder: Path) -> Simulation:
    """How the station in a folder is played.

    Raises
    ------
    BadInput: If the folder has no such file, or it cannot be read.
    """
    path = folder / SIMULATION
    try:
        return msgspec.json.decode(path.read_bytes(), type=Simulation)
    except (OSError, msgspec.DecodeError) as error:
        raise BadInput(f"{path} is no simulated station: {error}; `gyrofleet simulate FOLDER` makes one") from error


def _station(simulation: Simulation, units: Sequence[str]) -> str:
    """The station file: what a real one would have as well, but for the clock."""
    resource = {name: f"TCPIP::127.0.0.1::{port}::SOCKET" for name, port in simulation.ports.items()}
    slots = "".join(f'[slots.S{i}]\npower = "supply"\n\n' for i in range(1, len(units) + 1))
    return f"""[station]
site = "simulated"
name = "bench"
latitude_deg = {simulation.latitude_deg}
time_zone = "UTC"
simulated = true

[clock]          # a real station has none
speed = {simulation.speed}
start_ns = {simulation.start_ns}
origin_s = {simulation.origin_s!r}

[instruments.chamber]
kind = "temperature_chamber"
resource = "{resource["chamber"]}"
sample_interval_s = 10.0

[instruments.table]
kind = "rate_table"
resource = "{resource["table"]}"
sample_interval_s = 5.0
max_rate_deg_per_s = 400.0

[instruments.vibration]
kind = "vibration_table"
resource = "{resource["vibration"]}"
sample_interval_s = 2.0
max_amplitude_deg_per_s = 200.0

[instruments.supply]
kind = "power_supply"
resource = "{resource["supply"]}"
sample_interval_s = 10.0
max_voltage_v = 12.0
max_current_a = 10.0

[buses.can]
dbc = ["{DBC}"]
mapping = "{MAPPING}"

[buses.can.bus]
interface = "udp_multicast"
channel = "{MULTICAST}"
options = {{ port = {simulation.multicast_port} }}

{slots}"""


_DATABASE = """VERSION ""

NS_ :

BS_:

BU_: GYRO HOST

BO_ 256 GYRO: 8 GYRO
 SG_ RATE : 0|32@1- (5E-05,0) [0|0] "deg/s" HOST
 SG_ TEMPERATURE : 32|16@1- (0.01,0) [0|0] "degC" HOST
 SG_ COUNTER : 48|16@1+ (1,0) [0|0] "" HOST
"""


def _mapping(units: Sequence[str], rate_hz: float) -> str:
    ids = ", ".join(f'"{unit}" = {FIRST_ID + i:#x}' for i, unit in enumerate(units))
    return f"""[[message]]
message = "GYRO"
ids = {{ {ids} }}
signals = {{ RATE = "rate", TEMPERATURE = "temperature" }}
counter = {{ signal = "COUNTER", modulus = 65536 }}
interval_s = {1.0 / rate_hz!r}
"""


def _fleet(units: Sequence[str], rate_hz: float, seed: int) -> str:
    names = ", ".join(f'"{unit}"' for unit in units)
    return f"""# What is planted in the simulated gyros; see ingest/simulator/physics.
[fleet]
seed = {seed}
units = [{names}]
sample_interval_ns = {round(1e9 / rate_hz)}

[fleet.scale]
error_ppm = {{ mean = 0.0, sd = 500.0 }}
nonlinearity_ppm = [{{ mean = 0.0, sd = 20.0 }}, {{ mean = 0.0, sd = 20.0 }}]
asymmetry_ppm = {{ mean = 0.0, sd = 10.0 }}
temperature_ppm_per_deg_c = {{ mean = 5.0, sd = 2.0 }}

[fleet.bias]
constant_deg_per_h = {{ mean = 0.0, sd = 1.0 }}
turn_on_deg_per_h = 0.05
warm_up = [{{ amplitude_deg_per_h = 0.3, time_constant_s = 300.0 }}]

[fleet.thermal]
lag_s = 120.0
bias_polynomial_deg_per_h = [{{ mean = 0.03, sd = 0.01 }}]

[fleet.noise]
angle_random_walk_deg_per_sqrt_h = {{ mean = 0.02, sd = 0.003, low = 0.005 }}
bias_instability_deg_per_h = 0.1
rate_random_walk_deg_per_h_per_sqrt_h = 0.03
"""


def _free_ports(n: int) -> list[int]:
    sockets = [socket.socket() for _ in range(n)]
    try:
        for each in sockets:
            each.bind(("127.0.0.1", 0))
        return [each.getsockname()[1] for each in sockets]
    finally:
        for each in sockets:
            each.close()


def _free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])
