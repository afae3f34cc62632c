"""What a unit or a limit lacks is named: averages that are not computed, outputs that are not there, products."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from analytics.evaluation.reasons import in_chinese
from tests.analytics.verdicts.few_metrics import computing
from tests.e2e.judging.conftest import Ask

AVERAGES = """
revision = "{}"
{}
[[limit]]
metric = "bias_stability_averaged"
parameters = {{ average_s = 50 }}
product = "K"
upper = 5.0
unit_of_measure = "deg/h"
"""
START = ("--start", "2026-01-05T08:00:00Z", "--procedure", "static_bias", "--position", "IRA_east_west")


@pytest.fixture(autouse=True)
def _few_metrics() -> Iterator[None]:
    with computing("bias_stability_averaged"):
        yield


def still(path: Path, signal: str, n: int = 600) -> Path:
    values = np.random.default_rng(3).normal(1.0, 1.0, n)
    path.write_text(f"time[s],{signal}\n" + "".join(f"{at},{value:.6f}\n" for at, value in enumerate(values)))
    return path


@pytest.fixture
def tested(ask: Ask, tmp_path: Path) -> Path:
    (tmp_path / "units.csv").write_text("serial,product\nK1,K\nK2,K\n")
    for unit, signal in (("K1", "rate[deg/h]"), ("K2", "temperature[degC]")):
        path = still(tmp_path / f"{unit}.csv", signal)
        ask("import", path, "--unit", unit, "--units", tmp_path / "units.csv", *START)
    return tmp_path


def test_averages_that_are_not_computed_are_named_with_the_remedy(ask: Ask, tested: Path) -> None:
    path = tested / "k.toml"
    path.write_text(AVERAGES.format("A", ""))
    (said,) = ask("limits", "add", path)["doubts"]
    remedy = 'write average_s = 50 in [product."K"]'
    assert said.startswith("warning: bias_stability_averaged (average_s = 50): averages of 50 s are not computed")
    assert said.endswith(remedy)
    reasons = {row["unit"]: row["reason"] for row in ask("verdicts", "--unit", "K1", "--unit", "K2")["verdicts"]}
    assert reasons["K1"] == (
        f"averages of 50 s are not computed: {remedy} of its specification, and enter that with "
        "`gyrofleet limits revise --rejudge`"
    )
    # there is a static step: what it lacks is the output
    assert reasons["K2"] == (
        "its steps (static_bias) are there, but without the output of a gyro (of temperature alone): import a column "
        "of its rate, or name its output rate"
    )
    assert all(in_chinese(each) != each for each in reasons.values())
    path.write_text(AVERAGES.format("B", "valid_from = 2026-01-01") + '[product."K"]\naverage_s = 50\n')
    assert ask("limits", "revise", path, "--reason", "average", "--rejudge")["doubts"] == []
    assert {row["unit"]: row["verdict"] for row in ask("verdicts")["units"]} == {"K1": "PASS", "K2": "NO_DATA"}


def test_a_product_that_no_unit_has_is_named(ask: Ask, tested: Path) -> None:
    path = tested / "k.toml"
    path.write_text(
        'revision = "A"\n[product."k"]\n[[limit]]\nmetric = "bias_stability"\nproduct = "k"\nupper = 5.0\n'
        'unit_of_measure = "deg/h"\n'
    )
    said = ask("limits", "add", path)
    assert said["doubts"] == ["warning: no unit of the store is of product 'k'; did you mean K?"]
