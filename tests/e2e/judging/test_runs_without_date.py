"""A run whose date is not known, of a product whose specification has revisions: its unit does not pass."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

SPECIFICATION = """
name = "S"
revision = "{revision}"
valid_from = {day}
[[limit]]
metric = "bias"
parameters = {{ earth_rate = "none" }}
upper = {upper}
unit_of_measure = "deg/h"
"""


@pytest.mark.long
def test_a_value_that_no_revision_judges_keeps_its_unit_from_passing(
    run_command: Callable[..., Any], tmp_path: Path
) -> None:
    """The bad run is beyond the limit of either revision; the unit had passed, with a yield of 100 %."""
    rng = np.random.default_rng(1)
    for name, bias in (("good", 2.0), ("bad", 20.0)):
        rows = "\n".join(f"{at},{bias + 0.5 * rng.standard_normal():.5f}" for at in range(4000))
        (tmp_path / f"{name}.csv").write_text(f"time[s],rate[deg/h]\n{rows}\n")
    for revision, day, upper, word in (("A", "2026-01-01", 3.0, "add"), ("B", "2026-02-01", 2.5, "revise")):
        (tmp_path / f"{revision}.toml").write_text(SPECIFICATION.format(revision=revision, day=day, upper=upper))
        reason = ("--reason", "tighter") if word == "revise" else ()
        assert run_command("limits", word, f"{revision}.toml", *reason, "--store", "s", cwd=tmp_path).code == 0
    step = ("--unit", "U", "--procedure", "static_bias", "--position", "IRA_up", "--store", "s")
    assert run_command("import", "good.csv", *step, "--start", "2026-03-01T12:00:00Z", cwd=tmp_path).code == 0
    found = run_command("verdicts", "--store", "s", "--json", cwd=tmp_path).json["units"]
    assert [each["verdict"] for each in found] == ["PASS"]
    assert run_command("import", "bad.csv", *step, cwd=tmp_path).code == 0
    found = run_command("verdicts", "--store", "s", "--json", cwd=tmp_path).json
    (unit,) = found["units"]
    assert (unit["verdict"], unit["latest_verdict"], unit["no_data"]) == ("NO_DATA", "NO_DATA", 1)
    assert {(row["run"], row["verdict"]) for row in found["verdicts"]} == {("good", "PASS"), ("bad", "NO_DATA")}


@pytest.mark.long  # in the gate: unit FROZE of `test_doubtful_records.py`
def test_an_output_that_stood_still_has_no_bounds_of_its_deviation(
    run_command: Callable[..., Any], tmp_path: Path
) -> None:
    rng = np.random.default_rng(2)
    rates = 2.0 + 0.5 * rng.standard_normal(4000)
    rates[1000:3400] = rates[1000]
    rows = "\n".join(f"{at},{rate:.5f}" for at, rate in enumerate(rates))
    (tmp_path / "w.csv").write_text(f"time[s],rate[deg/h]\n{rows}\n")
    step = ("--unit", "U", "--procedure", "static_bias", "--position", "IRA_up", "--store", "s")
    assert run_command("import", "w.csv", *step, cwd=tmp_path).code == 0
    found = run_command("metrics", "--store", "s", "--json", cwd=tmp_path).json
    of = [row for row in found if row["metric"] in {"bias_stability", "bias_stability_averaged"} and row["value"]]
    assert len(of) >= 3
    assert [(row["lo"], row["hi"]) for row in of] == [(None, None)] * len(of)
