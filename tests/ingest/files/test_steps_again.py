"""Files of a run whose steps lie over those that are stored: each sample counts in one step."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

START = ("--start", "2026-03-01T12:00:00Z")
AT_REST = ("--procedure", "static_bias", "--position", "IRA_up")
TURN = (0, -10, 10, -20, 20, -30, 30, -40, 40, -50, 50, 0)
RATES = np.round(5.0 + np.random.default_rng(1).normal(0, 1, 400), 5)


@pytest.fixture
def ask(run_command: Callable[..., Any], tmp_path: Path) -> Callable[..., Any]:
    def ask(*words: object, code: int = 0) -> Any:
        done = run_command(*words, "--store", "s", "--json", cwd=tmp_path)
        assert done.code == code, done.out + done.err
        return done

    return ask


def turns(path: Path, sign: int, rates: Sequence[float] = TURN, first: int = 0, count: int = 20) -> Path:
    """A gyro with a scale factor of 1 on a table, of whose commanded rates the file has the sign."""
    lines = ["time[s],rate[deg/s],procedure,step,rate_command[deg/s]"]
    for i, rate in enumerate(rates):
        for j in range(count):
            at = (first + i) * count + j
            lines.append(f"{at},{rate + RATES[at % 400] / 1e4:.7f},scale_factor,rate,{sign * rate:g}")
    path.write_text("\n".join(lines) + "\n")
    return path


def still(path: Path, first: int, last: int) -> Path:
    """A part of a record at rest."""
    path.write_text("\n".join(["time[s],rate[deg/h]", *(f"{i},{RATES[i]}" for i in range(first, last))]) + "\n")
    return path


def scale_factor(ask: Callable[..., Any]) -> list[float | None]:
    return [row["value"] for row in ask("metrics", "--metric", "scale_factor").json if row["value"] is not None]


def steps(ask: Callable[..., Any]) -> list[tuple[int, int]]:
    """First and last second of each step."""
    start = "epoch_ns(timestamp '2026-03-01 12:00:00')"
    asked = f"select (t_start_ns - {start}) // 1000000000 as a, (t_end_ns - {start}) // 1000000000 as b from steps"
    return [(row["a"], row["b"]) for row in ask("sql", f"{asked} order by 1, 2").json]


def test_other_words_over_stored_samples_are_refused(ask: Callable[..., Any], tmp_path: Path) -> None:
    turns(tmp_path / "wrong.csv", -1)
    turns(tmp_path / "right.csv", 1)
    words = ("--unit", "G", "--run", "scale", *START)
    ask("import", "wrong.csv", *words)
    refused = ask("import", "right.csv", *words, code=1).json["error"]["message"]
    assert "unit G, run scale has a step there already, with rate_command 10 deg/s; what is recorded stays" in refused
    assert ": from 2026-03-01 12:00:20.000000 UTC to 2026-03-01 12:00:39.000000 UTC the file has rate_" in refused
    assert "the file has rate_command -10 deg/s in its step rate (and so on, in 10 of its 12 steps)" in refused
    assert "`gyrofleet runs exclude scale --reason ... --store " in refused
    assert len(steps(ask)) == 12
    (file,) = ask("import", "wrong.csv", *words).json["files"]
    assert (file["steps"], file["steps_added"], file["signals"][0]["added"]) == (12, 0, 0)
    assert ask("import", "right.csv", "--unit", "G", "--run", "again", *START).code == 0
    assert {round(value or 0.0, 2) for value in scale_factor(ask)} == {-1.0, 1.0}


def test_steps_after_the_stored_ones_are_added(ask: Callable[..., Any], tmp_path: Path) -> None:
    words = ("--unit", "G", "--run", "scale", *START)
    ask("import", turns(tmp_path / "a.csv", 1, TURN[:5]), *words)
    ask("import", turns(tmp_path / "b.csv", 1, TURN[5:], first=5), *words)
    assert steps(ask) == [(20 * i, 20 * i + 19) for i in range(12)]
    assert {round(value or 0.0, 2) for value in scale_factor(ask)} == {1.0}


def test_a_position_that_a_column_corrects_is_refused(ask: Callable[..., Any], tmp_path: Path) -> None:
    for name, position in (("wrong", "X_up"), ("right", "Z_up")):
        lines = [f"{i},{RATES[i]},static_bias,still,{position}" for i in range(90)]
        (tmp_path / f"{name}.csv").write_text(
            "\n".join(["time[s],rate_z[deg/h],procedure,step,position", *lines]) + "\n"
        )
    words = ("--unit", "G", "--run", "r", *START)
    ask("import", "wrong.csv", *words)
    refused = ask("import", "right.csv", *words, code=1).json["error"]["message"]
    assert "has a step there already, with position X_up; what is recorded stays" in refused
    assert "the file has position Z_up" in refused
    # a part of it, with an option for the rest of the words
    still(tmp_path / "part.csv", 10, 20).write_text("time[s],rate_y[deg/h]\n" + "11,1\n12,2\n")
    refused = ask("import", "part.csv", *words, "--procedure", "static_bias", code=1).json["error"]["message"]
    assert "with step still, position X_up; what is recorded stays" in refused
    assert "the file has step (not given), position (not given)" in refused


@pytest.mark.parametrize(
    "parts",
    [
        [(0, 200), (150, 400), (0, 400)],
        [(150, 400), (0, 200), (0, 400)],
        [(0, 200), (200, 400)],
        [(200, 400), (0, 200)],
        [(0, 100), (300, 400), (90, 310)],
        [(0, 400), (100, 200), (0, 400)],
    ],
    ids=["overlap", "later-first", "adjoining", "adjoining-later-first", "between", "within"],
)
@pytest.mark.in_gate("later-first")
def test_parts_of_one_record_are_one_step(
    ask: Callable[..., Any], tmp_path: Path, parts: list[tuple[int, int]]
) -> None:
    words = ("--unit", "U", "--run", "r", *START, *AT_REST)
    for i, (first, last) in enumerate(parts):
        ask("import", still(tmp_path / f"{i}.csv", first, last), *words)
    assert steps(ask) == [(0, 399)]
    ((value, n),) = [(row["value"], row["n"]) for row in ask("metrics", "--metric", "bias").json if row["value"]]
    assert n == 400
    assert value == pytest.approx(RATES.mean(), rel=1e-6)
    ((again),) = ask("import", f"{len(parts) - 1}.csv", *words).json["files"]
    assert (again["steps_added"], again["signals"][0]["added"]) == (0, 0)


def test_a_step_that_grows_over_another_one_is_refused(ask: Callable[..., Any], tmp_path: Path) -> None:
    for name, edge in (("wrong", 50), ("right", 70)):
        lines = [f"{i},{RATES[i]},static_bias,{'IRA_up' if i < edge else 'IRA_down'}" for i in range(90)]
        (tmp_path / f"{name}.csv").write_text("\n".join(["time[s],rate[deg/h],procedure,position", *lines]) + "\n")
    words = ("--unit", "U", "--run", "r", *START)
    ask("import", "wrong.csv", *words)
    refused = ask("import", "right.csv", *words, code=1).json["error"]["message"]
    assert "has a step there already, with position IRA_down; what is recorded stays" in refused
    assert (
        "from 2026-03-01 12:00:50.000000 UTC to 2026-03-01 12:01:09.000000 UTC the file has position IRA_up" in refused
    )
    assert steps(ask) == [(0, 49), (50, 89)]


def test_parts_with_a_gap_between_them_are_two_steps(ask: Callable[..., Any], tmp_path: Path) -> None:
    words = ("--unit", "U", "--run", "r", *START, *AT_REST)
    for i, (first, last) in enumerate([(0, 100), (103, 200)]):
        ask("import", still(tmp_path / f"{i}.csv", first, last), *words)
    assert steps(ask) == [(0, 99), (103, 199)]
