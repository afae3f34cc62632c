"""Runs that lack a channel of the model are left out, and the verdict says so first."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np


def test_nothing_is_denied_of_runs_that_were_left_out(run_command: Callable[..., Any], tmp_path: Path) -> None:
    """Of three runs one alone has the table's rate."""
    rng = np.random.default_rng(3)
    at = np.arange(3600)
    rates = np.where(at // 300 % 2, 10.0, -10.0)
    for name, title, own in (("turned", ",input_rate[deg/s]", True), ("a", "", False), ("b", "", False)):
        values = rng.normal(5.0, 1.0, at.size) + (3600.0 * rates if own else 0.0)
        rows = [f"{t},{v:.4f}" + (f",{r}" if own else "") for t, v, r in zip(at, values, rates, strict=True)]
        (tmp_path / f"{name}.csv").write_text(f"time[s],rate[deg/h]{title}\n" + "\n".join(rows) + "\n")
    files = ["turned.csv", "a.csv", "b.csv"]
    assert run_command("import", *files, "--unit", "U", "--store", "s", cwd=tmp_path).code == 0
    model = "rate = bias + scale_factor*input_rate"
    found = run_command(
        "diagnose", "--unit", "U", "--signal", "rate", "--model", model, "--store", "s", "--json", cwd=tmp_path
    ).json
    assert found["verdict"] != "nothing_missing"
    assert {round(each["share"], 2) for each in found["left_out"] if "lack a channel" in each["why"]} == {0.67}
