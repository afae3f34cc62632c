"""What `deploy` has: units that systemd accepts, a container file without root, settings that the program accepts.

An image is not built here: that needs a container engine. What can be read from the files is checked.
"""

import configparser
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import click
import pytest
import yaml
from click.testing import CliRunner

from analytics.serve.doors.roles import Role
from analytics.serve.doors.users_file import add_person
from gyrofleet import main
from tests.free_ports import free_endpoint

DEPLOY = Path(__file__).parents[3] / "deploy"
UNIT = DEPLOY / "systemd" / "gyrofleet@.service"
ALERT = DEPLOY / "systemd" / "gyrofleet@alert.service.d" / "command.conf"
NEWER = ("RestartSteps", "RestartMaxDelaySec")  # systemd 254
ROLES = ("record", "router", "estimate", "compensate", "lake", "serve", "attest", "replicate")


class CaseKept(configparser.ConfigParser):
    """Names of systemd have capitals."""

    def optionxform(self, optionstr: str) -> str:
        return optionstr


def command(name: str) -> click.Command:
    found = main.get_command(click.Context(main), name)
    assert found is not None
    return found


def unit(path: Path) -> configparser.ConfigParser:
    found = CaseKept(strict=False, interpolation=None, delimiters=("=",))
    found.read(path)
    return found


def test_settings_of_the_example_are_accepted(tmp_path: Path) -> None:
    shutil.copy(DEPLOY / "gyrofleet.toml", tmp_path)
    add_person(tmp_path / "users.toml", "li", Role.ENGINEER, "a long password")
    (tmp_path / "alerts.toml").write_text('[[rules]]\nname = "room"\nkind = "disk"\n')
    done = CliRunner().invoke(main, ["config", "check", str(tmp_path / "gyrofleet.toml"), "--json"])
    assert done.exit_code == 0, done.output
    (found,) = json.loads(done.output)["files"]
    assert found["text"].split(", ") == ["record", "lake", "estimate", "serve", "alert", "attest"]


@pytest.mark.parametrize("role", ROLES)
def test_the_unit_starts_a_command_that_there_is(role: str) -> None:
    words = shlex.split(unit(UNIT)["Service"]["ExecStart"].replace("%i", role))
    assert words[1:] == [role, "--config", "/etc/gyrofleet/gyrofleet.toml"]
    assert "--config" in {each for option in command(role).params for each in option.opts}


def test_the_alert_role_has_its_two_words() -> None:
    lines = [line for line in ALERT.read_text().splitlines() if line.startswith("ExecStart=")]
    assert lines[0] == "ExecStart="  # takes the one of the template away
    assert shlex.split(lines[1])[1:4] == ["alert", "run", "--config"]


