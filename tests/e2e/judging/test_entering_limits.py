"""What `limits add` says of limits in a wrong unit, and how a wrong revision is replaced from its first day."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from gyrofleet import main
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
Ask = Callable[..., Any]


@pytest.fixture
def enter(ask: Ask, tmp_path: Path) -> Callable[..., Any]:
    """Enter a revision; its answer, or the refusal."""

    def enter(revision: str, upper: float, unit: str, *words: str) -> Any:
        (tmp_path / "p1.toml").write_text(LIMIT.format(revision, upper, unit))
        words = ("limits", "add", str(tmp_path / "p1.toml"), *words, "--store", str(tmp_path / "S"), "--json")
        return json.loads(CliRunner().invoke(main, list(words)).stdout)

    ask("import", record(tmp_path / "one.csv", "G1", 5.0, 1))
    return enter


@pytest.mark.parametrize(
    ("upper", "unit", "said"),
    [(10.0, "deg/s", "10 deg/s is 7,2"), pytest.param(0.002, "deg/h", "times 0.002 deg/h", marks=pytest.mark.long)],
)
def test_a_limit_far_from_all_stored_values_is_doubted_and_replaced(
    ask: Ask, enter: Callable[..., Any], upper: float, unit: str, said: str
) -> None:
    ask("metrics", "--metric", "bias")
    (doubt,) = enter("A", upper, unit)["doubts"]
    assert said in doubt
    assert doubt.endswith(": check its unit of measure")
    refused = enter("B", 10.0, "deg/h")["error"]["message"]
    assert "withdraw it (`gyrofleet limits withdraw P1-A --reason ..." in refused
    assert "then enter B by `gyrofleet limits add ... --rejudge" in refused
    ask("limits", "withdraw", "P1-A", "--reason", "unit of measure")
    assert enter("B", 10.0, "deg/h", "--rejudge")["doubts"] == []
    with computing("bias"):
        assert [(row["revision"], row["verdict"]) for row in ask("verdicts")["verdicts"]] == [("B", "PASS")]
