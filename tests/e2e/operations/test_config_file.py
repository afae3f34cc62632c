"""One TOML file for roles, and the check of every kind of file: file, key, and what is expected."""

import json
import re
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from analytics.config_kinds import KINDS
from gyrofleet import main
from ingest.station.units_file import read_units
from storage.store import Store, writer_endpoint
from stream.errors import BadInput
from tests.secured_sites import make_site
from tests.sources import SOURCES

SETTINGS = """
store = "S"
log_level = "warning"
[record]
listen = "tcp/127.0.0.1:7999"
rotate_mb = 4
no_lake = true
[serve]
port = 0
name = ["bench-7"]
"""


def check(*words: object) -> tuple[int, list[dict[str, Any]]]:
    done = CliRunner().invoke(main, ["config", "check", *map(str, words), "--json"])
    return done.exit_code, json.loads(done.output)["files"]


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("rotate_mb = 4", 'rotate_mb = "4"', "record.rotate_mb is '4'; a whole number is expected, 1 or more"),
        ("rotate_mb = 4", "rotate_mb = 0", "record.rotate_mb: 0 is not in the range x>=1"),
        ("rotate_mb = 4", "rotate = 4", "record.rotate is not an option of `gyrofleet record`"),
        ("rotate_mb = 4", "rotate_md = 4", "did you mean rotate_mb?"),
        ("no_lake = true", 'no_lake = "yes"', "record.no_lake is 'yes'; true or false is expected"),
        ('name = ["bench-7"]', 'name = "bench-7"', "serve.name is 'bench-7'; a list is expected"),
        ('log_level = "warning"', 'log_level = "loud"', "log_level: 'loud' is not one of"),
        ("[record]", "[recorder]", "recorder is not a role, did you mean record?"),
        ('store = "S"', 'stores = "S"', "stores is not an option of a role, did you mean store?"),
        ("tcp/127.0.0.1:7999", "127.0.0.1", "record.listen: '127.0.0.1' is no address"),
        ('store = "S"', 'store = "S', "roles.toml: "),
        ("[serve]", "[record]", "roles.toml: "),
    ],
)  # fmt: skip
def test_a_wrong_setting_is_named(old: str, new: str, expected: str, tmp_path: Path) -> None:
    path = tmp_path / "roles.toml"
    path.write_text(SETTINGS)
    code, (right,) = check(path)
    assert (code, right["kind"], right["text"]) == (0, "settings", "record, serve")
    assert old in SETTINGS
    path.write_text(SETTINGS.replace(old, new))
    code, (wrong,) = check(path, "--as", "settings")
    assert code == 1
    assert expected in wrong["problem"]
    assert str(path) in wrong["problem"]


@pytest.mark.parametrize(
    ("words", "option", "table"),
    [
        (("serve", "--port", "0"), "users", "serve"),
        (("serve", "--port", "0"), "login", "serve"),
        (("alert", "run"), "rules", "alert"),
    ],
)
@pytest.mark.parametrize("content", [None, "x = ["])
def test_settings_name_files_that_can_be_used(
    words: tuple[str, ...], option: str, table: str, content: str | None, tmp_path: Path
) -> None:
    """Whoever starts roles again does not start one with exit code 2: its settings stay wrong."""
    path, named = tmp_path / "roles.toml", tmp_path / "named.toml"
    path.write_text(f'store = "S"\n[{table}]\n{option} = "named.toml"\n')
    Store.create(tmp_path / "S")
    if content is not None:
        named.write_text(content)
        named.chmod(0o600)
    code, (wrong,) = check(path)
    assert code == 1
    assert f"{path}: {table}.{option}: " in wrong["problem"]
    done = CliRunner().invoke(main, [*words, "--config", str(path)])
    assert (done.exit_code, str(named) in done.output) == (2, True), done.output