def test_the_unit_restarts_stops_and_confines() -> None:
    service = unit(UNIT)["Service"]
    expected = {
        "Restart": "on-failure", "RestartSec": "1", "RestartMaxDelaySec": "60", "RestartPreventExitStatus": "2",
        "SuccessExitStatus": "130", "KillSignal": "SIGTERM", "TimeoutStopSec": "120", "User": "gyrofleet",
        "NoNewPrivileges": "yes", "ProtectSystem": "strict", "ProtectHome": "yes", "CapabilityBoundingSet": "",
    }  # fmt: skip
    assert {name: service[name] for name in expected} == expected
    assert "MemoryDenyWriteExecute" not in service  # the estimators are compiled while they run


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
def test_systemd_accepts_the_units(tmp_path: Path, command_line: Callable[..., list[str]]) -> None:
    (program,) = command_line()
    for instance in ("record", "alert", "serve"):
        path = tmp_path / f"gyrofleet@{instance}.service"
        path.write_text(UNIT.read_text().replace("/opt/gyrofleet/bin/gyrofleet", program))
    folder = tmp_path / "gyrofleet@alert.service.d"
    folder.mkdir()
    (folder / "command.conf").write_text(ALERT.read_text().replace("/opt/gyrofleet/bin/gyrofleet", program))
    units = [str(path) for path in sorted(tmp_path.glob("*.service"))]
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", *units], capture_output=True, text=True, timeout=60, check=False
    )
    ours = [line for line in done.stderr.splitlines() if str(tmp_path) in line or "gyrofleet" in line]
    # a role is not ordered after itself
    harmless = [f"'{name}'" for name in NEWER] + ["Dependency After=gyrofleet@record.service is dropped"]
    wrong = [line for line in ours if not any(each in line for each in harmless)]
    assert wrong == []
    security = subprocess.run(
        ["systemd-analyze", "security", "--offline=yes", "--threshold=40", "--no-pager", units[0]],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert security.returncode == 0, security.stdout[-2000:]  # exposure of 4.0 of 10 or less


def instructions() -> list[tuple[str, str]]:
    text = (DEPLOY / "container" / "Containerfile").read_text()
    joined = re.sub(r"\\\n\s*", " ", "\n".join(line for line in text.splitlines() if not line.startswith("#")))
    return [(line.split(" ", 1)[0], line.split(" ", 1)[1].strip()) for line in joined.splitlines() if line.strip()]


def of(name: str) -> list[str]:
    return [argument for instruction, argument in instructions() if instruction == name]


def test_the_container_runs_without_root_and_says_how_it_is() -> None:
    known = {"FROM", "WORKDIR", "COPY", "RUN", "LABEL", "ENV", "VOLUME", "USER", "EXPOSE", "STOPSIGNAL", "HEALTHCHECK",
             "ENTRYPOINT", "CMD"}  # fmt: skip
    assert {name for name, _ in instructions()} <= known  # no ADD, MAINTAINER, SHELL
    for image in of("FROM"):
        tag = image.split(" ")[0].partition(":")[2]
        assert re.fullmatch(r"\d+\.\d+\.\d+-slim-\w+", tag)  # a release, not `latest`
    (user,) = of("USER")
    assert re.fullmatch(r"[1-9]\d{3,}:[1-9]\d{3,}", user)  # by number, so that a cluster can tell that it is not root
    after_user = instructions()[[name for name, _ in instructions()].index("USER") :]
    assert "RUN" not in {name for name, _ in after_user}
    (check,) = of("HEALTHCHECK")
    assert all(f"--{name}=" in check for name in ("interval", "timeout", "start-period", "retries"))
    probe = json.loads(check.partition("CMD ")[2])
    compile(probe[2], "probe", "exec")
    assert json.loads(of("ENTRYPOINT")[0]) == ["gyrofleet"]
    assert json.loads(of("CMD")[0])[0] in main.list_commands(click.Context(main))
    assert of("STOPSIGNAL") == ["SIGTERM"]
    runs = " ".join(of("RUN"))
    assert "--no-cache-dir" in runs
    assert "sudo" not in runs
    assert "curl" not in runs
    assert all(path.startswith("/") for path in of("WORKDIR"))
    copied = {word for line in of("COPY") if not line.startswith("--from") for word in line.split()[:-1]}
    packages = {"stream", "storage", "ingest", "analytics"}
    assert copied == packages | {"pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "gyrofleet.py"}


def test_the_extras_that_the_image_installs_are_there() -> None:
    project = tomllib.loads((DEPLOY.parent / "pyproject.toml").read_text())["project"]
    found = re.search(r"'\.\[([a-z0-9,]+)\]'", " ".join(of("RUN")))
    assert found is not None
    assert set(found[1].split(",")) <= project["optional-dependencies"].keys()


def test_the_composition_reads_its_root_only_and_turns_its_logs_over() -> None:
    content = yaml.safe_load((DEPLOY / "container" / "compose.yaml").read_text())
    (user,) = of("USER")
    for name, service in content["services"].items():
        assert service["command"][0] == name
        assert name in main.list_commands(click.Context(main))
        assert service["user"] == user
        assert service["read_only"] is True
        assert service["cap_drop"] == ["ALL"]
        assert service["security_opt"] == ["no-new-privileges:true"]
        assert service["logging"]["options"].keys() == {"max-size", "max-file"}
        assert service["restart"] == "unless-stopped"
        assert any(each.startswith("/tmp:") for each in service["tmpfs"])
        written = {each.split(":")[1] for each in service["volumes"] if not each.endswith(":ro")}
        assert written == set(json.loads(of("VOLUME")[0]))


@pytest.mark.long
def test_the_health_check_asks_what_a_role_answers(
    tmp_path: Path, spawn: Callable[..., "subprocess.Popen[str]"], endpoint: str
) -> None:
    address = free_endpoint().removeprefix("tcp/")
    probe = json.loads(of("HEALTHCHECK")[0].partition("CMD ")[2])[2]

    def is_healthy() -> bool:
        env = {**os.environ, "GYROFLEET_HEALTH": f"http://{address}/health"}
        return subprocess.run([sys.executable, "-c", probe], env=env, capture_output=True, check=False).returncode == 0

    assert not is_healthy()
    recorder = spawn("record", "--store", "S", "--listen", endpoint, "--status-listen", address, "--json")
    assert recorder.stdout is not None
    assert json.loads(recorder.stdout.readline())["event"] == "recording"
    assert is_healthy()
    recorder.terminate()
    assert recorder.wait(timeout=60) == 0
    assert not is_healthy()
