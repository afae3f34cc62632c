"""Samples lost at random: what is missing is counted, however many they are."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

INTERVAL_NS = 500_000_000
SPECIFICATION = """
name = "B"
revision = "A"
valid_from = 2020-01-01
[[limit]]
metric = "bias"
parameters = { earth_rate = "none" }
upper = 3.0
unit_of_measure = "deg/h"
"""


@pytest.mark.parametrize(("lost", "seed"), [(0.3, 1), (0.55, 2), (0.75, 3), (0.9, 4)])
@pytest.mark.in_gate("0.55-2")
def test_a_record_without_its_samples_does_not_pass(
    run_command: Callable[..., Any], tmp_path: Path, lost: float, seed: int
) -> None:
    """From half lost on the interval had been taken as a multiple of the true one: nothing was missing, a PASS."""
    rng = np.random.default_rng(seed)
    at = np.flatnonzero(rng.random(8000) >= lost)
    rates = 2.0 + 0.5 * rng.standard_normal(at.size)
    start = np.datetime64("2026-03-01T12:00:00.000")
    rows = "\n".join(
        f"{start + np.timedelta64(500 * int(k), 'ms')}Z,{rate:.5f}" for k, rate in zip(at, rates, strict=True)
    )
    (tmp_path / "r.csv").write_text(f"Timestamp,rate[deg/h]\n{rows}\n")
    (tmp_path / "limits.toml").write_text(SPECIFICATION)
    step = ("--procedure", "static_bias", "--position", "IRA_up")
    done = run_command("import", "r.csv", "--unit", "U", *step, "--store", "s", "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    (signal,) = done.json["files"][0]["signals"]
    assert (signal["sample_interval_s"], signal["irregular"]) == (0.5, False)
    assert run_command("limits", "add", "limits.toml", "--store", "s", cwd=tmp_path).code == 0
    (row,) = run_command("verdicts", "--unit", "U", "--store", "s", "--json", cwd=tmp_path).json["verdicts"]
    assert row["verdict"] == "MARGINAL", row
    assert f"{at.size} of " in row["reason"]
    # of white noise: the standard deviation over the root of the number, and hardly more
    assert 1.8 * 0.5 / np.sqrt(at.size) < (row["hi"] - row["lo"]) / 2 < 10 * 0.5 / np.sqrt(at.size)


def test_events_in_whole_milliseconds_are_no_grid() -> None:
    """A source that sends with jitter about its interval has no finer one."""
    from ingest.tables.timing.grid import SamplingGrid

    rng = np.random.default_rng(5)
    for steps in (rng.integers(97, 105, 5000), rng.integers(2, 9, 5000), rng.choice([20, 30], 5000)):
        grid = SamplingGrid()
        grid.add(np.cumsum(steps) * 1_000_000)
        assert grid.finish().dt_ns > 1_500_000