FILES = {
    "station": ('[station]\nsite = "a"\nname = "b"\ntime_zone = "UTC"\nlatitude_deg = 300.0\n', "latitude_deg"),
    "specification": ('revision = "A"\n[[limit]]\nmetric = "biass"\nupper = 1\nunit_of_measure = "deg/h"\n', "biass"),
    "alerts": ('[[rules]]\nname = "x"\nkind = "disc"\n', "disk"),
    "procedure": ('name = "a"\nnames = {en = "A", zh = "甲"}\n[[step]]\nname = "s"\nrecrod_s = 1\n', "record_s"),
    "fleet": ('[fleet]\nseed = -1\nunits = ["U1"]\n', "seed"),
    "mapping": ("[[message]]\nname = 3\n", "name"),
    "frame": ('sync = "zz"\ninterval_s = 0.1\nlength = 7\n[[fields]]\nsignal = "r"\nat = 3\ntype = "i24"\nunit = "V"\n',
              "sync"),
    "order": ('[laboratory]\nnam = "x"\n', "nam"),
    "users": ('[users.li]\nrole = "boss"\n', "role"),
    "login": ("[oidc]\nissuer = 3\n", "oidc"),
    "site": ('two_persons = ["everything"]\n', "two_persons"),
    "units": ("serial,slot\nFOG 1/2,A1\nFOG-2,A1\n", "line"),
    "access": ('{"content": {}, "signature": ""}', "access.json"),
    "settings": ("[record]\nrotate_mb = 0\n", "record.rotate_mb"),
}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_file_is_recognised_and_its_fault_named(kind: str, tmp_path: Path) -> None:
    content, key = FILES[kind]
    name = {"units": "units.csv", "access": "access.json"}.get(kind, f"{kind}.toml")
    path = tmp_path / name
    path.write_text(content)
    code, (found,) = check(path)
    assert (code, found["kind"]) == (1, kind)
    assert key in found["problem"]
    assert name in found["problem"]


WRONG_STATION = """
[station]
site = "a"
nmae = "b"
latitude_deg = "39"
[clock]
sped = 1.0
[instruments.table]
kind = "rate_table"
resource = "TCPIP::192.168.1.20::5025::SOCKET"
timeot_s = 1.0
sample_interval_s = "1"
[instruments.chamber]
kind = "fridge"
[standards.level]
calibration_due = "soon"
[lines.L1]
port = "/dev/ttyS0"
baud = 0
unit = "FOG-1"
layout = "x.toml"
[slots.S1]
power = "table"
"""


WRONG_RULES = """
[[rules]]
kind = "disk"
free_bg = 1
free_percent = "1"
[[rules]]
kind = "disc"
[targets.A]
kind = "fax"
"""


