"""What a bias with the input axis north is a result of, and how results of the unit 1 are printed: from files."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

STATION = """
[station]
site = "lab"
name = "pier"
latitude_deg = 39.9
time_zone = "Asia/Shanghai"
[standards.table]
serial = "RT-17"
calibration_due = 2026-01-31
uncertainty.rate = { U = 1e-4, unit = "1" }
"""
RATES = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 75, 100)


@pytest.fixture(scope="module")
def lab(run_command: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A folder with a store S, and what the import of a record with the input axis north reported."""
    folder = tmp_path_factory.mktemp("stated")
    draws = np.random.default_rng(59).normal(10.0, 0.3, 3600)
    rows = [f"{at},{value:.6f}" for at, value in enumerate(draws)]
    (folder / "north.csv").write_text("\n".join(["time[s],rate[deg/h]", *rows]))
    rows = [
        f"{at * 12 + sample},{rate * 1.00006 + 1e-4 * (sample % 3):.7f},scale_factor_jjf2014,rate,{rate}"
        for at, rate in enumerate((*RATES, *(-each for each in RATES)))
        for sample in range(12)
    ]
    (folder / "scale.csv").write_text("\n".join(["time[s],rate[deg/s],procedure,step,rate_command[deg/s]", *rows]))
    (folder / "station.toml").write_text(STATION)
    at = ("--unit", "N-1", "--store", "S", "--start", "2026-03-02T09:00:00+08:00", "--station", "station.toml")
    words = ("--run", "north", "--procedure", "static_bias", "--position", "IRA_north")
    reported = run_command("import", "north.csv", *at, *words, cwd=folder)
    assert reported.code == 0, reported.err
    assert run_command("import", "scale.csv", *at, "--run", "scale", cwd=folder).code == 0
    return folder, reported.err


def test_a_known_position_is_not_warned_of_and_a_standard_out_of_date_is(lab: tuple[Path, str]) -> None:
    assert "--position" not in lab[1]
    assert "warning: the standard table, serial RT-17 was due for calibration on 2026-01-31" in " ".join(lab[1].split())


def test_a_bias_with_the_input_axis_north_is_of_no_clause(
    lab: tuple[Path, str], run_command: Callable[..., Any]
) -> None:
    words = ("--unit", "N-1", "--metric", "bias", "--store", "S", "--json")
    rows = run_command("metrics", *words, cwd=lab[0]).json
    assert {each["parameters"]["earth_rate"] for each in rows} == {"none", "removed"}
    for each in rows:
        assert (each["standard"], each["clause"]) == ("informative", "mean of a static step")
        assert "GJB 2426A lays it east-west, JJF 2014 stands it upright" in each["parameters"]["remark"]
    page = run_command("metrics", "--annex-a", "N-1", "--store", "S", "--json", cwd=lab[0]).json["rows"]
    assert [row["results"] for row in page if row["metric"] == "bias"] == [[]]


def test_the_unit_1_leaves_no_blank_and_a_percentage_is_asked_about(
    lab: tuple[Path, str], run_command: Callable[..., Any]
) -> None:
    words = ("budget", "--unit", "N-1", "--metric", "scale_factor", "--store", "S")
    assert " ," not in run_command(*words, cwd=lab[0]).out
    refused = run_command(*words, "--p", 95, cwd=lab[0])
    assert refused.code == 1
    assert "did you mean 0.95?" in refused.err
