"""A term that the declared model forgets, a million times the noise: named alone, in each unit and in all together."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.e2e.loop.plain_units import Columns, noise, steps, stored, warming

RATES = (0.0, 1.0, -1.0, 5.0, -5.0, 20.0, -20.0, 0.0)
MODEL = "rate = bias + temperature"


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory, run_command: Callable[..., Any]) -> Path:
    """Three units whose scale factors differ by 30 ppm; in each run the table turns and the temperature moves."""
    rng = np.random.default_rng(58)
    units: dict[str, dict[str, Columns]] = {}
    for unit, factor in (("F1", 3600.1), ("F2", 3599.9), ("F3", 3600.0)):
        units[unit] = {}
        for number in range(6):
            rate, warm = steps(RATES, rng), warming(number)
            error = factor * rate + 0.02 * (warm - 25.0) + noise(rng)
            units[unit][f"r{number}"] = {"rate[deg/h]": error, "input_rate[deg/s]": rate, "temperature[degC]": warm}
    return stored(tmp_path_factory.mktemp("forgotten"), run_command, units)


@pytest.mark.in_gate("F1")
@pytest.mark.parametrize("unit", ["F1", "F2"])
def test_nothing_that_leaves_a_million_times_the_noise_is_its_rival(
    gyrofleet: Callable[..., Any], store: Path, unit: str
) -> None:
    found = gyrofleet("diagnose", "--unit", unit, "--model", MODEL, "--store", store, "--json").json
    assert (found["verdict"], [each["name"] for each in found["effects"]]) == ("effect_found", ["scale_factor"])
    assert found["confounded"] == []
    # that of the readings: 0.6 deg/h at 1 Hz are 0.01 deg/sqrt(h), known to 8 % from the differences of 310 blocks
    assert found["noise"]["N"] == pytest.approx(0.01, rel=0.25)


@pytest.mark.long
def test_what_each_unit_lacks_is_not_missing_in_none(gyrofleet: Callable[..., Any], store: Path) -> None:
    found = gyrofleet("diagnose", "--fleet", "--signal", "rate", "--model", MODEL, "--store", store, "--json").json
    assert set(found["own_findings"]) == {"F1", "F2", "F3"}
    assert found["verdict"] == "effect_found"
    (effect,) = found["effects"]
    assert effect["name"] == "scale_factor"
    assert len(found["by_unit"]["scale_factor"]) == 3
