"""From records of a minute in a file to a bias repeatability that does not take their noise for one."""

import csv
import json
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from gyrofleet import main

RUNS, SECONDS, RATE_HZ = 7, 52, 10
START_S = 1_767_600_000


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[dict[str, Any]]]:
    """Two units of the same noise in seven records of a day: the biases of one are all the same, of the other not."""
    here = tmp_path_factory.mktemp("repeatability")
    rng = np.random.default_rng(20260791)
    with (here / "minute.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["unit", "run", "time[s]", "rate[deg/h]", "procedure", "step"])
        for run in range(RUNS):
            for unit, scatter in (("SAME", 0.0), ("OTHER", 20.0)):
                values = 5 + rng.normal(0, scatter) + rng.normal(0, 3 * np.sqrt(SECONDS * RATE_HZ), SECONDS * RATE_HZ)
                for at, value in enumerate(values):
                    time_s = START_S + 600 * run + at / RATE_HZ
                    writer.writerow([unit, f"r{run}", f"{time_s:.1f}", f"{value:.6f}", "static_bias", "static"])
    store = ["--store", str(here / "S"), "--json"]
    done = CliRunner().invoke(main, ["import", str(here / "minute.csv"), "--station", "bench-1", *store])
    assert done.exit_code == 0, done.output
    done = CliRunner().invoke(main, ["metrics", "--metric", "bias_repeatability", *store])
    assert done.exit_code == 0, done.output
    every = json.loads(done.stdout)
    return {unit: [row for row in every if row["unit"] == unit] for unit in ("SAME", "OTHER")}


@pytest.mark.long
@pytest.mark.parametrize("kind", ["within_day_component"])
def test_noise_is_no_repeatability(rows: dict[str, list[dict[str, Any]]], kind: str) -> None:
    found = {unit: [row for row in of if row["parameters"]["kind"] == kind] for unit, of in rows.items()}
    (same,), (other,) = found["SAME"], found["OTHER"]
    assert same["lo"] == 0.0
    assert same["hi"] < 8.0
    assert 10.0 < other["value"] < 40.0
    assert other["lo"] > 5.0
    (whole,) = (row for row in rows["SAME"] if row["parameters"]["kind"] == "all")
    assert whole["value"] == pytest.approx(3.0, rel=0.6)
    assert same["parameters"]["uncertainty_of_means"] == pytest.approx(3.0, rel=0.6)
    assert same["parameters"]["remark"] == (
        "7 of 7 records are of 52 s: the clauses ask for an hour as a rule; "
        "7 power-ons are not recorded: each run is taken for one"
    )
    assert (same["parameters"]["power_ons"], same["parameters"]["power_ons_recorded"]) == (7, 0)
