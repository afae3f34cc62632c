"""A voltage output: the scale factor is measured on a table, the bias on a pier that has none."""

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

UNIT, K = "V-1", 0.02  # V/(deg/s)
STATION = """
[station]
site = "lab"
name = "{name}"
time_zone = "Asia/Shanghai"
latitude_deg = 39.9
[standards.voltmeter]
serial = "D-1"
certificate = "2026-V-1"
calibration_due = 2027-05-31
[standards.voltmeter.uncertainty]
voltage = {{ U = 20.0, k = 2.0, unit = "ppm" }}
voltage_offset = {{ U = 1e-6, k = 2.0, unit = "V" }}
[standards.site]
serial = "N-3"
certificate = "2026-G-7"
calibration_due = 2027-05-31
[standards.site.uncertainty]
levelling = {{ half_width = 10.0, unit = "arcsec" }}
heading = {{ U = 30.0, k = 2.0, unit = "arcsec" }}
latitude = {{ half_width = 5.0, unit = "arcsec" }}
clock = {{ U = 1.0, k = 2.0, unit = "ppm" }}
"""
TABLE = """
[standards.table]
serial = "T-1"
certificate = "2026-T-1"
calibration_due = {due}
[standards.table.uncertainty]
rate = {{ U = 2e-3, k = 2.0, unit = "1" }}
rate_nonuniformity = {{ U = 2e-5, k = 2.0, unit = "1" }}
"""


def measured(folder: Path, gyrofleet: Callable[..., Any], due: str) -> dict[str, Any]:
    """The bias of a store whose table's calibration is valid until that day."""
    rng = np.random.default_rng(3)
    with (folder / "scale.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time[s]", "rate[V]", "rate_command[deg/s]", "procedure", "step"])
        at = 0
        for rate in [*(s * r for s in (1, -1) for r in (1, 2, 5, 10, 20, 40, 60, 80, 100, 150, 200)), 0, 0]:
            for _ in range(30):
                value = K * (rate + 0.01) + rng.normal(0, 1e-5)
                writer.writerow([at, f"{value:.8f}", rate, "scale_factor", "rate"])
                at += 1
    with (folder / "bias.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time[s]", "rate[V]"])
        writer.writerows([at, f"{K * 0.01 + rng.normal(0, 1e-5):.8f}"] for at in range(3700))
    (folder / "hall.toml").write_text(STATION.format(name="hall") + TABLE.format(due=due))
    (folder / "pier.toml").write_text(STATION.format(name="pier"))
    store = ("--unit", UNIT, "--store", "S")
    for words in (
        ("import", "scale.csv", *store, "--station", "hall.toml", "--start", "2026-03-02T09:00:00+08:00"),
        ("import", "bias.csv", *store, "--station", "pier.toml", "--start", "2026-03-02T13:00:00+08:00", "--procedure",
         "static_bias", "--position", "IRA_east"),
    ):  # fmt: skip
        done = gyrofleet(*words)
        assert done.code == 0, done.err
    rows = gyrofleet("metrics", "--metric", "bias", "--store", "S", "--json").json
    found = [row for row in rows if row["run"] == "bias" and row["value"] is not None]
    bias = next(row for row in found if row["parameters"]["earth_rate"] == "none")
    assert isinstance(bias, dict)
    return bias


@pytest.mark.long
def test_the_rate_of_the_table_enters_where_the_scale_factor_was_measured(
    tmp_path: Path, gyrofleet: Callable[..., Any]
) -> None:
    bias = measured(tmp_path, gyrofleet, "2027-05-31")
    assert bias["value"] == pytest.approx(36.0, rel=0.01)
    assert bias["parameters"]["scale_factor"] == "measured in run scale"
    assert bias["uncertainty_reason"] is None
    # the bias is divided by K, whose table is sure to 0.1 %; half a microvolt of offset is 0.09 deg/h
    assert bias["u_type_b"] == pytest.approx(np.hypot(36.0 * 1e-3, 0.5e-6 / K * 3600), rel=0.01)
    budget = gyrofleet("budget", "--unit", UNIT, "--metric", "bias", "--run", "bias", "--store", "S", "--json").json
    assert "T-1" in json.dumps(budget)


@pytest.mark.long
def test_a_table_that_had_expired_there_leaves_the_bias_without_an_uncertainty(
    tmp_path: Path, gyrofleet: Callable[..., Any]
) -> None:
    bias = measured(tmp_path, gyrofleet, "2026-02-28")
    assert bias["U"] is None
    assert "table rate" in bias["uncertainty_reason"]
