"""A store with a calibrated gyro, made of files by code of its own, and the order of its certificate."""

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

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


@pytest.fixture(scope="session")
def laboratory(tmp_path_factory: pytest.TempPathFactory, run_command: Callable[..., Any]) -> Path:
    """A folder with the store ``lab`` (one gyro: scale factor and bias), and the files it is made of."""
    folder = tmp_path_factory.mktemp("laboratory")
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
    return folder