def test_all_mistakes_of_a_station_are_named(tmp_path: Path) -> None:
    path = tmp_path / "station.toml"
    path.write_text(WRONG_STATION)
    code, (found,) = check(path)
    assert code == 1
    for each in (
        "station.toml: 10 mistakes: ",
        "unknown field `nmae` - at `$.station`, did you mean name?",
        "missing required field `name` - at `$.station`",
        "Expected `float`, got `str` - at `$.station.latitude_deg`",
        "unknown field `sped` - at `$.clock`, did you mean speed?",
        "instruments.table (a rate_table): Object contains unknown field `timeot_s`, did you mean timeout_s?",
        "instruments.table (a rate_table): Expected `float`, got `str` - at `$.sample_interval_s`",
        "instruments.chamber.kind is 'fridge'; gyrofleet knows ",
        "standards.level: calibration_due is 'soon'",
        "lines.L1.baud is 0; ",
    ):
        assert each in found["problem"]


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("roles.toml", "stores = 1\n[record]\nrotate_mb = 0\nlisten = 3\n[serv]\n",
         ("4 mistakes: ", "stores is not", "record.rotate_mb: 0", "record.listen is 3", "serv is not a role")),
        ("alerts.toml", WRONG_RULES,
         ("4 mistakes: ", "unknown field `free_bg`, did you mean free_gb?", "$.free_percent", "'disc'", "'fax'")),
        ("p.toml", 'name = 1\n[[step]]\nnmae = "a"\n', ("3 mistakes: ", "$.name", "`names`", "$.step[0]", "`nmae`")),
    ],
)  # fmt: skip
def test_all_mistakes_of_a_file_are_named(name: str, content: str, expected: tuple[str, ...], tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text(content)
    code, (found,) = check(path, "--as", {"r": "settings", "a": "alerts", "p": "procedure"}[name[0]])
    assert code == 1
    for each in expected:
        assert each in found["problem"], found["problem"]


def test_two_users_of_a_serial_device_are_named(tmp_path: Path) -> None:
    fields = '[[fields]]\nsignal = "r"\nat = 3\ntype = "i24"\nunit = "V"\n'
    (tmp_path / "x.toml").write_text('sync = "55 AA"\ninterval_s = 0.1\nlength = 7\n' + fields)
    (tmp_path / "tty").touch()
    (tmp_path / "by-id").symlink_to(tmp_path / "tty")
    station = '[station]\nsite = "a"\nname = "{name}"\n'
    line = '[lines.{name}]\nport = "{port}"\nunit = "{name}"\nlayout = "x.toml"\n'
    for first, second in ((tmp_path / "tty", tmp_path / "by-id"), ("socket://box:7000", "socket://Box:7000/")):
        lines = line.format(name="L1", port=first), line.format(name="L2", port=second)
        whole, one, other = (tmp_path / name for name in ("whole.toml", "one.toml", "other.toml"))
        whole.write_text(station.format(name="b") + "".join(lines))
        code, (found,) = check(whole)
        named = f"are on one serial device, {first} and {second}: "
        assert (code, found["problem"].startswith(f"{whole}: lines.L1 and lines.L2 {named}")) == (1, True)
        for path, each in ((one, lines[0]), (other, lines[1])):
            path.write_text(station.format(name=path.stem) + each)
            assert check(path)[0] == check(path, path)[0] == 0
        code, (well, found) = check(one, other)
        assert (code, well["problem"]) == (1, "")
        assert found["problem"].startswith(f"{other}: lines.L1 of {one} and lines.L2 {named}")


def test_a_file_that_is_not_there_is_no_file_without_rules(tmp_path: Path) -> None:
    for name in ("site.toml", "users.toml"):
        done = CliRunner().invoke(main, ["config", "check", str(tmp_path / "nowhere" / name), "--json"])
        assert done.exit_code == 1
        assert "No such file" in done.output


@pytest.mark.parametrize("name", ["ca.key", "ca.csv", "ca.toml"])
@pytest.mark.parametrize("words", [(), ("--as", "units")])
@pytest.mark.parametrize("before", ["", "Bag Attributes\n    friendlyName: ca\n"])
def test_of_a_key_nothing_is_shown(name: str, words: tuple[str, ...], before: str, tmp_path: Path) -> None:
    line = "MC4CAQAwBQYDK2VwBCIEIMzXBPqRhkCVN8dmZK"
    (tmp_path / name).write_text(f"{before}-----BEGIN PRIVATE KEY-----\n{line}\n-----END PRIVATE KEY-----\n")
    done = CliRunner().invoke(main, ["config", "check", str(tmp_path / name), *words])
    assert done.exit_code == 1
    assert f"{name}: it is a key or a certificate" in done.output
    assert line not in done.output
    assert "BEGIN" not in done.output
    with pytest.raises(BadInput, match="it is a key or a certificate"):
        read_units(tmp_path / name)


def test_files_of_the_program_and_a_site_are_well(tmp_path: Path) -> None:
    make_site(tmp_path / "site")
    procedures = sorted((SOURCES / "ingest/procedures").glob("*.toml"))
    assert len(procedures) > 5
    (tmp_path / "units.csv").write_text("serial,product\nFOG-1,FOG-70\n")
    code, found = check(*procedures, tmp_path / "site/recorder/recorder/access.json", tmp_path / "units.csv")
    assert code == 0, found
    assert len(found) == len(procedures) + 2


@pytest.mark.long
def test_a_recorder_takes_its_settings_and_its_certificate_from_the_file(
    tmp_path: Path, spawn: Callable[..., subprocess.Popen[str]], gyrofleet: Callable[..., Any], endpoint: str
) -> None:
    """Paths count from the file; what the command line gives counts more."""
    make_site(tmp_path / "etc/site")
    (tmp_path / "etc/roles.toml").write_text(
        f'[record]\nstore = "../S"\nlisten = "{endpoint}"\nsecurity = "site/recorder/recorder"\nrotate_mb = 4\n'
    )
    recorder = spawn("record", "--config", "etc/roles.toml", "--json", "--log-level", "error")
    assert recorder.stdout is not None
    started = json.loads(recorder.stdout.readline())
    assert started == {"event": "recording", "store": str(Path("etc/../S")), "listen": endpoint.replace("tcp/", "tls/")}
    assert writer_endpoint(tmp_path / "S") == endpoint.replace("tcp/", "tls/")
    station = ("import", "a.csv", "--unit", "U1", "--run", "r1", "--station", "c1", "--connect", endpoint)
    (tmp_path / "a.csv").write_text("time[s],rate[deg/s]\n" + "".join(f"{i / 10},{i % 3}\n" for i in range(100)))
    refused = gyrofleet(*station)
    assert refused.code != 0
    sent = gyrofleet(*station, "--security", "etc/site/station/c1")
    assert sent.code == 0, sent.err
    recorder.terminate()
    _, err = recorder.communicate(timeout=60)
    assert recorder.returncode == 0
    assert err == ""  # its level is error
    wrong = gyrofleet("record", "--config", "etc/roles.toml", "--rotate-mb", "0")
    assert wrong.code == 2


def test_a_file_of_settings_that_is_wrong_ends_the_command(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    (tmp_path / "roles.toml").write_text("[record]\nrotate = 4\n")
    done = gyrofleet("record", "--config", "roles.toml")
    assert done.code == 2
    assert "roles.toml: record.rotate is not an option of `gyrofleet record`" in done.err
    assert not (tmp_path / "gyrofleet-data").exists()


@pytest.mark.long
@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('[record]\nlisten = "tcp/0.0.0.0:7447"\n',
         "record.listen: tcp/0.0.0.0:7447 reaches beyond this computer, and anybody on the network could send"),
        ('[estimate]\nconnect = "tcp/10.0.0.7:7447"\n', "estimate.connect: tcp/10.0.0.7:7447 reaches beyond"),
        ('[router]\nlisten = "tls/127.0.0.1:7447"\n', "router.listen: tls/127.0.0.1:7447 needs certificates"),
        ('[record]\nlisten = "tcp/0.0.0.0:7447"\nsecurity = "site/station/c1"\n',
         "is of station c1; this command needs a certificate of role recorder"),
        ('[record]\nlisten = "udp/0.0.0.0:7447"\nsecurity = "site/recorder/recorder"\n',
         "record.listen: udp/0.0.0.0:7447: with --security an address is tls/HOST:PORT"),
        ('[record]\nsecurity = "site/recorder/recorder"\ninsecure = true\n', "record.insecure: give --security or"),
        ('[record]\nlisten = "tcp/127.0.0.1:1"\nconnect = "tcp/127.0.0.1:2"\n', "record.connect: give --listen or"),
        ('[replicate]\nfrom = ["night"]\nto = 3\n', "replicate.to is 3; a text is expected"),
        ('[replicate]\nfrom = ["night", 3]\nto = "F"\n', "replicate.from[1] is 3; a text is expected"),
        ('[replicate]\nfrom = ["night"]\n', "replicate.to: give --from PLANT and --to FLEET"),
        ('[replicate]\nfrom = ["night", "./night"]\nto = "F"\n',
         "replicate.from: --from ./night is the same plant as --from night; give each once"),
        ('[replicate]\nfrom = ["night"]\nto = "s3://Gyros_1/x"\n', "replicate.to: 's3://Gyros_1/x' is no address on"),
        ('[record]\nrotate_mb = 4.5\n', "record.rotate_mb is 4.5; a whole number is expected, 1 or more"),
        ('[record]\nstatus_listen = "[::]:nine"\n', "record.status_listen: --status-listen [::]:nine: this is no"),
        ('[lake]\nolder_than = "90 days"\n', "lake.older_than: age '90 days': give a number with s, m, h, d or w"),
        ('[lake]\nrepair = true\n', "lake.repair: --repair and --endpoint-url are of a published lake"),
        ('[attest]\ntimestamp_url = "digicert.com"\n', "attest.timestamp_url: --timestamp-url 'digicert.com'"),
        ('[serve]\nhost = "0.0.0.0"\n', "serve.host: --host 0.0.0.0 is reached from other machines, which needs users"),
        ('[serve]\nkey = "k.pem"\n', "serve.certificate: --certificate and --key belong together"),
        ('[alert]\nstatus_listen = "127.0.0.1:9464"\n', "alert: Missing option '--rules'"),
        ('security = "nowhere"\n[record]\n', "security: Path"),
    ],
)  # fmt: skip
def test_what_the_role_refuses_is_refused_before(
    text: str, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The role itself, started with the file, refuses it with the same sentence."""
    make_site(tmp_path / "site")
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "roles.toml"
    path.write_text(text)
    code, (wrong,) = check(path, "--as", "settings")
    assert code == 1
    assert wrong["problem"].startswith(f"{path}: ")
    assert expected in wrong["problem"]
    (role,) = re.findall(r"^\[(\w+)\]$", text, re.MULTILINE)
    words = ["alert", "run"] if role == "alert" else [role]
    refused = CliRunner().invoke(main, [*words, "--config", str(path)])
    assert refused.exit_code in {1, 2}
    said = expected.partition(": ")[2] or expected
    assert said in " ".join(refused.output.split())
    assert {each.name for each in tmp_path.iterdir()} == {"roles.toml", "site"}


def test_a_role_that_may_is_well(tmp_path: Path) -> None:
    make_site(tmp_path / "site")
    path = tmp_path / "roles.toml"
    path.write_text(
        '[record]\nlisten = "tcp/0.0.0.0:7447"\nsecurity = "site/recorder/recorder"\n[router]\n'
        'listen = "tcp/0.0.0.0:7449"\ninsecure = true\n[replicate]\nfrom = ["night", "tcp/127.0.0.1:7448"]\nto = "F"\n'
    )
    code, (right,) = check(path)
    assert (code, right["problem"], right["text"]) == (0, "", "record, router, replicate")


def test_files_that_a_station_names_are_looked_for(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    (tmp_path / "station.toml").write_text(
        """[station]
        site = "p"
        name = "b"
        [buses.gyros]
        bus = { interface = "socketcan", channel = "can0" }
        dbc = ["gyros.dbc"]
        mapping = "gyros.toml"
        """
    )
    done = gyrofleet("config", "check", "station.toml")
    assert (done.code, "gyros.dbc" in done.err or "gyros.toml" in done.err) == (1, True), done.err
