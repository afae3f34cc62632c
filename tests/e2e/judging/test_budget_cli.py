"""From the station's file and samples to budgets: by the commands that people use."""

import csv
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from gyrofleet import main

STATION = """
[station]
site = "plant"
name = "lab"
latitude_deg = 40.0

[instruments.table]
kind = "rate_table"
resource = "TCPIP::127.0.0.1::5025::SOCKET"
max_rate_deg_per_s = 400.0
serial = "RT-17"
certificate = "LL-2026-0117"
calibration_due = {due}
uncertainty.rate = {{ U = 1e-4, unit = "1" }}

[standards.level]
uncertainty.levelling = {{ U = 60, k = 2, unit = "arcsec" }}
[standards.north]
uncertainty.heading = {{ half_width = 3, distribution = "uniform", unit = "arcmin" }}
[standards.position]
uncertainty.latitude = {{ U = 36, k = 3, unit = "arcsec", freedom = 50 }}
"""
ANOTHER_TABLE = """
[standards.other_table]
serial = "RT-18"
uncertainty.rate = { U = 1e-5, unit = "1" }
"""
EARTH = 15.041067 * math.pi / 648_000  # deg/h per arcsec
Ask = Callable[..., Result]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    here = tmp_path_factory.mktemp("budget")
    rng = np.random.default_rng(3)
    with (here / "still.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time[s]", "rate[deg/h]"])
        writer.writerows([i, f"{20 + noise:.6f}"] for i, noise in enumerate(rng.normal(0, 0.5, 3600)))
    (here / "station.toml").write_text(STATION.format(due="2027-03-31"))
    (here / "old.toml").write_text(STATION.format(due="2025-03-31"))
    (here / "two.toml").write_text(STATION.format(due="2025-03-31") + ANOTHER_TABLE)
    imported(here, ("up", "IRA_up", "station.toml"))
    return here


def imported(here: Path, *runs: tuple[str, str, str | None]) -> None:
    for run, position, station in runs:
        where = ["--station", here / station] if station else ["--latitude", 40]
        words = [
            "import", here / "still.csv", "--unit", "U1", "--run", run, "--procedure", "static_bias", "--position",
            position, "--start", "2026-11-20T00:00:00Z", *where, "--store", here / "S",
        ]  # fmt: skip
        done = CliRunner().invoke(main, [str(word) for word in words])
        assert done.exit_code == 0, done.output


@pytest.fixture(scope="module")
def other_runs(folder: Path) -> None:
    """Those that no test of the gate asks for."""
    imported(
        folder, ("east", "IRA_east", "station.toml"), ("old", "IRA_up", "old.toml"), ("two", "IRA_up", "two.toml"),
        ("plain", "IRA_up", None),
    )  # fmt: skip


@pytest.fixture
def ask(folder: Path) -> Ask:
    def asked(*words: object) -> Result:
        return CliRunner().invoke(main, [*(str(word) for word in words), "--store", str(folder / "S")])

    return asked


def budget(ask: Ask, run: str, *words: object) -> dict[str, Any]:
    done = ask("budget", "--unit", "U1", "--metric", "bias", "--run", run, "--json", *words)
    assert done.exit_code == 0, done.output
    document: dict[str, Any] = json.loads(done.stdout)
    every = [document, *document["others"]]
    return next(each for each in every if each["parameters"]["earth_rate"] == "removed")


def parts(found: dict[str, Any]) -> dict[str, float]:
    return {each["name"]: each["contribution"] for each in found["components"]}


@pytest.mark.long
@pytest.mark.usefixtures("other_runs")
def test_an_upright_axis_sees_level_and_latitude(ask: Ask) -> None:
    found = budget(ask, "up")
    cosine = math.cos(math.radians(40))
    own = parts(found)
    assert own["levelling"] == pytest.approx(EARTH * cosine * 30, rel=1e-6)
    assert own["latitude"] == pytest.approx(EARTH * cosine * 12, rel=1e-6)
    assert own["north reference"] == 0
    # an error of the scale factor acts on the output as a whole, whatever is subtracted from it afterwards
    output = found["value"] + 15.041067 * math.sin(math.radians(40))
    assert own["table rate, error common to all rates"] == pytest.approx(output * 5e-5, rel=1e-6)
    assert found["u_type_b"] == pytest.approx(math.hypot(*(own[name] for name in own if not name.startswith("sc"))))
    assert found["u"] == pytest.approx(math.hypot(found["u_type_a"], found["u_type_b"]))
    assert found["U"] == pytest.approx(found["k"] * found["u"])
    assert found["method"] == "JCGM 100"


