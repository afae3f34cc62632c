"""Files of a site's security, and the state of runs: access lists, certificates, the site's index, run states."""

import base64
import hashlib
import json
import random
from collections.abc import Callable
from pathlib import Path

import msgspec
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from ingest.run.live_run import RunParameters, RunState, begin_run
from ingest.run_record import read_state, write_state
from ingest.simulator.station_files import read_simulation, write_station
from storage.recording.command_box import FOLDER, GIVEN, CommandBox, RunCommand
from stream.events import RunAction
from stream.security.certificate_authority import Site
from stream.security.credentials import load_credentials
from stream.security.rights import Role
from tests.fuzz.format import Format
from tests.fuzz.mutations import mutated_json, mutated_lines
from tests.fuzz.trees import made_by

_OWN = "recorder/main"
_BOX = f"{FOLDER}/{hashlib.sha256(b'r1').hexdigest()[:32]}"


def _make_site(folder: Path) -> None:
    site = Site.create(folder)
    site.add(Role.RECORDER, "main", days=30)
    site.add(Role.STATION, "chamber-2", days=30)


def _site_around(folder: Path) -> None:
    made_by(_make_site).write(folder)


def _of_site(name: str) -> Callable[[Path], list[bytes]]:
    return lambda _folder: made_by(_make_site).contents(name)


def _mutated_access_list(content: bytes, rng: random.Random) -> bytes:
    """Other entries, signed by the site; or another file."""
    try:
        text = mutated_json(json.dumps(json.loads(content)["content"]).encode(), rng)
    except (ValueError, TypeError, KeyError, RecursionError):
        return mutated_json(content, rng)
    if rng.random() < 0.3:
        return mutated_json(content, rng)
    key = load_pem_private_key(made_by(_make_site).contents("ca.key")[0], None)
    assert isinstance(key, ec.EllipticCurvePrivateKey)
    signature = base64.b64encode(key.sign(text, ec.ECDSA(SHA256()))).decode()
    return b'{"content":' + text + b',"signature":"' + signature.encode() + b'"}'


def _read_access_list(path: Path) -> None:
    access = load_credentials(path.parent).access
    for principal in access.admitted:
        access.key_of(principal)
        access.reason_against(principal)


def _read_site(path: Path) -> None:
    site = Site(path.parent)
    for each in site.issued:
        if each.revoked_ns is None:
            site.renew(each.principal, days=1.0)


def _run_states(folder: Path) -> list[bytes]:
    parameters = RunParameters(
        simulate=2, rate_hz=10.0, batch=10, hours=1.0, speed=1.0, seed=1, site="plant", station="bench"
    )
    write_state(folder / "run.json", begin_run("r1", parameters, 10**18))
    return [(folder / "run.json").read_bytes()]


def _simulations(folder: Path) -> list[bytes]:
    write_station(folder, ["G-1"], speed=1.0, rate_hz=10.0, seed=1, now_s=1.7e9)
    return [(folder / "simulation.json").read_bytes()]


def _commands(_folder: Path) -> list[bytes]:
    command = RunCommand(
        id="c1", run="r1", action=RunAction.PAUSE, by="li", reason="door open", given_ns=1, expires_ns=2**61
    )
    return [msgspec.json.encode(command)]


def _box(folder: Path) -> None:
    CommandBox(folder, "r1").close()


def _take(path: Path) -> None:
    path.chmod(0o600)  # as the server writes it
    with CommandBox(path.parents[2], "r1") as box:
        list(box.take())


FORMATS = [
    Format("access list", _of_site(f"{_OWN}/access.json"), _read_access_list, _mutated_access_list,
           f"{_OWN}/access.json", _site_around, False, 100),
    Format("certificate", _of_site(f"{_OWN}/certificate.pem"), lambda path: load_credentials(path.parent),
           mutated_lines, f"{_OWN}/certificate.pem", _site_around, False, 100),
    Format("site", _of_site("site.json"), _read_site, mutated_json, "site.json", _site_around, True, 30),
    Format("run state", _run_states, lambda path: read_state(path, RunState), mutated_json, "run.json"),
    Format("simulation", _simulations, lambda path: read_simulation(path.parent), mutated_json, "simulation.json"),
    Format("run command", _commands, _take, mutated_json, f"{_BOX}/c1.{GIVEN}", _box, True, 100),
]  # fmt: skip
