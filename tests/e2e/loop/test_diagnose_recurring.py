"""An error that comes again in each run with the time, while the temperature rises: no effect of it is confirmed."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analytics.loop.effects.registry import effect


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory, run_command: Callable[..., Any]) -> Path:
    """Six runs of means of 30 s: a square wave in time, and a temperature that settles."""
    folder = tmp_path_factory.mktemp("recurring")
    rng = np.random.default_rng(1)
    hours = np.arange(200) * 30.0 / 3600.0
    names = []
    for run in range(6):
        temperature = 20.0 + 15.0 * -np.expm1(-hours / 0.6) + 0.02 * rng.standard_normal(hours.size)
        rate = 3.0 + 0.12 * np.sign(np.sin(2 * np.pi * hours / 0.45))
        rate += 0.055 * rng.standard_normal(hours.size) + 0.0018 * np.cumsum(rng.standard_normal(hours.size))
        rows = zip(hours * 3600.0, rate, temperature, strict=True)
        names.append(f"r{run}.csv")
        text = "\n".join(f"{a:g},{b:.6f},{c:.4f}" for a, b, c in rows)
        (folder / names[-1]).write_text(f"time[s],rate[deg/h],temperature[degC]\n{text}")
    assert run_command("import", *names, "--unit", "P", "--store", "S", cwd=folder).code == 0
    return folder / "S"


def test_what_makes_the_held_out_error_worse_is_not_confirmed(gyrofleet: Callable[..., Any], store: Path) -> None:
    found = gyrofleet("diagnose", "--store", store, "--unit", "P", "--model", "rate = bias", "--json").json
    for part in ("rms_300s", "rms_1800s"):
        assert found["error"]["after"][part] <= 1.25 * found["error"]["before"][part]
    assert found["verdict"] not in ("effect_found", "nothing_missing")
    refused = [each["effect"] for each in found["holdout"]["effects"] if each["answer"] == "refused"]
    assert refused
    assert not found["holdout"]["accepted"]
    (why,) = [each for each in found["limits"] if "is refused whatever its slope" in each]
    assert why.split(" is refused")[0] in [effect(each).en for each in refused]


@pytest.mark.long
def test_bounds_that_no_station_has_are_refused(gyrofleet: Callable[..., Any], store: Path) -> None:
    ask = ("diagnose", "--store", store, "--unit", "P", "--model", "rate = bias", "--no-explainable", "--next-test")
    for bounds, text in (
        ("slope_deg_c_per_min=0", "slope_deg_c_per_min=0: give a positive number"),
        ("least_deg_c=60", "the first must be below the second"),
        ("most_deg_c=inf", "no finite number"),
        ("rate_deg_per_s=-5", "give a positive number"),
        ("least_deg_c=-300", "below absolute zero"),
        ("most_deg_c=50,most_deg_c=60", "given twice"),
    ):
        refused = gyrofleet(*ask, "--bounds", bounds)
        assert refused.code == 1
        assert text in refused.err


@pytest.mark.long
def test_a_single_run_is_recovered_in_its_segments(gyrofleet: Callable[..., Any], store: Path) -> None:
    ask = ("diagnose", "--store", store, "--unit", "P", "--run", "r0", "--model", "rate = bias", "--no-explainable")
    found = gyrofleet(*ask, "--recover", 1, "--json").json
    assert found["replication"] == "within_run"
    assert all(each["tries"] == 1 for each in (found["recovery"] or {}).values())
