"""`gyrofleet site` and the refusal of an unprotected network, from the command line."""

import json
import os
import stat
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from gyrofleet import main
from stream.security.certificate_authority import Site
from stream.security.credentials import load_credentials
from stream.security.rights import Role

BEYOND = ("tcp/0.0.0.0:7447", "tcp/[::]:7447", "tcp/10.1.2.3:7447", "tcp/plant.example:7447", "udp/224.0.0.1:7447")
LISTENING = (
    ("record", "--store", "STORE", "--listen"),
    ("router", "--listen"),
    ("replicate", "--serve", "--store", "STORE", "--listen"),
    ("import", "FILE", "--store", "STORE", "--listen"),
)
CONNECTING = (
    ("record", "--store", "STORE", "--connect"),
    ("estimate", "--store", "STORE", "--connect"),
    ("compensate", "--store", "STORE", "--connect"),
    ("import", "FILE", "--store", "STORE", "--connect"),
    ("run-simulated", "--run", "r1", "--simulate", "1", "--store", "STORE", "--connect"),
)


def invoke(*arguments: object) -> tuple[int, str]:
    done = CliRunner().invoke(main, [str(each) for each in arguments])
    return done.exit_code, done.output


@pytest.mark.parametrize("address", BEYOND)
@pytest.mark.parametrize("command", [*LISTENING, *CONNECTING], ids=lambda command: f"{command[0]}{command[-1]}")
def test_no_command_reaches_the_network_unprotected(command: tuple[str, ...], address: str, tmp_path: Path) -> None:
    words = [{"STORE": str(tmp_path / "store"), "FILE": str(tmp_path / "a.csv")}.get(each, each) for each in command]
    code, text = invoke(*words, address)
    assert code == 2
    assert "--security" in text
    assert "--insecure" in text
    assert not (tmp_path / "store").exists()


def test_a_site_is_made_listed_renewed_and_revoked(tmp_path: Path) -> None:
    site = tmp_path / "site"
    assert invoke("site", "init", site)[0] == 0
    assert invoke("site", "add-station", site, "chamber-2", "--days", 2)[0] == 0
    for path in (site / "ca.key", site / "station/chamber-2/key.pem", site / "recorder/recorder/key.pem"):
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
    key = (site / "station/chamber-2/key.pem").read_bytes()
    code, text = invoke("site", "add-station", site, "chamber-2")
    assert code == 1
    assert "never overwritten" in text
    assert "keys are never overwritten" in invoke("site", "init", site)[1]
    before = _listed(site)["chamber-2"]
    assert invoke("site", "renew", site, "station:chamber-2", "--days", 40)[0] == 0
    after = _listed(site)["chamber-2"]
    assert after["until_ns"] - before["until_ns"] > 37 * 86_400e9
    assert (site / "station/chamber-2/key.pem").read_bytes() == key
    assert invoke("site", "revoke", site, "station:chamber-2")[0] == 0
    assert _listed(site)["chamber-2"]["state"] == "revoked"
    for again in (("renew", site, "station:chamber-2"), ("add-station", site, "chamber-2")):
        code, text = invoke("site", *again)
        assert code == 1
        assert "revoked" in text


@pytest.mark.parametrize("name", ["../up", "a/b", "", "a b", "*", ".hidden", "@x", "x" * 60, "lake", "recorder"])
def test_a_name_is_an_identity(name: str, tmp_path: Path) -> None:
    invoke("site", "init", tmp_path / "site")
    code, text = invoke("site", "add-station", tmp_path / "site", name)
    assert code == 1, text
    assert sorted(path.name for path in (tmp_path / "site").iterdir()) == ["ca.key", "ca.pem", "recorder", "site.json"]


def test_a_key_that_others_can_read_is_refused(tmp_path: Path) -> None:
    invoke("site", "init", tmp_path / "site")
    (tmp_path / "site/recorder/recorder/key.pem").chmod(0o644)
    code, text = invoke(
        "record", "--store", tmp_path / "s", "--listen", "tcp/0.0.0.0:0", "--security", tmp_path / "site"
    )
    assert code == 1
    assert "chmod 600" in text


def test_a_certificate_of_another_role_is_refused(tmp_path: Path) -> None:
    invoke("site", "init", tmp_path / "site")
    invoke("site", "add-station", tmp_path / "site", "c1")
    code, text = invoke("record", "--store", tmp_path / "s", "--security", tmp_path / "site/station/c1")
    assert code == 1
    assert "needs a certificate of role recorder" in text


def _listed(site: Path) -> dict[str, dict[str, Any]]:
    return {each["name"]: each for each in json.loads(invoke("site", "list", site, "--json")[1])}


@pytest.mark.parametrize("what", ["file", "dangling", "loop", "pipe"])
def test_no_site_is_made_where_something_else_is(tmp_path: Path, what: str) -> None:
    place = tmp_path / "site"
    if what == "file":
        place.write_text("x")
    elif what == "pipe":
        os.mkfifo(place)
    else:
        place.symlink_to(place if what == "loop" else tmp_path / "nowhere")
    code, text = invoke("site", "init", place)
    assert code in (1, 2)
    assert f"{place} cannot be made" in text or "is a file" in text


def test_a_damaged_certificate_is_named_and_can_be_revoked(tmp_path: Path) -> None:
    site = tmp_path / "site"
    invoke("site", "init", site)
    path = site / "recorder" / "recorder" / "certificate.pem"
    path.write_text("-----BEGIN CERTIFICATE-----\n")
    for words in (("renew", site, "recorder:recorder"), ("add-station", site, "chamber-3")):
        code, text = invoke("site", *words)
        assert code == 1
        assert str(path) in text.replace("\n", "")
    assert invoke("site", "revoke", site, "recorder:recorder")[0] == 0
    assert invoke("site", "add-station", site, "chamber-3")[0] == 0, "nothing was left of the first try"
    (site / "station" / "killed").mkdir()
    code, text = invoke("site", "add-station", site, "killed")
    assert code == 1
    assert "an interrupted command has left it" in text


def test_what_many_commands_add_at_once_is_all_there(tmp_path: Path) -> None:
    """Each reads the index, and writes it whole."""
    site = tmp_path / "site"
    Site.create(site)
    sites = [Site(site) for _ in range(8)]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda number: sites[number].add(Role.STATION, f"c{number}", days=2.0), range(8)))
    assert [each.principal.name for each in Site(site).issued] == [f"c{number}" for number in range(8)]
    access = load_credentials(site / "station" / "c0").access
    assert len(access.admitted) == 8
