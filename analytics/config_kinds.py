"""Every kind of file that people write for gyrofleet, how it is recognised, and how it is checked."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import click
import msgspec

from stream.errors import BadInput, GyrofleetError
from stream.files.toml_text import decode_toml
from stream.mistakes import collected, listed
from stream.roles.config_file import check_config
from stream.security.pem_text import fault_of_pem
from stream.security.site_rules import RULES_FILE
from stream.terminal.console import counted

_MOST_BYTES = 16 << 20
_SETTINGS = "settings"
Commands = Mapping[str, click.Command]


class Checked(msgspec.Struct, frozen=True, kw_only=True):
    """A file: what it is and what it has; or the `problem`, with file, key and what is expected."""

    file: str
    kind: str
    text: str = ""
    problem: str = ""


class Kind(NamedTuple):
    """A kind of file: whether a tree of TOML is one, and its check, which returns a few words or raises BadInput."""

    fits: Callable[[Mapping[str, Any]], bool]
    check: Callable[[Path], str]


def _has(*keys: str) -> Callable[[Mapping[str, Any]], bool]:
    return lambda tree: all(key in tree for key in keys)


def _station(path: Path) -> str:
    from ingest.can.mapping import CanMapping
    from ingest.run.station_security import station_security
    from ingest.serial.frame_layout import load_layout
    from ingest.station.serial_devices import SerialDevices
    from ingest.station.station import load_station

    found = load_station(path)
    wrong: list[str] = []
    with collected(wrong):
        SerialDevices().add(found, found.lines)
    with collected(wrong):
        found.make_instruments(found.make_clock())
    with collected(wrong):
        station_security(path)
    for bus in found.buses.values():
        with collected(wrong):
            CanMapping([found.beside(each) for each in bus.dbc], found.beside(bus.mapping)).plan()
    for line in found.lines.values():
        with collected(wrong):
            load_layout(found.beside(line.layout))
    if wrong:
        raise BadInput(listed(wrong))
    return f"{counted(len(found.instruments), 'instrument')}, {counted(len(found.slots), 'slot')}"


def _units(path: Path) -> str:
    from ingest.station.units_file import read_units

    return counted(len(read_units(str(path)).entries), "unit")


def _specification(path: Path) -> str:
    from analytics.specifications.checking import checked_specification
    from storage.specifications.specification import read_specification

    found = checked_specification(read_specification(path), str(path))
    return f"{found.label}, {counted(len(found.limits), 'limit')}"


def _alerts(path: Path) -> str:
    from analytics.alerts.rules import load_rules

    found = load_rules(path)
    return f"{counted(len(found.rules), 'rule')}, {counted(len(found.targets), 'target')}"


def _procedure(path: Path) -> str:
    from ingest.procedures.procedure import load_procedure

    found = load_procedure(str(path))
    return f"{found.name}, {counted(len(found.steps({})), 'step')}"


def _fleet(path: Path) -> str:
    from ingest.simulator.physics.plan import load_imu_plan, load_plan

    try:
        units = load_plan(path).units
    except BadInput as error:
        try:
            units = load_imu_plan(path).units
        except BadInput:
            raise error from None
    return counted(len(units), "unit")


def _mapping(path: Path) -> str:
    from ingest.can.mapping_file import read_mapping

    return counted(len(read_mapping(path)), "message")


def _frame(path: Path) -> str:
    from ingest.serial.frame_layout import load_layout

    return counted(len(load_layout(path).fields), "field")


def _order(path: Path) -> str:
    from analytics.certificate.statement.order import read_order
    from analytics.certificate.statement.words import Words

    found = read_order(path)
    return f"laboratory {Words.of(found.laboratory.name).en}" if found.laboratory is not None else "no laboratory"


def _users(path: Path) -> str:
    from analytics.serve.doors.users_file import read_users

    return counted(len(read_users(path)), "user")


def _login(path: Path) -> str:
    from analytics.serve.doors.login_file import LoginFile

    found = LoginFile.read(path)
    found.check_secrets()
    return ", ".join(name for name in ("oidc", "proxy") if getattr(found, name) is not None)


def _site(path: Path) -> str:
    from stream.security.site_rules import read_site_rules

    return f"two persons for {', '.join(read_site_rules(path).two_persons) or 'nothing'}"


def _access(path: Path) -> str:
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePublicKey
    from cryptography.x509 import load_pem_x509_certificate

    from stream.security.access import read_access_list
    from stream.security.credentials import SITE_CERTIFICATE

    beside = path.parent / SITE_CERTIFICATE
    try:
        key = load_pem_x509_certificate(beside.read_bytes()).public_key()
    except (OSError, ValueError) as error:
        raise BadInput(f"{path}: the site's certificate {beside} is needed beside it to check it: {error}") from error
    if not isinstance(key, EllipticCurvePublicKey):
        raise BadInput(f"{beside}: its key is not of the curve P-256; copy it from the site's folder")
    found = read_access_list(path, key)
    return f"{len(found.admitted)} admitted, {len(found.revoked)} revoked"


# in the order in which a file is tried
KINDS: dict[str, Kind] = {
    "station": Kind(_has("station"), _station),
    "specification": Kind(_has("revision"), _specification),
    "alerts": Kind(_has("rules"), _alerts),
    "procedure": Kind(lambda tree: "step" in tree or {"name", "names"} <= tree.keys(), _procedure),
    "fleet": Kind(_has("fleet"), _fleet),
    "mapping": Kind(_has("message"), _mapping),
    "frame": Kind(_has("sync"), _frame),
    "order": Kind(lambda tree: bool({"laboratory", "customer", "people"} & tree.keys()), _order),
    "users": Kind(_has("users"), _users),
    "login": Kind(lambda tree: bool({"oidc", "proxy"} & tree.keys()), _login),
    "site": Kind(_has("two_persons"), _site),
    "units": Kind(lambda _tree: False, _units),
    "access": Kind(lambda _tree: False, _access),
    _SETTINGS: Kind(lambda _tree: False, lambda _path: ""),
}


def checked(path: Path, kind: str | None, commands: Commands) -> Checked:
    """Check a file; `commands` are the roles that settings may have tables of."""
    try:
        if kind is None or path.is_file():  # a pipe can be read only once
            content = _content_of(path)
            kind = kind or _kind_of(path, content, commands)
        is_settings = kind == _SETTINGS
        text = ", ".join(check_config(path, commands)) or "no role" if is_settings else KINDS[kind].check(path)
    except GyrofleetError as error:
        named = str(error) if str(path) in str(error) else f"{path}: {error}"
        return Checked(file=str(path), kind=kind or "", problem=named)
    return Checked(file=str(path), kind=kind, text=text)


def checked_together(found: Sequence[Checked]) -> list[Checked]:
    """Stations that are well each by itself, and have a serial device in common, are not."""
    from ingest.station.serial_devices import SerialDevices
    from ingest.station.station import load_station

    devices, together = SerialDevices(), []
    files: set[Path] = set()
    for each in found:
        path = Path(each.file)
        if each.kind == "station" and not each.problem and (file := path.resolve()) not in files:
            files.add(file)
            try:
                station = load_station(path)
                devices.add(station, station.lines)
            except GyrofleetError as error:
                each = Checked(file=each.file, kind=each.kind, problem=str(error))
        together.append(each)
    return together


def _content_of(path: Path) -> bytes:
    """The content of a file; BadInput if it cannot be read, or is a key or a certificate."""
    try:
        with path.open("rb") as file:
            content = file.read(_MOST_BYTES)
    except OSError as error:
        raise BadInput(f"{path} cannot be read: {error.strerror or error}") from error
    if fault := fault_of_pem(content):
        raise BadInput(f"{path}: {fault}")
    return content


def _kind_of(path: Path, content: bytes, commands: Commands) -> str:
    """What a file is, by its name and its first keys."""
    if path.name == RULES_FILE:
        return "site"
    if path.suffix == ".json":
        return _kind_of_json(path, content)
    if path.suffix != ".toml":
        return "units"
    try:
        tree = decode_toml(content, dict[str, Any])
    except msgspec.MsgspecError as error:
        raise BadInput(f"{path}: {error}") from error
    found = [name for name, each in KINDS.items() if each.fits(tree)]
    if found:
        return found[0]
    if tree.keys() & commands.keys():
        return _SETTINGS
    known = ", ".join(KINDS)
    raise BadInput(f"{path}: its keys ({', '.join(tree) or 'none'}) are those of no kind; say which by --as: {known}")


def _kind_of_json(path: Path, content: bytes) -> str:
    try:
        tree = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{path}: it is no JSON: {error}") from error
    if isinstance(tree, dict) and {"content", "signature"} <= tree.keys():
        return "access"
    raise BadInput(f"{path}: the only JSON that is checked is an access list of a site (access.json)")
