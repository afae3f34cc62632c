"""What `limits add` says of limits in a wrong unit, and how a wrong revision is replaced from its first day."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from analytics.specifications.far_limits import Kept, doubts
from gyrofleet import main
from storage.specifications.specification import SpecificationLimit
from tests.analytics.verdicts.few_metrics import computing
from tests.e2e.judging.test_groups_of_units import record

LIMIT = """
name = "P1"
revision = "{}"
valid_from = 2026-01-01
[[limit]]
metric = "bias"
parameters = {{ earth_rate = "none" }}
lower = 0
upper = {}
unit_of_measure = "{}"
"""
WALK = """
name = "WALK"
revision = "A"
[[limit]]
metric = "angle_random_walk"
upper = 10.0
unit_of_measure = "deg/sqrt(h)"
"""
Ask = Callable[..., Any]


@pytest.fixture
def enter(ask: Ask, tmp_path: Path) -> Callable[..., Any]:
    """Enter a revision; its answer, or the refusal."""

    def enter(revision: str, upper: float, unit: str, *words: str) -> Any:
        (tmp_path / "p1.toml").write_text(LIMIT.format(revision, upper, unit))
        words = ("limits", "add", str(tmp_path / "p1.toml"), *words, "--store", str(tmp_path / "S"), "--json")
        return json.loads(CliRunner().invoke(main, list(words)).stdout)

    files = (record(tmp_path / f"{at}.csv", f"G{at % 3}", 5.0 + at / 100, at, at + 1) for at in range(6))
    ask("import", *files)
    return enter


@pytest.mark.parametrize(
    ("upper", "unit", "said"),
    [(10.0, "deg/s", "10 deg/s is 7,"), pytest.param(0.002, "deg/h", "times 0.002 deg/h", marks=pytest.mark.long)],
)
def test_a_limit_far_from_all_stored_values_is_doubted_and_replaced(
    ask: Ask, enter: Callable[..., Any], upper: float, unit: str, said: str
) -> None:
    ask("metrics", "--metric", "bias")
    (doubt,) = enter("A", upper, unit)["doubts"]
    assert said in doubt
    assert re.search(r" of 6 stored values \([45]\.\d+ deg/h\)", doubt)
    assert doubt.endswith(": check its unit of measure")
    refused = enter("B", 10.0, "deg/h")["error"]["message"]
    assert "withdraw it (`gyrofleet limits withdraw P1-A --reason ..." in refused
    assert "then enter B by `gyrofleet limits add ... --rejudge" in refused
    ask("limits", "withdraw", "P1-A", "--reason", "unit of measure")
    assert enter("B", 10.0, "deg/h", "--rejudge")["doubts"] == []
    with computing("bias"):
        assert {(row["revision"], row["verdict"]) for row in ask("verdicts")["verdicts"]} == {("B", "PASS")}


def test_limits_far_beyond_the_values_of_a_few_units_are_no_doubt(ask: Ask, tmp_path: Path) -> None:
    """Two units with some hundredths of a deg/h within +-50 deg/h."""
    ask("import", *(record(tmp_path / f"G{at}.csv", f"G{at}", 0.004 * at, at) for at in (1, 2)))
    ask("metrics", "--metric", "bias")
    (tmp_path / "p1.toml").write_text(LIMIT.format("A", 50.0, "deg/h").replace("lower = 0", "lower = -50"))
    assert ask("limits", "add", str(tmp_path / "p1.toml"))["doubts"] == []


@pytest.mark.parametrize(
    ("count", "units", "bound", "doubted"),
    [(5, 3, -2000.0, True), (5, 2, -2000.0, False), (4, 3, -2000.0, False), (5, 3, -40_000.0, False)],
)
def test_values_far_inside_of_a_limit(count: int, units: int, bound: float, *, doubted: bool) -> None:
    values = [Kept(1.0, "1 deg/h", f"G{at % units}") for at in range(count)]
    found = list(doubts(SpecificationLimit(metric="bias", lower=bound, unit_of_measure="deg/h"), values))
    said = (
        "warning: bias: -2000 deg/h is 2,000 times the largest of 5 stored values (1 deg/h): check its unit of measure"
    )
    assert found == [said] * doubted


@pytest.mark.long
@pytest.mark.parametrize("names", [["WALK", "P1"], ["P1", "WALK"]])
def test_all_specifications_entered_after_a_run_judge_it_in_any_order(
    ask: Ask, tmp_path: Path, names: list[str]
) -> None:
    ask("import", record(tmp_path / "bad.csv", "BAD", 50.0, 1))
    texts = {"WALK": WALK, "P1": LIMIT.format("A", 10.0, "deg/h"), "LATER": LIMIT.format("A", 1.0, "deg/h")}
    texts["LATER"] = texts["LATER"].replace('"P1"', '"LATER"')
    for name in [*names, "LATER"]:
        if name == "LATER":  # nor is it judged again by another name
            ask("limits", "withdraw", "P1-A", "--reason", "renamed")
        (tmp_path / f"{name}.toml").write_text(texts[name])
        ask("limits", "add", tmp_path / f"{name}.toml")
    with computing("bias", "angle_random_walk"):
        found = ask("verdicts")
    rows = {(row["metric"], row["specification"], row["verdict"]) for row in found["verdicts"]}
    assert rows == {("angle_random_walk", "WALK", "PASS"), ("bias", "P1", "FAIL")}
    assert [row["verdict"] for row in found["units"]] == ["FAIL"]


@pytest.mark.long
def test_a_specification_entered_since_changes_no_verdict_of_what_limits_judged_when_it_was_recorded(
    ask: Ask, enter: Callable[..., Any], tmp_path: Path
) -> None:
    enter("A", 10.0, "deg/h")
    ask("import", record(tmp_path / "late.csv", "G9", 5.0, 9))
    (tmp_path / "walk.toml").write_text(WALK.replace("10.0", "1e-9"))
    ask("limits", "add", tmp_path / "walk.toml")
    with computing("bias", "angle_random_walk"):
        found = {row["unit"]: row["verdict"] for row in ask("verdicts")["units"]}
    assert (found.pop("G9"), set(found.values())) == ("PASS", {"FAIL"})
