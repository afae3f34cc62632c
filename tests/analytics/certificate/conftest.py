"""A store with a calibrated gyro, made of files by code of its own, and the order of its certificate."""

import csv
import fcntl
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.analytics.certificate.keys import write_key

UNIT = "G-0042"
RATES_DEG_PER_S = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 75, 100)
EARTH_DEG_PER_H = 15.041067 * np.sin(np.radians(39.9))
BIAS_DEG_PER_S = (2.0 + EARTH_DEG_PER_H) / 3600
ORDER = """
deviations = { en = "none", zh = "无" }
number_prefix = "GYL"
valid_months = 12
[laboratory]
name = { en = "Gyro Calibration Laboratory", zh = "陀螺校准实验室" }
address = { en = "1 Test Road, Xi'an", zh = "西安市试验路1号" }
[customer]
name = { en = "Example Aerospace Ltd", zh = "示例航天有限公司" }
address = { en = "8 Example Street, Beijing", zh = "北京市示例街8号" }
[device]
manufacturer = { en = "Example Inertial", zh = "示例惯性" }
model = "VG-20"
received = 2026-02-27
[environment]
temperature_deg_c = [20.4, 21.1]
relative_humidity_percent = [41, 47]
[people]
calibrated_by = { en = "Wang Li", zh = "王力" }
checked_by = { en = "Zhao Min", zh = "赵敏" }
issued_by = { en = "Chen Gang", zh = "陈刚" }
issued_as = { en = "technical manager", zh = "技术负责人" }
"""
STATION = """
[station]
site = "lab"
name = "pier-2"
time_zone = "Asia/Shanghai"
latitude_deg = 39.9
altitude_m = 50.0
[instruments.table]
kind = "rate_table"
resource = "TCPIP::127.0.0.1::1::SOCKET"
max_rate_deg_per_s = 400.0
serial = "T-881"
certificate = "2025-RT-0113"
calibration_due = 2026-09-30
traceable_to = "NIM, rate"
[instruments.table.uncertainty]
rate = { U = 1e-4, k = 2.0, unit = "1" }
rate_nonuniformity = { U = 2e-5, k = 2.0, unit = "1" }
[standards.site]
serial = "N-3"
certificate = "2024-GEO-7"
calibration_due = 2027-05-31
traceable_to = "NIM, length and angle"
[standards.site.uncertainty]
levelling = { half_width = 10.0, unit = "arcsec" }
heading = { U = 30.0, k = 2.0, unit = "arcsec" }
latitude = { half_width = 5.0, unit = "arcsec" }
clock = { U = 1.0, k = 2.0, unit = "ppm" }
"""


SPECIFICATION = """
name = "VG-20"
revision = "A"
valid_from = 2026-01-01
[[limit]]
metric = "scale_factor"
lower = 0.999
upper = 1.001
unit_of_measure = "1"
decision_rule = "guarded_acceptance"
[[limit]]
metric = "bias"
parameters = { earth_rate = "removed" }
lower = -0.5
upper = 0.5
unit_of_measure = "deg/h"
[[limit]]
metric = "angle_random_walk"
signal = "another"
upper = 1.0
unit_of_measure = "deg/sqrt(h)"
"""
ORDERED = ("certificate", "--unit", UNIT, "--standard", "JJF2014", "--order", "order.toml", "--store", "lab", "--json")


def _made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], None]) -> Path:
    """A folder that the first of the processes of pytest makes; nobody changes it."""
    base = factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / f"certificate_{name}"
    with folder.with_suffix(".lock").open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "made").exists():
            shutil.rmtree(folder, ignore_errors=True)  # of a try that failed
            folder.mkdir()
            make(folder)
            (folder / "made").touch()
    return folder


@pytest.fixture(scope="session")
def _measured(tmp_path_factory: pytest.TempPathFactory, run_command: Callable[..., Any]) -> Path:
    return _made_once(tmp_path_factory, "laboratory", lambda folder: _measure(folder, run_command))


@pytest.fixture(scope="session")
def laboratory(_measured: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the store ``lab`` (one gyro: scale factor and bias), and the files it is made of."""
    return Path(shutil.copytree(_measured, tmp_path_factory.mktemp("laboratory") / "copy"))


@pytest.fixture(scope="session")
def certified(
    _measured: Path, tmp_path_factory: pytest.TempPathFactory, run_command: Callable[..., Any]
) -> tuple[Path, dict[str, Any]]:
    """Such a folder with a certificate ``signed.pdf`` that states the conformity with limits, and what the command
    answered; to be copied by whoever changes it or runs commands there."""

    def make(folder: Path) -> None:
        shutil.copytree(_measured, folder, dirs_exist_ok=True)
        (folder / "made").unlink()
        write_key(folder)
        (folder / "limits.toml").write_text(SPECIFICATION)
        order = f'traceability = "all to NIM"\n{ORDER}\n[conformity]\nspecification = "VG-20"\n'
        (folder / "order.toml").write_text(order, encoding="utf-8")
        words = ("limits", "add", "limits.toml", "--reason", "first", "--by", "Li", "--store", "lab")
        entered = run_command(*words, cwd=folder)
        assert entered.code == 0, entered.err
        signing = ("--out", "signed.pdf", "--lang", "en", "--key", "key.p12", "--key-passphrase", "open")
        done = run_command(*ORDERED, *signing, cwd=folder)
        assert done.code == 0, done.err
        (folder / "answer.json").write_text(done.out)

    folder = _made_once(tmp_path_factory, "certified", make)
    return folder, json.loads((folder / "answer.json").read_text())


def _measure(folder: Path, run_command: Callable[..., Any]) -> None:
    rng = np.random.default_rng(2014)
    with (folder / "scale.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time[s]", "rate[deg/s]", "procedure", "step", "rate_command[deg/s]"])
        t_s = 0
        for rate in (*RATES_DEG_PER_S, *(-each for each in RATES_DEG_PER_S)):
            for _ in range(30):
                value = rate * (1 + 50e-6) + BIAS_DEG_PER_S + rng.normal(0.0, 1e-4)
                writer.writerow([t_s, f"{value:.7f}", "scale_factor_jjf2014", "rate", rate])
                t_s += 1
    with (folder / "bias.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time[s]", "rate[deg/s]"])
        writer.writerows([at, f"{BIAS_DEG_PER_S + rng.normal(0.0, 1e-4):.7f}"] for at in range(3700))
    (folder / "station.toml").write_text(STATION, encoding="utf-8")
    (folder / "order.toml").write_text(ORDER, encoding="utf-8")
    at = ("--unit", UNIT, "--station", "station.toml", "--store", "lab")
    for words in (
        ("import", "scale.csv", *at, "--start", "2026-03-02T09:00:00+08:00"),
        ("import", "bias.csv", *at, "--start", "2026-03-02T13:00:00+08:00", "--procedure", "static_bias", "--position",
         "IRA_up"),
    ):  # fmt: skip
        done = run_command(*words, cwd=folder)
        assert done.code == 0, done.err
    # kept in the store: copies of it need not compute the metrics again
    assert run_command("metrics", "--store", "lab", "--json", cwd=folder).code == 0
