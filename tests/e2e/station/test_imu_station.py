"""An inertial measurement unit on the simulated station: from the procedure to the planted scale-factor errors."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.e2e.conftest import Bench, finish

QUANTITIES = {
    "system_level_scale_factor_asymmetry": "A", "system_level_scale_factor_error": "S",
    "system_level_accelerometer_bias": "B", "system_level_gyro_bias": "b",
}  # fmt: skip
# a 99.99 % interval: some twenty values that share their noise are compared
_WIDTHS = 4.0


@pytest.fixture
def station(tmp_path: Path, simulated: Callable[..., Bench]) -> Iterator[Bench]:
    """Five times real time: a busy machine starts and stops the table late, and rests are shorter by that.

    Seven signals at 100 Hz are 3500 frames a second, each a message of Python on both sides; where those come late, so
    do the turns that they tell of.
    """
    found = simulated(tmp_path / "imu", "--units", 1, "--device", "imu", "--speed", 5)
    yield found
    finish(found)


def planted(truth: dict[str, Any], row: dict[str, Any]) -> float:
    gyro = truth["gyros"][row["parameters"]["axis"].lower()]["parameters"]
    which = QUANTITIES[row["metric"]]
    if which == "B":
        return float(truth["accelerometers"][row["signal"][-1]]["parameters"]["bias_ug"])
    # (K+ - K-)/K is twice A
    values = {
        "A": gyro["scale"]["asymmetry_ppm"] / 2,
        "S": gyro["scale"]["error_ppm"],
        "b": gyro["bias"]["constant_deg_per_h"],
    }
    return float(values[which])


@pytest.mark.long
def test_what_is_planted_comes_back_within_its_uncertainty(
    gyrofleet: Callable[..., Any], spawn: Callable[..., Any], station: Bench
) -> None:
    more = ("--set", "rest_s=20", "--set", "warm_up_s=1", "--set", "speeds_deg_per_s=10,20,30")
    process = spawn(*station.run("system_level_asymmetry", *more))
    reported, _ = station.ended(process, timeout_s=400.0)
    assert reported["event"] == "ended"
    truth = json.loads((station.folder / "truth.jsonl").read_text().splitlines()[-1])
    asked = gyrofleet("metrics", "--store", "S", "--standard", "CN 102680005", "--json")
    assert asked.code == 0, asked.err
    rows = [row for row in asked.json if row["parameters"]["method"] in {"average", "joint", "joint_rest"}]
    assert {(row["metric"], row["parameters"]["axis"]) for row in rows} == {(m, a) for m in QUANTITIES for a in "XYZ"}
    for row in rows:
        assert row["value"] is not None, row["reason"]
        off = abs(row["value"] - planted(truth, row)) / row["standard_uncertainty"]
        assert off < _WIDTHS, (row["metric"], row["parameters"], row["value"], planted(truth, row))
        assert row["parameters"]["angle_random_walk"] == pytest.approx(0.002, rel=0.25)
    narrow = [row for row in rows if row["metric"] == "system_level_scale_factor_asymmetry"]
    widths = {row["parameters"]["method"]: row["hi"] - row["lo"] for row in narrow if row["parameters"]["axis"] == "X"}
    assert widths["joint_rest"] < min(widths["joint"], widths["average"])
    assert widths["joint_rest"] < 3.0
