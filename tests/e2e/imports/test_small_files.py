"""Many small files in one command: one recorder for all, estimates of rates only, each file reported."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

FILES, ROWS = 12, 60
CHANNELS = ("supply_voltage[V]", "supply_current[A]", "temperature[degC]")


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Files of one run a day, a rate in counts and three channels each, a row a minute."""
    folder = tmp_path_factory.mktemp("many")
    rng = np.random.default_rng(5)
    paths = []
    for day in range(FILES):
        columns: dict[str, Any] = {"time[s]": 1.79e9 + 86400 * day + 60.0 * np.arange(ROWS)}
        columns["rate[count]"] = rng.integers(-50, 50, ROWS)
        columns |= {name: 5.0 + rng.normal(size=ROWS) for name in CHANNELS}
        pl.DataFrame(columns).write_csv(folder / f"day{day:02}.csv")
        paths.append(folder / f"day{day:02}.csv")
    return paths


def test_many_files_of_one_command_go_through_one_recorder(
    gyrofleet: Callable[..., Any], tmp_path: Path, many: list[Path]
) -> None:
    done = gyrofleet("import", *many, "--unit", "U1")
    assert done.code == 0, done.err
    lines = done.out.splitlines()
    assert sum("4 signals, 240 samples added" in line for line in lines) == FILES
    assert f"{FILES} files: {FILES * 240:,} samples in the lake of gyrofleet-data, each once" in done.out
    assert len(list((tmp_path / "gyrofleet-data" / "log").glob("*.mcap"))) == 1
    rows = gyrofleet("sql", "select signal, count(distinct run) as runs from estimates group by all", "--json").json
    assert rows == [{"signal": "rate", "runs": FILES}]
    again = gyrofleet("import", *many, "--unit", "U1", "--json").json["files"]
    assert [each["signals"][0]["already_stored"] for each in again] == [ROWS] * FILES


@pytest.mark.long
def test_signals_that_are_named_are_estimated_as_well(gyrofleet: Callable[..., Any], many: list[Path]) -> None:
    gyrofleet("import", many[0], "--unit", "U1", "--estimates", "supply_voltage")
    wrong = gyrofleet("import", many[1], "--unit", "U1", "--estimates", "all", "--estimates", "suply_voltage")
    assert "nothing delivers suply_voltage, which --estimates names; there is rate, supply_current" in wrong.err
    rows = gyrofleet(
        "sql", "select run, list(distinct signal order by signal) as s from estimates group by run", "--json"
    )
    estimated = {row["run"]: row["s"] for row in rows.json}
    assert estimated["day00"] == ["rate", "supply_voltage"]
    assert estimated["day01"] == ["rate", "supply_current", "supply_voltage", "temperature"]
    # what is not estimated on its way is computed when it is asked for
    curve = gyrofleet("allan", "--unit", "U1", "--signal", "temperature", "--run", "day00", "--json")
    assert curve.code == 0, curve.err


def test_files_of_one_run_in_one_command_make_one_run(gyrofleet: Callable[..., Any], tmp_path: Path) -> None:
    time = 1.79e9 + np.arange(ROWS)
    step = np.repeat(["cold", "hot"], ROWS // 2)
    for unit in ("A", "B"):
        pl.DataFrame({"time[s]": time, "unit": unit, "step": step, "rate[deg/h]": np.sin(time)}).write_csv(
            tmp_path / f"{unit}.csv"
        )
    pl.DataFrame({"time[s]": time, "unit": "A", "temperature[degC]": np.cos(time)}).write_csv(tmp_path / "more.csv")
    done = gyrofleet("import", "A.csv", "B.csv", "more.csv", "--run", "night", "--json")
    assert done.code == 0, done.err
    assert [each["signals"][0]["in_lake"] for each in done.json["files"]] == [ROWS] * 3
    runs = gyrofleet("sql", "select run, outcome, samples from runs", "--json").json
    assert runs == [{"run": "night", "outcome": "completed", "samples": 3 * ROWS}]
    started = gyrofleet("sql", "select kind, count(*) as n from events where kind like '%Started' group by 1", "--json")
    assert {row["kind"]: row["n"] for row in started.json} == {"RunStarted": 1, "StepStarted": 4}


def test_files_that_give_a_run_a_date_and_none_are_refused_before_anything_is_stored(
    gyrofleet: Callable[..., Any], tmp_path: Path
) -> None:
    for unit, begin in (("A", 1.79e9), ("B", 0.0)):
        pl.DataFrame({"time[s]": begin + np.arange(9.0), "unit": unit, "rate[deg/h]": 1.0}).write_csv(
            tmp_path / f"{unit}.csv"
        )
    done = gyrofleet("import", "A.csv", "B.csv", "--run", "night")
    assert done.code == 1
    assert "B.csv: its times count from the start of run night, whose date A.csv gives" in done.err
    assert not list(tmp_path.glob("gyrofleet-data/log/*.mcap"))


@pytest.mark.long
def test_a_file_that_contradicts_the_store_keeps_its_group_out(
    gyrofleet: Callable[..., Any], tmp_path: Path, many: list[Path]
) -> None:
    gyrofleet("import", many[3], "--unit", "U1")
    changed = pl.read_csv(many[3]).with_columns(pl.col("supply_voltage[V]") + 1.0)
    changed.write_csv(tmp_path / "day03.csv")
    done = gyrofleet("import", many[2], "day03.csv", "--unit", "U1")
    assert done.code == 1
    assert "overlaps what is stored of unit U1, signal supply_voltage, run day03" in done.err
    assert gyrofleet("sql", "select run from runs", "--json").json == [{"run": "day03"}]
