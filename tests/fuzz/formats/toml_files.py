"""Files that people write in TOML: the station, procedures, specifications, alerts, logins, orders, CAN mappings."""

import re
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

import click

from analytics.alerts.rules import load_rules
from analytics.certificate.statement.order import read_order
from analytics.commands.services.config import roles
from analytics.serve.doors.login_file import LoginFile
from analytics.serve.doors.roles import Role as PersonRole
from analytics.serve.doors.users_file import add_certificate, add_person, add_program, read_users
from gyrofleet import main
from ingest.can.mapping import CanMapping
from ingest.procedures.file import ready_names
from ingest.procedures.procedure import load_procedure
from ingest.run.station_security import station_security
from ingest.serial.frame_layout import load_layout
from ingest.simulator.physics.plan import load_plan
from ingest.simulator.station_files import write_station
from ingest.station.station import load_station
from storage.specifications.specification import check_names, parse_specification, read_specification
from stream.roles.config_file import check_config
from stream.security.certificate_authority import Site
from stream.security.rights import Role
from stream.security.site_rules import read_site_rules
from tests.fuzz.format import Format
from tests.fuzz.mutations import mutated_toml
from tests.fuzz.trees import made_by

_DOCS = Path(__file__).resolve().parents[3] / "docs"
_LAYOUT = """sync = "AA 55"
length = 12
interval_s = 0.005
byte_order = "little"
counter = {at = 2, type = "u8"}
checksum = {kind = "crc16-modbus", at = -2, start = 2}
fields = [{signal = "rate", at = 3, type = "i32"}]
"""
_SCREENING = """revision = "7"

[[limit]]
characteristic = "allan_deviation"
signal = "rate"
tau_s = 100.0
upper = 0.2
unit_of_measure = "deg/h"
"""


def _of_page(page: str, *wanted: int) -> list[bytes]:
    """The examples of a page of the documentation, by their numbers on it."""
    found = re.findall(r"```toml\n(.*?)```", (_DOCS / "how-to" / page).read_text(encoding="utf-8"), re.DOTALL)
    return [found[number].encode() for number in wanted]


def _simulated(name: str) -> Callable[[Path], list[bytes]]:
    """A file of a simulated station."""

    def made(folder: Path) -> list[bytes]:
        write_station(folder, ["G-1", "G-2"], speed=1.0, rate_hz=10.0, seed=1, now_s=1.7e9)
        return [(folder / name).read_bytes()]

    return made


def _stations(folder: Path) -> list[bytes]:
    return [*_simulated("station.toml")(folder), *_of_page("station.md", 2)]


def _read_station(path: Path) -> None:
    station_security(path)
    station = load_station(path)
    assert station.standards_details is not None
    assert station.table.details is not None
    station.make_instruments(station.make_clock())


def _procedures(_folder: Path) -> list[bytes]:
    chosen = [files("ingest.procedures").joinpath(f"{name}.toml").read_bytes() for name in ready_names()[::4]]
    return [*chosen, *_of_page("station.md", 0)]


def _read_procedure(path: Path) -> None:
    procedure = load_procedure(path)
    procedure.requirements()
    procedure.duration_s()


def _read_specification(path: Path) -> None:
    specification = parse_specification(read_specification(path), str(path))
    check_names(specification, str(path))


def _users(folder: Path) -> list[bytes]:
    path = folder / "users.toml"
    add_person(path, "li", PersonRole.ENGINEER, "a long pass phrase")
    add_program(path, "poller", PersonRole.VIEWER)
    add_certificate(path, "wang", PersonRole.OPERATOR, "CN=Wang,O=Plant")
    return [path.read_bytes()]


def _mapping_database(folder: Path) -> None:
    write_station(folder, ["G-1", "G-2"], speed=1.0, rate_hz=10.0, seed=1, now_s=1.7e9)


def _make_what_settings_name(folder: Path) -> None:
    Site.create(folder / "site").add(Role.RECORDER, "recorder", days=30)
    add_person(folder / "users.toml", "li", PersonRole.ENGINEER, "a long pass phrase")


def _settings_around(folder: Path) -> None:
    made_by(_make_what_settings_name).write(folder)


def _roles() -> dict[str, click.Command]:
    with click.Context(main):
        return {name: command for name, (_, command) in roles().items()}


def _toml(
    name: str, seeds: Callable[[Path], list[bytes]], read: Callable[[Path], object],
    around: Callable[[Path], None] | None = None, gate_inputs: int = 80,
) -> Format:  # fmt: skip
    return Format(name, seeds, read, mutated_toml, f"{name}.toml", around, gate_inputs=gate_inputs)


FORMATS = [
    _toml("station", _stations, _read_station),
    _toml("procedure", _procedures, _read_procedure),
    _toml("specification", lambda _: _of_page("specifications.md", 0), _read_specification),
    _toml("screening", lambda _: [_SCREENING.encode()], _read_specification, gate_inputs=50),
    _toml("alerts", lambda _: _of_page("alerts.md", 0), load_rules),
    _toml("users", _users, read_users, gate_inputs=100),
    _toml("login", lambda _: [*_of_page("serve.md", 0), *_of_page("serve.md", 1)], LoginFile.read),
    _toml("order", lambda _: _of_page("certificates.md", 0), read_order),
    _toml(
        "mapping", _simulated("gyros.toml"),
        lambda path: CanMapping([path.parent / "gyros.dbc"], path).plan(), _mapping_database, gate_inputs=50,
    ),
    _toml("layout", lambda _: [_LAYOUT.encode()], load_layout),
    _toml("fleet", _simulated("fleet.toml"), load_plan),
    _toml("site rules", lambda _: [b'two_persons = ["models", "certificates"]\n'], read_site_rules),
    _toml(
        "settings", lambda _: _of_page("operations.md", 0), lambda path: check_config(path, _roles()), _settings_around
    ),
]  # fmt: skip
