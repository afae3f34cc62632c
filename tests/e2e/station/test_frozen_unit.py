"""A unit whose output freezes at power-on passes no limit of a live run, and is not released."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.e2e.conftest import finish

LIMITS = """
revision = "A"
[[limit]]
product = "FOG-SIM"
metric = "allan_deviation"
parameters = { tau_s = 10 }
upper = 3.0
unit_of_measure = "deg/h"
"""
FROZEN = """
[unit.SIM-0002.readout]
stuck = { probability = 0.5, mean_samples = 1e7 }
"""
SHORT = ("--set", "warm_up_s=30", "--set", "bias_record_s=900", "--every", 20, "--stop-when-decided")


@pytest.mark.long
def test_a_frozen_unit_is_not_released(
    gyrofleet: Callable[..., Any], tmp_path: Path, simulated: Callable[..., Any]
) -> None:
    finish(simulated(tmp_path / "sim", "--speed", 100, "--rate-hz", 10))  # which writes its files
    with (tmp_path / "sim" / "fleet.toml").open("a") as file:
        file.write(FROZEN)
    (tmp_path / "fog.toml").write_text(LIMITS)
    assert gyrofleet("limits", "add", "fog.toml", "--store", "S").code == 0
    bench = simulated(tmp_path / "sim")
    try:
        done = gyrofleet(*bench.run("static_bias", *SHORT))
    finally:
        finish(bench)
    assert done.code == 0, done.err
    last = json.loads(done.out.splitlines()[-1])
    assert last["verdicts"] == {"SIM-0001": "PASS", "SIM-0002": "NO_DATA"}
    assert set(last["released"]) == {"SIM-0001"}
    assert "the output is frozen" in done.err
    judged = json.loads(gyrofleet("verdicts", "--store", "S", "--json").out)["verdicts"]
    assert {row["unit"]: row["verdict"] for row in judged} == last["verdicts"]