@pytest.mark.long
@pytest.mark.usefixtures("other_runs")
def test_an_axis_that_points_east_sees_level_and_north(ask: Ask) -> None:
    own = parts(budget(ask, "east"))
    assert own["north reference"] == pytest.approx(EARTH * math.cos(math.radians(40)) * 180 / math.sqrt(3), rel=1e-6)
    assert own["levelling"] == pytest.approx(EARTH * math.sin(math.radians(40)) * 30, rel=1e-6)
    assert own["latitude"] == 0


@pytest.mark.long
@pytest.mark.usefixtures("other_runs")
def test_metrics_have_the_figures_of_the_budget(ask: Ask) -> None:
    rows = json.loads(ask("metrics", "--unit", "U1", "--metric", "bias", "--json").stdout)
    for run in ("up", "east"):
        found = budget(ask, run)
        (row,) = [e for e in rows if e["run"] == run and e["parameters"]["earth_rate"] == "removed"]
        for name in ("u_type_a", "u_type_b", "U", "k", "nu", "p"):
            assert row[name] == pytest.approx(found[name], rel=1e-9), name
        assert row["uncertainty_reason"] is None


@pytest.mark.long
@pytest.mark.usefixtures("other_runs")
@pytest.mark.parametrize(
    ("run", "reason"),
    [
        ("old", "the calibration of table, serial RT-17, certificate LL-2026-0117 ended on 2025-03-31"),
        ("two", "ended on 2025-03-31; another standard of the station states it too: take out what was not used"),
        ("plain", "the station states none"),
    ],
)
def test_what_is_not_stated_or_out_of_date_is_no_zero(ask: Ask, run: str, reason: str) -> None:
    found = budget(ask, run)
    assert (found["u_type_b"], found["U"], found["k"], found["p"]) == (None, None, None, None)
    assert found["u_type_a"] > 0
    assert reason in found["reason"]
    rows = json.loads(ask("metrics", "--unit", "U1", "--metric", "bias", "--run", run, "--json").stdout)
    assert all(row["U"] is None and row["u_type_b"] is None and reason in row["uncertainty_reason"] for row in rows)
    assert all(row["u_type_a"] > 0 for row in rows)


LIMITS = """
name = "data-sheet"
revision = "A"
[[limit]]
metric = "bias"
parameters = { earth_rate = "none" }
lower = 10.0
upper = 30.0
unit_of_measure = "deg/h"
"""


def test_a_standard_out_of_date_makes_no_value_pass(folder: Path, ask: Ask, tmp_path: Path) -> None:
    imported(folder, ("old", "IRA_up", "old.toml"), ("plain", "IRA_up", None))
    (tmp_path / "limits.toml").write_text(LIMITS)
    assert ask("limits", "add", tmp_path / "limits.toml", "--reason", "first").exit_code == 0
    undated = [
        "import", folder / "still.csv", "--unit", "U2", "--run", "undated", "--procedure", "static_bias", "--position",
        "IRA_up", "--station", folder / "old.toml",
    ]  # fmt: skip
    assert ask(*undated).exit_code == 0
    rows = json.loads(ask("verdicts", "--json").stdout)["verdicts"]
    found = {row["run"]: row for row in rows}
    assert found["up"]["verdict"] == "PASS"
    assert (found["old"]["verdict"], found["old"]["conformity"]) == ("MARGINAL", None)
    assert "RT-17, certificate LL-2026-0117 ended on 2025-03-31, so that nothing states" in found["old"]["reason"]
    (row,) = (row for row in rows if row["unit"] == "U2")
    assert (row["verdict"], row["conformity"]) == ("MARGINAL", None)
    assert "ended on 2025-03-31" in row["reason"]
    assert "(type" in ask("verdicts", "--unit", "U1").stdout, "of the run whose station states nothing"


def test_a_given_coverage_factor_and_monte_carlo(ask: Ask) -> None:
    found = budget(ask, "up", "--k", 2, "--monte-carlo")
    assert found["k"] == 2
    assert found["U"] == pytest.approx(2 * found["u"])
    assert found["monte_carlo"]["method"] == "JCGM 101"
    assert found["monte_carlo"]["p"] == found["p"]


@pytest.mark.long
@pytest.mark.usefixtures("other_runs")
def test_the_table_fits_80_columns_in_both_languages(ask: Ask, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    for language, words in (("en", ("levelling", "combined")), ("zh", ("调平", "合成", "扩展不确定度"))):
        done = ask("budget", "--unit", "U1", "--metric", "bias", "--lang", language)
        assert done.exit_code == 0
        assert all(word in done.stdout for word in words[:2])
        assert max(map(len, done.stdout.splitlines())) <= 80


@pytest.mark.long
@pytest.mark.usefixtures("other_runs")
def test_a_value_that_is_not_there_is_said(ask: Ask) -> None:
    done = ask("budget", "--unit", "U1", "--metric", "scale_factor", "--json")
    assert done.exit_code == 1
    assert "needs at least 11 rates" in done.output
