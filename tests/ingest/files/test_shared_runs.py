"""Runs that are named after a file: tests of other days are refused, other units are named, and so is what changes."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest


@pytest.fixture
def ask(run_command: Callable[..., Any], tmp_path: Path) -> Callable[..., Any]:
    def ask(*words: object, code: int = 0) -> Any:
        done = run_command(*words, "--store", "s", "--json", cwd=tmp_path)
        assert done.code == code, done.out + done.err
        return done.json

    for number, folder in enumerate(("bj", "sh")):
        values = 5.0 + np.random.default_rng(number).normal(0, 1, 99)
        (tmp_path / folder).mkdir()
        rows = "\n".join(f"{i},{value:.5f}" for i, value in enumerate(values))
        (tmp_path / folder / "still.csv").write_text(f"time[s],rate[deg/h]\n{rows}\n")
    return ask


def words(folder: str, unit: str, day: int, latitude: float) -> tuple[object, ...]:
    return (
        "import", f"{folder}/still.csv", "--unit", unit, "--start", f"2026-11-{day:02}T08:00:00+08:00",
        "--latitude", latitude, "--time-zone", "Asia/Shanghai", "--procedure", "static_bias", "--position", "IRA_up",
    )  # fmt: skip


def biases(ask: Callable[..., Any]) -> dict[str, float]:
    rows = ask("metrics", "--metric", "bias")
    return {row["unit"]: row["value"] for row in rows if row["parameters"]["earth_rate"] == "removed"}


def test_another_day_needs_a_run_of_its_own(ask: Callable[..., Any]) -> None:
    ask(*words("bj", "Y1", 2, 39.9))
    before = biases(ask)
    for more in ((), ("--restate",)):
        refused = ask(*words("sh", "Y2", 5, 31.2), *more, code=1)["error"]["message"]
        assert "run still, named after the file, has unit Y1 of 2026-11-02, more than a day apart" in refused
        assert "--run NAME" in refused
    refused = ask(*words("sh", "Y2", 5, 31.2), "--run", "still", code=1)["error"]["message"]
    assert (
        "is stored with latitude_deg 39.9, now it is 31.2; what is stored stays. The run has unit Y1 of 2026-"
        in refused
    )
    assert refused.endswith("--restate, which changes the values of unit Y1 of 2026-11-02 as well")
    (file,) = ask(*words("sh", "Y2", 5, 31.2), "--run", "sh")["files"]
    assert file["restated"] == []
    assert biases(ask)["Y1"] == before["Y1"]
    # on purpose
    (file,) = ask(*words("sh", "Y2", 5, 31.2), "--run", "still", "--restate")["files"]
    assert file["restated"] == [{"run": "still", "units": ["Y1"], "changes": {"latitude_deg": ["39.9", "31.2"]}}]
    assert biases(ask)["Y1"] != before["Y1"]


def test_another_unit_of_the_same_day_is_warned_of_once(ask: Callable[..., Any]) -> None:
    ask(*words("bj", "Y1", 2, 39.9))
    for found in (1, 0):
        (file,) = ask(*words("sh", "Y2", 2, 39.9))["files"]
        text = "run still, named after the file, has unit Y1 of 2026-11-02"
        assert len([each for each in file["remarks"] if text in each]) == found


@pytest.mark.long
def test_a_daily_file_of_one_name_is_warned_of(run_command: Callable[..., Any], tmp_path: Path) -> None:
    """One run of three days has one power-on in a repeatability."""
    rng = np.random.default_rng(4)
    for day in (21, 22, 23):
        rows = "\n".join(f"{at},{5 + rng.normal():.5f}" for at in range(300))
        (tmp_path / "data.csv").write_text(f"time[s],rate[deg/h]\n{rows}\n")
        given = ("--unit", "W", "--start", f"2026-11-{day}T08:00:00Z", "--procedure", "static_bias", "--store", "s")
        done = run_command("import", "data.csv", *given, cwd=tmp_path)
        assert done.code == 0, done.err
        assert ("run data, named after the file, has unit W of 2026-11-21" in done.err) is (day > 21), done.err
    # one that goes on within the day is the same test
    later = _later(rng, tmp_path, 9)
    assert "named after the file" not in run_command("import", *later, cwd=tmp_path).err
    assert run_command("runs", "exclude", "data", "--reason", "kicked", "--store", "s", cwd=tmp_path).code == 0
    done = run_command("import", *_later(rng, tmp_path, 10), "--run", "data", cwd=tmp_path)
    assert "run data is excluded from evaluation for unit W (kicked)" in done.err


def _later(rng: np.random.Generator, folder: Path, hour: int) -> tuple[str, ...]:
    """Another file of the same name, at an hour of the last day."""
    rows = "\n".join(f"{at},{5 + rng.normal():.5f}" for at in range(300))
    (folder / "data.csv").write_text(f"time[s],rate[deg/h]\n{rows}\n")
    start = f"2026-11-23T{hour:02d}:00:00Z"
    return "data.csv", "--unit", "W", "--start", start, "--procedure", "static_bias", "--store", "s"
